"""Dirt seen in the residuals of a fit: outliers are left out, the noise takes its own shape.

Every fit decides here; a diagnosis in `diagnosis.clean_start`, in an order of its own, because
noise and missing effects compete there. Outliers are looked for always; level and colour of the
noise only where the residuals are not what the stated noise predicts. They are measured from what
is fast, where a missing effect is not, and believed where they are alike in all slews, at rest and
in motion. Where nothing is found, the estimate is the very object given.

A channel that was asked for Student-t noise has its outliers modelled: none is left out, and its
level and colour are taken as given. So is the level of a channel whose scale is sampled.

Star-tracker fixes that stand out from the others of their burst.

A missing torque turns the body from fix to fix. The rate sensor saw that turn, so that the fixes
are compared without it. The rate sensor may have an error of its own, so that an outlier is only
what stands out with that turn, too: in a long burst from the fixes on both sides, in a short one
from a steady drift.

A reading is compared with the median of those before it and of those after it, each for itself.
A missing effect cannot look like that: a slope lies above on one side and below on the other, a
step agrees with one side, a ringing is as large all around. What stands out just where the wheels'
torques change is left alone all the same, since an effect could do that where rows are few.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import integrate, ndimage, stats

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, body_rates
from bayes_inertia.campaign.sensors import stream_named
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.fault import Dirt, Treatment
from bayes_inertia.faults.quantisation import quantisation_sigma
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate, gap_of, plain_series, predicted_readings
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_colour import (
    Colour,
    bursts_of,
    colour_of,
    factor_of_rounding,
    factor_of_shared_errors,
    has_one_error,
    is_alike_everywhere,
    is_coarse,
    level_of_rounded,
    noise_beside_rounding,
    rounding_steps,
    white_factor,
)
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.treatment import DirtTreatment, treated
from bayes_inertia.maths.printed import counted
from bayes_inertia.maths.robust_scale import SD_OVER_MAD
from bayes_inertia.physics.forward_model import Model


def distance_from_both_sides(series: np.ndarray) -> np.ndarray:
    """How far each reading lies beyond its neighbours on both sides.

    `series` (n,). Returns (n,): the lesser of the distances from the medians of the readings before
    and after; 0 where they have opposite signs. At the ends the one side there is goes on as a
    level, a slope or a curve, whichever is nearest: a missing effect turns the body there, too.

    Examples
    --------
    >>> spike = np.where(np.arange(13) == 6, 9.0, 0.0)
    >>> float(distance_from_both_sides(spike)[6])
    9.0
    >>> float(distance_from_both_sides(np.arange(13.0))[6])
    0.0
    """
    before = series - _median_before(series)
    after = series - _median_before(series[::-1])[::-1]
    distance = lesser_distance(before, after)
    for side, step in ((before, 1), (after, -1)):
        for i in np.flatnonzero(np.isnan(side)):
            distance[i] = _distance_at_end(series[i::step])
    return distance


def _distance_at_end(series: np.ndarray) -> float:
    """How far the first reading lies beyond those that follow it, as these go on towards it."""
    size = LIMITS.neighbours
    windows = min(max((len(series) - 1) // size, 1), 3)
    starts = 1 + size * np.arange(windows)
    middles = starts + 0.5 * (size - 1)
    medians = np.array([np.median(series[k : k + size]) for k in starts])
    distance = series[0] - medians[0]
    for order in range(1, len(medians)):
        known = slice(order + 1)
        there = np.polynomial.polynomial.polyfit(middles[known], medians[known], order)[0]
        distance = lesser_distance(distance, series[0] - there)
    return float(distance)


def lesser_distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The lesser of two distances.

    Examples
    --------
    >>> lesser_distance(np.array([-3.0, 1.0]), np.array([-2.0, -1.0])).tolist()
    [-2.0, 0.0]
    """
    least = np.minimum(np.abs(one), np.abs(other))
    return np.where(np.sign(one) == np.sign(other), np.sign(one) * least, 0.0)


