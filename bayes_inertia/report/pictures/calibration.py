"""Ranks of truths among posterior draws, against the band that uniform ranks keep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style


@array_dataclass
class RankCurves:
    """Rank curves of one case.

    Parameters
    ----------
    title : str
        Above its row.
    departures : (14, ranked) array
        ECDFs of ranks minus that of uniform ones, in standard errors.
    band : float
        Half width of the band [standard errors].
    fits : int
        Ranks in each curve.
    """

    title: str
    departures: np.ndarray
    band: float
    fits: int


@style.styled
def draw_calibration(cases: Sequence[RankCurves], names: Sequence[str]) -> Figure:
    """ECDFs of ranks minus uniform, a row a case; the band holds all curves of a right pipeline.

    `names`: the 14 quantities: J, K and principal moments, two predictions.
    """
    size = (style.WIDTH, LAYOUT.calibration_row_height * len(cases) + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    groups = (("J", range(6)), ("K and moments", range(6, 12)), ("predictions", range(12, 14)))
    axes = figure.subplots(len(cases), len(groups), sharex=True, sharey="row", squeeze=False)
    for row, case in zip(axes, cases, strict=True):
        for panel, (title, members) in zip(row, groups, strict=True):
            _panel(panel, case, [(names[k], case.departures[k]) for k in members])
            panel.set_title(f"{case.title}: {title}", fontsize=8.0)
        row[0].set_ylabel("ECDF of ranks − uniform")
    for panel in axes[-1]:
        panel.set_xlabel("rank of the truth / number of draws")
    return figure


def _panel(axes: Axes, case: RankCurves, curves: list[tuple[str, np.ndarray]]) -> None:
    ranked = case.departures.shape[1]
    x = np.arange(1, ranked + 1) / (ranked + 1)
    error = np.sqrt(x * (1.0 - x) / case.fits)
    half = case.band * error
    axes.fill_between(x, -half, half, color=style.PALE, lw=0, label="band of all curves")
    axes.axhline(0.0, color=style.MUTED, lw=0.6)
    for k, (name, departure) in enumerate(curves):
        line = ("-", "--")[k // 3]
        axes.plot(x, departure * error, color=style.color(k % 3), ls=line, lw=1.1, label=name)
    axes.legend(ncols=3, fontsize=6.0, loc="lower center")
    axes.set_ylim(-2.6 * half.max(), 1.8 * half.max())
