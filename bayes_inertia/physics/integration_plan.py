"""How long the integration steps of a campaign may be, and how many telemetry rows each spans.

The motion decides, not the telemetry's rate. A step h of a method of sixth order is wrong by a
share of (f h)^6 of what the body turns; f = |w| + |M| / sqrt(J1 J2), the fastest that a free body's
rate can change: its own rate, and that of its nutation about the total momentum M. What commands or
tachometers do within a step beyond a cubic is integrated to first order (`step_drive`); its
square, and its product with the turn, must be small.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from bayes_inertia.campaign.body_rates import rows_read, turning
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, StarTracker, Wheel
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.physics.actuators.gimballed_rotors import carried_momentum
from bayes_inertia.physics.effect import LOOKING_BACK, MOVING_HOOKS, Effect
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.packing import bridged, longest_step, on_grid, refined_grid
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.step_drive import left_out, polynomials, step_ends, step_grid


class IntegrationPlan(NamedTuple):
    """The integration grid of a campaign.

    Parameters
    ----------
    spacing : float
        Longest step between grid points [s].
    rows_per_step : int
        Grid points that one integration step spans.
    """

    spacing: float
    rows_per_step: int


def integration_plan(
    campaign: Campaign, effects: Sequence[Effect], drive: Drive
) -> IntegrationPlan:
    """The longest steps that keep the simulation's error far below every sensor's noise.

    Effects shorten the steps: to their `max_step`; to the telemetry's own rows where they act on
    the motion and state no step; and sensors that look between rows see a grid as fine as their
    hooks were promised.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> integration_plan(small_campaign(), (), "commanded").rows_per_step
    1
    """
    steps = [step for step in (effect.max_step(campaign) for effect in effects) if step is not None]
    motion = motion_scales(campaign)
    longest = min([longest_smooth_step(campaign, motion), *steps])
    looks_back = any(
        effect.acts(hook) and effect.looks_between_rows(campaign)
        for effect in effects
        for hook in LOOKING_BACK
    )
    spacing = min(longest, longest_step(campaign)) if looks_back else longest
    row_by_row = IntegrationPlan(spacing, 1)
    short = max(len(slew.time) for slew in campaign.slews) < NUMERICS.rows_of_long_slew
    if short or any(_needs_each_row(effect, campaign) for effect in effects):
        return row_by_row
    rows = _cheapest(campaign, spacing, longest)
    for fewer in (r for r in NUMERICS.rows_per_step if 1 < r <= rows):
        plan = IntegrationPlan(min(spacing, longest / fewer), fewer)
        if _follows_the_wheels(campaign, plan, drive, motion):
            return plan
    return row_by_row


def _needs_each_row(effect: Effect, campaign: Campaign) -> bool:
    """Whether an effect changes the motion and relies on the telemetry's own step, or on inputs."""
    if effect.inputs:
        return True
    moves = any(effect.acts(hook) for hook in MOVING_HOOKS)
    return moves and effect.max_step(campaign) is None


class MotionScales(NamedTuple):
    """How fast a campaign's motion is.

    Parameters
    ----------
    frequency : float
        Fastest change of the rates [rad/s].
    turn : float
        Angle turned in a slew, the largest of all slews [rad].
    """

    frequency: float
    turn: float


def motion_scales(campaign: Campaign) -> MotionScales:
    """How fast the motion is, from readings, and from the momentum that wheels may hold.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> round(motion_scales(small_campaign()).turn, 1)
    1.1
    """
    moments = np.linalg.eigvalsh(campaign.inertia.tensor)
    rate, momentum, turn = 0.0, 0.0, 0.0
    seen, noise = campaign.body_rates
    # Smoothed rates may be too small.
    doubt = 0.0 if seen is campaign else np.sqrt(3.0) * noise
    for slew in seen.slews:
        rate_B, stored_B = _rates_and_momentum(campaign, seen, slew)
        if len(rate_B):
            rate = max(rate, _largest(rate_B) + doubt)
            momentum = max(momentum, _largest(stored_B))
            turn = max(turn, slew.duration * float(np.mean(np.linalg.norm(rate_B, axis=1))))
    if any(slew.wheel_momentum is None for slew in campaign.slews):
        usual = 3.0 * float(moments[-1]) * rate
        limits = [stored_at_most(wheel, usual) for wheel in campaign.wheels]
        momentum += float(np.linalg.norm(limits))
    nutation = momentum / float(np.sqrt(moments[0] * moments[1]))
    return MotionScales(rate + nutation, turn)