def _median_before(series: np.ndarray) -> np.ndarray:
    """Median of the readings before each; NaN where there are fewer than three."""
    padded = np.concatenate([np.full(LIMITS.neighbours, np.nan), series[:-1]])
    windows = sliding_window_view(padded, LIMITS.neighbours).copy()
    few = np.isfinite(windows).sum(axis=1) < 3
    windows[few] = 0.0
    return np.where(few, np.nan, np.nanmedian(windows, axis=1))


def outlying_readings(
    slews: list[np.ndarray], steps: Sequence[float] | None = None
) -> list[np.ndarray]:
    """Readings of one channel that stand out from their neighbours.

    `slews` (rows, components). `steps`: to which multiples each component's readings are rounded,
    in the unit of the residuals; 0 where they are not. One step up or down is no outlier. Returns
    (rows, components).

    Examples
    --------
    >>> calm = np.random.default_rng(1).normal(size=(400, 3))
    >>> spiked = calm.copy()
    >>> spiked[[50, 200, 201], [0, 1, 1]] += 12.0
    >>> int(outlying_readings([calm])[0].sum())
    0
    >>> np.argwhere(outlying_readings([spiked])[0]).tolist()
    [[50, 0], [200, 1], [201, 1]]
    """
    n = sum(int(np.isfinite(slew).sum()) for slew in slews)
    limit = stats.norm.isf(0.5 * LIMITS.reject_below / max(n, 1))
    flags = [np.zeros(slew.shape, bool) for slew in slews]
    for component in range(slews[0].shape[1]):
        rows = [np.flatnonzero(np.isfinite(slew[:, component])) for slew in slews]
        distances = [
            distance_from_both_sides(slew[k, component])
            if len(k) > 2 * LIMITS.neighbours
            else np.zeros(len(k))
            for slew, k in zip(slews, rows, strict=True)
        ]
        overall = _scale(np.concatenate(distances))
        least = LIMITS.steps_beyond * steps[component] if steps is not None else 0.0
        for flag, k, distance in zip(flags, rows, distances, strict=True):
            scale = np.maximum(overall, _scale_around(distance))
            flag[k, component] = np.abs(distance) > np.maximum(limit * scale, least)
    return flags


def _scale(distance: np.ndarray) -> float:
    """Standard deviation of white noise that would lie so far beyond its neighbours."""
    beyond = np.abs(distance[distance != 0.0])
    if len(beyond) < LIMITS.readings_around:
        return np.inf
    return float(np.median(beyond)) * SD_OVER_MAD / LIMITS.scale_of_white


def _scale_around(distance: np.ndarray) -> np.ndarray:
    """As `_scale`, of the readings around each."""
    width = 2 * LIMITS.readings_around + 1
    if len(distance) < width:
        return np.zeros(len(distance))
    beyond = np.where(distance != 0.0, np.abs(distance), np.nan)
    padded = np.pad(beyond, LIMITS.readings_around, mode="reflect")
    windows = sliding_window_view(padded, width)
    some = np.isfinite(windows).sum(axis=1) >= LIMITS.fewest_around
    around = np.zeros(len(distance))
    around[some] = np.nanmedian(windows[some], axis=1)
    return around * SD_OVER_MAD / LIMITS.scale_of_white


def away_from_switches(slews: tuple[Slew, ...], flags: list[np.ndarray]) -> list[np.ndarray]:
    """Take back outliers at changes of torque, if they gather there.

    `flags` (rows, components). Returns (rows, components).
    """
    near = [_near_switch(slew, len(flag)) for slew, flag in zip(slews, flags, strict=True)]
    every, hit = np.concatenate(near), np.concatenate([flag.any(axis=1) for flag in flags])
    there, total, share = int((every & hit).sum()), int(hit.sum()), every.sum() / max(1, len(every))
    if not total or stats.binom.sf(there - 1, total, share) > LIMITS.reject_below:
        return flags
    return [flag & ~rows[:, None] for flag, rows in zip(flags, near, strict=True)]


