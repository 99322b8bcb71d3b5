"""Residuals of all slews and channels, small enough to lie in the page, for its own script.

A residual is a whole number of steps of a fine scale in 16 bits, times are 32-bit floats, both in
base64. Where there are too many rows, some are left out (`thinned_rows`), never an outlier; how
many are shown is said.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.report.formatting import CHANNEL_NAMES
from bayes_inertia.report.pictures.posterior_data import attitude_misfit, channel_series, values_of
from bayes_inertia.report.pictures.thinning import thinned_rows

_MOST_NUMBERS = 24_000  # residuals in a page
_NOT_MEASURED = -32768  # stands for a gap
_LARGEST = 32767  # steps
_FEWEST_ROWS = 50  # of a slew and channel
_FEW_ROWS = CHANNEL_NAMES["attitude"]
_STANDS_OUT = 5.0  # standard errors: noise makes one such channel and slew in a million


@array_dataclass
class ResidualChannel:
    """Residuals of one channel.

    Parameters
    ----------
    name : str
        In print.
    components : list of str
        Names of its components.
    slews : list of str
        Names of the slews.
    time : list of (rows,) array
        Of each slew, from its first row on [s].
    residual : list of (rows, components) array
        Of each slew, in stated sigmas; NaN where a component was not measured.
    """

    name: str
    components: list[str]
    slews: list[str]
    time: list[np.ndarray]
    residual: list[np.ndarray]

    @property
    def size(self) -> int:
        """Numbers in all slews."""
        return sum(values.size for values in self.residual)


def residual_channels(posterior: Posterior) -> list[ResidualChannel]:
    """The residuals of a fit, channel by channel.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    list of ResidualChannel
        Those that the fit predicted: rates, attitude, wheel momentum.
    """
    channels = []
    # 32-bit floats do not hold seconds from an epoch.
    start = np.nanmin(values_of(posterior, "constant_data", "time"), 1)[:, None]
    for name in ("rate", "momentum"):
        series = channel_series(posterior, name)
        if series is not None:
            label = CHANNEL_NAMES[name]
            parts = (series.components, series.slews, series.time - start, series.residual)
            channels.append(_measured_rows(label, *parts))
    misfit = attitude_misfit(posterior)
    if misfit is not None:
        axes = [f"about body {axis}" for axis in "xyz"]
        label = CHANNEL_NAMES["attitude"]
        time = misfit.time - start
        channels.insert(1, _measured_rows(label, axes, misfit.slews, time, misfit.whitened))
    return channels


def _measured_rows(
    name: str, components: list[str], slews: list[str], time: np.ndarray, residual: np.ndarray
) -> ResidualChannel:
    """A channel without its padding."""
    kept = [np.isfinite(t) & np.isfinite(r).any(-1) for t, r in zip(time, residual, strict=True)]
    return ResidualChannel(
        name,
        components,
        slews,
        [t[k] for t, k in zip(time, kept, strict=True)],
        [r[k] for r, k in zip(residual, kept, strict=True)],
    )


def explorer_data(
    channels: list[ResidualChannel], most_numbers: int = _MOST_NUMBERS
) -> dict[str, Any]:
    """Residuals as the page's script wants them.

    Parameters
    ----------
    channels : list of ResidualChannel
        At least one.
    most_numbers : int
        About how many residuals to keep at most.

    Returns
    -------
    dict
        To be written into the page as JSON: `channels`, the names of the `slews`, and where to
        `start`, the channel and the slew whose residuals are largest.
    """
    share = most_numbers / max(1, sum(channel.size for channel in channels))
    return {
        "channels": [_channel_content(channel, share) for channel in channels],
        "slews": channels[0].slews,
        "start": _largest(channels),
    }


def _channel_content(channel: ResidualChannel, share: float) -> dict[str, Any]:
    largest = max((np.nanmax(np.abs(r)) for r in channel.residual if r.size), default=0.0)
    step = float(f"{max(float(largest), 1.0) / _LARGEST:.6g}") * (1.0 + 1e-5)
    return {
        "name": channel.name,
        "components": channel.components,
        "step": step,
        "slews": [
            _slew_content(time, residual, share, step)
            for time, residual in zip(channel.time, channel.residual, strict=True)
        ],
    }


def _slew_content(
    time: np.ndarray, residual: np.ndarray, share: float, step: float
) -> dict[str, Any]:
    rows = thinned_rows(residual, max(_FEWEST_ROWS, int(share * len(time))))
    steps = np.nan_to_num(np.round(residual[rows] / step), nan=_NOT_MEASURED)
    return {
        "rows": len(time),
        "mean_square": float(f"{np.nanmean(residual**2):.3g}") if residual.size else None,
        "time": _base64(time[rows].astype("<f4")),
        "residual": [_base64(column.astype("<i2")) for column in steps.T],
    }


def _largest(channels: list[ResidualChannel]) -> list[int]:
    """Channel and slew whose mean square is furthest above one, in its own standard errors.

    The few fixes of a star tracker fill no picture: it comes first where nothing else stands out.
    """
    excess = {
        (c, s): (float(np.nanmean(residual**2)) - 1.0) * float(np.sqrt(0.5 * residual.size))
        for c, channel in enumerate(channels)
        for s, residual in enumerate(channel.residual)
        if residual.size
    }
    dense = {p: size for p, size in excess.items() if channels[p[0]].name != _FEW_ROWS}
    if dense and not max(dense.values()) <= _STANDS_OUT < max(excess.values()):
        excess = dense
    c, s = max(excess, key=lambda place: excess[place])
    return [c, s]


def _base64(values: np.ndarray) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")
