"""Fly a plan: telemetry, truth and final attitude errors of slews in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import EffectError
from bayes_inertia.flight.closed_loop import fly_slews
from bayes_inertia.flight.closed_loop_inputs import closed_loop_inputs
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.spacecraft import Controller, Spacecraft
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.slew_context import Trajectory


@array_dataclass
class Flight:
    """A flown plan.

    Parameters
    ----------
    campaign : Campaign
        What telemetry shows of it.
    plan : Plan
        What was flown.
    mission : Mission
        With what it was flown; its spacecraft's bias is the one that was drawn.
    final_error_B : (slews, 3) array
        Rotation vector from the target to the final attitude [rad].
    measured_error_B : (slews, 3) array
        The same from the star tracker's fixes after the slew [rad]; NaN without star tracker.
    peak_torque : (slews, wheels) array
        Largest torque as a fraction of the wheel's limit; NaN where it has none.
    peak_momentum : (slews, wheels) array
        Largest momentum as a fraction of the wheel's limit; NaN where it has none.
    truth : tuple of Trajectory
        True trajectory of each slew at the telemetry's times.
    """

    campaign: Campaign
    plan: Plan
    mission: Mission
    final_error_B: np.ndarray
    measured_error_B: np.ndarray
    peak_torque: np.ndarray
    peak_momentum: np.ndarray
    truth: tuple[Trajectory, ...]

    @property
    def spacecraft(self) -> Spacecraft:
        """The spacecraft that flew, with its bias as drawn."""
        return self.mission.spacecraft

    @property
    def correction_slews(self) -> np.ndarray:
        """Angle (slews,) [rad] of the correction slew after each slew, by the star tracker."""
        return np.linalg.norm(self.measured_error_B, axis=1)


def fly(
    plan: Plan,
    mission: Mission,
    seed: int | None,
    *,
    controller: Controller | None = None,
    name: str | None = None,
) -> Flight:
    """Fly a plan in closed loop.

    Between slews the spacecraft is brought to the last target, at rest, with the total momentum
    that the campaign began with.

    Parameters
    ----------
    plan : Plan
        What to fly.
    mission : Mission
        The spacecraft as it is, and the inertia tensor that the campaign states as known before
        flight.
    seed : int or None
        Of noise, bias and rest errors. None for a flight without any of them; the bias then is its
        prior mean.
    controller : Controller, optional
        None for one that believes the prior.
    name : str, optional
        Name of the campaign; None for the plan's.

    Returns
    -------
    Flight
        Telemetry as a campaign, and the truth.

    Raises
    ------
    CampaignError
        If the plan does not fit the spacecraft.
    EffectError
        If an effect lacks environment columns, or grows without bound together with the controller.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> plan = Plan("one", (PlannedSlew((1., 0., 0.), 0.5),))
    >>> fly(plan, most_like_mission(), seed=None).final_error_B.round(4)[0, 0].item()
    0.005
    """
    rng = None if seed is None else np.random.default_rng(seed)
    planned, loop = closed_loop_inputs(plan, mission, controller, rng, name)
    flown: Any = jax.tree.map(np.asarray, fly_slews(loop))  # a FlownSlew of numpy arrays
    _check_converged(flown, planned, mission.spacecraft.effects)
    bias = tuple(np.asarray(loop.plant.bias).tolist())
    craft = replace(mission.spacecraft, bias=bias)
    return _flight(plan, replace(mission, spacecraft=craft), planned, flown)


def _check_converged(flown: Any, planned: Campaign, effects: Sequence[Effect]) -> None:
    """Raise for a slew that runs away or whose relaxation did not end."""
    bad = ~np.isfinite(flown.attitude).all(axis=(1, 2))
    if effects:
        bad |= ~(flown.relaxation_change <= NUMERICS.relaxation_tolerance)
    if bad.any():
        raise EffectError(
            "the closed loop is not stable with these effects",
            where=planned.slews[int(np.argmax(bad))].name,
            advice="use smaller values, or a lower controller bandwidth",
        )


def _flight(plan: Plan, mission: Mission, planned: Campaign, flown: Any) -> Flight:
    """The flight, from the numpy arrays of all slews (a `FlownSlew`)."""
    craft = mission.spacecraft
    slews = tuple(_telemetry(plan, craft, i, slew, flown) for i, slew in enumerate(planned.slews))
    truth = tuple(_true_path(i, slew, flown) for i, slew in enumerate(planned.slews))
    measured = flown.measured_error_B
    if craft.star_tracker is None:
        measured = np.full_like(flown.final_error_B, np.nan)
    return Flight(
        campaign=replace(planned, slews=slews),
        plan=plan,
        mission=mission,
        final_error_B=flown.final_error_B,
        measured_error_B=measured,
        peak_torque=_peaks(flown.command, planned, craft, "max_torque"),
        peak_momentum=_peaks(flown.wheel_momentum, planned, craft, "max_momentum"),
        truth=truth,
    )


def _telemetry(plan: Plan, craft: Spacecraft, i: int, slew: Slew, flown: Any) -> Slew:
    """Telemetry of slew i."""
    n = len(slew.time)
    fixes = None
    if craft.star_tracker is not None:
        rows = np.concatenate(plan.fixes(i))
        fixes = np.full((n, 4), np.nan)
        fixes[rows] = flown.fixes[i, rows]
    tachometers = craft.wheels and all(w.momentum_sigma is not None for w in craft.wheels)
    return replace(
        slew,
        rate=flown.rate[i, :n],
        attitude=fixes,
        wheel_torque=flown.command[i, :n] if craft.wheels else None,
        wheel_momentum=flown.momentum[i, :n] if tachometers else None,
    )


def _true_path(i: int, slew: Slew, flown: Any) -> Trajectory:
    """True trajectory of slew i at the telemetry's times."""
    n = len(slew.time)
    no_own_states: Any = np.zeros((n, 0))
    time: Any = slew.time
    return Trajectory(
        time,
        flown.attitude[i, :n],
        flown.rate_B[i, :n],
        flown.wheel_momentum[i, :n],
        no_own_states,
    )


def _peaks(padded: np.ndarray, planned: Campaign, craft: Spacecraft, limit: str) -> np.ndarray:
    """Largest magnitude (slews, wheels) in each slew, as a fraction of the wheels' limit."""
    limits = np.array([getattr(wheel, limit) or np.nan for wheel in craft.wheels])
    histories = (x[: len(slew.time)] for x, slew in zip(padded, planned.slews, strict=True))
    return np.stack([np.abs(x).max(axis=0) for x in histories]) / limits
