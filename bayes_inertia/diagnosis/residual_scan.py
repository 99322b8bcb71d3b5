"""Where a fit disagrees with the data: a scan over channels, slews, components and time windows.

Windows of 1, 2, 4, ... rows, each overlapping the next by half, are tested for a shift of their mean and for too
large a mean square. The largest of all these statistics is compared with the largest that fits of a perfect
model leave (simulated, with the share that fitting takes), so that each p-value counts all the places looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import ChannelRows, LinearisedFit
from bayes_inertia.maths.values import array_dataclass

SIGNIFICANT = 0.05
# More windows than this only cost time: the shortest ones are left out first.
_MOST_WINDOWS = 20_000
_BATCH = 50
_BINS = 60


@dataclass(frozen=True)
class Window:
    """A stretch of one channel in one slew that noise does not explain.

    Attributes
    ----------
    channel : "rate", "attitude" or "momentum". slew, component : names. t_start, t_end : first and last row in it [s].
    kind : "shift" (the mean is off) or "energy" (the mean square is too large). score : in standard deviations.
    p_value : probability of a window like this anywhere in the campaign if model and noise are right.
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
class Cells:
    """One channel for the picture: mean residuals in short bins, in standard deviations of such a mean.

    `edges` (slews, bins + 1) [s]; `shift` (slews, components, bins), NaN where nothing was measured.
    """

    components: tuple[str, ...]
    edges: np.ndarray
    shift: np.ndarray


@dataclass(frozen=True)
class Disagreement:
    """`windows` most significant first, not overlapping within a channel and slew; `p_value` of the strongest disagreement
    anywhere; `cells` by channel, for the picture; names of the `slews`."""

    windows: tuple[Window, ...]
    p_value: float
    cells: dict[str, Cells]
    slews: tuple[str, ...]


def disagreement(
    at: Estimate, *, seed: int = 0, stated: bool = True, replicates: int = 300
) -> Disagreement:
    """Scan the residuals of an estimate.

    Parameters
    ----------
    stated : compare with the noise that the campaign states; False: with the noise as used in the fit.
    replicates : simulated fits behind the p-values (smaller p-values than they reach follow from a Gumbel tail).
    """
    fit, rng = at.linearised(), np.random.default_rng([seed, 5])
    noise = fit.weight if stated else np.ones_like(fit.weight)
    scans = _scans(fit, noise)
    largest = []
    for begin in range(0, replicates, _BATCH):
        drawn = fit.replicates(rng, min(_BATCH, replicates - begin), noise)
        tops = [
            np.maximum(*scan.scores(channel.shaped(drawn))).reshape(-1, drawn.shape[-1]).max(0)
            for channel, scan in scans
        ]
        largest.append(np.max(tops, axis=0))
    # Half the square of a normal score has an exponential tail, and the largest of many such a Gumbel distribution.
    null = stats.gumbel_r(*stats.gumbel_r.fit(0.5 * np.concatenate(largest) ** 2))
    slews = tuple(s.name for s in at.model.campaign.slews)
    found, cells, best = [], {}, 1.0
    for (name, channel), (_, scan) in zip(
        [(n, c) for n, c in fit.channels.items() if c.valid.any()], scans, strict=True
    ):
        components = component_names(at, name)
        shift, energy = (
            x[..., 0] for x in scan.scores(channel.shaped(fit.settled_residual[..., None]))
        )
        p = np.maximum(null.sf(0.5 * np.maximum(shift, energy) ** 2), 1e-300)
        best = min(best, float(p.min()))
        found += _significant(
            name, channel, scan, components, slews, np.maximum(shift, energy), shift >= energy, p
        )
        cells[name] = _cells(channel, components, fit, noise)
    return Disagreement(
        tuple(sorted(found, key=lambda w: (w.p_value, -w.score))), best, cells, slews
    )


def component_names(at: Estimate, channel: str) -> tuple[str, ...]:
    """What the components of a channel are called."""
    if channel == "momentum":
        return tuple(w.name for w in at.model.campaign.wheels)
    return (
        ("axis 1", "axis 2", "axis 3") if channel == "rate" else ("about x", "about y", "about z")
    )


