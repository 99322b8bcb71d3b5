"""The figures of docs/results.md, from committed results.

    python -m analyses.pages.result_figures

writes `figures/result_*.svg`.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analyses.calibration.other_methods import KINDS
from analyses.calibration.quoted_sd_page import CANDIDATES, held
from analyses.calibration.unmodelled_disturbance_page import coverage_of
from analyses.naming import table_page
from analyses.pages.figures import save_svg
from analyses.pages.numbers import RESULTS, content, rows
from bayes_inertia.report.pictures import style

_SIZE = (4.1, 2.8)  # [in]: two side by side on a page
_MODEL, _QUOTED = CANDIDATES[0], CANDIDATES[-1]
_KINDS = {
    "clean": "nothing missing",
    "designed": "designed slews",
    "weak-library": "weak effect,\nin the library",
    "weak-outside": "weak effect,\noutside",
    "dirty": "gaps, outliers, ...",
}
_FOUND = {
    "alone": ("the only name", style.BLUE),
    "several": ("one of several names", style.SKY),
    "none": ("nothing, or unknown", style.PALE),
    "wrong": ("a wrong name", style.VERMILLION),
}
_PEERS = {
    "least squares": ("least squares", style.ORANGE, "s"),
    "filter": ("Kalman filter", style.VERMILLION, "^"),
    "package": ("bayes_inertia", style.BLUE, "o"),
}
_PEER_KINDS = {
    "clean": "nothing missing",
    "random-torque": "random torque",
    "rate-squared": "torque ∝ rate²",
    "deadband": "wheel dead band",
}
_GOALS = {
    "cross_terms": "worst product\nof inertia",
    "inertia": "J as a whole",
    "scale_factors": "worst K",
    "correction_slew": "correction\nslew",
}
_SAMPLERS = ("bayes_inertia", "emcee, default move", "emcee, DE move", "NUTS (blackjax)")
_AFTER_UNKNOWN = {
    "stated": "believing the model",
    "usual": "misfit discounted",
    "robust": "scatter of slews",
    "remainder": "as quoted",
}


def _panel() -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE, layout="constrained")
    return figure, figure.subplots()


@style.styled
def coverage() -> Figure:
    """How often 90 % intervals hold the truth, quoted and as the model has them."""
    found = [row for row in rows("quoted_sd") if isinstance(row.get("error"), list)]
    figure, axes = _panel()
    axes.axvspan(88, 92, color=style.PALE, lw=0)
    for shift, half in ((-0.14, True), (0.14, False)):
        for (name, width), color, label in (
            (_MODEL, style.ORANGE, "sd of the model"),
            (_QUOTED, style.BLUE, "quoted sd"),
        ):
            share = [
                100.0 * held(name, width, own).mean()
                for kind in _KINDS
                if (own := [r for r in found if r["kind"] == kind and r["tachometers"] is half])
            ]
            axes.plot(
                share,
                np.arange(len(_KINDS)) + shift,
                "o",
                color=color,
                mfc=color if half else "white",
                ms=5,
                label=label if half else None,
            )
    axes.set_yticks(range(len(_KINDS)), _KINDS.values())
    axes.invert_yaxis()
    axes.set(xlabel="90 % intervals that hold the truth [%]", xlim=(65, 100))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _shares() -> dict[str, dict[str, float]]:
    """Share of campaigns by how a hidden effect is found [%]."""
    shares = {}
    for kind, half, name in (
        ("single", "tacho", "one effect,\ntachometers"),
        ("single", "notacho", "one effect,\nno tachometers"),
        ("random", "tacho", "random effect,\ntachometers"),
    ):
        found = table_page.read(RESULTS / "naming", kind, half)
        right, alone = (sum(map(f, found)) for f in (table_page.in_the_set, table_page.alone))
        wrong = sum(table_page.wrong_name(r) and not table_page.in_the_set(r) for r in found)
        shares[name] = _split(len(found), alone, right, wrong)
    return shares


def _split(total: int, alone: int, right: int, wrong: int) -> dict[str, float]:
    counts = {
        "alone": alone,
        "several": right - alone,
        "none": total - right - wrong,
        "wrong": wrong,
    }
    return {key: 100.0 * count / total for key, count in counts.items()}


@style.styled
def naming() -> Figure:
    """Hidden effects: found alone, among several, not, or wrongly."""
    figure, axes = _panel()
    shares = _shares()
    order = sorted(shares, reverse=True, key=lambda name: "one" in name)
    left = np.zeros(len(order))
    for key, (label, color) in _FOUND.items():
        width = np.array([shares[name][key] for name in order])
        axes.barh(range(len(order)), width, left=left, color=color, label=label, height=0.62)
        left += width
    axes.set_yticks(range(len(order)), order)
    axes.invert_yaxis()
    axes.set(xlabel="campaigns [%]", xlim=(0, 100))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@style.styled
def unexplained() -> Figure:
    """Coverage where an unmodelled disturbance is missing."""
    shares = coverage_of(rows("unmodelled_disturbance"))
    figure, axes = _panel()
    axes.axvline(90, color=style.MUTED, lw=0.8, ls="--")
    for shift, half, color in ((-0.19, True, style.BLUE), (0.19, False, style.SKY)):
        width = [100.0 * shares[half][method] for method in _AFTER_UNKNOWN]
        label = f"{'with' if half else 'without'} tachometers"
        axes.barh(np.arange(len(width)) + shift, width, 0.36, color=color, label=label)
    axes.set_yticks(range(len(_AFTER_UNKNOWN)), _AFTER_UNKNOWN.values())
    axes.invert_yaxis()
    axes.set(xlabel="90 % intervals that hold the truth [%]", xlim=(0, 100))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@style.styled
def other_methods() -> Figure:
    """Error of the moments of three methods on the same telemetry."""
    figure, axes = _panel()
    kinds = [kind for kind in KINDS if kind in _PEER_KINDS]
    for method, (label, color, marker) in _PEERS.items():
        rms = []
        for kind in kinds:
            own = [row for row in rows("other_methods") if row["kind"] == kind]
            error = np.array([np.divide(r[method]["error"][:3], r["truth"][:3]) for r in own])
            rms.append(100.0 * np.sqrt(np.mean(error**2)))
        axes.semilogx(rms, range(len(kinds)), marker, color=color, label=label, ms=6)
    axes.set_yticks(range(len(kinds)), [_PEER_KINDS[kind] for kind in kinds])
    axes.invert_yaxis()
    axes.grid(axis="x", color=style.PALE, lw=0.5)
    axes.set(xlabel="error of the moments [%], rms", ylim=(len(kinds) - 0.6, -0.4))
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.0, handletextpad=0.2)
    return figure


@style.styled
def sampling() -> Figure:
    """Effective samples a second, of the same posterior."""
    results = content("benchmark")["results"][: len(_SAMPLERS)]
    rate = [r["ess"] / (r["seconds"] + r["warmup_seconds"]) for r in results]
    figure, axes = _panel()
    colors = [style.BLUE, *[style.ORANGE] * (len(rate) - 1)]
    axes.barh(range(len(rate)), rate, color=colors, height=0.6)
    for k, value in enumerate(rate):
        axes.text(value * 1.15, k, f"{value:,.0f}", va="center")
    axes.set_xscale("log")
    axes.set_yticks(range(len(rate)), _SAMPLERS)
    axes.invert_yaxis()
    axes.set(xlabel="effective samples a second, one core", xlim=(5, 3e4))
    return figure


@style.styled
def design() -> Figure:
    """What designed slews gain in equal time."""
    gains = content("design_gains")
    figure, axes = _panel()
    places = np.arange(len(_GOALS))
    bars = (
        ("slews like the paper's", style.PALE, [1.0 for _ in _GOALS]),
        (
            "best of 10,000 random plans",
            style.SKY,
            [gains[g]["random"]["best"] / gains[g]["paper"] for g in _GOALS],
        ),
        ("designed", style.BLUE, [gains[g]["designed"] / gains[g]["paper"] for g in _GOALS]),
    )
    for k, (label, color, height) in enumerate(bars):
        axes.bar(places + 0.27 * (k - 1), height, 0.25, color=color, label=label)
    axes.set_xticks(places, _GOALS.values())
    axes.set(ylabel="sd, of that of the first", ylim=(0, 1.05))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def main() -> None:
    """Draw all six."""
    for draw in (coverage, naming, unexplained, other_methods, sampling, design):
        save_svg(draw(), f"result_{draw.__name__}")


if __name__ == "__main__":
    main()
