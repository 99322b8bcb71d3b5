"""Level and colour of a sensor's noise, from what is fast in the residuals.

Smooth misfit does not touch second differences, which tell the white level.

A missing effect is slow, or tied to the motion. So the noise is measured from the fast cosine
components of stretches of rest and of motion (Whittle's likelihood), and believed only where one
noise serves them all: rest and motion, and every slew.

Readings rounded to a step are known from the readings themselves, before any fit. Rounding adds an
error of step / sqrt(12). Where the noise is small beside the step, readings stay the same while the
truth moves little: their errors are one error, not many, and no test for white noise applies
(Widrow and Kollar 2008, chapter 20: noise of half a step makes errors independent).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft, optimize, stats

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import series_of
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.quantisation import quantisation_sigma, quantisation_step
from bayes_inertia.inference.limits import LIMITS

# Differences of white noise, by order: variance, and the number of independent values that one is
# worth times two (from their correlations).
_DIFFERENCE_VARIANCE = {1: 2.0, 2: 6.0, 4: 70.0}
_DIFFERENCE_WORTH = {
    1: 2.0 * (1.0 + 2.0 / 4.0),
    2: 2.0 * (1.0 + 2.0 * (16.0 + 1.0) / 36.0),
    4: 2.0 * (1.0 + 2.0 * (56.0**2 + 28.0**2 + 8.0**2 + 1.0) / 70.0**2),
}
_MEDIAN_OF_CHI2 = 0.454936  # with one degree of freedom
_POWER_BELOW_3_SIGMA = 0.973337  # mean square of a standard normal number that is below 3 sigma


class ColourOfAxis(NamedTuple):
    """Noise of one component: white plus Gauss-Markov.

    Parameters
    ----------
    sd : float
        Of all of it, in stated sigmas.
    share : float
        Share of the variance that is correlated.
    correlation : float
        Of the correlated part over one reading.
    lead : float
        Log likelihood beyond that of white noise of any level.
    """

    sd: float
    share: float
    correlation: float
    lead: float


@dataclass(frozen=True)
class Colour:
    """Correlated noise of the rate sensor.

    Parameters
    ----------
    axes : tuple of ColourOfAxis
        One an axis.
    spacing : float
        Time from reading to reading [s].
    """

    axes: tuple[ColourOfAxis, ...]
    spacing: float

    @property
    def times(self) -> tuple[float, ...]:
        """Correlation times [s]."""
        return tuple(-self.spacing / float(np.log(axis.correlation)) for axis in self.axes)


class Stretch(NamedTuple):
    """Readings of one slew, all at rest or all in motion.

    Parameters
    ----------
    slew : str
        Name of the slew.
    rests : bool
        Whether the body rests.
    readings : (n,) array
        Residuals of one axis.
    """

    slew: str
    rests: bool
    readings: np.ndarray


def colour_of(
    slews: Sequence[Slew],
    residuals: Sequence[np.ndarray],
    *,
    slow: bool = False,
) -> Colour | None:
    """The correlated noise that residuals of the rates show.

    `residuals` (rows, axes): in stated sigmas, white where the noise is as stated; NaN where
    nothing was measured. `slow`: whether slow components count, too: where effects are not taken
    for noise by other means. Returns: none where the noise is white, or where what looks like noise
    is not alike in all slews, at rest and in motion.
    """
    axes, gain, parameters = [], 0.0, 0
    for axis in range(residuals[0].shape[1]):
        stretches = stretches_of(slews, [values[:, axis] for values in residuals])
        if not stretches:
            return None
        axes.append(gauss_markov_noise(_whole(residuals, axis), slow=slow))
        for key in ("rests", "slew"):
            more = _gain_apart(stretches, key, axes[-1])
            gain, parameters = gain + more[0], parameters + more[1]
    spacings = _spacings(slews, residuals)
    medians = [float(np.median(x)) for x in spacings if len(x)]
    uneven = max(medians) > 1.5 * min(medians)
    if uneven or max(a.lead for a in axes) < LIMITS.clear_lead:
        return None
    if parameters and stats.chi2.sf(2.0 * gain, parameters) < LIMITS.reject_below:
        return None
    clear = tuple(a if a.lead > LIMITS.least_lead else a._replace(share=0.0) for a in axes)
    return Colour(clear, float(np.median(np.concatenate(spacings))))


def _whole(residuals: Sequence[np.ndarray], axis: int) -> list[np.ndarray]:
    """The readings of one axis, by slew."""
    series = [values[np.isfinite(values[:, axis]), axis] for values in residuals]
    return [x for x in series if len(x) >= LIMITS.fewest_readings]


def _spacings(slews: Sequence[Slew], residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Times (m,) from one reading to the next in each slew [s]."""
    return [
        np.diff(slew.time[np.isfinite(values[: len(slew.time)]).any(axis=1)])
        for slew, values in zip(slews, residuals, strict=True)
    ]


