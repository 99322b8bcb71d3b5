"""One plan in a comparison: what to expect of it, what fits achieved, and what it costs.

The expected accuracy is exact: the plan is flown in the closed loop, and the model is linearised
there as a fit of its telemetry is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin, planned_margins
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight, first_states, fly
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight, draw_spacecraft
from bayes_inertia.flight.spacecraft import Controller
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate, Starts
from bayes_inertia.inference.likelihood import Point, information_blocks
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.objective import normal_equations
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model

# What the names of such plans say.
_REFERENCE = "like the paper's"


@array_dataclass
class Contender:
    """One plan in a comparison.

    Parameters
    ----------
    name : str
        The plan's name in the comparison.
    plan : Plan
        What would be flown.
    expected : (6 + axes,) array
        Sds of J [kg m^2] and K to expect, see `expected_sd`.
    achieved : AchievedErrors or None
        What fits to simulated campaigns achieved; None unless simulated.
    total_time : float
        From the first row of telemetry to the last [s].
    motion_time : float
        Of all slews [s].
    peak_momentum : float
        Largest of any wheel, planned [N m s]; NaN where unlimited.
    peak_torque : float
        Largest of any wheel, planned [N m]; NaN where unlimited.
    margins : tuple of Margin
        What is left of every limit.
    """

    name: str
    plan: Plan
    expected: np.ndarray
    achieved: AchievedErrors | None
    total_time: float
    motion_time: float
    peak_momentum: float
    peak_torque: float
    margins: tuple[Margin, ...]

    @property
    def is_reference(self) -> bool:
        """Whether it is of slews like the paper's, which other plans are measured by."""
        return _REFERENCE in self.name

    @property
    def worst_cross_term(self) -> float:
        """Largest expected sd of a product of inertia [kg m^2]."""
        return float(self.expected[3:6].max())


def assess_plan(
    name: str,
    plan: Plan,
    mission: Mission,
    limits: Limits,
    *,
    seed: int = 0,
    achieved: AchievedErrors | None = None,
) -> Contender:
    """Expected sds of a plan, and its margin to every limit."""
    margins = planned_margins(plan, mission.spacecraft, limits)
    peaks = {
        key: [margin.used for margin in margins if margin.limit.startswith(f"{key} of")]
        for key in ("torque", "momentum")
    }
    expected = expected_sd(plan, mission, truths=NUMERICS.expected_flights, seed=seed + 1)
    return Contender(
        name=name,
        plan=plan,
        expected=expected,
        achieved=achieved,
        total_time=plan.starts[-1] + plan.durations[-1],
        motion_time=float(sum(slew.motion_time for slew in plan.slews)),
        peak_momentum=max(peaks["momentum"], default=float("nan")),
        peak_torque=max(peaks["torque"], default=float("nan")),
        margins=margins,
    )


