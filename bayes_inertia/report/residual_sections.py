"""The sections of a fit's report that set the model against the data.

Residuals of all slews and channels, small enough to lie in the page, for its own script.

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
from bayes_inertia.report.criteria import criteria_of
from bayes_inertia.report.formatting import channel_name
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures.posterior_data import (
    channel_series,
    n_slews,
    values_of,
    worst_slews,
)
from bayes_inertia.report.pictures.style import thinned_rows
from bayes_inertia.report.pictures.telemetry import draw_attitude, draw_rates, draw_residuals
from bayes_inertia.report.section import Picture, Section, captioned, packaged
from bayes_inertia.report.words import phrase


def residuals_section(posterior: Posterior) -> Section:
    """Reduced chi^2 by channel, and by slew with the weight that each slew was given."""
    n_data, chi2, discount, names, labels = (
        values_of(posterior, "estimate", name)
        for name in ("slew_n_data", "slew_chi2", "discount", "slew", "channel")
    )
    context = {
        "fit": posterior.attributes["fit"],
        "criteria": criteria_of(posterior.attributes),
        "noise": posterior.attributes.get("noise", {}),
        **{"n_data": n_data, "chi2": chi2, "discount": discount, "names": names, "labels": labels},
        "measured": np.flatnonzero(n_data.sum(0) > 0),
        "worst": worst_slews(posterior, LAYOUT.most_slews_listed),
    }
    return Section("Does the model explain the data?", packaged("residuals.html"), context)


def telemetry_section(posterior: Posterior) -> Section | None:
    """Measured against simulated telemetry: residuals to choose, enlarge and read, and pictures."""
    channels = residual_channels(posterior)
    if not channels:
        return None
    pictures = (
        *_series_pictures(posterior),
        *captioned("fixes", draw_attitude(posterior), folded=True),
    )
    return Section(
        "Measured against simulated",
        packaged("residual_explorer.html"),
        {"data": explorer_data(channels)},
        pictures,
        packaged("residual_explorer.js"),
    )


def _series_pictures(posterior: Posterior) -> list[Picture]:
    """Rates over time, measured and simulated, and residuals of the other series."""
    slews, total = worst_slews(posterior, LAYOUT.most_slews_drawn), n_slews(posterior)
    rows = posterior.tree["constant_data"].sizes["row"]
    which = phrase("pictures", "drawn", rows, len(slews), total)
    pictures = [*captioned("rates", draw_rates(posterior, slews), which)]
    for name in map(str, values_of(posterior, "estimate", "channel")):
        if name not in ("rate", "attitude"):
            figure = draw_residuals(posterior, name, slews)
            pictures += captioned("residuals", figure, name, which, instead_of_script=True)
    return pictures


_FEW_ROWS = channel_name("attitude")


@array_dataclass
class ResidualChannel:
    """Residuals of one channel."""

    name: str  # in print
    components: list[str]  # names of its components
    slews: list[str]  # names of the slews
    time: list[np.ndarray]  # of each slew, from its first row on [s]
    # Of each slew, in stated sigmas; NaN where a component was not measured.
    residual: list[np.ndarray]

    @property
    def size(self) -> int:
        """Numbers in all slews."""
        return sum(values.size for values in self.residual)


def residual_channels(posterior: Posterior) -> list[ResidualChannel]:
    """The residuals of a fit, channel by channel."""
    channels = []
    for name in map(str, values_of(posterior, "estimate", "channel")):
        if (series := channel_series(posterior, name)) is not None:
            kept = np.isfinite(series.time) & np.isfinite(series.residual).any(-1)
            time, residual = (
                [rows[k] for rows, k in zip(values, kept, strict=True)]
                for values in (series.time, series.residual)
            )
            label = channel_name(name)
            components = series.components
            channels.append(ResidualChannel(label, components, series.slews, time, residual))
    return channels


def explorer_data(channels: list[ResidualChannel]) -> dict[str, Any]:
    """Residuals as the page's script wants them.

    Returns: to be written into the page as JSON: `channels`, the names of the `slews`, and where to
    `start`, the channel and the slew whose residuals are largest.
    """
    share = LAYOUT.most_residuals / max(1, sum(channel.size for channel in channels))
    return {
        "channels": [_channel_content(channel, share) for channel in channels],
        "slews": channels[0].slews,
        "start": _largest(channels),
    }


def _channel_content(channel: ResidualChannel, share: float) -> dict[str, Any]:
    largest = max((np.nanmax(np.abs(r)) for r in channel.residual if r.size), default=0.0)
    step = float(f"{max(float(largest), 1.0) / LAYOUT.largest_step:.6g}") * (1.0 + 1e-5)
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
    rows = thinned_rows(residual, max(LAYOUT.fewest_residual_rows, int(share * len(time))))
    steps = np.nan_to_num(np.round(residual[rows] / step), nan=LAYOUT.not_measured)
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
    if dense and not max(dense.values()) <= LAYOUT.stands_out < max(excess.values()):
        excess = dense
    c, s = max(excess, key=lambda place: excess[place])
    return [c, s]


def _base64(values: np.ndarray) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")
