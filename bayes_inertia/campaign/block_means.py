"""High-rate telemetry reduced without loss: block means, as long as the motion allows.

A gyro that is read at 4 kHz tells nothing of a body that turns at 20 rad/s which its block means of
some milliseconds do not tell as well. The mean of m readings at equal steps over a block of length
L is w + w'' L^2 / 24 + O(w'''' L^4), w at the block's middle. The second term is removed with the
curvature of five neighbouring block means; the rest is kept below a hundredth of the mean's noise
sigma / sqrt(m). Only whole blocks count, so that this noise holds for every one; what is left over
at gaps and ends is left out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.sensors import MOMENTUM, RATE, STREAMS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.limits import LIMITS as FAULTS
from bayes_inertia.faults.quantisation import quantisation_step
from bayes_inertia.faults.saturated import in_range


def reduced(campaign: Campaign, block: int | None = None) -> Campaign:
    """The campaign with rates and wheel momentum averaged over blocks.

    Star-tracker fixes, changes of the commands and columns that are read too seldom for blocks
    keep their rows. All slews have one block length, because the sensor has one noise.

    `campaign`: telemetry whose noise is white, at equal steps but for gaps. `block`: readings a
    block; by default as many as the bandwidth of the motion allows. Returns: the means at the mean
    times of their blocks, with sigma / sqrt(block) of rate sensor and tachometers; the campaign
    itself if blocks of two are too long, commands were lost, or no sensor reads rates.
    """
    lost = any(slew.lost_command is not None for slew in campaign.slews)
    # Means are of rates; only rows at equal steps show which commands are unknown.
    if lost or campaign.rate_sensor is None:
        return campaign
    given, campaign = campaign, _without_saturated(campaign)
    length = _whole(campaign, longest_block(campaign)) if block is None else block
    if length < 2:
        return given
    noise, sensor, kept = 1.0 / np.sqrt(length), campaign.gyro, _kept_as_read(campaign, length)
    averaged = 1 if MOMENTUM.field in kept else length
    read = zip(campaign.wheels, _tachometer_readings(campaign, averaged), strict=True)
    wheels = tuple(
        w if s is None else replace(w, momentum_sigma=float(s * (1.0 / np.sqrt(readings))))
        for w, readings in read
        for s in [w.momentum_sigma]
    )
    sensor = replace(sensor, sigma=tuple(float(s * noise) for s in sensor.sigma))
    slews = tuple(_reduced_slew(slew, length, kept) for slew in campaign.slews)
    return replace(campaign, slews=slews, rate_sensor=sensor, wheels=wheels)


def without_surplus_rows(campaign: Campaign) -> Campaign:
    """The campaign with block means where its slews have far more rows than their motion asks for.

    What searches among many hypotheses then costs as the motion does, not as the sampling.

    Returns: the very object where slews have few rows or torque commands (whose changes a late
    reading shows within a block), its noise is stated to be correlated, its rates are rounded
    coarsely, or tell what wheels did between readings of slower tachometers.
    """
    return reduced(campaign, readings_a_mean(campaign))


def readings_a_mean(campaign: Campaign) -> int:
    """Readings that a diagnosis averages; 1 where they stay, see `without_surplus_rows`."""
    commanded = any(slew.wheel_torque is not None for slew in campaign.slews)
    sensor = campaign.rate_sensor
    if sensor is None or sensor.correlated_noise is not None or campaign.more_sensors:
        return 1
    # A mean would mix what devices did before and after a jump.
    if campaign.actuators or commanded:
        return 1
    rates = [np.asarray(slew.rate) for slew in campaign.slews]
    rows = int(np.median([np.isfinite(rate).any(axis=1).sum() for rate in rates]))
    if rows <= LIMITS.rows_for_blocks:
        return 1
    steps = [quantisation_step(axis) or 0.0 for axis in np.concatenate(rates).T]
    pairs = zip(steps, sensor.sigma, strict=True)
    if any(step > LIMITS.coarse_rounding * s for step, s in pairs):
        return 1
    campaign = _without_saturated(campaign)
    length = _whole(campaign, min(longest_block(campaign), rows // LIMITS.fewest_blocks))
    return 1 if MOMENTUM.field in _kept_as_read(campaign, length) else length


def _without_saturated(campaign: Campaign) -> Campaign:
    """The campaign without rates beyond the sensor's range: a mean of some would seem inside."""
    rates = (np.asarray(slew.rate) for slew in campaign.slews)
    beyond = [np.isfinite(x) & ~in_range(x, campaign.gyro.range) for x in rates]
    if not any(rows.any() for rows in beyond):
        return campaign
    slews = (RATE.masked(s, rows) for s, rows in zip(campaign.slews, beyond, strict=True))
    return replace(campaign, slews=tuple(slews))


