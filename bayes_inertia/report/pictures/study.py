"""Stated against achieved uncertainty over many simulated campaigns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from bayes_inertia.design.comparison import AchievedErrors
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style


@style.styled
def draw_coverage(names: Sequence[str], achieved: AchievedErrors, z: np.ndarray) -> Figure:
    """Left: achieved over stated sd. Right: how often central intervals hold the truth.

    Bars are two standard errors. The band holds all curves of sound uncertainties in 95 % of
    studies (Dvoretzky-Kiefer-Wolfowitz, Bonferroni over parameters).
    """
    figure = Figure(figsize=(style.WIDTH, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    _sd_ratios(left, names, achieved)
    left.set_title(f"{len(z)} simulated campaigns (bars: 2 standard errors)")
    _coverage(right, names, z)
    return figure


def _sd_ratios(axes: Axes, names: Sequence[str], achieved: AchievedErrors) -> None:
    stated = achieved.stated_sd
    x = np.arange(len(names))
    axes.axhline(1.0, color=style.MUTED, lw=0.8)
    ratio, error = achieved.sd / stated, 2.0 * achieved.sd_error / stated
    axes.errorbar(x, ratio, error, fmt="o", ms=4.5, capsize=2.5, color=style.BLUE)
    axes.set(xticks=x, xticklabels=names, ylabel="achieved sd / stated sd")


def _coverage(axes: Axes, names: Sequence[str], z: np.ndarray) -> None:
    level = np.linspace(0.0, 1.0, 201)
    band = np.sqrt(np.log(2.0 * len(names) / 0.05) / (2.0 * len(z)))
    low, high = -100 * np.minimum(band, level), 100 * np.minimum(band, 1.0 - level)
    said = "95 % band of sound sds"
    axes.fill_between(100 * level, low, high, color=style.PALE, lw=0, label=said)
    half = stats.norm.ppf(0.5 + 0.5 * level)
    for k, name in enumerate(names):
        held = (np.abs(z[:, k, None]) < half).mean(0)
        color, dash = style.color(k // 3), ("-", "--", ":")[k % 3]
        axes.plot(100 * level, 100 * (held - level), color=color, ls=dash, lw=1.2, label=name)
    axes.axhline(0.0, color=style.MUTED, lw=0.8)
    axes.set(
        xlabel="level of the central interval [%]",
        ylabel="share that held the truth − level [%]",
        xlim=(0.0, 100.0),
    )
    axes.set_ylim(-260.0 * band, 160.0 * band)
    axes.legend(ncols=4, fontsize=7.0, loc="lower center")


@array_dataclass
class RankCurves:
    """Rank curves of one case."""

    title: str  # above its row
    # (14, ranked) ECDFs of ranks minus that of uniform ones, in standard errors.
    departures: np.ndarray
    band: float  # half width of the band [standard errors]
    fits: int  # ranks in each curve


@style.styled
def draw_calibration(cases: Sequence[RankCurves], names: Sequence[str]) -> Figure:
    """ECDFs of ranks minus uniform, a row a case; the band holds all curves of a right pipeline."""
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