@array_dataclass
class AchievedErrors:
    """Errors of fits to n simulated campaigns whose truths were drawn from the prior.

    Parameters
    ----------
    errors : (n, 6 + axes) array
        Estimate minus truth, of Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K of each sensor axis.
    stated : (n, 6 + axes) array
        Sds that the fits stated.
    peak_torque : (n,) array
        Largest torque as a fraction of the wheel's limit; NaN where unlimited.
    peak_momentum : (n,) array
        Largest momentum as a fraction of the wheel's limit; NaN where unlimited.
    chi2 : (n,) array
        Reduced chi^2 of all telemetry.
    """

    errors: np.ndarray
    stated: np.ndarray
    peak_torque: np.ndarray
    peak_momentum: np.ndarray
    chi2: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Achieved sds (6 + axes,): root mean square of the errors."""
        return np.sqrt(np.mean(self.errors**2, axis=0))

    @property
    def stated_sd(self) -> np.ndarray:
        """Stated sds (6 + axes,): root mean square over the campaigns."""
        return np.sqrt(np.mean(self.stated**2, axis=0))

    @property
    def sd_error(self) -> np.ndarray:
        """Standard errors (6 + axes,) of `sd`, from the scatter of the squared errors."""
        n = len(self.errors)
        return np.std(self.errors**2, axis=0, ddof=1) / np.sqrt(n) / (2.0 * self.sd)


def fit_simulated_campaign(
    plan: Plan, mission: Mission, source: np.random.SeedSequence
) -> dict[str, np.ndarray]:
    """Fly a plan once with noise, with a truth drawn from the prior, and fit the campaign in full.

    `source`: of truth and noise. Campaigns of two plans from one source have the same truth.
    """
    template = planned_campaign(plan, mission)
    flight = draw_flight(template, plan, source, vary=False, craft=mission.spacecraft)
    estimate = optimizer.estimate(Model(flight.campaign), starts=1, discount=False)
    n = estimate.model.n_base
    return {
        "errors": estimate.theta[:n] - flight.mission.theta,
        "stated": estimate.sd[:n],
        "peak_torque": np.max(flight.peak_torque, initial=-np.inf),
        "peak_momentum": np.max(flight.peak_momentum, initial=-np.inf),
        "chi2": np.asarray(estimate.tests["total"].reduced_chi2),
    }


def estimate_at_truth(
    plan: Plan,
    mission: Mission,
    effects: Sequence[Effect] = (),
    *,
    controller: Controller | None = None,
    seed: int | None = None,
) -> Estimate:
    """The estimate that a plan would lead to, at the truth.

    `mission`: its spacecraft is the truth to expect; what else acts in it is left out.
    `controller`: none for one that knows the truth and flies just what was planned. `seed`: of the
    noise in the flight; None for none.
    """
    craft = mission.spacecraft
    bias = craft.rate_sensor.bias if craft.rate_sensor else ()
    quiet = replace(craft, bias=bias, effects=(), values={})
    mission = replace(mission, spacecraft=quiet)
    controller = controller or Controller(quiet.inertia_B, quiet.scale_factor)
    flight = fly(plan, mission, seed, controller=controller)
    model = Model(flight.campaign, tuple(effects))
    theta = model.expected
    theta[: model.n_base] = mission.theta
    for name, value in flight.parameters.items():
        theta[model.space.names.index(name)] = value
    return _at_truth(model, flight, theta)


def expected_sd(plan: Plan, mission: Mission, *, truths: int = 8, seed: int = 0) -> np.ndarray:
    """Sds (6 + axes,) of J and K to expect of a plan.

    The root mean square over flights with noise, each with a truth drawn from the prior, by a
    controller that believes the prior. What such a controller gets wrong shakes the spacecraft,
    which tells more than the planned motion alone: a third in slews that tell little.

    Returns: of Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K1 K2 K3, one an axis of the rate sensor.
    """
    controller = mission.controller()
    estimates = [
        estimate_at_truth(plan, truth, controller=controller, seed=seed + i)
        for i, truth in enumerate(likely_missions(plan, mission, truths + 1, seed)[1:])
    ]
    base = slice(len(mission.theta))
    return np.sqrt(np.mean([estimate.sd[base] ** 2 for estimate in estimates], axis=0))


def likely_missions(plan: Plan, mission: Mission, n: int, seed: int) -> list[Mission]:
    """Missions to expect before flight."""
    template = planned_campaign(plan, mission.without_effects())
    rng = np.random.default_rng([seed, 5])
    craft = mission.at_prior_mean().spacecraft
    drawn = (draw_spacecraft(template, rng, craft=craft) for _ in range(n - 1))
    return [mission.at_prior_mean(), *(replace(mission, spacecraft=x) for x in drawn)]


def _at_truth(model: Model, flight: Flight, theta: np.ndarray) -> Estimate:
    """Estimate of an optimizer that found the truth: nothing expected is left to luck."""
    reference, scale = model.data.arrays.reference, np.asarray(model.data.scale.local)
    start: Any = first_states(flight.truth)
    turned = np.asarray(quaternion.error(reference.attitude, jnp.asarray(start.attitude)))
    momentum = start.wheel_momentum - reference.wheel_momentum
    off = [start.rate_B - reference.rate_B, turned, momentum]
    local = np.concatenate(off, axis=1) / scale
    coefficients = np.zeros((len(local), model.structure.n_local - local.shape[1]))
    local = np.concatenate([local, coefficients], axis=1)
    point = Point(theta, np.zeros(model.n_bias), local)
    white = whitening(model, theta)
    info = information_blocks(model, point, white)
    hessian, _ = normal_equations(model, point, info)
    objective = 0.5 * float(info.chi2.sum() + np.sum(local**2))
    undiscounted = np.ones(info.n_data.shape)
    return Estimate(
        model, point, white, white, undiscounted, info, hessian, objective, Starts(1, 1)
    )
