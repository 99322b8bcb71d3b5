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

from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    RateSensor,
    StarTracker,
    axes_to_body,
    body_rates,
)
from bayes_inertia.campaign.inputs import held_integral
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.saturated import in_range

# A `Campaign`, whose module imports this one.
Campaign = Any


def reads_motion(campaign: Campaign) -> bool:
    """Whether the noise of the rate sensor is smaller than the motion that it reads."""
    sensor = campaign.gyro
    readings = np.concatenate([turning(campaign, s)[1] for s in campaign.slews])
    power = float(np.mean(np.sum(readings**2, axis=1))) if len(readings) else 0.0
    return float(np.linalg.norm(sensor.sigma)) <= LIMITS.noise_of_motion * np.sqrt(power)


def turning(campaign: Campaign, slew: Slew) -> tuple[np.ndarray, np.ndarray]:
    """Rows (m,) in which all axes of a gyro are read, and what they tell of body rates (m, 3).

    By its readings as they are [rad/s], without scale factors and bias.
    """
    rows, readings = slew.complete_rates(campaign.valid_readings(slew))
    return rows, readings @ axes_to_body(campaign.gyro.axes).T


def _readings(campaign: Campaign, slew: Slew, kinds: Any) -> Iterator[tuple[str, Any, np.ndarray]]:
    """Names, records and readings of a slew's sensors of some kinds, the first of a kind first."""
    first = zip(campaign.names, (slew.rate, slew.attitude), strict=True)
    read = dict(first) | {name: (slew.more or {}).get(name) for name, _ in campaign.more_sensors}
    for name, sensor in campaign.sensors.items():
        if isinstance(sensor, kinds) and read[name] is not None:
            yield name, sensor, read[name]


def rows_read(campaign: Campaign, slew: Slew, kinds: Any) -> np.ndarray:
    """Rows (n,) in which a sensor of some kinds reads: the first of its kind or a further one."""
    rows = np.zeros(len(slew.time), dtype=bool)
    for _, _, values in _readings(campaign, slew, kinds):
        rows |= np.isfinite(values).any(axis=1)
    return rows


class BodyRates(NamedTuple):
    """A campaign whose rate sensor reads three axes, perhaps smoothed, and their noise."""

    campaign: Campaign
    noise: float  # Of one rate [rad/s]: the mean of a sensor's axes, the median of smoothed ones


def body_rates_of(campaign: Campaign) -> BodyRates:
    """The campaign itself where its own rates will do, else with smoothed ones."""
    sensor = campaign.rate_sensor
    if sensor is not None and len(sensor.axes) == 3 and reads_motion(campaign):
        return BodyRates(campaign, float(np.mean(sensor.sigma)))
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
    most = LIMITS.splines_of_numbers * numbers
    counts = [n for n in LIMITS.spline_pieces if n == 1 or 3 * n <= most]
    fits = [_spline(slew, seen, pieces, left) for pieces in counts]
    best = max(fits, key=lambda fit: fit[1])[0]
    return best._replace(rate_B=known_B + best.rate_B)


def _by_wheels(campaign: Campaign, slew: Slew) -> np.ndarray:
    """Changes (n, 3) of the rates by what the wheels took up, gyroscopic torque included [rad/s].

    By the trapezoidal rule, which stays bounded where much stored momentum turns them fast.
    """
    momentum, time = slew.wheel_momentum, slew.time
    known = np.isfinite(momentum).all(axis=1) if momentum is not None else np.zeros(0, bool)
    if momentum is not None and known.any():
        momentum = np.stack([np.interp(time, time[known], h[known]) for h in momentum.T], axis=-1)
    elif slew.wheel_torque is not None:
        momentum = held_integral(time, slew.wheel_torque, time)
    else:
        return np.zeros((len(time), 3))
    stored_B, inertia = momentum @ campaign.wheel_axes_B.T, campaign.inertia.tensor
    # J w' = H x w - h', with the total momentum H in the middle of each step.
    rate_B = np.zeros((len(time), 3))
    middle_B, gained_B = 0.5 * (stored_B[:-1] + stored_B[1:]), np.diff(stored_B, axis=0)
    for k, half_step in enumerate(0.5 * np.diff(time)):
        x, y, z = (half_step * (middle_B[k] + inertia @ rate_B[k])).tolist()
        half = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        change = (inertia + half) @ rate_B[k] - gained_B[k]
        rate_B[k + 1] = np.linalg.solve(inertia - half, change)
    return rate_B


