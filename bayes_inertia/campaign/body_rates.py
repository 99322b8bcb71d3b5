"""Rates about the three body axes, smoothed from all sensors of a campaign.

Where a start or a scale of the motion is asked for, the readings of one good gyro will do. Another
spacecraft has none, or one of two axes, or one whose noise is larger than its motion: there a
spline for each body axis goes through whatever was read, by weighted least squares. A fix counts by
the angle turned since the first one of its run, so that its noise stays white.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.hardware import RateSensor, StarTracker
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.saturated import in_range

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign


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


def with_body_rates(campaign: Campaign) -> Campaign:
    """The campaign with a rate sensor along the body axes, whose readings are the smoothed rates.

    Its sigma is that of the smoothed rates, whose errors are alike from one row to the next.
    """
    smoothed = [_smoothed(campaign, slew) for slew in campaign.slews]
    sigma = np.sqrt(np.mean([each.sd**2 for each in smoothed], axis=0))
    slews = (replace(s, rate=r.rate_B) for s, r in zip(campaign.slews, smoothed, strict=True))
    sensor = RateSensor(sigma=tuple(sigma.tolist()))
    return replace(campaign, rate_sensor=sensor, slews=tuple(slews))


class _Smoothed(NamedTuple):
    """Rates (n, 3) at all rows of a slew, and their sd (3,), the mean over the rows [rad/s]."""

    rate_B: np.ndarray
    sd: np.ndarray


class _Seen(NamedTuple):
    """What a sensor tells of the rates: readings of w or of its integral, in sigmas."""

    time: np.ndarray  # (m,)
    values: np.ndarray  # (m,)
    direction_B: np.ndarray  # (m, 3), over the sigma
    run: int | None  # of fixes, whose start is unknown; None for rates


def _smoothed(campaign: Campaign, slew: Slew) -> _Smoothed:
    """By the number of knots at which the Bayesian information criterion is lowest."""
    seen = [*_of_gyros(campaign, slew), *_of_fixes(campaign, slew)]
    numbers = sum(len(part.values) for part in seen)
    if not numbers:
        return _Smoothed(np.zeros((len(slew.time), 3)), np.full(3, LIMITS.unseen_rate))
    best, lowest = None, np.inf
    for pieces in LIMITS.spline_pieces:
        if best is not None and 3 * pieces > LIMITS.splines_of_numbers * numbers:
            break
        fit, criterion = _spline(slew, seen, pieces)
        if criterion < lowest:
            best, lowest = fit, criterion
    assert best is not None
    return best


def _spline(slew: Slew, seen: list[_Seen], pieces: int) -> tuple[_Smoothed, float]:
    """Cubic splines of some pieces, and the information criterion of their fit."""
    ends = slew.time[0], slew.time[-1]
    knots = np.concatenate([[ends[0]] * 3, np.linspace(*ends, pieces + 1), [ends[1]] * 3])
    n = pieces + 3
    basis = BSpline(knots, np.eye(n), 3)
    integrals = basis.antiderivative()
    runs = 1 + max((part.run for part in seen if part.run is not None), default=-1)
    size = 3 * n + 3 * runs
    normal, pull, squares, numbers = np.zeros((size, size)), np.zeros(size), 0.0, 0
    for part in seen:
        along = (basis if part.run is None else integrals)(part.time)
        columns = np.zeros((len(part.values), size))
        columns[:, : 3 * n] = (part.direction_B[:, :, None] * along[:, None]).reshape(-1, 3 * n)
        if part.run is not None:
            columns[:, 3 * n + 3 * part.run :][:, :3] = part.direction_B
        normal += columns.T @ columns
        pull += columns.T @ part.values
        squares += float(part.values @ part.values)
        numbers += len(part.values)
    # What no sensor sees stays at zero, known to as much as a spacecraft may turn.
    covariance = np.linalg.inv(normal + np.eye(size) / LIMITS.unseen_rate**2)
    found = covariance @ pull
    misfit = max(squares - float(found @ pull), 1e-12 * squares + 1e-300)
    at_rows = basis(slew.time)
    blocks = covariance[: 3 * n, : 3 * n].reshape(3, n, 3, n)[np.arange(3), :, np.arange(3)]
    variance = np.einsum("rn,cnm,rm->c", at_rows, blocks, at_rows) / len(at_rows)
    rate_B = at_rows @ found[: 3 * n].reshape(3, n).T
    criterion = numbers * np.log(misfit / numbers) + size * np.log(numbers)
    return _Smoothed(rate_B, np.sqrt(np.maximum(variance, 1e-300))), criterion


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
            yield _Seen(slew.time[rows], rates / sigma, direction_B, None)


def _of_fixes(campaign: Campaign, slew: Slew) -> Iterator[_Seen]:
    """The angle turned about each body axis since the first fix of each run of small steps."""
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
