"""Measured against simulated rates, and whitened residuals of rates and any other channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.formatting import channel_name
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import posterior_data, style


@style.styled
def draw_rates(posterior: Posterior, slews: Sequence[int] | None = None) -> Figure | None:
    """Rates as measured and as predicted (90 % band), whitened residuals under each slew."""
    channel = posterior_data.channel_series(posterior, "rate")
    if channel is None:
        return None
    chosen = range(len(channel.slews)) if slews is None else slews
    names = [channel.slews[s] for s in chosen]
    figure, panels, columns = style.slew_panels(
        names, 0.6, 2.9, left=0.7, top=0.7, gap_x=0.6, gap_y=0.55
    )
    span = float(np.nanmax(np.abs(channel.measured[list(chosen)]), initial=1e-12))
    scale = style.scale("rate", "rad/s", 0.0, span)
    for k, (below, s) in enumerate(zip(panels, chosen, strict=True)):
        left, bottom, width, height = below.get_position().bounds
        above = figure.add_axes((left, bottom + 0.44 * height, width, 0.56 * height), sharex=below)
        below.set_position((left, bottom, width, 0.38 * height))
        below.set_title("")
        rate_panel(above, channel, s, scale)
        residual_panel(below, channel, s)
        above.tick_params(labelbottom=False)
        if k % columns == 0:
            above.set_ylabel(scale.label)
            below.set_ylabel("residual [σ]")
    handles = [
        *style.component_lines(channel.components, "simulated, "),
        style.mark("measured", style.MUTED, ".", ms=4),
        Patch(fc=style.PALE, label="90 % predicted"),
        style.sigma_mark(),
    ]
    style.legend(figure, handles, 6, columnspacing=1.2)
    return figure


def rate_panel(
    axes: Axes, channel: posterior_data.ChannelSeries, s: int, scale: style.Scale
) -> None:
    """Draw measured and predicted rates of one slew."""
    time, measured = channel.time[s], channel.measured[s]
    # Padding is predicted too.
    predicted = np.where(np.isfinite(time)[:, None], channel.predicted[s], np.nan)
    reach = LAYOUT.sds_of_90_percent * channel.spread[s]
    dots = style.thinned_rows(measured, LAYOUT.most_dots)
    rows = style.thinned_rows(predicted, LAYOUT.most_line_points)
    for i in range(len(channel.components)):
        how = style.dots(i) | {"marker": "."}
        axes.plot(time[dots], scale(measured[dots, i]), **how, ms=1.8, alpha=0.45)
        middle, half = predicted[rows, i], reach[rows, i]
        band = scale(middle - half), scale(middle + half)
        axes.fill_between(time[rows], *band, color=style.color(i), alpha=0.2, lw=0, rasterized=True)
        axes.plot(time[rows], scale(middle), **style.line(i), lw=1.4, zorder=4, rasterized=True)
    axes.axhline(0.0, color=style.PALE, lw=0.6, zorder=0)
    axes.set_title(channel.slews[s])


def residual_panel(axes: Axes, channel: posterior_data.ChannelSeries, s: int) -> None:
    """Draw the whitened residuals of one slew with guides at +-1, 2, 3 sigma."""
    style.sigma_guides(axes)
    rows = style.thinned_rows(channel.residual[s], LAYOUT.most_dots)
    for i in range(channel.residual.shape[-1]):
        shown = channel.residual[s, rows, i]
        axes.plot(channel.time[s, rows], shown, **style.dots(i), ms=1.9, alpha=0.65)
    limit = style.symmetric_limit(channel.residual[s])
    finite = channel.time[s][np.isfinite(channel.time[s])]
    axes.set(ylim=(-limit, limit))
    if limit < 6.0:
        axes.set_yticks([-3, 0, 3])
    if finite.size > 1:
        axes.set_xlim(finite.min(), finite.max())


@style.styled
def draw_residuals(
    posterior: Posterior, name: str, slews: Sequence[int] | None = None
) -> Figure | None:
    """Whitened residuals of a channel, one panel a slew."""
    channel = posterior_data.channel_series(posterior, name)
    if channel is None:
        return None
    chosen = range(len(channel.slews)) if slews is None else slews
    names = [channel.slews[s] for s in chosen]
    figure, panels, columns = style.slew_panels(
        names, 0.6, 1.75, left=0.95, top=0.7, gap_x=0.6, gap_y=0.5
    )
    for axes, s in zip(panels, chosen, strict=True):
        residual_panel(axes, channel, s)
    for axes in panels[::columns]:
        axes.set_ylabel(f"{channel_name(name)}\nresidual [σ]")
    style.legend(figure, [*style.component_marks(channel.components), style.sigma_mark()])
    return figure