def longest_block(campaign: Campaign) -> int:
    """Number of readings that may be averaged before the motion shows in the error of their mean.

    Rates of a free body change at frequencies up to |w| + |h| / J, in rad/s: its own rate, and that
    of its nutation about the momentum of its wheels.
    """
    rate = campaign.largest_rate()
    inertia = float(np.linalg.eigvalsh(campaign.inertia.tensor)[0])
    momenta = [s.wheel_momentum for s in campaign.slews if s.wheel_momentum is not None]
    momentum = max((float(np.sqrt(np.nansum(h**2, axis=1)).max()) for h in momenta), default=0.0)
    bandwidth = rate + momentum / inertia
    step = max(slew.rate_step for slew in campaign.slews)
    blocks = np.arange(1, LIMITS.largest_block + 1)
    error = LIMITS.block_remainder * rate * (bandwidth * step * blocks) ** 4
    allowed = error <= LIMITS.block_error_of_noise * min(campaign.gyro.sigma) / np.sqrt(blocks)
    # Five blocks a slew tell the curvature.
    rows = min(len(slew.rate_steps) + 1 for slew in campaign.slews)
    return max(1, min(int(allowed.sum()), rows // LIMITS.block_neighbours))


def _whole(campaign: Campaign, length: int) -> int:
    """A length, halved until enough rows with rates stand in whole blocks."""
    rated = (np.isfinite(np.asarray(slew.rate)).any(axis=1).sum() for slew in campaign.slews)
    rows, least = max(1, int(sum(rated))), LIMITS.least_kept_by_blocks
    while length > 1:
        blocks = sum(len(_blocks(slew, length)) for slew in campaign.slews)
        if length * blocks / rows >= least:
            break
        length //= 2
    return length


def _blocks(slew: Slew, length: int) -> np.ndarray:
    """Rows (blocks, length) of whole blocks at equal steps, in runs of five blocks and more."""
    rows = np.flatnonzero(np.isfinite(np.asarray(slew.rate)).any(axis=1))
    steps = np.diff(slew.time[rows])
    breaks = steps > FAULTS.longest_step * np.median(steps)
    if slew.wheel_torque is not None:
        breaks |= np.any(np.diff(slew.wheel_torque[rows], axis=0) != 0.0, axis=1)
    runs = np.split(rows, np.flatnonzero(breaks) + 1)
    whole = [run[: len(run) // length * length].reshape(-1, length) for run in runs]
    enough = [blocks for blocks in whole if len(blocks) >= LIMITS.block_neighbours]
    return np.concatenate(enough) if enough else np.zeros((0, length), dtype=int)


def _read_with_rates(slew: Slew) -> dict[str, np.ndarray]:
    """Columns (n, k) of a slew that may be read as often as the rates, by field."""
    fields = [*(s.field for s in STREAMS if s.is_series), "magnetic_field_N", "position_N"]
    values = {field: getattr(slew, field) for field in fields}
    return {field: x for field, x in values.items() if x is not None}


def _kept_as_read(campaign: Campaign, length: int) -> frozenset[str]:
    """The fields whose readings are too rare for blocks of this length: most hold none."""
    kept = set()
    for slew in campaign.slews:
        blocks = _blocks(slew, length)
        for field, values in _read_with_rates(slew).items():
            read = np.isfinite(values).any(axis=0)
            if field == RATE.field or not len(blocks) or not read.any():
                continue
            bridged = _bridged(slew.time, values[:, read], length)[blocks]
            if np.isfinite(bridged).all(axis=(1, 2)).mean() < LIMITS.least_kept_by_blocks:
                kept.add(field)
    return frozenset(kept)


def _reduced_slew(slew: Slew, length: int, kept: frozenset[str]) -> Slew:
    blocks = _blocks(slew, length)
    middle = slew.time[blocks].mean(axis=1)
    others = slew.fixes.copy()
    others[[0, -1]] = True
    given = _read_with_rates(slew)
    fixes = ((s.field, s.of(slew)) for s in STREAMS if not s.is_series)
    as_read = {field: x for field, x in fixes if x is not None}
    as_read |= {field: given.pop(field) for field in kept.intersection(given)}
    for field in kept.intersection(as_read):
        others |= np.isfinite(as_read[field]).any(axis=1)
    if slew.wheel_torque is not None:
        others[1:] |= np.any(np.diff(slew.wheel_torque, axis=0) != 0.0, axis=1)
    # A row of its own at a block's middle would be given twice.
    others &= ~np.isin(slew.time, middle)
    time = np.concatenate([middle, slew.time[others]])
    order = np.argsort(time, kind="stable")
    channels: dict[str, Any] = {}
    for name, values in given.items():
        if name != RATE.field:
            values = _bridged(slew.time, values, length)
        means = _middles(slew.time, values, blocks)
        gaps = np.full((int(others.sum()), values.shape[1]), np.nan)
        channels[name] = np.concatenate([means, gaps])[order]
    last = np.searchsorted(slew.time, time[order], side="right") - 1
    if slew.wheel_torque is not None:
        channels["wheel_torque"] = slew.wheel_torque[last]
    exact = slew.time[last] == time[order]
    for name, values in as_read.items():
        channels[name] = np.where(exact[:, None], values[last], np.nan)
    return replace(slew, time=time[order], **channels)


def _tachometer_readings(campaign: Campaign, length: int) -> np.ndarray:
    """Readings (wheels,) of each tachometer in a block of rates, at least one."""
    told = (s for s in campaign.slews if s.wheel_momentum is not None)
    rated = ((s, np.isfinite(np.asarray(s.rate)).any(axis=1)) for s in told)
    given = [np.isfinite(np.asarray(s.wheel_momentum)[rows]) for s, rows in rated]
    if not given:
        return np.full(len(campaign.wheels), float(length))
    return np.maximum(1.0, length * np.concatenate(given).mean(axis=0))


def _bridged(time: np.ndarray, values: np.ndarray, length: int) -> np.ndarray:
    """Readings (n, k) with straight lines between those that are no more than a block apart."""
    bridged, row = values.copy(), np.arange(len(time))
    for column in bridged.T:
        given = np.flatnonzero(np.isfinite(column))
        if len(given):
            after = given[np.minimum(np.searchsorted(given, row), len(given) - 1)]
            before = given[np.maximum(np.searchsorted(given, row, "right") - 1, 0)]
            near = np.maximum(after - row, 0) + np.maximum(row - before, 0) <= length
            line = np.interp(time, time[given], column[given])
            column[:] = np.where(np.isnan(column) & near, line, column)
    return bridged


def _middles(time: np.ndarray, values: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Means (blocks, k) of readings (n, k), without what the curvature of the motion adds."""
    means = values[blocks].mean(axis=1)
    if len(blocks) < LIMITS.block_neighbours:
        return means
    middle = time[blocks].mean(axis=1)
    spread = time[blocks].var(axis=1)
    half = LIMITS.block_neighbours // 2
    first = np.clip(np.arange(len(blocks)) - half, 0, len(blocks) - LIMITS.block_neighbours)
    window = first[:, None] + np.arange(LIMITS.block_neighbours)
    length = np.median(np.diff(middle))
    x = (middle[window] - middle[:, None]) / length
    # A cubic through five means: its curvature at the block itself is twice the second coefficient.
    powers = x[:, :, None] ** np.arange(4)
    across = np.abs(x).max(axis=1) <= LIMITS.block_neighbours
    fitted = np.linalg.pinv(powers)[:, 2, :]
    curvature = 2.0 * np.einsum("bn,bnk->bk", fitted, means[window]) / length**2
    return means - 0.5 * np.where(across, spread, 0.0)[:, None] * curvature