def _beyond(known_B: np.ndarray, slew: Slew, seen: list[_Seen]) -> list[_Seen]:
    """What was read less what known rates (n, 3) make of it."""
    from scipy import integrate

    angle_B = integrate.cumulative_trapezoid(known_B, slew.time, axis=0, initial=0.0)
    left = []
    for part in seen:
        course = known_B if part.run is None else angle_B
        there = np.stack([np.interp(part.time, slew.time, column) for column in course.T], -1)
        if part.run is not None:
            there = there - there[0]
        gone = np.einsum("mc,mc->m", part.direction_B, there)
        left.append(part._replace(values=part.values - gone))
    return left


def _spline(slew: Slew, seen: list[_Seen], pieces: int, sd: float) -> tuple[_Smoothed, float]:
    """Cubic splines of some pieces, and the logarithm of the evidence for them.

    `sd`: prior sd of their coefficients, around a constant of which nothing is known [rad/s].
    """
    from scipy import linalg
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
    # The triangle of QR: normal equations would square a condition number of up to 1e9.
    triangle = np.column_stack([np.diag(np.sqrt(prior)), np.zeros(len(prior))])
    for part in seen:
        along, whole = basis(part.time), np.ones(len(part.time))
        if part.run is not None:
            along, whole = (x - x[0] for x in (integrals(part.time), part.time))
        columns = np.zeros((len(part.values), len(prior)))
        columns[:, : 3 * n] = (part.direction_B[:, :, None] * along[:, None]).reshape(-1, 3 * n)
        columns[:, 3 * n : shared] = part.direction_B * whole[:, None]
        if part.run is not None:
            columns[:, shared + 3 * part.run :][:, :3] = part.direction_B
        rows = np.column_stack([columns, part.values])
        triangle = np.linalg.qr(np.concatenate([triangle, rows]), mode="r")[: len(prior)]
    root, pull = triangle[:, :-1], triangle[:, -1]
    inverse = linalg.solve_triangular(root, np.eye(len(prior)))
    covariance = inverse @ inverse.T
    found = inverse @ pull
    log_volume = 0.5 * np.sum(np.log(prior)) - np.sum(np.log(np.abs(np.diag(root))))
    log_evidence = log_volume + 0.5 * pull @ pull
    at_rows = np.concatenate([basis(slew.time), np.ones((len(slew.time), 1))], axis=1)
    # The coefficients of each axis: n of its spline, and its constant.
    places = [np.append(np.arange(n * axis, n * (axis + 1)), 3 * n + axis) for axis in range(3)]
    rate_B = np.stack([at_rows @ found[place] for place in places], axis=-1)
    variance = [
        np.einsum("rn,nm,rm->", at_rows, covariance[np.ix_(place, place)], at_rows) / len(at_rows)
        for place in places
    ]
    sds = np.sqrt(np.maximum(variance, 1e-300))
    return _Smoothed(rate_B, sds, max(1.0, len(at_rows) / n)), float(log_evidence)


def _of_gyros(campaign: Campaign, slew: Slew) -> Iterator[_Seen]:
    """Each axis of each rate sensor."""
    for _, sensor, readings in _readings(campaign, slew, RateSensor):
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
    """Rows (m,) with an attitude, attitudes (m, 4), body from inertial, and their sigma [rad].

    Of the first star tracker that has any; else from two directions and more seen in one row.
    """
    for _, tracker, readings in _readings(campaign, slew, StarTracker):
        rows = np.flatnonzero(np.isfinite(readings).all(axis=1))
        if len(rows):
            return rows, readings[rows], max(tracker.sigma_cross, tracker.sigma_roll)
    return _from_directions(campaign, slew)


class _Direction(NamedTuple):
    """Vectors that a sensor saw, where it looked, and its noise."""

    body: np.ndarray  # (n, 3), NaN where nothing was seen
    inertial: np.ndarray  # (n, 3)
    sigma: float  # [rad]


def _directions(campaign: Campaign, slew: Slew) -> list[_Direction]:
    """What each direction sensor saw, on the rows of a slew."""
    seen = []
    for name, sensor, readings in _readings(campaign, slew, DirectionSensor):
        time, reference_N = reference_of(name, sensor, slew)
        at = slew.time - slew.time[0]
        there = np.stack([np.interp(at, time, column) for column in reference_N.T], axis=-1)
        noise, size = max(sensor.sigma), 1.0
        if sensor.is_field:
            size, read = (_usual_size(field) for field in (there, readings))
            # A field that its noise drowns is in another unit: what is read tells the size.
            size = size if size > noise else max(read, noise)
        seen.append(_Direction(readings, there, noise / size))
    return seen


