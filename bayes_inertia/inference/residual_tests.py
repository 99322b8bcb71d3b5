"""Does the model explain the data? Tests of whitened residuals, and what misfit does to the noise.

Where residuals are larger than the stated noise, or correlated in time, the stated noise
understates the uncertainty by far: n correlated numbers carry the information of n / (chi^2 tau),
with chi^2 their mean square and tau their integrated autocorrelation time. `dispersion` measures
that factor slew by slew; the estimate then counts each slew with its inverse.

A fit takes away what it can explain. A few J, K and start states take little from many readings,
and the number of parameters that each channel pays for makes up for it. Free shapes over time take
much, and what they leave is not white: the fast part that a reduced basis lacks remains, the slow
one is overfitted. Where such a shape is a first-order process of the readings it is not taken away
but filtered out, like any other correlated noise (Mehra 1970, "On the identification of variances
and adaptive Kalman filtering": innovations are white if the model is right).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from emcee.autocorr import integrated_time
from scipy import stats

from bayes_inertia.inference.likelihood import Information, Point, residuals
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_model import Whitenings, measured
from bayes_inertia.inference.objective import block_index
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.forward_model import Model


def residual_series(model: Model, point: Point, white: Whitenings) -> dict[str, list[np.ndarray]]:
    """Residuals as series over time.

    Returns (rows, components): by channel and slew; NaN where nothing was measured.
    """
    flat = residuals(model.structure, point, model.data, white)
    series = {}
    for channel, values, valid in zip(model.structure.channels, flat, measured(model), strict=True):
        shaped = np.where(valid, np.asarray(values).reshape(valid.shape), np.nan)
        series[channel.name] = list(shaped)
    return series


@dataclass(frozen=True)
class ChannelTest:
    """Tests of one channel's residuals, all slews together.

    Parameters
    ----------
    reduced_chi2 : float or None
        Mean square per degree of freedom; None without data.
    interval : (float, float) or None
        Its central 99 % interval if the model is right; None without data.
    p_chi2 : float or None
        Two-sided p-value of chi^2.
    p_white : float or None
        p-value of no autocorrelation (ten lags, and periodogram); None where it cannot be tested.
    """

    reduced_chi2: float | None
    interval: tuple[float, float] | None
    p_chi2: float | None
    p_white: float | None

    @property
    def rejected(self) -> bool:
        """Whether the residuals are not what the model and the stated noise predict."""
        return _rejects(self.p_chi2) or self.is_structured

    @property
    def too_large(self) -> bool:
        """Whether they are larger or smoother than predicted (smaller ones are no danger)."""
        return self.is_structured or self._large

    @property
    def why_too_large(self) -> str:
        """By what that shows.

        >>> ChannelTest(1.02, (0.95, 1.05), 0.4, 9e-4).why_too_large
        'residuals structured in time, p = 0.0009'
        """
        if self.is_structured and not self._large:
            return f"residuals structured in time, p = {self.p_white:.1g}"
        return f"reduced chi^2 {self.reduced_chi2:.3g}"

    @property
    def is_structured(self) -> bool:
        """Whether they are correlated in time."""
        return _rejects(self.p_white)

    @property
    def _large(self) -> bool:
        larger = self.reduced_chi2 is not None and self.reduced_chi2 > 1.0
        return larger and _rejects(self.p_chi2)


def _rejects(p_value: float | None) -> bool:
    """Whether noise is no explanation; None: not tested."""
    return p_value is not None and p_value < LIMITS.reject_below


def chi2_test(
    chi2: float, dof: float, p_white: float | None = None, *, shared: bool = False
) -> ChannelTest:
    """Test a sum of squares against its degrees of freedom.

    `dof`: degrees of freedom; there is no test where the fit leaves less than half of one.
    `shared`: whether readings share errors, so that small sums are no surprise.

    Examples
    --------
    >>> chi2_test(130.0, 100.0).rejected, chi2_test(200.0, 100.0).rejected
    (False, True)
    """
    if dof < 0.5:
        return ChannelTest(None, None, None, None)
    lower = 1.0 if shared else stats.chi2.cdf(chi2, dof)
    tails = 2.0 * min(lower, stats.chi2.sf(chi2, dof))
    interval = tuple((stats.chi2.ppf([0.005, 0.995], dof) / dof).tolist())
    return ChannelTest(float(chi2 / dof), interval, float(min(1.0, tails)), p_white)


def channel_tests(
    channels: Sequence[Channel],
    series: dict[str, list[np.ndarray]],
    chi2: np.ndarray,
    dof: np.ndarray,
    rounded: Sequence[str],
) -> dict[str, ChannelTest]:
    """Test every channel, and the total.

    `chi2`, `dof`: of each channel. `series` (rows, components): residuals by channel and slew, NaN
    where nothing was measured. `rounded`: channels whose readings are rounded so coarsely that
    they share errors, which are not white by right.
    """
    tests = {}
    for i, channel in enumerate(channels):
        # Star-tracker fixes come in a few bursts: no series to correlate.
        shared = channel.name in rounded
        is_tested = channel.stream.is_series and not shared
        p_white = whiteness(series[channel.name]) if is_tested else None
        tests[channel.name] = chi2_test(float(chi2[i]), float(dof[i]), p_white, shared=shared)
    tests["total"] = chi2_test(float(chi2.sum()), float(dof.sum()), shared=bool(rounded))
    return tests


def scale_test(scale: float, spread: float, test: ChannelTest) -> ChannelTest:
    """The test of a channel whose scale is sampled: against the prior of the scale.

    Its squares tell nothing any more. They are counted in stated sigmas, and so is the interval.
    `spread`: prior sd of the scale's logarithm.
    """
    if test.reduced_chi2 is None:
        return test
    p_scale = float(2.0 * stats.norm.sf(abs(np.log(scale)) / spread))
    central_99 = float(stats.norm.isf(0.005))
    low, high = np.exp(2.0 * spread * central_99 * np.array([-1.0, 1.0])).tolist()
    return ChannelTest(scale**2 * test.reduced_chi2, (low, high), p_scale, test.p_white)


def _columns(slews: list[np.ndarray]) -> list[np.ndarray]:
    """Series of single components that are long enough to correlate."""
    columns = [slew[np.isfinite(slew[:, i]), i] for slew in slews for i in range(slew.shape[1])]
    return [c for c in columns if len(c) > 5 * LIMITS.lags]


def whiteness(slews: list[np.ndarray]) -> float | None:
    """p-value of white residuals, all components and slews together.

    Two tests, the smaller p-value counted twice: correlation over a few samples, which noise that
    is louder at times is not, and the highest line of the periodogram summed over all series
    (Fisher's g without its single series), which sees a small ripple that lasts.

    `slews` (rows, components).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> noise = rng.normal(size=(400, 3))
    >>> whiteness([noise]) > 1e-3, whiteness([noise.cumsum(0)]) < 1e-3
    (True, True)
    >>> ripple = 0.3 * np.sin(0.3 * np.arange(400.0))[:, None]
    >>> whiteness([rng.normal(size=(400, 3)) + ripple for _ in range(5)]) < 1e-6
    True
    """
    columns = _columns(slews)
    if not columns:
        return None
    smallest = min(_correlation_over_lags(columns), _highest_line(columns))
    return float(-np.expm1(2.0 * np.log1p(-min(smallest, 1.0 - 1e-16))))


def _correlation_over_lags(columns: list[np.ndarray]) -> float:
    """p-value of correlation over a few samples, all series together.

    The variance of each correlation is that of the products seen, so that noise which is louder at
    times is no correlation (Lobato, Nankervis and Savin, Int. Econ. Rev. 42, 2001).
    """
    total, lags = 0.0, range(1, LIMITS.lags + 1)
    for column in columns:
        x = column - column.mean()
        products, variances = np.array(
            [[x[lag:] @ x[:-lag], x[lag:] ** 2 @ x[:-lag] ** 2] for lag in lags]
        ).T
        total += float(np.sum(products**2 / np.maximum(variances, 1e-300)))
    return float(stats.chi2.sf(total, LIMITS.lags * len(columns)))


def _highest_line(columns: list[np.ndarray]) -> float:
    """Sidak's p-value of the highest line of the summed periodogram.

    Noise that repeats in every slew, as that of an actuator's readings may, spreads the sums of all
    lines: the degrees of freedom are those of the spread of the others.
    """
    n, dof = max(len(x) for x in columns), 2 * len(columns)
    lines: Any = sum(
        2.0
        * np.abs(np.fft.rfft(x - x.mean(), n)) ** 2
        / max(float(np.sum((x - x.mean()) ** 2)), 1e-300)
        for x in columns
    )
    # Without the mean, and the line at half the sampling rate, which has one degree of freedom.
    inside = lines[1 : (n - 1) // 2 + 1]
    highest = int(np.argmax(inside))
    # What lies between two lines leaks into both.
    others = np.delete(inside, slice(max(highest - 1, 0), highest + 2))
    seen = dof * min(1.0, 2.0 * dof / max(float(np.var(others)), 1e-300))
    single = float(stats.chi2.sf(inside[highest] * seen / dof, seen))
    return float(-np.expm1(len(inside) * np.log1p(-min(single, 1.0 - 1e-16))))


def dispersion(slew: np.ndarray, *, bursts: bool = False) -> float:
    """By which factor one slew's residuals carry less information than white unit noise would.

    `slew` (rows, components). `bursts`: star-tracker fixes, taken as fully correlated within each
    half of the slew.

    Examples
    --------
    >>> dispersion(2.0 * np.random.default_rng(1).normal(size=(4000, 3))) < 6.0
    True
    """
    finite = slew[np.isfinite(slew)]
    if len(finite) == 0:
        return 1.0
    size = float(np.mean(finite**2))
    if bursts:
        return max(1.0, size * len(finite) / slew.shape[1] / 2.0) if size > 1.0 else 1.0
    # A series that never changes has no correlation to measure.
    varying = [x for x in _columns([slew]) if np.ptp(x) > 0.0]
    taus = [float(integrated_time(x, quiet=True, tol=0)[0]) for x in varying]
    return max(1.0, size * max(1.0, float(np.mean(taus)) if taus else 1.0))


@array_dataclass
class TestedResiduals:
    """Residuals that are white and of unit variance where the model is right.

    Parameters
    ----------
    series : dict of list of (rows, components) arrays
        By channel and slew, in stated sigmas; NaN where nothing was measured.
    chi2 : (slews, channels) array
        Sums of squares by slew and channel.
    parameters : (channels,) array
        How many parameters each channel pays for.
    """

    series: dict[str, list[np.ndarray]]
    chi2: np.ndarray
    parameters: np.ndarray


def effective_parameters(
    model: Model,
    point: Point,
    information: Information,
    covariance: np.ndarray,
    *,
    nuisances: np.ndarray | None = None,
) -> np.ndarray:
    """How many parameters of location each channel pays for: the hat matrix's traces over its rows.

    `covariance` (unknowns, unknowns) [free]. `nuisances` (n_local,): which of a slew's nuisances
    are paid for; all by default. The others act all the same. Returns (channels,).
    """
    located = np.array([model.space.names[i] not in model.noise.names for i in information.free])
    n_local = point.n_local
    total = np.zeros(information.n_data.shape[1])
    for s, block in enumerate(information.matrix):
        index = block_index(block.shape[-1] - n_local, n_local, s)
        if not model.noise.is_stated:
            keep = np.concatenate([located, np.ones(len(index) - len(located), bool)])
            index, block = index[keep], block[:, keep][:, :, keep]
        paid = np.ones(len(index), bool)
        if nuisances is not None:
            paid[-n_local:] = nuisances
        total += np.einsum("cpq,qp->c", block[:, paid], covariance[np.ix_(index, index[paid])])
    return total
