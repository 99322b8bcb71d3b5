"""Attitude: residuals against the star tracker before and after each slew, error of the next slew.

The latter with J and K of before the fit and of the fit on board.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.formatting import arcsec, arcsec_text
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import posterior_data, style


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
