"""Stated against achieved uncertainty over many simulated campaigns."""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from bayes_inertia.design.comparison import Achieved
from bayes_inertia.report.pictures import style


@style.styled
def coverage_picture(names: Sequence[str], found: Achieved, z: np.ndarray) -> Figure:
    """Left: achieved over stated sd with two standard errors. Right: how often central intervals hold the truth, over what they say.

    The band holds all curves of sound uncertainties in 95 % of studies (Dvoretzky-Kiefer-Wolfowitz, Bonferroni over parameters).
    """
    figure = Figure(figsize=(style.WIDTH, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    stated = np.sqrt(np.mean(found.stated**2, axis=0))
    x = np.arange(len(names))
    left.axhline(1.0, color=style.MUTED, lw=0.8)
    left.errorbar(
        x,
        found.sd / stated,
        2.0 * found.sd_error / stated,
        fmt="o",
        ms=4.5,
        capsize=2.5,
        color=style.BLUE,
    )
    left.set(xticks=x, xticklabels=names, ylabel="achieved sd / stated sd")
    left.set_title(f"{len(z)} simulated campaigns (bars: 2 standard errors)")
    level = np.linspace(0.0, 1.0, 201)
    band = np.sqrt(np.log(2.0 * len(names) / 0.05) / (2.0 * len(z)))
    right.fill_between(
        100 * level,
        -100 * np.minimum(band, level),
        100 * np.minimum(band, 1.0 - level),
        color=style.PALE,
        lw=0,
        label="95 % band of sound sds",
    )
    half = stats.norm.ppf(0.5 + 0.5 * level)
    for k, name in enumerate(names):
        held = (np.abs(z[:, k, None]) < half).mean(0)
        right.plot(
            100 * level,
            100 * (held - level),
            color=style.color(k // 3),
            ls=("-", "--", ":")[k % 3],
            lw=1.2,
            label=name,
        )
    right.axhline(0.0, color=style.MUTED, lw=0.8)
    right.set(
        xlabel="level of the central interval [%]",
        ylabel="share that held the truth − level [%]",
        xlim=(0.0, 100.0),
    )
    right.set_ylim(-260.0 * band, 160.0 * band)
    right.legend(ncols=4, fontsize=7.0, loc="lower center")
    return figure