def _near_switch(slew: Slew, rows: int) -> np.ndarray:
    """Rows (rows,) beside a change of torque."""
    near = np.zeros(rows, bool)
    if slew.wheel_torque is None or len(slew.time) < 2:
        return near
    torque = slew.wheel_torque
    change = np.abs(np.diff(torque, axis=0)).max(axis=1, initial=0.0)
    largest = np.abs(torque).max(initial=0.0)
    for row in np.flatnonzero(change > LIMITS.switch * largest) if largest > 0.0 else ():
        near[max(0, row + 1 - LIMITS.rows_at_switch) : row + 2 + LIMITS.rows_at_switch] = True
    return near


@dataclass(frozen=True)
class CleanFit:
    """An estimate from which dirt was kept away.

    Parameters
    ----------
    estimate : Estimate
        Its model's campaign is the treated one.
    treatment : DirtTreatment
        What was done to the campaign.
    """

    estimate: Estimate
    treatment: DirtTreatment


def clean_fit(estimate: Estimate, *, seed: int = 0) -> CleanFit:
    """Look for dirt in an estimate's residuals, and repeat the estimate without it."""
    repeat = partial(_repeated, estimate.model, seed=seed)
    stated = estimate.model.campaign
    fit = without_outliers(CleanFit(estimate, DirtTreatment()), stated, repeat)
    for measured in (_with_rounding, _with_colour, _with_level):
        again = repeat(fit, measured(fit))
        fit = fit if again is fit else without_outliers(again, stated, repeat)
    return fit


def _repeated(stated: Model, fit: CleanFit, treatment: DirtTreatment, *, seed: int) -> CleanFit:
    """The fit with another treatment of the campaign as stated."""
    if treatment == fit.treatment:
        return fit
    campaign = treated(stated.campaign, treatment, stated.structure.drive)
    model = replace(stated, campaign=campaign)
    if model.structure.hyperparameters:
        # Sizes of what has no fixed shape are learnt at length: go on where they are known.
        return CleanFit(optimizer.resumed(fit.estimate, model), treatment)
    return CleanFit(optimizer.estimate(model, seed=seed), treatment)


def refitted(previous: Estimate, campaign: Campaign, **asked: Any) -> Estimate:
    """An estimate repeated with other readings, or another noise, of the same slews.

    `asked`: as of `re_estimate`. Returns: the same object if its campaign is that already.
    """
    if campaign is previous.model.campaign:
        return previous
    begin = replace(previous, model=replace(previous.model, campaign=campaign))
    return optimizer.re_estimate(begin, previous.theta, previous.free, **asked)


def without_outliers(
    fit: CleanFit, stated: Campaign, repeat: Callable[[CleanFit, DirtTreatment], CleanFit]
) -> CleanFit:
    """The fit with every outlier masked."""
    for _ in range(LIMITS.rounds_of_masks):
        masked = masks_at(fit.estimate, stated, fit.treatment)
        if masked == fit.treatment.masked:
            break
        fit = repeat(fit, replace(fit.treatment, masked=masked))
    return fit


def masks_at(estimate: Estimate, stated: Campaign, treatment: DirtTreatment) -> tuple[Dirt, ...]:
    """All outliers at an estimate, among readings that are masked already as among the others.

    What an earlier, worse fit took for an outlier need not be one.
    """
    if not treatment.masked:
        return _masks((), *_outliers_in(estimate))
    model, unmasked = estimate.model, replace(treatment, masked=())
    model = replace(model, campaign=treated(stated, unmasked, model.structure.drive))
    references = (x.data.arrays.reference for x in (model, estimate.model))
    if not all(np.array_equal(a, b) for a, b in zip(*references, strict=True)):
        # Nuisances are counted from readings that are masked.
        return _masks(treatment.masked, *_outliers_in(estimate))
    estimate = replace(estimate, model=model, stated=whitening(model, estimate.theta))
    return _masks((), *_outliers_in(estimate))


# Rows of outliers by channel and slew; the share of outliers in channels that have too many.
_Rows = dict[tuple[str, str], np.ndarray]
_Shares = dict[str, float]