def _rates_and_momentum(
    campaign: Campaign, seen: Campaign, slew: Slew
) -> tuple[np.ndarray, np.ndarray]:
    """Rates and total momentum (n, 3) of a slew, body axes, as far as they are read."""
    rows, rate_B = turning(seen, slew)
    if not len(rows):
        return np.zeros((0, 3)), np.zeros((0, 3))
    times = slew.time[rows]
    stored_B = rate_B @ campaign.inertia.tensor + carried_momentum(campaign, slew, times)
    if campaign.wheels and slew.wheel_momentum is not None:
        columns = (bridged(times, slew.time, h) for h in slew.wheel_momentum.T)
        stored_B = stored_B + np.stack([*columns], axis=-1) @ campaign.wheel_axes_B.T
    return rate_B, stored_B


def shapes_of_input_noise(campaign: Campaign) -> np.ndarray:
    """Noise of tachometers and gimbal angles that moves the attitude: half periods in a slew.

    Slow noise adds up in the attitude, and so does noise at the frequency of the body's nutation
    about its momentum M, which lies between M / sqrt(J2 J3) and M / sqrt(J1 J2): a resonance.

    Returns (slews, shapes) of int.

    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> shapes_of_input_noise(small_campaign())[0].tolist()
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]
    """
    slow, margin = NUMERICS.slow_input_shapes, NUMERICS.nutation_margin
    J1, J2, J3 = np.linalg.eigvalsh(campaign.inertia.tensor)
    seen, bands = campaign.with_body_rates, []
    for slew in seen.slews:
        momentum = np.linalg.norm(_rates_and_momentum(campaign, seen, slew)[1], axis=1)
        turns = float(np.median(momentum)) * slew.duration / np.pi if len(momentum) else 0.0
        first, last = turns / np.sqrt(J2 * J3) - margin, turns / np.sqrt(J1 * J2) + margin
        bands.append((max(slow, int(first)), max(slow, 1 + int(np.ceil(last)))))
    width = min(max(last - first for first, last in bands), NUMERICS.most_nutation_shapes)
    starts = [max(slow, (first + last - width) // 2) for first, last in bands]
    of_nutation = np.array(starts)[:, None] + np.arange(width)
    return np.concatenate([np.tile(np.arange(slow), (len(bands), 1)), of_nutation], axis=1)


def stored_at_most(wheel: Wheel, usual: float, *, read: bool = False) -> float:
    """Momentum that a wheel may hold beside what is `read` of it [N m s].

    Its limit; else the usual one, or that of a fast rotor where nothing is read.
    """
    fast = 0.0 if read else NUMERICS.fastest_rotor * wheel.spin_inertia
    return wheel.max_momentum or max(usual, fast)


def _largest(rows: np.ndarray) -> float:
    """The largest norm of rows (n, 3) but for outliers."""
    largest = np.quantile(np.linalg.norm(rows, axis=1), NUMERICS.largest_quantile)
    return NUMERICS.largest_over_quantile * float(largest)


def longest_smooth_step(campaign: Campaign, motion: MotionScales) -> float:
    """The longest step for a motion without kinks.

    `campaign`: says how large the noise of each sensor is. Returns: one of a few steps an octave
    [s], so that the grid does not change with every reading.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> campaign = small_campaign()
    >>> longest_smooth_step(campaign, motion_scales(campaign)) > 1.0
    True
    """
    frequency = max(motion.frequency, 1e-9)
    allowed = NUMERICS.error_of_noise * _angle_noise(campaign, frequency)
    angle = (allowed / (NUMERICS.error_of_step * max(motion.turn, 1e-6))) ** (1.0 / 6.0)
    step = min(angle, NUMERICS.longest_turn) / frequency
    few = NUMERICS.steps_an_octave
    return float(2.0 ** (np.floor(few * np.log2(step)) / few))


def _angle_noise(campaign: Campaign, frequency: float) -> float:
    """The error of attitude that equals the noise of the sensor that sees it first [rad]."""
    return min(campaign.rate_noise / frequency, campaign.attitude_noise)


def _cheapest(campaign: Campaign, spacing: float, longest: float) -> int:
    """Rows a step at which rows and steps together cost least."""
    gaps = [np.diff(slew.time) for slew in campaign.slews]

    def cost(rows: int) -> float:
        between = min(spacing, longest / rows)
        points = max(float(np.maximum(1.0, np.ceil(g / between - 1e-9)).sum()) for g in gaps)
        steps = np.ceil(points / rows)
        return float(steps * rows + NUMERICS.rows_worth_a_step * steps)

    return min(NUMERICS.rows_per_step, key=cost)


def _follows_the_wheels(
    campaign: Campaign, plan: IntegrationPlan, drive: Drive, motion: MotionScales
) -> bool:
    """Whether steps of so many rows do justice to what the wheels do within them."""
    if not campaign.wheels:
        return True
    turn = NUMERICS.coupling_of_wheels * motion.frequency * plan.rows_per_step * plan.spacing
    frequency = max(motion.frequency, 1e-9)
    allowed_rate = NUMERICS.error_of_noise * campaign.rate_noise / frequency
    allowed_fix = NUMERICS.error_of_noise * _angle_noise(campaign, frequency)
    for angle, at_fix in _angles(campaign, plan, drive):
        error = angle * (angle + turn)
        if error.max(initial=0.0) > allowed_rate or error[at_fix].max(initial=0.0) > allowed_fix:
            return False
    return True


def _angles(
    campaign: Campaign, plan: IntegrationPlan, drive: Drive
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Of each slew: the angle that the body turns by what the cubics leave out (n,) [rad].

    And which grid points are fixes.
    """
    inverse = np.linalg.inv(campaign.inertia.tensor) @ campaign.wheel_axes_B
    for slew in campaign.slews:
        grid, sample = refined_grid(slew.time - slew.time[0], plan.spacing)
        momentum, step = _wheels_on_grid(slew, grid, sample, drive, len(campaign.wheels))
        spare = -len(grid) % plan.rows_per_step
        momentum = np.concatenate([momentum, np.repeat(momentum[-1:], spare, axis=0)])
        at_fix = sample[rows_read(campaign, slew, StarTracker | DirectionSensor)]
        grid = np.concatenate([grid, np.repeat(grid[-1:], spare)])
        steps = step_grid(grid, np.concatenate([step, np.zeros(spare)]), plan.rows_per_step, np)
        pieces = step_ends(momentum, momentum[-1], plan.rows_per_step, np)
        lacking = left_out(steps, pieces, polynomials(steps, pieces, np), np)
        yield np.abs(lacking @ inverse.T).max(axis=-1).ravel(), at_fix


def _wheels_on_grid(
    slew: Slew, grid: np.ndarray, sample: np.ndarray, drive: Drive, wheels: int
) -> tuple[np.ndarray, np.ndarray]:
    """Momentum (n, wheels) known beforehand [N m s], and the grid's steps (n,) [s]."""
    step = np.append(np.diff(grid), 0.0)
    if drive == "measured" and slew.wheel_momentum is not None:
        return on_grid(slew, "wheel_momentum", grid, wheels), step
    if slew.wheel_torque is None:
        return np.zeros((len(grid), wheels)), step
    held = np.searchsorted(sample, np.arange(len(grid)), side="right") - 1
    gained = np.cumsum(slew.wheel_torque[held] * step[:, None], axis=0)
    return np.concatenate([np.zeros((1, wheels)), gained[:-1]]), step
