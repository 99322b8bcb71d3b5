"""The page and the pictures of `design_study.py`, from its results."""

from __future__ import annotations

from collections import Counter

import numpy as np
from design_cases import FLIGHTS, PAPER
from design_separation import HOPELESS, STRENGTH
from matplotlib.figure import Figure
from page_table import table_lines

from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.pictures import style


def page(results: dict[str, dict]) -> str:
    """Compose the page of all results there are."""
    lines = [
        "# Designed plans",
        "",
        "Made by `python analyses/design_study.py`. MOST-like spacecraft; "
        "planned rate 1 deg/s, 1855 s from first to last telemetry:",
        "the rate and the time of five slews like the paper's (30 to 60 deg about x, y, z and two "
        "diagonals). Wheel limits with 20 % reserve.",
        "",
    ]
    sections = {
        "gains": _gain_lines,
        "achieved": _achieved_lines,
        "flown": _margin_lines,
        "separate": _separation_lines,
        "times": _time_lines,
    }
    for key, section in sections.items():
        if key in results:
            lines += section(results[key])
    return "\n".join(lines)


def _gain_lines(gains: dict) -> list[str]:
    rows = [
        (
            goal,
            f"{row['paper']:.3g}" + (f" {row['unit']}" if row["unit"] else ""),
            f"{row['random']['best']:.3g}",
            f"{row['designed']:.3g}",
            f"**{row['gain']:.2f}**",
        )
        for goal, row in gains.items()
    ]
    columns = ("goal", "paper-like", "best of 10,000 random", "designed", "gain")
    seeds = ", ".join(f"{gain:.2f}" for gain in gains["cross_terms"]["seeds"])
    return [
        "## Gains",
        "",
        *table_lines(columns, rows),
        "",
        f"Other seeds of the search for the cross terms: gain {seeds}. Smaller is better; "
        "each number is an sd as `criterion` defines it.",
        "",
        "![Gains of designed plans](../../figures/design_gains.png)",
        "",
    ]


def _achieved_lines(achieved: dict) -> list[str]:
    rows = []
    for name, row in achieved.items():
        ratios = zip(row["ratio"], row["ratio_error"], strict=True)
        cells = [f"{ratio:.3f} ± {error:.3f}" for ratio, error in ratios]
        rows.append((name, f"{row['campaigns']}", *cells))
    paper, designed = (
        max(achieved[name]["achieved"][3:6]) for name in (PAPER, "for the cross terms")
    )
    return [
        "## Predicted over achieved",
        "",
        *table_lines(("plan", "campaigns", *BASE_NAMES), rows),
        "",
        f"Worst cross term, achieved: {paper:.3g} kg m² with slews like the paper's, "
        f"{designed:.3g} designed: **{paper / designed:.2f}** times smaller.",
        "",
        "![Predicted over achieved sds](../../figures/design_ratio.png)",
        "",
    ]


def _margin_lines(flown: dict) -> list[str]:
    limits = list(next(iter(flown.values())))
    lines = [
        "## Margins in flight",
        "",
        f"Smallest margin over {FLIGHTS} closed-loop flights a plan, truths from the prior, "
        "noise on.",
        "",
    ]
    rows = []
    for goal, row in flown.items():
        cells = [f"{100 * row[limit]['smallest']:.1f} %" for limit in limits]
        broken = sum(row[limit]["broken"] for limit in limits)
        rows.append((goal, *cells, f"{broken}"))
    return [*lines, *table_lines(("goal", *limits, "broken"), rows), ""]


def _separation_lines(separate: dict) -> list[str]:
    lines = [
        "## Effects told apart",
        "",
        f"Either effect of a pair hidden at a strength (non-centrality {STRENGTH:.0f}) that "
        "slews like the paper's just show, in the direction",
        "that the other imitates best. Right: the effect alone is named.",
        "",
    ]
    columns = (
        "hidden",
        "alternative",
        "plan",
        "canonical correlation",
        "named rightly",
        "verdicts",
    )
    rows = []
    for pair, row in separate["pairs"].items():
        effects = pair.split(",")
        for hidden, alternative in (effects, effects[::-1]):
            rows += [_separation_row(row, hidden, alternative, label) for label in row["plans"]]
    left = " and ".join(
        f"{1.0 - correlation:.0e} ({label})" for label, correlation in separate["hopeless"].items()
    )
    return [
        *lines,
        *table_lines(columns, rows),
        "",
        f"No slew tells {HOPELESS[0]} from {HOPELESS[1]} without tachometers: "
        f"their canonical correlation is 1 but for {left}, "
        "although the last plan was designed for it.",
        "",
    ]


