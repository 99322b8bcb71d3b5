"""Whether the residuals of a fit are noise, where they are not, and slews left out of the fit.

Windows of 1, 2, 4, ... rows, each overlapping the next by half, are tested for a shift of their
mean and for too large a mean square. The largest of all these statistics is compared with the
largest that fits of a perfect model leave (simulated, with the share that fitting takes), so that
each p-value counts all the places looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from bayes_inertia.campaign.sensors import stream_named
from bayes_inertia.diagnosis.limits import LIMITS, Rules
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import ChannelRows, LinearisedFit
from bayes_inertia.inference.residual_tests import ChannelTest
from bayes_inertia.inference.slew_shares import eliminated
from bayes_inertia.maths.linear_algebra import solve
from bayes_inertia.maths.values import array_dataclass


def is_explained(tests: dict[str, ChannelTest], rules: Rules) -> bool:
    """Test whether nothing is left in the residuals that noise would not leave.

    Residuals may be smaller than the noise; structure none may have.
    """
    p_values = [t.p_white for t in tests.values()]
    p_values += [t.p_chi2 for t in tests.values() if t.reduced_chi2 and t.reduced_chi2 > 1.0]
    return min((p for p in p_values if p is not None), default=1.0) > rules.misfit_p_value


@dataclass(frozen=True)
class Window:
    """A stretch of one channel in one slew that noise does not explain.

    Parameters
    ----------
    channel : str
        Which channel.
    slew, component : str
        Names.
    t_start, t_end : float
        First and last row in it [s].
    kind : {"shift", "energy"}
        Whether the mean is off, or the mean square is too large.
    score : float
        In standard deviations.
    p_value : float
        Probability of a window like this anywhere in the campaign if model and noise are right.
    """

    channel: str
    slew: str
    component: str
    t_start: float
    t_end: float
    kind: str
    score: float
    p_value: float


@array_dataclass
class BinnedResiduals:
    """One channel for the picture: mean residuals in short bins.

    Parameters
    ----------
    components : tuple of str
        Names.
    edges : (slews, bins + 1) array
        Of the bins [s].
    shift : (slews, components, bins) array
        In standard deviations of such a mean; NaN where nothing was measured.
    """

    components: tuple[str, ...]
    edges: np.ndarray
    shift: np.ndarray


@array_dataclass
class Disagreement:
    """Where residuals are not what noise would leave.

    Parameters
    ----------
    windows : tuple of Window
        Most significant first, not overlapping within a channel and slew.
    p_value : float
        Of the strongest disagreement anywhere.
    cells : dict
        {channel: BinnedResiduals}, for the picture.
    slews : tuple of str
        Names.
    """

    windows: tuple[Window, ...]
    p_value: float
    cells: dict[str, BinnedResiduals]
    slews: tuple[str, ...]


def scan_residuals(
    estimate: Estimate, *, seed: int = 0, stated: bool = True, replicates: int = 300
) -> Disagreement:
    """Scan the residuals of a fit for windows that noise does not explain.

    `stated`: compare with the noise that the campaign states, or (False) with the noise as used.
    `replicates`: simulated fits behind the p-values. Smaller p-values than they reach follow from
    the tail of a Gumbel distribution.
    """
    fit, rng = estimate.linearised(), np.random.default_rng([seed, 5])
    noise = fit.weight if stated else np.ones_like(fit.weight)
    scans = channel_scans(fit, noise)
    largest = []
    for start in range(0, replicates, LIMITS.replicates_at_a_time):
        drawn = fit.replicates(rng, min(LIMITS.replicates_at_a_time, replicates - start), noise)
        scores = (s.scores(fit.channels[n].shaped(drawn)) for n, s in scans.items())
        largest.append(np.max([x.max((0, 1, 2, 3)) for x in scores], axis=0))
    # Half the square of a normal score has an exponential tail, and the largest of many such a
    # Gumbel distribution.
    null = stats.gumbel_r(*stats.gumbel_r.fit(0.5 * np.concatenate(largest) ** 2))
    windows: list[Window] = []
    smallest = 1.0
    for name, scan in scans.items():
        score = scan.scores(fit.channels[name].shaped(fit.settled_residual[..., None]))[..., 0]
        p_value = np.maximum(null.sf(0.5 * score.max(0) ** 2), 1e-300)
        smallest = min(smallest, float(p_value.min()))
        windows += _significant_windows(fit, name, scan, score, p_value)
    return Disagreement(
        tuple(sorted(windows, key=lambda w: (w.p_value, -w.score))),
        smallest,
        {name: _binned(fit, name, noise) for name in scans},
        tuple(slew.name for slew in estimate.model.campaign.slews),
    )


def _significant_windows(
    fit: LinearisedFit, name: str, scan: ChannelScan, scores: np.ndarray, p_value: np.ndarray
) -> list[Window]:
    """The most significant windows of each slew of one channel that do not overlap.

    `scores` (2, slews, w, components): of shift and energy; `p_value` of the larger.
    """
    channel, campaign = fit.channels[name], fit.model.campaign
    components = stream_named(name, campaign).components(campaign)
    score, kind = scores.max(0), scores.argmax(0)
    windows = []
    for s, slew in enumerate(campaign.slews):
        covered = np.zeros(channel.valid.shape[1], bool)
        significant = np.argwhere(p_value[s] < LIMITS.significant)
        for w, c in sorted(significant, key=lambda i: -score[s][tuple(i)]):
            measured = np.flatnonzero(channel.valid[s, : scan.stop[w], c])
            first, last = measured[measured >= scan.start[w]][[0, -1]]
            if covered[first : last + 1].any():
                continue
            covered[first : last + 1] = True
            windows.append(
                Window(
                    channel=name,
                    slew=slew.name,
                    component=components[c],
                    t_start=float(channel.time[s, first]),
                    t_end=float(channel.time[s, last]),
                    kind=("shift", "energy")[kind[s, w, c]],
                    score=float(score[s, w, c]),
                    p_value=float(p_value[s, w, c]),
                )
            )
    return windows


def _binned(fit: LinearisedFit, name: str, noise: np.ndarray) -> BinnedResiduals:
    """Mean residuals of one channel in even bins over each slew."""
    channel, bins = fit.channels[name], LIMITS.bins
    scaled = channel.shaped(fit.settled_residual) / channel.shaped(noise)
    times = fit.channels["rate"].time
    edges = np.stack([np.linspace(t[0], t[-1] * (1 + 1e-12) + 1e-12, bins + 1) for t in times])
    slews, _, components = channel.valid.shape
    count, total = np.zeros((2, slews, components, bins))
    for s, c in np.ndindex(slews, components):
        there = channel.valid[s, :, c]
        time, each = channel.time[s, there], scaled[s, there, c]
        count[s, c], _ = np.histogram(time, edges[s])
        total[s, c], _ = np.histogram(time, edges[s], weights=each)
    shift = np.where(count > 0, total / np.sqrt(np.maximum(count, 1)), np.nan)
    names = stream_named(name, fit.model.campaign).components(fit.model.campaign)
    return BinnedResiduals(names, edges, shift)


def scan_windows(rows: int, shortest: int) -> tuple[np.ndarray, np.ndarray]:
    """List the windows of a scan.

    `shortest`: rows of the shortest windows, a power of two. Returns `start, stop` (w,): first row,
    and row after the last, of all windows.

    Examples
    --------
    >>> [x.tolist() for x in scan_windows(4, 2)]
    [[0, 1, 2, 0], [2, 3, 4, 4]]
    """
    pairs = []
    length = shortest
    while length < 2 * rows:
        size = min(length, rows)
        starts = np.arange(0, rows - size + 1, max(1, size // 2))
        pairs.append(np.stack([starts, starts + size]))
        length *= 2
    start, stop = np.concatenate(pairs, axis=1)
    return start, stop


@array_dataclass
class ChannelScan:
    """The windows of one channel, and what a perfect model would leave in them.

    Parameters
    ----------
    start, stop : (w,) arrays of int
        First row, and row after the last.
    sd : (slews, w, components) array
        Of the sum of the residuals; zero where nothing was measured.
    energy : (slews, w, components) array
        Expected sum of squares.
    dof : (slews, w, components) array
        Its degrees of freedom.
    """

    start: np.ndarray
    stop: np.ndarray
    sd: np.ndarray
    energy: np.ndarray
    dof: np.ndarray

    def scores(self, residuals: np.ndarray) -> np.ndarray:
        """Score the windows of k sets of residuals.

        `residuals` (slews, rows, components, k). Returns (2, slews, w, components, k): normal
        scores of the mean's shift and of too large a mean square.
        """
        # Where nothing was measured both are zero.
        sd, expected = (np.where(x > 0, x, np.inf)[..., None] for x in (self.sd, self.energy))
        shift = np.abs(_sums(residuals, self.start, self.stop)) / sd
        ratio = _sums(residuals**2, self.start, self.stop) / expected
        # Wilson and Hilferty (1931): the cube root of a mean square is nearly normal.
        dof = self.dof[..., None]
        spread = 2.0 / (9.0 * np.maximum(dof, 1e-3))
        energy = np.where(dof > 0.5, (np.cbrt(ratio) - 1.0 + spread) / np.sqrt(spread), 0.0)
        return np.stack([shift, np.maximum(energy, 0.0)])


def channel_scans(fit: LinearisedFit, noise: np.ndarray) -> dict[str, ChannelScan]:
    """Prepare the scan of every channel that measured anything.

    `fit`: the fit, whose columns tell what share of the noise it takes. `noise` (slews, numbers):
    standard deviation of the noise in units of the noise as used; one for all numbers of a channel
    and slew.
    """
    channels = {name: c for name, c in fit.channels.items() if c.valid.any()}
    numbers = sum(c.valid.size for c in channels.values())
    shortest = 2 ** max(0, int(np.ceil(np.log2(4.0 * numbers / LIMITS.windows))))
    return {name: _channel_scan(fit, c, noise, shortest) for name, c in channels.items()}


def _channel_scan(
    fit: LinearisedFit, channel: ChannelRows, noise: np.ndarray, shortest: int
) -> ChannelScan:
    """The scan of one channel, its shortest windows as long, if it has many more rows."""
    rows, columns = channel.valid.shape[1], channel.shaped(fit.columns)
    start, stop = scan_windows(rows, shortest if rows > 8 * shortest else 1)
    valid = channel.valid.astype(float)
    n = _sums(valid, start, stop)
    leverage = _taken_by_fit(columns, fit)
    taken = _taken_by_fit(_sums(columns, start, stop), fit)
    # Noise is the same for all numbers of one channel and slew.
    scale = _sums(channel.shaped(noise) ** 2 * valid, start, stop) / np.maximum(n, 1.0)
    left = np.where(n > 0, np.maximum(scale * (n - taken), 1e-3 * scale * n), 0.0)
    dof = np.where(n > 0, n - _sums(leverage * valid, start, stop), 0.0)
    return ChannelScan(start, stop, np.sqrt(left), scale * np.maximum(dof, 0.0), dof)


def _taken_by_fit(columns: np.ndarray, fit: LinearisedFit) -> np.ndarray:
    """Variance (slews, r, components) that fitting takes from columns (slews, r, components, p)."""
    covariances = [fit.covariance_of(s) for s in range(len(columns))]
    return np.einsum("srcp,spq,srcq->src", columns, np.array(covariances), columns, optimize=True)


def _sums(values: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Sums over the windows of values (slews, rows, ...)."""
    total = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(values, axis=1)], axis=1)
    return total[:, stop] - total[:, start]


def held_out_chi2(estimate: Estimate) -> float | None:
    """Compute the reduced chi^2 of slews that were left out of the fit, one after the other.

    Each slew is predicted with theta and bias from the others; only its own start state is fitted.
    To first order around the estimate.

    Returns: 1 if the predictions are as good as noise allows; None with fewer than two slews.
    """
    slews, fit, total = estimate.model.n_slews, estimate.linearised(), 0.0
    if slews < 2:
        return None
    info, own = fit.information, eliminated(fit.information, fit.point.local, fit.n_shared)
    for s in range(slews):
        step, known = fit.shares.without(s)
        gradient = own.gradient[s] + own.matrix[s] @ step
        left = info.chi2[s].sum() - own.pull[s] @ own.pull[s]
        # The prediction is itself uncertain: the others leave theta and bias open to some degree.
        allowed = gradient @ solve(own.matrix[s] + known, gradient)
        total = total + left + step @ (own.gradient[s] + gradient) - allowed
    return float(total / (info.n_data.sum() - slews * fit.n_local))
