"""The pictures of the method pages.

    python -m analyses.pages.method_pictures

writes `figures/method_*.svg`.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from scipy import stats

from analyses.pages.figures import save_svg
from bayes_inertia.report.pictures import style

_FILL = "#e8f0f8"
_STEPS: dict[str, tuple[tuple[str, str], ...]] = {
    "diagnosis": (
        ("Linearise", "every effect, random\nsignals, shapes without\na name: one matrix"),
        ("Weigh", "every set of them:\nevidence, probability,\nits J and K"),
        ("Refit", "the best row in full"),
        ("Verdict", "named, ambiguous,\nformula, partial,\nunknown"),
    ),
    "likelihood": (
        ("Input", "torque commands\nor tachometers"),
        ("Simulate", "one slew, with J, K\nand effects"),
        ("Compare", "rates, attitude,\nwheel momentum,\nin sigmas of noise"),
        ("Integrate out", "start states, bias,\nslow noise:\nin closed form"),
        ("Sample", "J, K and effects\nwith emcee"),
    ),
    "trust": (
        ("Converged?", "four ensembles agree,\nenough samples"),
        ("Explained?", "residuals as large and\nas white as the noise"),
        ("Prior?", "J and K where they\ncan be"),
        ("Diagnosed?", "not unknown"),
        ("Trusted", "exit code 0;\nelse 3, with reasons"),
    ),
    "forecasts": (
        ("Plan", "slews, rates, rests"),
        ("Linearise", "telemetry against J, K\nand start states,\nslew by slew"),
        ("Add up", "information of all slews\nand of the prior"),
        ("Invert", "sd of each parameter,\nbefore anything is flown"),
    ),
}


@style.styled
def steps(name: str) -> Figure:
    """Boxes in a row, each with what happens there."""
    boxes = _STEPS[name]
    figure = Figure(figsize=(8.0, 1.9 if name == "diagnosis" else 1.6))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, len(boxes)), ylim=(0, 1) if name == "diagnosis" else (0.1, 0.96))
    axes.set_axis_off()
    for k, (title, says) in enumerate(boxes):
        _box(axes, k, title, says)
        if k:
            axes.annotate("", (k + 0.06, 0.52), (k - 0.06, 0.52), arrowprops=_ARROW)
    if name == "diagnosis":
        _loop(axes, 2.5, 0.5, "again around it, until it stays")
    return figure


_ARROW = {"arrowstyle": "-|>", "color": style.MUTED, "lw": 1.2}


def _box(axes: Axes, k: int, title: str, says: str) -> None:
    rounded = "round,pad=0,rounding_size=0.04"
    look = {"boxstyle": rounded, "fc": _FILL, "ec": style.BLUE, "lw": 1.0, "mutation_aspect": 2.0}
    axes.add_patch(FancyBboxPatch((k + 0.07, 0.2), 0.86, 0.66, **look))
    axes.text(k + 0.5, 0.74, title, ha="center", va="center", weight="bold", fontsize=10)
    axes.text(k + 0.5, 0.44, says, ha="center", va="center", fontsize=8, linespacing=1.35)


def _loop(axes: Axes, start: float, end: float, says: str) -> None:
    axes.plot([start, start, end], [0.19, 0.08, 0.08], color=style.MUTED, lw=1.2)
    axes.annotate("", (end, 0.19), (end, 0.075), arrowprops=_ARROW)
    look = {"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none"}
    axes.text(0.5 * (start + end), 0.08, says, ha="center", va="center", fontsize=8, bbox=look)


@style.styled
def uncertainty() -> Figure:
    """What the quoted sd counts: the model's posterior, weak effects, slews that disagree."""
    figure = Figure(figsize=(8.0, 2.5), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    x = np.linspace(-6.0, 6.0, 400)
    own = stats.norm.pdf(x)
    moved = 0.75 * own + 0.15 * stats.norm.pdf(x, 1.2, 1.2) + 0.10 * stats.norm.pdf(x, -1.8, 1.4)
    scattered = np.interp(x / 1.4, x, moved) / 1.4
    titles = (
        "sd\nbelieves the model",
        "averaged\nover effects too weak to be found",
        "quoted sd\ntimes the scatter of the slews",
    )
    for ax, density, title in zip(axes, (own, moved, scattered), titles, strict=True):
        ax.plot(x, own, color=style.MUTED, lw=0.8, ls="--")
        ax.plot(x, density, color=style.BLUE)
        total = np.cumsum(density) / density.sum()
        low, high = np.interp((0.05, 0.95), total, x)
        ax.fill_between(x, density, where=(x >= low) & (x <= high), color=style.SKY, alpha=0.35)
        ax.set_title(title)
        ax.set_yticks([])
        ax.set_xlabel("parameter [sd of the model]")
    return figure


def main() -> None:
    """Draw all."""
    for name in _STEPS:
        save_svg(steps(name), f"method_{name}")
    save_svg(uncertainty(), "method_uncertainty")


if __name__ == "__main__":
    main()
