"""J and K of two runs, in combined standard deviations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style
from bayes_inertia.report.run_comparison import ParameterDifference


@style.styled
def draw_run_differences(parameters: Sequence[ParameterDifference]) -> Figure | None:
    """Both runs' values of each parameter with their quoted sd, relative to the first run's."""
    if not parameters:
        return None
    figure, (place,) = style.grid(
        1.1 + 0.3 * len(parameters), 1, 1, left=0.8, right=0.3, top=0.45, bottom=0.55
    )
    axes = figure.add_axes(place)
    rows = np.arange(len(parameters))
    combined = np.array([p.combined_sd or 1.0 for p in parameters])
    sides = [
        [row["quoted_sd"] for row in (p.first, p.second) if row is not None] for p in parameters
    ]
    first, second = (np.array(column) / combined for column in zip(*sides, strict=True))
    shift = np.array([p.in_sd or 0.0 for p in parameters])
    axes.axvspan(-LAYOUT.noticeable_sd, LAYOUT.noticeable_sd, color=style.PALE, alpha=0.4, lw=0)
    axes.axvline(0.0, color=style.MUTED, lw=0.7)
    axes.errorbar(
        np.zeros(len(rows)), rows - 0.15, xerr=first, fmt="s", color=style.MUTED, ms=5, capsize=2
    )
    axes.errorbar(shift, rows + 0.15, xerr=second, fmt="o", color=style.BLUE, ms=5, capsize=2)
    half = 1.1 * max(LAYOUT.noticeable_sd, float(np.max(np.abs(shift) + second)))
    axes.set(xlim=(-half, half), ylim=(len(rows) - 0.5, -0.5))
    axes.set_yticks(rows, [p.name for p in parameters])
    axes.set_xlabel("difference from A [combined sd]")
    handles = [
        style.mark("A ± sd", style.MUTED, "s", ls="-"),
        style.mark("B ± sd", style.BLUE, "o", ls="-"),
    ]
    style.legend(figure, handles)
    return figure
