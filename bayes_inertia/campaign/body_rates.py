"""Rates about the three body axes, smoothed from all sensors of a campaign.

Where a start or a scale of the motion is asked for, the readings of one good gyro will do. Another
spacecraft has none, or one of two axes, or one whose noise is larger than its motion: there a
spline for each body axis goes through whatever was read, by weighted least squares: what it adds to
the rates that the wheels account for roughly. A fix counts by the angle turned since the first one
of its run, so that its noise stays white.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.campaign.hardware import RateSensor, StarTracker
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.saturated import in_range

# A `Campaign`, whose module imports this one.
Campaign = Any


def reads_body_rates(campaign: Campaign) -> bool:
    """Whether the rate sensor reads three axes, and its noise is smaller than the motion."""
    sensor = campaign.rate_sensor
    if sensor is None or len(sensor.axes) != 3:
        return False
    readings = np.concatenate(
        [s.complete_rates(campaign.valid_readings(s))[1] for s in campaign.slews]
    )
    power = float(np.mean(np.sum(readings**2, axis=1))) if len(readings) else 0.0
    return float(np.linalg.norm(sensor.sigma)) <= LIMITS.noise_of_motion * np.sqrt(power)


class BodyRates(NamedTuple):
    """A campaign whose rate sensor reads three axes, perhaps smoothed, and the noise of its rates.

    Parameters
    ----------
    campaign : Campaign
    noise : float
        Of one rate [rad/s]: the mean of a sensor's axes, the median of smoothed ones.
    """

    campaign: Campaign
    noise: float


def body_rates_of(campaign: Campaign) -> BodyRates:
    """The campaign itself where its own rates will do, else with smoothed ones."""
    if campaign.rate_sensor is not None and reads_body_rates(campaign):
        return BodyRates(campaign, float(np.mean(campaign.rate_sensor.sigma)))
    return smoothed_rates(campaign)


def smoothed_rates(campaign: Campaign) -> BodyRates:
    """The campaign with a rate sensor along the body axes, whose readings are smoothed rates.

    Their errors are alike from one row to the next. The sensor's sigma is that of white noise which
    adds up to the same angle.
    """
    # Heavy to import, and seldom wanted.
    from bayes_inertia.maths.blas_threads import on_one_blas_thread

    smooth = on_one_blas_thread(_smoothed)
    smoothed = [smooth(campaign, slew) for slew in campaign.slews]
    sd = np.sqrt(np.mean([each.sd**2 for each in smoothed], axis=0))
    white = np.sqrt(np.mean([each.sd**2 * each.rows_alike for each in smoothed], axis=0))
    slews = (replace(s, rate=r.rate_B) for s, r in zip(campaign.slews, smoothed, strict=True))
    sensor = RateSensor(sigma=tuple(white.tolist()))
    changed = replace(campaign, rate_sensor=sensor, slews=tuple(slews))
    return BodyRates(changed, float(np.median(sd)))


class _Smoothed(NamedTuple):
    """Rates (n, 3) at all rows of a slew, and their sd (3,), the mean over the rows [rad/s]."""

    rate_B: np.ndarray
    sd: np.ndarray
    rows_alike: float  # rows a coefficient of the splines


class _Seen(NamedTuple):
    """What a sensor tells of the rates: readings of w or of its integral, in sigmas."""

    time: np.ndarray  # (m,)
    values: np.ndarray  # (m,)
    direction_B: np.ndarray  # (m, 3), over the sigma
    run: int | None = None  # of fixes, whose start is unknown; None for rates


def _smoothed(campaign: Campaign, slew: Slew) -> _Smoothed:
    """By the number of pieces for which the evidence is greatest."""
    known_B = _by_wheels(campaign, slew)
    largest = float(np.linalg.norm(known_B, axis=1).max())
    left = LIMITS.error_of_wheels * largest if largest > 0.0 else LIMITS.unseen_rate
    seen = _beyond(known_B, slew, [*_of_gyros(campaign, slew), *_of_fixes(campaign, slew)])
    numbers = sum(len(part.values) for part in seen)
    fits = [
        _spline(slew, seen, pieces, left)
        for pieces in LIMITS.spline_pieces
        if pieces == 1 or 3 * pieces <= LIMITS.splines_of_numbers * numbers
    ]
    best = max(fits, key=lambda fit: fit[1])[0]
    return best._replace(rate_B=known_B + best.rate_B)


def _by_wheels(campaign: Campaign, slew: Slew) -> np.ndarray:
    """Changes (n, 3) of the rates by what the wheels took up, without gyroscopic torque [rad/s]."""
    momentum, time = slew.wheel_momentum, slew.time
    known = np.isfinite(momentum).all(axis=1) if momentum is not None else np.zeros(0, bool)
    if momentum is not None and known.any():
        momentum = np.stack([np.interp(time, time[known], h[known]) for h in momentum.T], axis=-1)
    elif slew.wheel_torque is not None:
        held = slew.wheel_torque[:-1] * np.diff(time)[:, None]
        momentum = np.concatenate([np.zeros((1, held.shape[1])), np.cumsum(held, axis=0)])
    else:
        return np.zeros((len(time), 3))
    taken_B = (momentum - momentum[0]) @ campaign.wheel_axes_B.T
    return -np.linalg.solve(campaign.inertia.tensor, taken_B.T).T


def _beyond(known_B: np.ndarray, slew: Slew, seen: list[_Seen]) -> list[_Seen]:
    """What was read less what known rates (n, 3) make of it."""
    from scipy import integrate

    angle_B = integrate.cumulative_trapezoid(known_B, slew.time, axis=0, initial=0.0)
    left = []
    for part in seen:
        course = known_B if part.run is None else angle_B
        there = np.stack([np.interp(part.time, slew.time, column) for column in course.T], -1)
        gone = np.einsum("mc,mc->m", part.direction_B, there)
        left.append(part._replace(values=part.values - gone))
    return left


def _spline(slew: Slew, seen: list[_Seen], pieces: int, sd: float) -> tuple[_Smoothed, float]:
    """Cubic splines of some pieces, and the logarithm of the evidence for them.

    `sd`: prior sd of their coefficients, around a constant of which nothing is known [rad/s].
    """
    from scipy.interpolate import BSpline

    ends = slew.time[0], slew.time[-1]
    knots = np.concatenate([[ends[0]] * 3, np.linspace(*ends, pieces + 1), [ends[1]] * 3])
    n = pieces + 3
    basis = BSpline(knots, np.eye(n), 3)
    integrals = basis.antiderivative()
    runs = 1 + max((part.run for part in seen if part.run is not None), default=-1)
    shared = 3 * n + 3
    prior = np.full(shared + 3 * runs, LIMITS.unseen_rate**-2)
    prior[: 3 * n] = sd**-2
    normal, pull = np.diag(prior), np.zeros(len(prior))
    for part in seen:
        along, whole = basis(part.time), np.ones(len(part.time))
        if part.run is not None:
            along, whole = integrals(part.time), part.time - ends[0]
        columns = np.zeros((len(part.values), len(prior)))
        columns[:, : 3 * n] = (part.direction_B[:, :, None] * along[:, None]).reshape(-1, 3 * n)
        columns[:, 3 * n : shared] = part.direction_B * whole[:, None]
        if part.run is not None:
            columns[:, shared + 3 * part.run :][:, :3] = part.direction_B
        normal += columns.T @ columns
        pull += columns.T @ part.values
        covariance = np.linalg.inv(normal)
    found = covariance @ pull
    log_evidence = 0.5 * (np.sum(np.log(prior)) - np.linalg.slogdet(normal)[1] + pull @ found)
    at_rows = np.concatenate([basis(slew.time), np.ones((len(slew.time), 1))], axis=1)
    places = _of_axes(n)
    rate_B = np.stack([at_rows @ found[place] for place in places], axis=-1)
    variance = [
        np.einsum("rn,nm,rm->", at_rows, covariance[np.ix_(place, place)], at_rows) / len(at_rows)
        for place in places
    ]
    sds = np.sqrt(np.maximum(variance, 1e-300))
    return _Smoothed(rate_B, sds, max(1.0, len(at_rows) / n)), float(log_evidence)


def _of_axes(n: int) -> list[np.ndarray]:
    """Where the coefficients of each axis stand: n of its spline, and its constant."""
    return [np.append(np.arange(n * axis, n * (axis + 1)), 3 * n + axis) for axis in range(3)]


def _of_gyros(campaign: Campaign, slew: Slew) -> Iterator[_Seen]:
    """Each axis of each rate sensor."""
    sensors = [(campaign.rate_sensor, slew.rate)]
    sensors += [(sensor, (slew.more or {}).get(name)) for name, sensor in campaign.more_sensors]
    for sensor, readings in sensors:
        if not isinstance(sensor, RateSensor) or readings is None:
            continue
        valid = in_range(readings, sensor.range)
        for i, axis_B in enumerate(sensor.axes):
            rows, sigma = np.flatnonzero(valid[:, i]), sensor.scale_factor[i] * sensor.sigma[i]
            rates = sensor.scale_factor[i] * readings[rows, i] - sensor.bias[i]
            direction_B = np.tile(axis_B / sigma, (len(rows), 1))
            yield _Seen(slew.time[rows], rates / sigma, direction_B)


def _of_fixes(campaign: Campaign, slew: Slew) -> Iterator[_Seen]:
    """The angle turned about each body axis since the first fix of each run of small steps."""
    from scipy.spatial.transform import Rotation

    rows, attitude, sigma = attitudes_seen(campaign, slew)
    if len(rows) < 2:
        return
    body_to_inertial = Rotation.from_quat(attitude)
    steps = (body_to_inertial[:-1].inv() * body_to_inertial[1:]).as_rotvec()
    apart = np.linalg.norm(steps, axis=1) > LIMITS.largest_turn_between_fixes
    places = np.split(np.arange(len(rows)), np.flatnonzero(apart) + 1)
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    for run, place in enumerate(places):
        time = slew.time[rows[place]]
        for axis in range(3):
            angle = (turned[place, axis] - turned[place[0], axis]) / sigma
            direction_B = np.tile(np.eye(3)[axis] / sigma, (len(place), 1))
            yield _Seen(time, angle, direction_B, run)


def attitudes_seen(campaign: Campaign, slew: Slew) -> tuple[np.ndarray, np.ndarray, float]:
    """Rows (m,) with a fix, attitudes (m, 4) there, body from inertial, and their sigma [rad].

    Of the first star tracker that has any.
    """
    trackers = [(campaign.star_tracker, slew.attitude)]
    trackers += [(sensor, (slew.more or {}).get(name)) for name, sensor in campaign.more_sensors]
    for tracker, readings in trackers:
        if isinstance(tracker, StarTracker) and readings is not None:
            rows = np.flatnonzero(np.isfinite(readings).all(axis=1))
            if len(rows):
                return rows, readings[rows], max(tracker.sigma_cross, tracker.sigma_roll)
    return np.zeros(0, dtype=int), np.zeros((0, 4)), 1.0