def _separation_row(row: dict, hidden: str, alternative: str, label: str) -> tuple[str, ...]:
    verdicts = [v for v in row["verdicts"] if v["hidden"] == hidden and v["plan"] == label]
    right = sum(v["verdict"] == "named" and v["named"] == [hidden] for v in verdicts)
    counts = Counter(v["verdict"] for v in verdicts)
    return (
        hidden,
        alternative,
        label,
        f"{row['plans'][label]['canonical_correlation']:.3f}",
        f"{right} of {len(verdicts)}",
        ", ".join(f"{count} {verdict}" for verdict, count in counts.items()),
    )


def _time_lines(times: dict) -> list[str]:
    cold = times["cold_design"]
    return [
        "## Times",
        "",
        "A cold design of five slews, imports and compilation included: "
        f"{cold['wall']:.0f} s ({cold['cpu']:.0f} s of processor time).",
        f"One exact gradient: {1e3 * times['gradient']:.0f} ms (the first one, with compilation: "
        f"{times['first_gradient']:.0f} s).",
        f"`separating_slew`: {times['separating_slew']:.0f} s.",
        "",
    ]


@style.styled
def gains_picture(gains: dict) -> Figure:
    """Distribution of the goal's number over random feasible plans, with the paper-like and the
    designed plan.
    """
    figure = Figure(figsize=(style.WIDTH, 3.2), layout="constrained")
    titles = {
        "cross_terms": "worst cross term",
        "inertia": "all of J",
        "scale_factors": "worst scale factor",
        "correction_slew": "correction slew",
    }
    for axes, (goal, row) in zip(figure.subplots(1, len(gains)), gains.items(), strict=True):
        paper = row["paper"]
        grid = np.linspace(0.0, 1.0, len(row["values"]))
        axes.plot(
            np.array(row["values"]) / paper, grid, color=style.BLUE, label="10,000 random plans"
        )
        axes.axvline(1.0, color=style.MUTED, ls=(0, (4, 2)), label="like the paper's")
        axes.axvline(row["designed"] / paper, color=style.VERMILLION, lw=1.8, label="designed")
        axes.set(xlim=(0.0, 2.0), ylim=(0.0, 1.0), xlabel="sd, over that of paper-like slews")
        axes.set_title(f"{titles[goal]}: {paper / row['designed']:.2f} times", fontsize=9.0)
    first = figure.axes[0]
    first.set_ylabel("part of the random plans below")
    first.legend(loc="upper right", fontsize=7.5, frameon=True, framealpha=1.0, edgecolor="none")
    return figure


@style.styled
def ratio_picture(achieved: dict) -> Figure:
    """Predicted over achieved sd of every parameter, three plans, with 2 standard errors."""
    figure = Figure(figsize=(style.WIDTH, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(0.95, 1.05, color=style.PALE, alpha=0.6, lw=0, label="± 5 %")
    axes.axhline(1.0, color=style.MUTED, lw=0.8)
    for k, (name, row) in enumerate(achieved.items()):
        x = np.arange(9) + 0.18 * (k - 1)
        axes.errorbar(
            x,
            row["ratio"],
            2.0 * np.array(row["ratio_error"]),
            fmt=style.MARKERS[k],
            ms=4.5,
            capsize=2,
            color=style.color(k),
            label=name,
        )
        stated = np.array(row["expected"]) / np.array(row["stated"])
        axes.plot(
            x,
            stated,
            "_",
            color=style.INK,
            ms=9,
            label="over the sd that fits state (rms)" if k == 0 else None,
        )
    axes.set(
        xticks=range(9),
        xticklabels=BASE_NAMES,
        ylabel="predicted sd / achieved sd",
        ylim=(0.85, 1.2),
    )
    number = next(iter(achieved.values()))["campaigns"]
    axes.set_title(
        f"{number} simulated campaigns of each plan, J, K and bias drawn from the prior (bars: "
        "2 standard errors)"
    )
    axes.legend(ncols=3, loc="upper left")
    return figure
