"""The page and the picture of `observability_study.py`, from its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from observability_cases import CASES, DEGREE, MISSION, NOISES, NUMBERS, PRIOR, RATES

from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.pictures import style


def worst(sds: Sequence) -> np.ndarray:
    """Largest sd of a product of inertia (last axis: nine parameters)."""
    return np.asarray(sds)[..., 3:6].max(-1)


@style.styled
def picture(results: dict) -> Figure:
    """The worst cross term in four cases, and what the loss is made of.

    Against rate, number of slews and noise.
    """
    figure = Figure(figsize=(style.WIDTH, 6.6), layout="constrained")
    panels = figure.subplots(2, 2)
    labels = {
        "rate": "slew rate [deg/s], same slews stretched in time",
        "number": "number of slews",
        "noise": "noise of all sensors, times nominal",
    }
    ranges = {"rate": RATES, "number": NUMBERS, "noise": NOISES}
    for axes, (key, x) in zip(panels.ravel(), ranges.items(), strict=False):
        for k, (name, curve) in enumerate(results["curves"].items()):
            axes.plot(
                x,
                worst(curve[key]),
                color=style.color(k),
                ls=style.DASHES[k],
                marker=style.MARKERS[k],
                ms=3.5,
                lw=1.3,
                label=name,
            )
        _levels(axes, x[-1])
        axes.set(
            yscale="log",
            xscale="linear" if key == "number" else "log",
            xlabel=labels[key],
            ylabel="sd of the worst cross term [kg m²]",
        )
    panels[0, 1].legend(loc="upper right", bbox_to_anchor=(1.0, 0.82))
    _losses(panels[1, 1], results["causes"])
    return figure


def _levels(axes, right: float) -> None:
    """Lines at the largest cross term and at the prior's sd, with their names at `right`."""
    size = max(abs(v) for v in MISSION.theta[3:6])
    axes.axhline(size, color=style.MUTED, lw=0.8, ls=(0, (4, 3)))
    axes.axhline(PRIOR.product_sigma, color=style.MUTED, lw=0.8)
    for y, label, align in (
        (size * 0.93, "the largest cross term itself", "top"),
        (PRIOR.product_sigma * 1.05, "prior", "bottom"),
    ):
        axes.text(right, y, label, fontsize=7.5, color=style.MUTED, va=align, ha="right")


def _losses(axes, causes: dict) -> None:
    groups = list(next(iter(causes.values()))["inflation"])
    for y, (_name, row) in enumerate(causes.items()):
        start = 0.0
        for k, group in enumerate(groups):
            length = max(0.0, math.log10(row["inflation"][group]))
            label = group if y == 0 else None
            axes.barh(
                y,
                length,
                left=start,
                height=0.6,
                color=style.color(k),
                hatch="///" if k % 2 else None,
                ec="white",
                lw=0,
                label=label,
            )
            start += length
        axes.text(start, y, f"  ×{row['lost']:.2g}", va="center", fontsize=7.5, color=style.MUTED)
    axes.set(
        yticks=range(len(causes)),
        yticklabels=causes,
        ylim=(len(causes) - 0.4, -1.6),
        xlabel="decades of sd lost to not knowing …",
    )
    axes.set_xlim(0.0, 1.25 * max(math.log10(row["lost"]) for row in causes.values()))
    axes.legend(ncols=4, loc="upper left", fontsize=7.5, columnspacing=1.0)


def page(results: dict) -> str:
    """The answer, with numbers."""
    lines = [
        "# Why products of inertia are hard",
        "",
        "`python analyses/observability_study.py` · MOST-like spacecraft, five slews of 30 to 60 "
        "deg, three wheels with tachometers, rate sensor 2e-5 rad/s",
        "a sample at 4 Hz. All sds are what a fit of the whole telemetry would state.",
        "",
        *_summary_lines(results["causes"]),
        "",
        *_loss_lines(results["causes"]),
        "",
        *_curve_lines(results["curves"]),
        "",
        *_remarks(results),
        "",
        *_feedback_lines(results["hidden"]),
        "",
        "For slews that show the cross terms better see `analyses/results/design.md`; "
        "for the paper's own claim about rate, `analyses/PAPER.md`.",
        "",
    ]
    return "\n".join(lines)


def _summary_lines(causes: dict) -> list[str]:
    Jxx, Jxy, rate = causes["Jxx"], causes["Jxy"], DEGREE
    size = abs(Jxy["value"])
    relative = {name: causes[name]["sd"] / abs(causes[name]["value"]) for name in BASE_NAMES[:6]}
    return [
        "## In one paragraph",
        "",
        "Because they are small, not because they are hidden. "
        "In kg m² the products of inertia are known *better* than the moments: "
        f"{Jxy['sd']:.1e} for Jxy and",
        f"{Jxx['sd']:.1e} for Jxx. But Jxx is {Jxx['value']:.2f} and Jxy {size:.3f} kg "
        "m²: relative to their size the cross terms are",
        f"{relative['Jxy'] / relative['Jxx']:.0f} (Jxy) to {relative['Jxz'] / relative['Jxx']:.0f} "
        "(Jxz) times worse. "
        f"The signal of Jxy's own size in all telemetry is {Jxy['signal_of_size']:,.0f} "
        "sigma,",
        f"that of Jxx {Jxx['signal_of_size']:,.0f}: "
        f"at 1 deg/s a cross term of {size:.3f} kg m² asks the wheels for {size * rate:.1e} N m "
        "s, and its gyroscopic torque",
        f"is {size * rate**2:.1e} N m; slews at 0.1 deg/s have a tenth and a hundredth of that.",
    ]


