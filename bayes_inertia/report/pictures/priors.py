"""Prior against posterior of every parameter."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.criteria import sd_in_print, sharpened
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style
from bayes_inertia.report.pictures.posterior_data import values_of


@style.styled
def draw_priors(posterior: Posterior) -> Figure:
    """Posterior density with its sd (blue) and a wider quoted sd (orange), and the prior.

    Where the data narrow the prior by more than a factor of eight, the panel zooms in on the
    posterior, and a strip above it shows its place (blue mark) inside the prior's +-3 sd range.
    """
    summary = posterior.summary()["parameters"]
    names = posterior.names
    columns = 3 if len(names) <= 12 else 4
    rows = -(-len(names) // columns)
    figure, cells = style.grid(
        0.75 + 1.95 * rows, rows, columns, left=0.25, top=0.5, bottom=0.5, gap_x=0.3, gap_y=0.62
    )
    for name, cell in zip(names, cells, strict=False):
        prior_panel(figure.add_axes(cell), posterior, name, summary[name])
    handles = [
        Patch(fc=style.BLUE, alpha=0.35, ec=style.BLUE, label="posterior"),
        style.mark("prior", style.MUTED, ls=(0, (4, 2))),
        style.mark("mean ± sd (model)", style.BLUE, lw=3, ls="-"),
    ]
    if any(_is_widened(row) for row in summary.values()):
        handles.append(style.mark("mean ± quoted sd", style.ORANGE, "|", lw=3, ms=9, ls="-"))
    style.legend(figure, handles)
    return figure


def prior_panel(axes: Axes, posterior: Posterior, name: str, row: dict) -> None:
    """One parameter: its posterior, its prior, and its row of the summary as bars."""
    i = posterior.names.index(name)
    draws = posterior.averaged_samples[:, i]
    prior = values_of(posterior, "prior", name).ravel()
    prior_mean = float(values_of(posterior, "estimate", "prior_mean")[i])
    mean, prior_sd = row["mean"], row["prior_sd"]
    quoted = sd_in_print(row)
    zoomed = quoted < LAYOUT.zoomed_sd_ratio * prior_sd
    low, high = mean - 4.5 * quoted, mean + 4.5 * quoted
    if not zoomed:
        low, high = min(low, prior_mean - 3.2 * prior_sd), max(high, prior_mean + 3.2 * prior_sd)
    scale = style.scale(name, row["unit"], mean, 0.5 * (high - low))
    x, p = style.density(draws, low, high, LAYOUT.density_bins)
    top = p.max()
    axes.fill(scale(x), p / top, color=style.BLUE, alpha=0.35, lw=0)
    axes.plot(scale(x), p / top, color=style.BLUE)
    if not zoomed:
        x, p = style.density(prior, low, high, LAYOUT.density_bins)
        axes.plot(scale(x), p / top, color=style.MUTED, ls=(0, (4, 2)))
    _bar(axes, scale, mean, row["sd"], style.BLUE, -0.09)
    if _is_widened(row):
        _bar(axes, scale, mean, quoted, style.ORANGE, -0.2, marker="|")
    axes.set(xlim=(scale(low), scale(high)), ylim=(-0.3, 1.75), yticks=[], xlabel=scale.label)
    axes.spines["left"].set_visible(False)
    axes.locator_params(axis="x", nbins=5)
    if zoomed:
        _strip(axes, (mean - prior_mean) / prior_sd)
    gain = _gain_text(sharpened(row))
    style.note(axes, 0.99, 0.74, gain, transform=axes.transAxes, ha="right", va="top")


def _is_widened(row: dict) -> bool:
    """Whether the sd to quote is not the model's."""
    return sd_in_print(row) > row["sd"]


def _bar(
    axes: Axes,
    scale: style.Scale,
    mean: float,
    sd: float,
    color: str,
    height: float,
    marker: str | None = None,
) -> None:
    """Mean and sd as a bar below the density."""
    axes.plot(
        scale(np.array([mean - sd, mean + sd])),
        [height] * 2,
        color=color,
        lw=3,
        marker=marker,
        ms=9,
        solid_capstyle="butt",
    )
    axes.plot([scale(mean)], [height], marker="o", ms=3.2, color="white", mec=color, mew=0.9)


def _gain_text(gain: float) -> str:
    """Gain over the prior, in words."""
    if gain >= 10:
        return f"{gain:,.0f}× sharper than the prior"
    return f"{gain:.1f}× sharper than the prior" if gain >= 1.05 else "no sharper than the prior"


def _strip(axes: Axes, place: float) -> None:
    """The prior over +-3.2 sd, and the posterior's place in it [prior sd]."""
    z = np.linspace(-3.2, 3.2, 60)
    bottom, top = LAYOUT.prior_strip_height
    x, height = 0.5 + z / 6.4, bottom + (top - bottom) * np.exp(-0.5 * z**2)
    within: dict[str, Any] = {"transform": axes.transAxes}
    axes.fill_between(x, bottom, height, color=style.PALE, lw=0, **within)
    axes.plot(x, height, color=style.MUTED, ls=(0, (4, 2)), lw=0.8, **within)
    mark = 0.5 + np.clip(place, -3.2, 3.2) / 6.4
    axes.plot([mark, mark], [bottom, top], color=style.BLUE, lw=1.6, **within)
    style.note(axes, 0.0, top, "prior\n±3 sd", va="top", fontsize=6.5, **within)