def stretches_of(slews: Sequence[Slew], residuals: Sequence[np.ndarray]) -> list[Stretch]:
    """Cut residuals of one axis into stretches of rest and of motion.

    `residuals` (rows,).
    """
    stretches = []
    for slew, values in zip(slews, residuals, strict=True):
        rows = np.flatnonzero(np.isfinite(values[: len(slew.time)]))
        rest = at_rest(slew)[rows]
        for part in np.split(np.arange(len(rows)), 1 + np.flatnonzero(np.diff(rest))):
            if len(part) >= LIMITS.fewest_readings:
                stretches.append(Stretch(slew.name, bool(rest[part[0]]), values[rows[part]]))
    return stretches


def at_rest(slew: Slew) -> np.ndarray:
    """Rows in which the body hardly turns.

    Returns (n,): A few rows of rest amid motion count as motion, and the other way round.
    """
    rows, rates = slew.complete_rates()
    if not len(rows):
        return np.zeros(len(slew.time), bool)
    speed = np.interp(slew.time, slew.time[rows], np.linalg.norm(rates, axis=1))
    rests = speed < LIMITS.rests_below * float(np.quantile(speed, 0.95))
    width = 2 * (LIMITS.fewest_readings // 4) + 1
    padded = np.pad(rests.astype(float), width // 2, mode="edge")
    return np.convolve(padded, np.ones(width), "valid") > 0.5 * width


def gauss_markov_noise(series: Sequence[np.ndarray], *, slow: bool = False) -> ColourOfAxis:
    """White and Gauss-Markov noise that fast components of series show.

    `series` (n,).

    Examples
    --------
    >>> from scipy.signal import lfilter
    >>> white = np.random.default_rng(1).normal(size=(5, 500))
    >>> noise = gauss_markov_noise(list(lfilter([0.8], [1.0, -0.6], white)))
    >>> bool(noise.lead > 100.0), round(noise.correlation, 1), round(noise.sd, 1)
    (True, 0.6, 1.0)
    """
    longest = LIMITS.longest_slow if slow else LIMITS.longest_fast
    return _best_noise(*_fast_components(series, longest), LIMITS.colour_starts)


def _fast_components(
    series: Sequence[np.ndarray], longest: tuple[float, float] = LIMITS.longest_fast
) -> tuple[np.ndarray, np.ndarray]:
    """Angular frequency [rad a reading] and power of the fast cosine components of series."""
    angles, powers = [], []
    for x in series:
        angle = np.pi * np.arange(len(x)) / len(x)
        fast = angle > 2.0 * np.pi / min(longest[0], longest[1] * len(x))
        angles.append(angle[fast])
        powers.append(fft.dct(x - x.mean(), norm="ortho")[fast] ** 2)
    return np.concatenate(angles), np.maximum(np.concatenate(powers), 1e-12)


def _spectrum(x: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Power of noise with the log variance and the logits of share and correlation in x."""
    share, correlation = _share_and_correlation(x)
    lasting = (1.0 - correlation**2) / (1.0 - 2.0 * correlation * np.cos(angle) + correlation**2)
    return np.exp(x[0]) * (1.0 - share + share * lasting)


def _share_and_correlation(x: np.ndarray) -> tuple[float, float]:
    share, correlation = 1.0 / (1.0 + np.exp(-np.asarray(x[1:])))
    return float(share), float(LIMITS.most_correlation * correlation)


def _best_noise(
    angle: np.ndarray, power: np.ndarray, starts: Sequence[tuple[float, float]]
) -> ColourOfAxis:
    """The noise of greatest Whittle likelihood."""
    mean = float(power.mean())
    # Neighbouring components share a spectrum: a hundredth of the work.
    place = np.minimum((angle * (LIMITS.bins / np.pi)).astype(int), LIMITS.bins - 1)
    count = np.bincount(place, minlength=LIMITS.bins)
    filled = count > 0
    count = count[filled]
    middle = np.bincount(place, angle, LIMITS.bins)[filled] / count
    average = np.bincount(place, power, LIMITS.bins)[filled] / count

    def cost(x: np.ndarray) -> float:
        spectrum = _spectrum(x, middle)
        return 0.5 * float(np.sum(count * (np.log(spectrum) + average / spectrum)))

    level = float(np.log(mean))
    bounds = [(level - 8.0, level + 8.0), (-6.0, 12.0), (-6.0, 8.0)]
    stop = {"xatol": 1e-3, "fatol": 1e-4}
    fits = [
        optimize.minimize(cost, [level, *start], method="Nelder-Mead", bounds=bounds, options=stop)
        for start in starts
    ]
    best = min(fits, key=lambda result: result.fun)
    white = 0.5 * len(power) * (level + 1.0)
    return ColourOfAxis(
        float(np.exp(0.5 * best.x[0])), *_share_and_correlation(best.x), float(white - best.fun)
    )


def _groups(stretches: Sequence[Stretch], key: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Fast components of groups alike in one field; none unless two have enough of them."""
    groups: dict[object, list[np.ndarray]] = {}
    for stretch in stretches:
        groups.setdefault(getattr(stretch, key), []).append(stretch.readings)
    parts = [_fast_components(readings) for readings in groups.values()]
    parts = [part for part in parts if len(part[0]) >= LIMITS.fewest_components]
    return parts if len(parts) > 1 else []


def _gain_apart(
    stretches: Sequence[Stretch], key: str, together: ColourOfAxis
) -> tuple[float, int]:
    """Log likelihood that a noise for each group gains on one for all, and parameters more."""
    parts = _groups(stretches, key)
    if not parts:
        return 0.0, 0
    share = np.clip(together.share, 1e-3, 1.0 - 1e-5)
    correlation = np.clip(together.correlation / LIMITS.most_correlation, 1e-3, 1.0 - 1e-3)
    start = (float(np.log(share / (1 - share))), float(np.log(correlation / (1 - correlation))))

    def log_likelihood(angle: np.ndarray, power: np.ndarray) -> float:
        lead = _best_noise(angle, power, (start,)).lead
        return lead - 0.5 * len(power) * (np.log(float(power.mean())) + 1.0)

    apart = sum(log_likelihood(*part) for part in parts)
    every = map(np.concatenate, zip(*parts, strict=True))
    return apart - log_likelihood(*every), 3 * (len(parts) - 1)


def is_alike_everywhere(slews: Sequence[Slew], residuals: Sequence[np.ndarray]) -> bool:
    """Whether fast noise is as strong in all slews, and at rest as in motion.

    `residuals` (rows, components): white but for what the model misses; NaN where nothing was
    measured. Returns: also where there are too few numbers to tell.
    """
    statistic, freedom = 0.0, 0
    for component in range(residuals[0].shape[1]):
        stretches = stretches_of(slews, [values[:, component] for values in residuals])
        for key in ("rests", "slew"):
            more = _unlike([power for _, power in _groups(stretches, key)])
            statistic, freedom = statistic + more[0], freedom + more[1]
    return not freedom or bool(stats.chi2.sf(statistic, freedom) > LIMITS.reject_below)


def _unlike(parts: Sequence[np.ndarray]) -> tuple[float, int]:
    """Bartlett's test of equal variances of fast components: statistic, degrees of freedom."""
    if not parts:
        return 0.0, 0
    every = np.concatenate(parts)
    apart = sum(len(part) * np.log(part.mean()) for part in parts)
    return float(len(every) * np.log(every.mean()) - apart), len(parts) - 1


def white_factor(pieces: list[np.ndarray], large: list[np.ndarray] | None = None) -> float:
    """Measure by what factor the white noise of series exceeds one.

    Components (sensor axes, wheels) and pieces share one factor. Where one is significantly louder
    than all together it is the loudest one's, so that no uncertainty comes out too small; so is a
    component where its readings are large, because noise may grow with what is measured. That of a
    component is measured from fourth differences, in which a ringing of one axis hardly counts. Of
    pieces too short for second differences, such as two fixes at rest, first ones are taken.

    `pieces` (rows, components): series of even spacing; NaN where nothing was measured. `large`
    (rows, components): where readings are large; None if they have no size.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> white_factor([rng.normal(size=(500, 3))])
    1.0
    >>> round(white_factor([rng.normal(size=(5000, 3)) * [1.0, 1.0, 3.0]]), 1)
    3.0
    """
    every = {k: np.concatenate([np.zeros(0), *_squares(pieces, k)]) for k in (2, 1)}
    order = next((k for k, own in every.items() if len(own) >= LIMITS.fewest_differences), None)
    if order is None:
        return 1.0
    power, least = _clipped_power(every[order], order), _louder_than(every[order].size, order)
    groups = [(4, own) for own in _squares(pieces, 4)]
    groups += [(order, np.concatenate(of)) for x in pieces if (of := _squares([x], order))]
    # Series of slews are as long as the longest.
    own_rows = zip(large or (), pieces, strict=False)
    where_large = [np.where(mask, piece[: len(mask)], np.nan) for mask, piece in own_rows]
    groups += [(order, own) for own in _squares(where_large, order)]
    for k, own in groups:
        if len(own) < LIMITS.fewest_differences:
            continue
        own_power, own_least = _clipped_power(own, k), _louder_than(own.size, k, len(groups))
        if own_power > power * own_least:
            power, least = own_power, own_least
    return float(np.sqrt(power)) if power > least else 1.0


def _louder_than(count: int, order: int, groups: int = 1) -> float:
    """By what factor a mean of so many squared differences exceeds its expectation significantly.

    `order`: of the differences; `groups`: that are looked at.
    """
    dof = 2.0 * count / _DIFFERENCE_WORTH[order]
    beyond = stats.norm.sf(LIMITS.significant_sigmas) / groups
    return float(stats.chi2.isf(beyond, dof) / dof)


def _squares(pieces: list[np.ndarray], order: int) -> list[np.ndarray]:
    """Squared differences of some order, one array a component."""
    squares = [np.diff(piece, n=order, axis=0) ** 2 for piece in pieces if len(piece) > order]
    columns = np.concatenate(squares).T if squares else ()
    return [column[np.isfinite(column)] for column in columns]


def bursts_of(time: np.ndarray) -> list[np.ndarray]:
    """Star-tracker fixes of a slew, split at its gaps.

    What differs between before and after a slew is not noise.

    `time` (fixes,) [s].

    Examples
    --------
    >>> [burst.tolist() for burst in bursts_of(np.array([0.0, 1.0, 2.0, 50.0, 51.0]))]
    [[0, 1, 2], [3, 4]]
    """
    gaps, every = np.diff(time), np.arange(len(time))
    if not len(gaps):
        return [every]
    long = gaps > LIMITS.gap_in_spacings * np.quantile(gaps, 0.25)
    return np.split(every, 1 + np.flatnonzero(long))


def _clipped_power(squares: np.ndarray, order: int) -> float:
    """White noise power from squared differences, without the few jumps of an unmodelled step.

    The median starts it, or the mean where most readings repeat, as those of an idle wheel or of a
    coarse counter do; the mean below three sigma, which scatters far less, finishes it.
    """
    power = float(np.median(squares)) / _MEDIAN_OF_CHI2 or float(np.mean(squares))
    for _ in range(20):
        below = squares[squares < 9.0 * power]
        if not below.any():
            return 0.0
        power = float(np.mean(below)) / _POWER_BELOW_3_SIGMA
    return power / _DIFFERENCE_VARIANCE[order]


def rounding_steps(campaign: Campaign) -> dict[str, np.ndarray]:
    """The steps to which readings in series are rounded.

    Returns (components,): by channel [stated sigma]; 0 where nothing is rounded.
    """
    steps = {}
    for stream in series_of(campaign):
        tables = [x for slew in campaign.slews if (x := stream.of(slew)) is not None]
        steps[stream.name] = np.array(
            [
                (quantisation_step(np.concatenate([x[:, k] for x in tables])) or 0.0) / one
                if one is not None and tables
                else 0.0
                for k, one in enumerate(stream.sigma(campaign))
            ]
        )
    return steps


def factor_of_rounding(steps: np.ndarray) -> float:
    """What rounding adds to the noise of a channel.

    `steps` (components,) [stated sigma]. Returns: factor on the stated sigma, of the coarsest
    component.

    Examples
    --------
    >>> factor_of_rounding(np.array([0.0, 6.0]))
    2.0
    """
    return float(np.hypot(1.0, quantisation_sigma(float(steps.max(initial=0.0)))))


def is_coarse(steps: np.ndarray) -> bool:
    """Whether a channel's noise as stated cannot hold its rounding.

    `steps` (components,) [stated sigma].

    Examples
    --------
    >>> is_coarse(np.array([1.0, 6.0])), is_coarse(np.array([1.0]))
    (True, False)
    """
    return quantisation_sigma(float(steps.max(initial=0.0))) > 1.0


def has_one_error(steps: np.ndarray) -> bool:
    """Whether readings of a channel share rounding errors, so that these are not white.

    `steps` (components,): [sigma of the noise as used, which holds the rounding].
    """
    in_used = LIMITS.coarse_step / np.hypot(1.0, quantisation_sigma(LIMITS.coarse_step))
    return bool(np.any(steps > in_used))


def factor_of_shared_errors(
    paths: Sequence[np.ndarray], motions: Sequence[np.ndarray], noise: Sequence[float]
) -> float:
    """By what factor rounding blurs the size of a motion more than independent errors would.

    Beside small noise the error depends on the true reading alone: it is one on the way up and
    down, at rest, and in every slew. A sawtooth of any phase has the variance 1 / (2 pi^2 k^2) in
    its harmonic k, of which noise leaves exp(-(2 pi k sd)^2) in common (Widrow and Kollar 2008).

    `paths` (rows,): true readings of each component [steps]; `motions`: the same without what is
    fitted beside the size. `noise`: its sd without rounding [steps].

    Examples
    --------
    >>> turn = 10.3 * np.sin(np.linspace(0.0, np.pi, 1200)) ** 2
    >>> [round(factor_of_shared_errors([turn], [turn], [sd]), 1) for sd in (0.02, 0.5)]
    [3.4, 1.0]
    """
    k, shared, total = np.arange(1, LIMITS.harmonics_of_rounding + 1), 0.0, 0.0
    for path, motion, sd in zip(paths, motions, noise, strict=True):
        in_common = np.exp(-((2.0 * np.pi * k * sd) ** 2)) / (2.0 * np.pi**2 * k**2)
        along = np.array([abs(np.exp(2j * np.pi * each * path) @ motion) ** 2 for each in k])
        shared += float(in_common @ (along - motion @ motion))
        total += float(motion @ motion) / 12.0
    return float(np.sqrt(max(1.0, 1.0 + shared / total))) if total else 1.0


def noise_beside_rounding(readings: np.ndarray, path: np.ndarray, motion: np.ndarray) -> float:
    """The sd of the noise of rounded readings, without their rounding [steps].

    Noise n moves a reading by |n| steps on average, whatever the place between two steps.

    `readings`, `path` (rows,): as read, and true [steps]; `motion` (rows,): what a row counts for.

    Examples
    --------
    >>> path, noise = np.linspace(0.0, 40.0, 4000), 0.1 * np.random.default_rng(1).normal(size=4000)
    >>> round(noise_beside_rounding(np.round(path + noise), path, path), 2)
    0.1
    """
    if not motion.any():
        return 0.0
    moved = np.abs(np.round(readings - readings[0]) - np.round(path - readings[0]))
    return float(np.sqrt(0.5 * np.pi) * np.average(moved, weights=motion**2))


def level_of_rounded(measured: float, steps: np.ndarray) -> float:
    """The noise of a rounded channel.

    Errors of coarse rounding are not independent: fast differences measure their level badly.

    `steps` (components,) [stated sigma].

    Examples
    --------
    >>> level_of_rounded(2.3, np.array([6.0])), level_of_rounded(1.1, np.array([1.0]))
    (2.0, 1.1)
    """
    factor = factor_of_rounding(steps)
    trusted = not has_one_error(steps) or measured > LIMITS.louder_than_coarse * factor
    return max(factor, measured) if trusted else factor