def _loss_lines(causes: dict) -> list[str]:
    lines = [
        "## What is lost to what",
        "",
        "| | value | sd | signal of its size [sigma] | sd lost to other unknowns | most to |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in causes.items():
        group, factor = max(row["inflation"].items(), key=lambda item: item[1])
        value = row["value"] - (1.0 if name.startswith("K") else 0.0)
        lines.append(
            f"| {name} | {value:.4g} | {row['sd']:.2g} | {row['signal_of_size']:,.0f} | "
            f"×{row['lost']:.1f} | {group} (×{factor:.1f}) |"
        )
    return [
        *lines,
        "",
        "(K as its distance from 1.) Each slew's own start state is what costs most: "
        "its rate, attitude and wheel momentum are fitted, too.",
    ]


def _curve_lines(curves: dict) -> list[str]:
    lines = [
        "## Against rate, number of slews, noise, sensors",
        "",
        "![Cross terms](../figures/cross_terms.png)",
        "",
        "| | 0.1 deg/s | 1 deg/s | 1 slew | 5 slews | 10 slews | noise ×10 |",
        "|---|---|---|---|---|---|---|",
    ]
    columns = (
        ("rate", _index(RATES, 0.1)),
        ("rate", _index(RATES, 1.0)),
        ("number", _index(NUMBERS, 1)),
        ("number", _index(NUMBERS, 5)),
        ("number", _index(NUMBERS, 10)),
        ("noise", _index(NOISES, 10.0)),
    )
    for name in CASES:
        cells = [f"{worst(curves[name][key])[i]:.2g}" for key, i in columns]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return [*lines, "", "(sd of the worst cross term, kg m²; prior 0.03.)"]


def _index(values: np.ndarray, value: float) -> int:
    return int(np.flatnonzero(values == value)[0])


def _remarks(results: dict) -> list[str]:
    """What the curves say, one item a cause."""
    lost, curves = results["lost"], results["curves"]
    known = "tachometers, misalignment known"
    by_rate, by_number, by_noise = (
        worst(curves[known][key]) for key in ("rate", "number", "noise")
    )
    at_1 = {name: worst(curve["rate"])[_index(RATES, 1.0)] for name, curve in curves.items()}
    no_tachometers, base = at_1["no tachometers"], at_1[known]
    cost = at_1["misalignment fitted"] / base
    cost_without = at_1["no tachometers, misalignment fitted"] / no_tachometers
    return [
        "- **Rate**: the same slews stretched in time to a tenth of the rate give "
        f"{by_rate[_index(RATES, 0.1)] / base:.0f} times larger sds, "
        "although they have",
        f"  ten times the readings. From 0.5 deg/s on ({by_rate[_index(RATES, 0.5)]:.1e}) hardly "
        "anything is gained: "
        "what rate adds in signal, stretching loses in readings and in telling",
        f"  J from the start states (which cost Jxy a factor {lost['0.2']:.1f} at 0.2 deg/s, "
        f"{lost['0.5']:.1f} at 0.5, {lost['1.0']:.1f} at 1 and {lost['2.0']:.1f} at 2: a deviation",
        f"  turns with momentum over inertia, once in {results['period']:.0f} s here). "
        "With equal telemetry the sd goes on falling (`analyses/PAPER.md`).",
        f"- **Number of slews**: one slew leaves {by_number[0]:.1e} and two {by_number[1]:.1e}: "
        "about one axis not all three products show. Three slews about three",
        f"  axes give {by_number[2]:.1e}, five {by_number[4]:.1e}; from five to ten it becomes "
        f"{by_number[4] / by_number[6]:.2f} times better (√2 would be 1.41).",
        f"- **Noise**: ten times the noise, {by_noise[4] / by_noise[2]:.1f} times the sd.",
        f"- **Tachometers**: without them {no_tachometers / base:.1f} times worse: "
        "the momentum of the wheels must then be inferred from the motion.",
        "- **Misalignment of the rate sensor**: fitting it costs the cross terms a factor "
        f"{cost:.2f} with tachometers and {cost_without:.2f} without: the slews",
        f"  themselves determine its angles to {results['misalignment_sd']:.1e} rad (prior 3e-3), "
        "because momentum and the star tracker do not pass through the rate sensor.",
        "  (Left out of the fit, a misalignment does pull J: `analyses/PAPER.md`.)",
    ]


def _feedback_lines(hidden: dict) -> list[str]:
    lines = [
        "## What the feedback controller hides",
        "",
        "Response of the rate sensors, over five slews, to a change of each parameter by its prior "
        "sd: with the torque commands as they were recorded, which is what",
        "the fit compares, and in the closed loop, where the controller answers the change with "
        "other commands. The ratio is what feedback hides from the motion.",
        "",
        "| | with recorded commands [sigma] | in closed loop [sigma] | hidden by | commands change "
        "by (rms) [N m] |",
        "|---|---|---|---|---|",
    ]
    for name, row in hidden.items():
        recorded, closed = row["rate_with_given_commands"], row["rate_in_closed_loop"]
        lines.append(
            f"| {name} | {recorded:,.0f} | {closed:,.0f} | ×{recorded / max(closed, 1e-9):,.1f} | "
            f"{row['commands_rms']:.1e} |"
        )
    factors = [
        hidden[name]["rate_with_given_commands"] / hidden[name]["rate_in_closed_loop"]
        for name in BASE_NAMES[3:6]
    ]
    return [
        *lines,
        "",
        "From the motion alone a controller hides the cross terms by factors of "
        f"{min(factors):.0f} to {max(factors):.0f}: "
        "whoever fits rates without the recorded commands",
        "fits what is left. The commands carry it: that is why `fit` takes them as recorded, and "
        "nothing is hidden from it.",
    ]
