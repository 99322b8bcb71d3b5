"""Strength of evidence for each candidate effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayes_inertia.report.formatting import plain, tenths
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style


@style.styled
def draw_candidates(
    candidates: Sequence[Mapping[str, Any]], threshold: float, named: Sequence[str]
) -> Figure | None:
    """Strength of the evidence for each candidate, −log10 p, with the line of significance."""
    scored = [c for c in candidates if c["p_value"] is not None and c["dof"]]
    if not scored:
        return None
    figure, (place,) = style.grid(0.9 + 0.23 * len(scored), 1, 1, left=2.3, right=1.9, top=0.4)
    candidates_panel(figure.add_axes(place), scored, threshold, named)
    handles = [
        Patch(fc=style.VERMILLION, hatch="////", ec="white", label="named"),
        Patch(fc=style.BLUE, label="significant by itself, before anything was added"),
        Line2D([], [], color=style.INK, ls=(0, (4, 2)), lw=1.0, label="significance"),
    ]
    figure.legend(handles=handles, loc="upper left", ncols=3, bbox_to_anchor=(0.01, 1.0))
    return figure


def candidates_panel(
    axes: Axes, scored: Sequence[Mapping[str, Any]], threshold: float, named: Sequence[str]
) -> None:
    """One bar a candidate that the campaign can see, the strongest on top."""
    scored = sorted(scored, key=lambda c: (-c["p_value"], c["log_bayes_factor"]))
    strength = np.array([-np.log10(max(c["p_value"], LAYOUT.smallest_p_drawn)) for c in scored])
    limit = -np.log10(max(threshold, LAYOUT.smallest_p_drawn))
    _bars(axes, [c["effect"] for c in scored], strength, limit, named)
    if strength.max() > LAYOUT.largest_on_linear_axis:
        axes.set_xscale("symlog", linthresh=10.0, linscale=1.5)
        axes.set_xticks(LAYOUT.strength_ticks, [str(tick) for tick in LAYOUT.strength_ticks])
        axes.minorticks_off()
    axes.set_xlim(0, 1.02 * max(strength.max(), 1.5 * limit))
    axes.axvline(limit, color=style.INK, ls=(0, (4, 2)), lw=1.0)
    _bayes_factors(axes, [c["log_bayes_factor"] for c in scored], strength > limit)
    off_scale = " (300: off the scale)" if strength.max() >= 299 else ""
    axes.set_xlabel(f"strength of the evidence: −log₁₀ of the p-value{off_scale}")


def _bars(
    axes: Axes, effects: Sequence[str], strength: np.ndarray, limit: float, named: Sequence[str]
) -> None:
    colors = [
        style.VERMILLION if effect in named else style.BLUE if s > limit else style.PALE
        for effect, s in zip(effects, strength, strict=True)
    ]
    axes.barh(
        np.arange(len(effects)),
        strength,
        color=colors,
        height=0.66,
        hatch=["////" if effect in named else "" for effect in effects],
        edgecolor="white",
        lw=0,
    )
    axes.set_yticks(np.arange(len(effects)))
    axes.set_yticklabels([plain(effect) for effect in effects], color=style.INK)


def _bayes_factors(axes: Axes, log_factors: Sequence[float], significant: np.ndarray) -> None:
    """The log Bayes factors, as a column of numbers to the right of the bars."""
    right = axes.get_yaxis_transform()
    for i, log_factor in enumerate(log_factors):
        axes.text(
            1.02,
            i,
            tenths(log_factor),
            transform=right,
            va="center",
            fontsize=8,
            color=style.INK if significant[i] else style.MUTED,
        )
    axes.text(
        1.02,
        len(log_factors) - 0.2,
        "log Bayes factor\n(first order)",
        transform=right,
        va="bottom",
        fontsize=8,
        color=style.MUTED,
    )
