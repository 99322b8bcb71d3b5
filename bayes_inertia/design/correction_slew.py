"""How large the next correction slew will be: what the base model promises, and what the effects found in the data will make of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.design.after_campaign import plan_after
from bayes_inertia.flight.final_errors import predict_correction_slew
from bayes_inertia.flight.follow_on import spacecraft_at
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.spacecraft import Controller, Spacecraft, spin_tensor
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.physical_draws import draw_physical
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import ParameterSpace
from bayes_inertia.physics.slew_input import idle_slew

_ANGLE = np.radians(60.0)


@dataclass(frozen=True)
class CorrectionForecast:
    """Correction slew [rad] after a slew of 60 degrees about the worst body axis: (median, 95 % quantile) over posterior draws.

    Attributes
    ----------
    axis : "x", "y" or "z", the axis with the largest expected correction.
    promised : if the base model were true and flown with its J and K.
    expected : with the effects found, flown with the base model's J and K.
    updated : with the effects found, flown with the J and K that were estimated together with them.
    """

    axis: str
    promised: tuple[float, float]
    expected: tuple[float, float]
    updated: tuple[float, float]


def correction_forecast(
    base: Estimate, final: Estimate, *, seed: int = 0, draws: int = 48
) -> CorrectionForecast | None:
    """Predict the next correction slew before and after effects were added; None without star tracker or wheels about three
    axes, or where a predicted slew does not end.

    J, K and the effects are drawn together. The controller knows J and K and compensates no effect: what remains in `updated` is what only a change of the
    on-board software, or a repair, would take away. Noise is left out.
    """
    campaign = final.model.campaign
    if (
        campaign.star_tracker is None
        or not campaign.wheels
        or np.linalg.matrix_rank(campaign.wheel_axes_B, tol=1e-6) < 3
    ):
        return None
    rng = np.random.default_rng([seed, 7])
    plain, true = _draws(base, rng, draws), _draws(final, rng, draws)
    old, new = (
        replace(spacecraft_at(campaign, at.theta), bias=(0.0, 0.0, 0.0)) for at in (base, final)
    )
    held = {i for i in range(final.model.space.size) if i not in final.free}
    named = tuple(
        e
        for e in final.model.effects
        if not set(range(*final.model.space.slice_of(e.name).indices(final.model.space.size)))
        & held
    )
    fitted = _parameters_afterwards(final.model, named, final.theta[None])
    fitted = {name: {k: x[0] for k, x in p.items()} for name, p in fitted.items()}
    acting = replace(new, effects=tuple(e.afterwards() for e in named), values=fitted)
    mission = Mission(acting, campaign.inertia)
    new = replace(new, inertia_B=_inertia_afterwards(new.inertia_B, named, fitted))
    # The base model is flown with the effects at their null, so that all cases share compiled code.
    nothing = np.tile(final.model.space.nulls, (len(plain), 1))
    disturbed = _parameters_afterwards(final.model, named, true, np.random.default_rng([seed, 8]))
    undisturbed = _parameters_afterwards(final.model, named, nothing)
    plan = plan_after(final)
    plan = replace(plan, orbit=Orbit() if any(e.needs for e in named) else None)
    forecasts = []
    for axis in np.eye(3):
        one = replace(plan, slews=(PlannedSlew(tuple(axis), _ANGLE),))
        cases = ((plain, undisturbed, old), (true, disturbed, old), (true, disturbed, new))
        forecasts.append(
            [_predicted(thetas, values, one, mission, known) for thetas, values, known in cases]
        )
    if not np.isfinite(forecasts).all():
        return None
    worst = int(np.argmax([f[1][0] for f in forecasts]))
    return CorrectionForecast("xyz"[worst], *forecasts[worst])


def _inertia_afterwards(
    inertia_B: np.ndarray, effects: tuple[Effect, ...], values: dict[str, dict]
) -> np.ndarray:
    """The tensor (3, 3) [kg m^2] to fly with after the campaign: where an effect changed it on the way, the one after the change."""
    for effect in effects:
        if effect.afterwards() != effect:
            inertia_B = np.asarray(
                effect.afterwards().inertia(
                    values[effect.name], idle_slew([0.0, 1.0]).context, inertia_B
                )
            )
    return inertia_B


def _predicted(
    thetas: np.ndarray,
    values: dict,
    plan: Plan,
    mission: Mission,
    believed: Spacecraft,
) -> tuple[float, float]:
    controller = Controller(believed.inertia_B, believed.scale_factor)
    angles = predict_correction_slew(thetas[:, :9], plan, mission, controller, values=values)
    return tuple(np.quantile(angles, [0.5, 0.95]).tolist())


def _draws(at: Estimate, rng: np.random.Generator, n: int) -> np.ndarray:
    """Draws (n, d) of all parameters from the Laplace approximation, every J physical."""
    space, campaign = at.model.space, at.model.campaign
    locked = campaign.inertia.includes_wheel_spin
    thetas = draw_physical(
        lambda k: rng.multivariate_normal(at.theta, at.covariance, size=k),
        n,
        wheel_spin=inertia_tensor.elements(spin_tensor(campaign.wheels)) if locked else None,
        where="the estimate",
        advice="hardly any tensor within its uncertainty is one of a body: fly more slews first",
    )
    thetas[:, 6:] = np.clip(thetas, space.lower + 1e-9 * space.sd, space.upper - 1e-9 * space.sd)[
        :, 6:
    ]
    return thetas


def _parameters_afterwards(
    model: Model,
    effects: tuple[Effect, ...],
    thetas: np.ndarray,
    rng: np.random.Generator | None = None,
) -> dict[str, dict[str, np.ndarray]]:
    """Parameters of effects in the next slew, for n draws (n, d): {effect: {parameter: (n, ...)}}.

    What the campaign does not tell of the next slew is drawn from its prior, or null without `rng`.
    """
    parameters = {}
    for effect in effects:
        after = effect.afterwards().parameters(model.campaign)
        space = ParameterSpace(tuple((effect.name, p) for p in after))
        if after == effect.parameters(model.campaign):
            rows = thetas[:, model.space.slice_of(effect.name)]
        elif rng is None:
            rows = np.tile(space.nulls, (len(thetas), 1))
        else:
            rows = space.draw(rng, len(thetas))
        drawn = [space.split(row).get(effect.name, {}) for row in rows]
        parameters[effect.name] = {
            key: np.stack([np.asarray(d[key]) for d in drawn]) for key in drawn[0]
        }
    return parameters
