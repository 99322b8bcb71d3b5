"""Measured against simulated rates and attitudes, and whitened residuals of any channel.

Also the error of the next slew, with J and K of before the fit and of the fit on board.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.formatting import arcsec, arcsec_text, channel_name
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


@style.styled
def draw_attitude(posterior: Posterior) -> Figure | None:
    """Attitude misfit at every fix, in arcsec (above) and in stated sigmas (below).

    Left: before the slew, right: after it; its halves where fixes come all the time.
    Small marks are single fixes, large ones their mean with its standard error.
    """
    misfit = posterior_data.attitude_misfit(posterior)
    if misfit is None:
        return None
    figure, cells = style.grid(5.4, 2, 2, left=0.8, top=0.75, bottom=0.6, gap_x=0.75, gap_y=0.45)
    rows = ((arcsec(misfit.angle_B), "misfit [arcsec]"), (misfit.whitened, "misfit [σ]"))
    for r, (values, label) in enumerate(rows):
        for c, after in enumerate((False, True)):
            axes = figure.add_axes(cells[2 * r + c])
            where = np.isfinite(misfit.time) & (misfit.after == after)
            attitude_panel(
                axes, np.where(where[..., None], values, np.nan), misfit.slews, label_slews=r == 1
            )
            if r == 1:
                style.sigma_guides(axes)
                limit = style.symmetric_limit(misfit.whitened)
                axes.set(ylim=(-limit, limit), xlabel="slew")
            else:
                largest = 1.08 * float(np.nanmax(np.abs(values)))
                axes.set(ylim=(-largest, largest), title=misfit.sides[c])
                axes.axhline(0.0, color=style.MUTED, lw=0.6, zorder=0.5)
            if c == 0:
                axes.set_ylabel(label)
    handles = [
        *style.component_marks("xyz", "about body "),
        style.mark("single fix", style.MUTED, ".", ms=4),
        style.mark("mean ± standard error", style.INK, lw=1.4, ls="-"),
    ]
    style.legend(figure, handles)
    return figure


def attitude_panel(axes: Axes, values: np.ndarray, slews: list[str], *, label_slews: bool) -> None:
    """One panel of misfits (slews, fixes, 3)."""
    for i in range(3):
        for s in range(len(slews)):
            fixes = values[s, :, i][np.isfinite(values[s, :, i])]
            if fixes.size:
                _fixes(axes, s + 0.25 * (i - 1), fixes, i)
    crowded = len(slews) > LAYOUT.most_slew_names
    shown = [str(i + 1) for i in range(len(slews))] if crowded else slews
    axes.set_xticks(range(len(slews)), shown if label_slews else [""] * len(slews))
    axes.set_xlim(-0.6, len(slews) - 0.4)


def _fixes(axes: Axes, x: float, fixes: np.ndarray, body_axis: int) -> None:
    """The fixes of one slew about one body axis, side by side, and their mean."""
    places = x + np.linspace(-0.07, 0.07, fixes.size)
    axes.plot(places, fixes, **style.dots(body_axis), ms=2.2, alpha=0.5)
    mean = fixes.mean()
    error = fixes.std(ddof=1) / np.sqrt(fixes.size) if fixes.size > 1 else 0.0
    axes.errorbar(
        x,
        mean,
        error,
        fmt=style.MARKERS[body_axis],
        ms=5,
        color=style.color(body_axis),
        mec=style.INK,
        mew=0.6,
        ecolor=style.INK,
        elinewidth=1.4,
        zorder=4,
    )


_ROWS = (
    ("before", "J and K before this fit", style.MUTED),
    ("after", "J and K of this fit", style.BLUE),
)


@style.styled
def draw_correction(forecast: Mapping[str, Any]) -> Figure:
    """Median of the error after a slew and the range of 90 % of the draws, old and new.

    `forecast`: `axis`, `angle_deg`, and (5 % quantile, median, 95 % quantile) [rad] of `before` and
    `after`.
    """
    figure, (place,) = style.grid(1.6, 1, 1, left=1.75, right=0.3, top=0.12, bottom=0.5)
    axes = figure.add_axes(place)
    ends = arcsec(np.array([forecast[key] for key, *_ in _ROWS]))
    for y, (key, _, color) in enumerate(_ROWS):
        low, middle, high = ends[y]
        axes.plot([low, high], [y, y], color=color, lw=7, alpha=0.35, solid_capstyle="butt")
        axes.plot([middle], [y], "o", color=color, ms=7)
        text = f"{arcsec_text(forecast[key][1])} arcsec"
        axes.annotate(text, (middle, y), (0, 9), textcoords="offset points", ha="center")
    low, high = 10.0 ** np.floor(np.log10(ends.min())), 10.0 ** np.ceil(np.log10(ends.max()))
    axes.set(xscale="log", xlim=(low, high), ylim=(1.6, -0.9))
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:,g}")
    axes.grid(axis="x", color=style.PALE, lw=0.6)
    axes.set_axisbelow(True)
    axes.set_yticks([0, 1], [label for _, label, _ in _ROWS], color=style.INK)
    turn = f"{forecast['angle_deg']:.0f}° slew about body {forecast['axis']}"
    axes.set_xlabel(f"error of attitude after a {turn} [arcsec]")
    return figure