def _masks(old: tuple[Dirt, ...], new: _Rows, too_many: _Shares) -> tuple[Dirt, ...]:
    """Masks of both, one record a channel and slew; a record of each channel with too many."""
    left = [dirt for dirt in old if dirt.slew]
    rows: dict[tuple[str, str], Iterable[int]] = {(d.channel, d.slew): d.rows for d in left}
    rows |= {key: {*rows.get(key, ()), *numbers} for key, numbers in new.items()}
    where = "far beyond the readings before and after"
    of_all = (
        Dirt("outliers", channel, "", (), "ignored", f"{100.0 * share:.2g} % of them are {where}")
        for channel, share in too_many.items()
    )
    return (*(_outliers(*key, own, "masked", where) for key, own in rows.items()), *of_all)


def _outliers(channel: str, slew: str, rows: Iterable[int], treated: Treatment, where: str) -> Dirt:
    """The record of outliers of one channel in one slew."""
    numbers = tuple(sorted(map(int, rows)))
    note = f"{counted(len(numbers), 'row')} {where}"
    return Dirt("outliers", channel, slew, numbers, treated, note)


def _outliers_in(estimate: Estimate) -> tuple[_Rows, _Shares]:
    """Rows of outliers among an estimate's residuals, by channel and slew.

    `estimate`: A fit; what its campaign masks already is not looked at. Returns too: of channels
    with so many that they are its noise, the share; none of these is among the rows.
    """
    model, series, too_many = estimate.model, plain_series(estimate), _Shares()
    slews, steps, hit = model.campaign.slews, rounding_steps(model.campaign), {}
    for channel in sorted(model.channels, key=lambda c: not c.stream.is_series):
        name = channel.name
        if not channel.stream.is_series:
            hit[name] = fix_outliers(estimate, series, name)
        elif any(np.isfinite(values).any() for values in series[name]):
            flags = outlying_readings(series[name], steps[name].tolist())
            flags = away_from_switches(slews, flags)
            hit[name] = [np.flatnonzero(flag.any(axis=1)) for flag in flags]
            read = sum(int(np.isfinite(values).sum()) for values in series[name])
            share = sum(int(flag.sum()) for flag in flags) / read
            if share > LIMITS.most_outliers:
                hit[name] = [np.zeros(0, int) for _ in slews]
                too_many |= {} if model.noise.of(name).heavy else {name: share}
    rows = {
        (channel, slew.name): rows
        for channel, of_slews in hit.items()
        if not model.noise.of(channel).heavy
        for slew, rows in zip(slews, of_slews, strict=True)
        if len(rows)
    }
    return rows, too_many


def noise_factors(estimate: Estimate) -> dict[str, float]:
    """Measure by what factor each channel's white noise exceeds its stated sigma.

    Smaller noise than stated is left alone: it makes the result cautious, not wrong.

    `estimate`: A fit; its residuals are in stated sigmas. Processes of readings that it knows of
    are filtered out of them. Returns: {channel: factor}; 1 unless the excess is significant (four
    sigma).
    """
    series, campaign = dict(estimate.tested_residuals.series), estimate.model.campaign
    large = {}
    for channel in estimate.model.channels:
        if channel.stream.is_series:
            readings = [channel.readings(campaign, slew) for slew in campaign.slews]
            # The two angles of a direction have no size.
            if readings[0].values.shape == readings[0].valid.shape:
                sizes = [np.abs(each.values) for each in readings]
                least = LIMITS.large_readings * np.max(np.concatenate(sizes), axis=0)
                large[channel.name] = [size > least for size in sizes]
        else:
            times = (slew.time[channel.readings(campaign, slew).row] for slew in campaign.slews)
            series[channel.name] = [
                slew[burst]
                for time, slew in zip(times, series[channel.name], strict=True)
                for burst in bursts_of(time)
            ]
    return {name: white_factor(pieces, large.get(name)) for name, pieces in series.items()}


def rounded_channels(estimate: Estimate) -> dict[str, float]:
    """Channels whose noise is larger than stated because their readings are rounded.

    `estimate`: A fit of the campaign with its noise as stated. Returns: by channel, the factor on
    its noise. Not among them where the stated noise holds the rounding already, and where the noise
    is louder than that.
    """
    measured, rounded = noise_factors(estimate), {}
    for channel, steps in rounding_steps(estimate.model.campaign).items():
        factor = factor_of_rounding(steps)
        louder = measured[channel] > 1.0 + 0.5 * (factor - 1.0)
        counts = factor > LIMITS.rounding_that_counts and (is_coarse(steps) or louder)
        level = level_of_rounded(measured[channel], steps) if counts else 1.0
        if (counts or has_one_error(steps)) and level < LIMITS.more_than_rounding * factor:
            rounded[channel] = with_shared_errors(estimate, channel, level)
    return rounded


