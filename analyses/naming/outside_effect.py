"""An effect of your own, in one file outside the package: solar radiation pressure.

The Sun's direction is fixed in inertial axes and turns through the body as it slews, so that this
torque can
be told from a body-fixed one. The script proves the effect's contract, hides it in simulated
telemetry, and
fits it together with the inertia tensor. Run it with `python -m analyses.naming.outside_effect`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.check_effect import check_effect
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import Normal, vector
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.small_campaign import small_campaign


@dataclass(frozen=True)
class SolarPressure(Effect):
    """The force of sunlight, `force` [N] away from the Sun, acts at the centre of pressure, `arm`
    [m] from the centre of mass.

    The arm's component along the Sun's direction does nothing while that direction does not change:
    slews make it visible.
    """

    name: ClassVar[str] = "solar_pressure"
    force: float = 4.56e-6 * 1.3 * 2.0  # pressure at 1 au [Pa], optical coefficient, area [m^2]
    sun_N: tuple[float, float, float] = (0.6, 0.0, 0.8)
    sigma: float = 0.3  # [m], of the arm: a wing on one side

    def parameters(self, campaign):
        return (vector("arm", "xyz", unit="m", prior=Normal(0.0, self.sigma)),)

    def body_torque(self, p, slew, t, state):
        sun_B = quaternion.to_body(state.attitude, jnp.array(self.sun_N))
        return jnp.cross(p["arm"], -self.force * sun_B)


def simulated(model: Model, theta: np.ndarray, seed: int) -> Campaign:
    """The model's campaign with the telemetry that theta (d,) predicts, plus its noise."""
    rng, campaign = np.random.default_rng(seed), model.campaign
    nuisances = jnp.zeros((model.n_slews, model.structure.n_local))
    flown = predict_all(model.structure, jnp.asarray(theta), nuisances, jnp.zeros(3), model.data)
    tracker, wheels = campaign.star_tracker, np.array([w.momentum_sigma for w in campaign.wheels])
    sigma = np.where(
        np.array(tracker.boresight_B) > 0.5, tracker.sigma_roll, tracker.sigma_cross
    )  # boresight along a body axis
    slews = []
    for i, slew in enumerate(campaign.slews):
        rows = len(slew.time)
        error = quaternion.exp(jnp.asarray(sigma * rng.normal(size=(rows, 3))))
        rate = np.array(flown[0][i, :rows]) + np.array(campaign.rate_sensor.sigma) * rng.normal(
            size=(rows, 3)
        )
        momentum = np.array(flown[2][i, :rows]) + wheels * rng.normal(size=(rows, len(wheels)))
        slews.append(
            replace(
                slew,
                rate=rate,
                attitude=np.array(quaternion.multiply(flown[1][i, :rows], error)),
                wheel_momentum=momentum,
            )
        )
    return replace(campaign, slews=tuple(slews))


def main(seed: int = 1) -> tuple[Estimate, np.ndarray]:
    """Check the effect, hide it, fit it; the estimate and the truth (d,)."""
    effect = SolarPressure()
    print(
        f"{effect.name}: the contract holds; "
        f"fingerprint {dict(check_effect(effect).fingerprint['commanded'])}"
    )
    quiet = Model(small_campaign(), (effect,))
    truth = quiet.space.mean + np.concatenate(
        [quiet.space.sd[:6] * 0.5, np.zeros(3), [0.25, -0.15, 0.1]]
    )
    fitted = estimate(Model(simulated(quiet, truth, seed), (effect,)), starts=1)
    for name, value, sd, true in zip(
        fitted.model.space.names, fitted.theta, fitted.sd, truth, strict=True
    ):
        print(f"{name:24s} {value:10.5f} +- {sd:.5f}   truth {true:10.5f}")
    return fitted, truth


if __name__ == "__main__":
    main()
