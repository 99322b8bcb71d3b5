"""The statistic of a scan over time windows: shift of the mean and size of the mean square.

Windows have 1, 2, 4, ... rows, each overlapping the next by half. What they may show is measured
against the share that fitting takes.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.channel_rows import ChannelRows
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass

# More windows than this only cost time: the shortest ones are left out first.
_MAX_WINDOWS = 20_000


def scan_windows(rows: int, shortest: int) -> tuple[np.ndarray, np.ndarray]:
    """List the windows of a scan.

    Parameters
    ----------
    rows : int
        Of the series.
    shortest : int
        Rows of the shortest windows, a power of two.

    Returns
    -------
    start, stop : (w,) arrays of int
        First row, and row after the last, of all windows.

    Examples
    --------
    >>> [x.tolist() for x in scan_windows(4, 2)]
    [[0, 1, 2, 0], [2, 3, 4, 4]]
    """
    pairs = []
    length = shortest
    while length < 2 * rows:
        size = min(length, rows)
        last = np.arange(0, rows - size + 1, max(1, size // 2))
        starts = last if size < rows else np.zeros(1, int)
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

    def scores(self, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Score the windows of k sets of residuals.

        Parameters
        ----------
        residuals : (slews, rows, components, k) array
            Whitened.

        Returns
        -------
        shift, energy : (slews, w, components, k) arrays
            Normal scores of the mean's shift and of too large a mean square.
        """
        shift = (
            np.abs(_sums(residuals, self.start, self.stop))
            / np.where(self.sd > 0, self.sd, np.inf)[..., None]
        )
        ratio = (
            _sums(residuals**2, self.start, self.stop)
            / np.where(self.energy > 0, self.energy, np.inf)[..., None]
        )
        # Wilson and Hilferty (1931): the cube root of a mean square is nearly normal.
        spread = (2.0 / (9.0 * np.maximum(self.dof, 1e-3)))[..., None]
        energy = np.where(
            self.dof[..., None] > 0.5, (np.cbrt(ratio) - 1.0 + spread) / np.sqrt(spread), 0.0
        )
        return shift, np.maximum(energy, 0.0)


def channel_scans(fit: LinearisedFit, noise: np.ndarray) -> dict[str, ChannelScan]:
    """Prepare the scan of every channel that measured anything.

    Parameters
    ----------
    fit : LinearisedFit
        The fit, whose columns tell what share of the noise it takes.
    noise : (slews, numbers) array
        Standard deviation of the noise in units of the noise as used; one for all numbers of a
        channel and slew.

    Returns
    -------
    dict
        {channel: ChannelScan}.
    """
    channels = {name: c for name, c in fit.channels.items() if c.valid.any()}
    numbers = sum(c.valid.size for c in channels.values())
    shortest = 2 ** max(0, int(np.ceil(np.log2(4.0 * numbers / _MAX_WINDOWS))))
    covariances = [fit.covariance_of(s) for s in range(len(fit.residual))]
    return {
        name: _channel_scan(
            c,
            c.shaped(fit.columns),
            covariances,
            c.shaped(noise) ** 2,
            shortest if c.valid.shape[1] > 8 * shortest else 1,
        )
        for name, c in channels.items()
    }


def _channel_scan(
    channel: ChannelRows,
    columns: np.ndarray,
    covariances: list[np.ndarray],
    variance: np.ndarray,
    shortest: int,
) -> ChannelScan:
    """The scan of one channel with these columns (slews, rows, components, unknowns)."""
    start, stop = scan_windows(channel.valid.shape[1], shortest)
    valid = channel.valid.astype(float)
    n = _sums(valid, start, stop)
    leverage = _taken_by_fit(columns, covariances)
    taken = _taken_by_fit(_sums(columns, start, stop), covariances)
    # Noise is the same for all numbers of one channel and slew.
    scale = _sums(variance * valid, start, stop) / np.maximum(n, 1.0)
    left = np.where(n > 0, np.maximum(scale * (n - taken), 1e-3 * scale * n), 0.0)
    dof = np.where(n > 0, n - _sums(leverage * valid, start, stop), 0.0)
    return ChannelScan(start, stop, np.sqrt(left), scale * np.maximum(dof, 0.0), dof)


def _taken_by_fit(columns: np.ndarray, covariances: list[np.ndarray]) -> np.ndarray:
    """Variance (slews, r, components) that fitting takes from columns (slews, r, components, p)."""
    return np.stack(
        [
            np.einsum("rcp,pq,rcq->rc", x, covariance, x, optimize=True)
            for x, covariance in zip(columns, covariances, strict=True)
        ]
    )


def _sums(values: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Sums over the windows of values (slews, rows, ...)."""
    total = np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(values, axis=1)], axis=1)
    return total[:, stop] - total[:, start]