def with_shared_errors(estimate: Estimate, channel: str, level: float) -> float:
    """The level of a rounded channel's noise, errors counted as often as readings share them."""
    steps = rounding_steps(estimate.model.campaign)[channel]
    if not has_one_error(steps):
        return level
    kept = np.flatnonzero(steps)
    every = (x[..., kept].reshape(-1, len(kept)) for x in _paths(estimate, channel, level))
    readings, paths, motions = ([x[np.isfinite(x)] for x in (own / steps[kept]).T] for own in every)
    # Stated noise that holds the rounding is smaller without it.
    rounding = quantisation_sigma(1.0) * steps[kept]
    stated = np.sqrt(np.maximum(level**2 - rounding**2, 0.0)) / steps[kept]
    seen = map(noise_beside_rounding, readings, paths, motions)
    factor = factor_of_shared_errors(paths, motions, np.minimum(stated, [*seen]))
    return float(np.sqrt(level**2 + (factor**2 - 1.0) * rounding.max() ** 2))


def _paths(
    estimate: Estimate, channel: str, level: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Readings (slews, n, components), predicted ones, and these without a fitted offset.

    In stated sigmas. A gyro's bias counts as far as it is open; others have an offset in each slew.
    """
    model = estimate.model
    campaign, stream = model.campaign, stream_named(channel, model.campaign)
    sigma, sensor = np.array(stream.sigma(campaign), float), stream.hardware(campaign)
    place, left = model.structure.place(channel), np.stack(plain_series(estimate)[channel])
    given = model.data.arrays.telemetry.readings[place]
    predicted = predicted_readings(estimate, place, np.nan_to_num(left))
    known = model.channels[place].known
    read, path = (known(given._replace(values=x)) / sigma for x in (given.values, predicted))
    if not isinstance(sensor, RateSensor):
        counts = np.maximum(np.isfinite(path).sum(axis=1, keepdims=True), 1)
        return read, path, path - np.nansum(path, axis=1, keepdims=True) / counts
    motion = path - np.array(sensor.bias) / sigma
    free = np.isfinite(path).sum((0, 1)) * (np.array(sensor.bias_sigma) / (level * sigma)) ** 2
    return read, path, motion - free / (1.0 + free) * np.nanmean(motion, axis=(0, 1))


def _with_rounding(fit: CleanFit) -> DirtTreatment:
    """The treatment with the noise that rounding adds."""
    tests, noise = fit.estimate.tests, fit.estimate.model.noise
    steps = rounding_steps(fit.estimate.model.campaign)
    rounded = {
        channel: level
        for channel, level in rounded_channels(fit.estimate).items()
        if tests[channel].too_large or has_one_error(steps[channel])
        if noise.of(channel).is_stated
    }
    level = {**fit.treatment.level, **rounded}
    return replace(fit.treatment, level=level, rounded=tuple(sorted(rounded)))


def _with_colour(fit: CleanFit) -> DirtTreatment:
    """The treatment with correlated noise of rate sensors, where that is what there is."""
    if not fit.estimate.is_too_large:
        return fit.treatment
    seen = {
        channel: colour
        for channel, colour in colours_seen(fit.estimate).items()
        if max(colour.times) <= LIMITS.longest_colour * colour.spacing
        and not fit.estimate.model.noise.of(channel).heavy
    }
    return replace(fit.treatment, colour={**seen, **fit.treatment.colour})


def colours_seen(estimate: Estimate, *, slow: bool = False) -> dict[str, Colour]:
    """Correlated noise of rate sensors in an estimate's residuals.

    Returns: by channel, in the sigmas of the estimate's campaign; none where the residuals are
    white, or where what they are is not alike everywhere.
    """
    campaign, tests = estimate.model.campaign, estimate.tests
    names = [c.name for c in estimate.model.channels if tests[c.name].is_structured]
    asked = [name for name in names if stream_named(name, campaign).may_be_correlated]
    series = plain_series(estimate) if asked else {}
    seen = {channel: colour_of(campaign.slews, series[channel], slow=slow) for channel in asked}
    return {channel: colour for channel, colour in seen.items() if colour is not None}


def _with_level(fit: CleanFit) -> DirtTreatment:
    """The treatment with the measured level of each channel's noise, where that is noise."""
    if not fit.estimate.is_too_large:
        return fit.treatment
    estimate = fit.estimate
    series, slews = estimate.residual_series, estimate.model.campaign.slews
    level, untold = dict(fit.treatment.level), estimate.model.campaign.shared_errors
    for channel, factor in noise_factors(estimate).items():
        # Of coarsely rounded readings fast differences do not tell the level.
        if channel in untold or factor <= 1.0 or not estimate.model.noise.of(channel).is_stated:
            continue
        in_bursts = not stream_named(channel, estimate.model.campaign).is_series
        if in_bursts or is_alike_everywhere(slews, series[channel]):
            level[channel] = level.get(channel, 1.0) * factor
    return replace(fit.treatment, level=level)


def outlying_fixes(
    slews: Sequence[np.ndarray],
    bursts: Sequence[Sequence[np.ndarray]],
    times: Sequence[np.ndarray] | None = None,
    turns: Sequence[np.ndarray] | None = None,
) -> list[np.ndarray]:
    """Star-tracker fixes that stand out from the others of their burst.

    `slews` (fixes, 3); `times` (fixes,) [s]. `turns` (fixes, 3): how the rate sensor saw the body
    turn beyond what is predicted, in the unit of the residuals; not at all by default. Returns
    (fixes,): none of a burst of less than three fixes, where nobody can say which is wrong, and
    never more than a third of a burst.
    """
    times = [np.arange(float(len(slew))) for slew in slews] if times is None else times
    turns = [np.zeros(slew.shape) for slew in slews] if turns is None else turns
    distances = [np.full(slew.shape, np.nan) for slew in slews]
    for slew, distance, parts, time, turn in zip(
        slews, distances, bursts, times, turns, strict=True
    ):
        for part in parts:
            distance[part] = _distances(slew[part], slew[part] - turn[part], time[part])
    every = np.concatenate(distances)
    every = every[np.isfinite(every)]
    if len(every) < LIMITS.readings_around:
        return [np.zeros(len(slew), bool) for slew in slews]
    limit = stats.norm.isf(0.5 * LIMITS.reject_below / len(every))
    # A quarter more: what others let expect scatters itself. Never below what is stated. Zeros do
    # not count: they are fixes between the others.
    beyond = np.abs(every[every != 0.0])
    scatter = float(np.median(beyond)) if len(beyond) >= LIMITS.readings_around else 0.0
    scale = LIMITS.scatter_of_median * max(1.0, SD_OVER_MAD * scatter)
    flags = [(np.abs(np.nan_to_num(d)) > limit * scale).any(axis=1) for d in distances]
    for flag, parts in zip(flags, bursts, strict=True):
        for part in parts:
            flag[part] &= 3 * int(flag[part].sum()) <= len(part)
    share = sum(int(flag.sum()) for flag in flags) / max(1, sum(map(len, flags)))
    return [flag & (share <= LIMITS.most_outlying_fixes) for flag in flags]


def _distances(burst: np.ndarray, unturned: np.ndarray, time: np.ndarray) -> np.ndarray:
    """How far each fix (m, 3) lies from what the others of its burst let expect."""
    if len(burst) < LIMITS.fewest_fixes:
        return np.full(burst.shape, np.nan)
    if len(burst) >= 2 * LIMITS.neighbours + 1:
        drifting, still = (
            np.stack([distance_from_both_sides(axis) for axis in x.T], 1) for x in (burst, unturned)
        )
        return lesser_distance(still, drifting)
    distance = np.zeros(burst.shape)
    for i in range(len(burst)):
        others = np.delete(np.arange(len(burst)), i)
        still = unturned[i] - np.median(unturned[others], axis=0)
        if len(others) == 2:  # Which of three is wrong is known only where two agree.
            apart = np.abs(unturned[others[1]] - unturned[others[0]])
            still = np.where(apart < 0.5 * np.abs(still), still, 0.0)
        line = np.polynomial.polynomial.polyfit(time[others] - time[i], burst[others], 1)
        drifting = (burst[i] - line[0]) / LIMITS.scatter_of_line
        distance[i] = lesser_distance(still, drifting)
    return distance


def fix_outliers(
    estimate: Estimate, series: dict[str, list[np.ndarray]], channel: str
) -> list[np.ndarray]:
    """Outliers among the fixes of an estimate's campaign.

    `series` (rows, components): its residuals by channel and slew, in stated sigmas, noise that is
    correlated as it is. `channel`: of the star tracker.
    """
    model, slews = estimate.model, estimate.model.campaign.slews
    place = model.structure.place(channel)
    rows = [model.channels[place].readings(model.campaign, slew).row for slew in slews]
    fixes = [x[: len(k)] for x, k in zip(series[channel], rows, strict=True)]
    times = [slew.time[k] for slew, k in zip(slews, rows, strict=True)]
    bursts = [bursts_of(time) for time in times]
    turns = [_turn_seen(estimate, s, x, rows[s]) for s, x in enumerate(series["rate"])]
    factors = np.asarray(estimate.stated[place].factors)
    turns = [np.einsum("fij,fj->fi", factors[s, : len(k)], turns[s]) for s, k in enumerate(rows)]
    flags = outlying_fixes(fixes, bursts, times, turns)
    return [k[flag] for k, flag in zip(rows, flags, strict=True)]


def _turn_seen(
    estimate: Estimate, slew: int, residuals: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """How the rate sensor saw the body turn beyond what is predicted (fixes, 3) [rad]."""
    campaign, time = estimate.model.campaign, estimate.model.campaign.slews[slew].time
    residuals = residuals[: len(time)]
    given = np.isfinite(residuals)
    if not len(rows) or not given.any(axis=0).all():
        return np.zeros((len(rows), 3))
    gap, over = gap_of(estimate, slew, residuals, "rate"), LIMITS.smoothed_over
    smooth = [
        np.interp(time, time[k], ndimage.median_filter(axis[k], over, mode="nearest"))
        for axis, k in zip(gap.T, given.T, strict=True)
    ]
    unbiased = replace(campaign.gyro, bias=(0.0,))
    K = estimate.theta[6 : estimate.model.n_base]
    rate_B = body_rates(unbiased, np.stack(smooth, axis=-1), K)
    return integrate.cumulative_trapezoid(rate_B, time, axis=0, initial=0.0)[rows]


def with_modelled_outliers(estimate: Estimate) -> Estimate:
    """The estimate with a record of each outlier in the channels of heavy noise; none is left out.

    A reading counts as one where Gaussian noise of the spread that the middle of its channel shows
    would not reach once in a thousand campaigns.

    `estimate`: with the noise that its model was asked for. Returns: the same but for the records
    of its campaign; the very object where there is none.
    """
    model, campaign, records = estimate.model, estimate.model.campaign, []
    heavy = [c for c in model.channels if model.noise.of(c.name).heavy]
    series = plain_series(estimate) if heavy else {}
    for channel in heavy:
        title = model.noise.of(channel.name).density.title
        numbers = np.concatenate([np.abs(z[np.isfinite(z)]) for z in series[channel.name]])
        spread = SD_OVER_MAD * float(np.median(numbers))
        limit = spread * float(stats.norm.isf(0.5 * LIMITS.reject_below / len(numbers)))
        for slew, z in zip(campaign.slews, series[channel.name], strict=True):
            # Star-tracker fixes stand one after the other, without the rows between them.
            given = channel.readings(campaign, slew).row
            rows = given[(np.abs(np.nan_to_num(z[: len(given)])) > limit).any(axis=1)]
            if len(rows):
                where = f"in {title} noise"
                records.append(_outliers(channel.name, slew.name, rows, "modelled", where))
    if not records:
        return estimate
    campaign = replace(campaign, dirt=(*campaign.dirt, *records))
    return replace(estimate, model=replace(model, campaign=campaign))
