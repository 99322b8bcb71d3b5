"""The predicted error of the next slew, with J and K of before the fit and of the fit on board."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_inertia.report.formatting import arcsec, arcsec_text
from bayes_inertia.report.pictures import style

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