@array_dataclass
class _Scan:
    """Windows of one channel: rows `start` to `stop` (w,), and for each (slews, w, components): the `sd` of its sum and
    the expected sum of squares `energy` if the model is right; zero where nothing was measured; `noise` of each number."""

    start: np.ndarray
    stop: np.ndarray
    sd: np.ndarray
    energy: np.ndarray
    dof: np.ndarray

    def scores(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal scores of mean shift and energy (slews, w, components, k) of residuals (slews, rows, components, k)."""
        shift = (
            np.abs(_sums(values, self.start, self.stop))
            / np.where(self.sd > 0, self.sd, np.inf)[..., None]
        )
        ratio = (
            _sums(values**2, self.start, self.stop)
            / np.where(self.energy > 0, self.energy, np.inf)[..., None]
        )
        # Wilson and Hilferty (1931): the cube root of a mean square is nearly normal.
        spread = (2.0 / (9.0 * np.maximum(self.dof, 1e-3)))[..., None]
        energy = np.where(
            self.dof[..., None] > 0.5, (np.cbrt(ratio) - 1.0 + spread) / np.sqrt(spread), 0.0
        )
        return shift, np.maximum(energy, 0.0)


def _sums(values: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    total = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(values, axis=1)], axis=1)
    return total[:, stop] - total[:, start]


def _scans(fit: LinearisedFit, noise: np.ndarray) -> list[tuple[ChannelRows, _Scan]]:
    channels = [c for c in fit.channels.values() if c.valid.any()]
    numbers = sum(c.valid.size for c in channels)
    shortest = 2 ** max(0, int(np.ceil(np.log2(4.0 * numbers / _MOST_WINDOWS))))
    columns, blocks = fit.columns, [fit.covariance_of(s) for s in range(len(fit.residual))]
    return [
        (c, _scan(c, columns, blocks, noise, shortest if c.valid.shape[1] > 8 * shortest else 1))
        for c in channels
    ]


def _windows(rows: int, shortest: int) -> tuple[np.ndarray, np.ndarray]:
    """First row and row after the last of all windows.

    >>> [x.tolist() for x in _windows(4, 2)]
    [[0, 1, 2, 0], [2, 3, 4, 4]]
    """
    pairs = []
    length = shortest
    while length < 2 * rows:
        size = min(length, rows)
        starts = (
            np.arange(0, rows - size + 1, max(1, size // 2)) if size < rows else np.zeros(1, int)
        )
        pairs.append(np.stack([starts, starts + size]))
        length *= 2
    start, stop = np.concatenate(pairs, axis=1)
    return start, stop


def _scan(
    channel: ChannelRows,
    columns: np.ndarray,
    blocks: list[np.ndarray],
    noise: np.ndarray,
    shortest: int,
) -> _Scan:
    start, stop = _windows(channel.valid.shape[1], shortest)
    valid, share = channel.valid.astype(float), channel.shaped(noise) ** 2
    own = channel.shaped(columns)
    n = _sums(valid, start, stop)
    leverage = np.stack(
        [
            np.einsum("rcp,pq,rcq->rc", x, b, x, optimize=True)
            for x, b in zip(own, blocks, strict=True)
        ]
    )
    along = _sums(own, start, stop)
    taken = np.stack(
        [
            np.einsum("wcp,pq,wcq->wc", x, b, x, optimize=True)
            for x, b in zip(along, blocks, strict=True)
        ]
    )
    # Noise is the same for all numbers of one channel and slew.
    scale = _sums(share * valid, start, stop) / np.maximum(n, 1.0)
    variance = np.where(n > 0, np.maximum(scale * (n - taken), 1e-3 * scale * n), 0.0)
    dof = np.where(n > 0, n - _sums(leverage * valid, start, stop), 0.0)
    return _Scan(start, stop, np.sqrt(variance), scale * np.maximum(dof, 0.0), dof)


def _significant(
    name, channel: ChannelRows, scan: _Scan, components, slews, score, shifted, p
) -> list[Window]:
    """The most significant windows of each slew that do not overlap."""
    found = []
    for s, slew in enumerate(slews):
        taken = np.zeros(channel.valid.shape[1], bool)
        order = [(w, c) for w, c in np.argwhere(p[s] < SIGNIFICANT)]
        for w, c in sorted(order, key=lambda i: -score[s][tuple(i)]):
            begin, end = _trimmed(channel.valid[s, :, c], scan.start[w], scan.stop[w])
            if taken[begin:end].any():
                continue
            taken[begin:end] = True
            t = channel.time[s]
            kind = "shift" if shifted[s, w, c] else "energy"
            found.append(
                Window(
                    name,
                    slew,
                    components[c],
                    float(t[begin]),
                    float(t[end - 1]),
                    kind,
                    float(score[s, w, c]),
                    float(p[s, w, c]),
                )
            )
    return found


def _trimmed(valid: np.ndarray, start: int, stop: int) -> tuple[int, int]:
    inside = start + np.flatnonzero(valid[start:stop])
    return int(inside[0]), int(inside[-1]) + 1


def _cells(
    channel: ChannelRows, components: tuple[str, ...], fit: LinearisedFit, noise: np.ndarray
) -> Cells:
    residual, scale = channel.shaped(fit.settled_residual), channel.shaped(noise)
    slews, _, width = channel.valid.shape
    everywhere = fit.channels["rate"].time
    edges = np.stack(
        [np.linspace(t[0], t[-1] * (1 + 1e-12) + 1e-12, _BINS + 1) for t in everywhere]
    )
    shift = np.full((slews, width, _BINS), np.nan)
    for s in range(slews):
        place = np.clip(np.searchsorted(edges[s], channel.time[s], side="right") - 1, 0, _BINS - 1)
        for c in range(width):
            ok = channel.valid[s, :, c]
            n = np.bincount(place[ok], minlength=_BINS)
            total = np.bincount(place[ok], residual[s, ok, c] / scale[s, ok, c], minlength=_BINS)
            shift[s, c] = np.where(n > 0, total / np.sqrt(np.maximum(n, 1)), np.nan)
    return Cells(components, edges, shift)