def _usual_size(field: np.ndarray) -> float:
    """Median length of vectors (n, 3), zero where nothing was read."""
    lengths = np.linalg.norm(field, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    return float(np.median(lengths)) if len(lengths) else 0.0


def _from_directions(campaign: Campaign, slew: Slew) -> tuple[np.ndarray, np.ndarray, float]:
    """Attitudes that directions tell, in so many rows of a slew at most."""
    seen = _directions(campaign, slew)
    if len(seen) < 2:
        return np.zeros(0, dtype=int), np.zeros((0, 4)), 1.0
    known = np.array([np.isfinite(part.body).all(axis=1) for part in seen])
    rows = np.flatnonzero(known.sum(axis=0) > 1)
    rows = rows[:: max(1, len(rows) // LIMITS.attitudes_by_directions)]
    attitude = [
        _turned_together([(seen[k], np.array([row])) for k in np.flatnonzero(known[:, row])])
        for row in rows
    ]
    sigma = LIMITS.attitude_of_directions * max(part.sigma for part in seen)
    return rows, np.array(attitude).reshape(-1, 4), sigma


def _turned_together(seen: list[tuple[_Direction, np.ndarray]]) -> np.ndarray:
    """The attitude (4,), body from inertial, that brings vectors in some rows together (Wahba)."""
    from scipy.spatial.transform import Rotation

    body = np.concatenate([part.body[rows] for part, rows in seen])
    inertial = np.concatenate([part.inertial[rows] for part, rows in seen])
    weights = np.concatenate([np.full(len(rows), part.sigma**-2) for part, rows in seen])
    body, inertial = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (body, inertial))
    # From body to inertial axes, which is a quaternion of body from inertial.
    turned, _ = Rotation.align_vectors(inertial, body, weights / weights.max())
    return np.asarray(turned.as_quat())


def first_attitude_by_rates(campaign: Campaign, slew: Slew) -> np.ndarray | None:
    """Attitude (4,) in a slew's first row, from directions that the rates carry back to it.

    One direction alone tells it where the direction moves in inertial axes. Rows count as long as
    scale factors and bias leave the turn known. None without directions or three-axis rates.
    """
    from scipy.spatial.transform import Rotation

    sensor, seen = campaign.rate_sensor, _directions(campaign, slew)
    if sensor is None or not seen or campaign.with_body_rates is not campaign:
        return None
    rows, readings = slew.complete_rates(campaign.valid_readings(slew))
    time, rate_B = slew.time, body_rates(sensor, readings, sensor.scale_factor)
    rate_B = np.stack([np.interp(time, time[rows], column) for column in rate_B.T], axis=-1)
    steps = 0.5 * (rate_B[1:] + rate_B[:-1]) * np.diff(time)[:, None]
    turned = np.linalg.norm(steps, axis=1).cumsum() * max(sensor.scale_factor_sigma)
    drifted = np.append(0.0, turned) + (time - time[0]) * max(sensor.bias_sigma)
    path = [Rotation.identity()]
    for step in steps[: max(1, np.searchsorted(drifted, LIMITS.known_turn) - 1)]:
        path.append(path[-1] * Rotation.from_rotvec(step))
    first = Rotation.concatenate(path)
    parts = []
    for part in seen:
        at = np.flatnonzero(np.isfinite(part.body[: len(path)]).all(axis=1))
        if len(at):
            carried = part.body.copy()
            carried[at] = first[at].apply(part.body[at])
            parts.append((part._replace(body=carried), at))
    return _turned_together(parts) if parts else None


def reference_of(name: str, sensor: DirectionSensor, slew: Slew) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) since a slew's first row and what a direction sensor looks at (m, 3), inertial.

    A constant, the input of the sensor's name, or the magnetic field.
    """
    if sensor.reference_N is not None:
        return np.zeros(1), np.array([sensor.reference_N])
    given = (slew.inputs or {}).get(name)
    time, values = slew.time, slew.magnetic_field_N
    if given is not None:
        time, values = given.time, given.values
    known = np.zeros(0, bool) if values is None else np.isfinite(values).all(axis=1)
    if values is None or not known.any():
        what = "nothing says in which inertial direction its vector points"
        advice = "give reference_N, a reference stream, or the magnetic field"
        raise CampaignError(what, where=f"sensor {name}, slew {slew.name}", advice=advice)
    values = values[known]
    if not sensor.is_field:
        values = values / np.linalg.norm(values, axis=1, keepdims=True)
    return time[known] - slew.time[0], values
