"""Confusion matrix and promised figures of the diagnosis, from the rows that
`diagnosis_study.py` has written.

    python analyses/diagnosis_figures.py

writes `analyses/results/diagnosis.md` and `figures/diagnosis_confusion.png`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from diagnosis_study import FOLDER, NAMES, OUTSIDE
from matplotlib.figure import Figure
from naming_page import nameless
from scipy import stats

from bayes_inertia.files import write_atomically
from bayes_inertia.report.pictures import style

FIGURES = Path(__file__).parents[1] / "figures"
PROMISED = 0.99
LOWER = (0.9,)
# Kinds with several effects: in words, and what is wanted of them [%].
_TOGETHER = {"pair": ("two", 90), "triple": ("three", 75)}
# Distance of a truth from its prior at which the verdict must speak of it [prior sd]: what
# a diagnosis takes for the prior follows the rates of its campaign.
_CLEARLY_BEYOND = 6.0
_OTHER = "other name"  # of an effect without a fixed shape
ENDS = ("one of several", "nothing found", "unknown")
WHERE = {True: "with tachometers", False: "without tachometers"}


def read(folder: Path = FOLDER) -> pd.DataFrame:
    """All rows: one campaign each, with the ideal test's power and how the verdict stands to the
    truth.
    """
    tables = []
    for path in sorted(folder.glob("diagnosis_*.jsonl")):
        table = pd.read_json(path, lines=True)
        tables.append(
            table.assign(
                power=float(path.stem.split("_")[2]), tachometers=path.stem.endswith("_tacho")
            )
        )
    rows = pd.concat(tables, ignore_index=True)
    return rows[rows["error"].isna()] if "error" in rows else rows


def candidates_of(row: pd.Series) -> tuple[set[str], set[str]]:
    """Effects named for sure, and those in ambiguous sets."""
    unsure = {name for group in row["ambiguous_with"] for name in group}
    return set(row["named"]) - unsure - {"noise_level"}, unsure


def outcome(row: pd.Series) -> str:
    """One hidden effect: the wrong name if the truth is not beside it, the truth's name, or how the
    search ended.
    """
    sure, unsure = candidates_of(row)
    truth = row["hidden"][0]
    if truth in sure:
        return truth
    if truth in unsure:
        return ENDS[0]
    if row["verdict"] == "unknown":
        return ENDS[2]
    named = [n for n in row["steps"] if n in sure | unsure]
    return named[0] if named else ENDS[1]


def judged(single: pd.DataFrame) -> pd.DataFrame:
    """Campaigns with one hidden effect and their `outcome`, whether the truth is named or in the
    set (`right`), or a name without it (`wrong`).
    """
    ends = single.apply(outcome, axis=1)
    right = (ends == single["label"]) | (ends == ENDS[0])
    return single.assign(outcome=ends, right=right, wrong=~right & ~ends.isin(ENDS))


def share(hits: int, n: int) -> str:
    """A fraction with its exact 95 % interval (Clopper and Pearson).

    >>> share(0, 200)
    '0 of 200 (0.0 %, 95 %: 0.0 to 1.8 %)'
    """
    interval = stats.binomtest(int(hits), int(n)).proportion_ci(0.95)
    return (
        f"{hits} of {n} ({100 * hits / n:.1f} %, 95 %: "
        f"{100 * interval.low:.1f} to {100 * interval.high:.1f} %)"
    )


def promised(rows: pd.DataFrame) -> list[str]:
    """The lines of the table: what was wanted, what was measured."""
    lines = ["| | wanted | measured |", "|---|---|---|"]
    both = [
        (WHERE[tachometers], rows[rows["tachometers"] == tachometers])
        for tachometers in (True, False)
    ]
    for build in (clean_lines, strong_lines, weaker_lines, many_times_lines, together_lines):
        for where, part in both:
            lines += build(part, where)
    flown = rows[rows["verdict"].notna()]
    sets = [len(group) for _, r in flown.iterrows() for group in r["ambiguous_with"]]
    lines.append(
        "| sets reported as ambiguous, in all campaigns: "
        f"of more than three | none | {sum(n > 3 for n in sets)} of {len(sets)} |"
    )
    for where, part in both:
        lines += outside_lines(part, where)
    return lines


def clean_lines(rows: pd.DataFrame, where: str) -> list[str]:
    """False alarms."""
    clean = rows[rows["kind"] == "clean"]
    named = sum(bool(candidates_of(r)[0] | candidates_of(r)[1]) for _, r in clean.iterrows())
    return [
        f"| clean campaigns {where} in which an effect is named | at most 5 % | "
        f"{share(named, len(clean))} |"
    ]


def strong_lines(rows: pd.DataFrame, where: str) -> list[str]:
    """One hidden effect that an ideal test would hardly miss: what is named, and how good the fit
    with it is.
    """
    single = judged(rows[(rows["kind"] == "single") & (rows["power"] == PROMISED)])
    good = single[single["right"]]
    alone = sum(set.union(*candidates_of(r)) == {r["label"]} for _, r in single.iterrows())
    beside = sum(bool(candidates_of(r)[0] - {r["label"]}) for _, r in good.iterrows())
    inside = sum(all(r["chi2_inside"].values()) for _, r in good.iterrows())
    better = sum(b > a for b, a in good["held_out"])
    sets, z = (
        good["verdict"] == "ambiguous",
        good["max_abs_z_averaged"].fillna(good["max_abs_z"]),
    )  # the same where there is no set
    return [
        f"| one effect at ideal power 0.99, {where}: truth named or in the set | at least 95 % | "
        f"{share(len(good), len(single))} |",
        f"| ... named alone | - | {share(alone, len(single))} |",
        "| ... named or in the set, and beside it a wrong name as sure | - | "
        f"{share(beside, len(single))} |",
        "| ... wrong name without the truth beside it | at most 2 % | "
        f"{share(single['wrong'].sum(), len(single))} |",
        f"| ... nothing named | - | {share((single['outcome'] == ENDS[1]).sum(), len(single))} |",
        "| ... then reduced chi² of every channel and in total inside its 99 % interval | 96 % by "
        f"chance | {share(inside, len(good))} |",
        "| ... then all nine of J and K within 3.5 sd | 99.6 % by chance | "
        f"{share((z < 3.5).sum(), len(good))} |",
        "| ... in ambiguous campaigns, J and K averaged over the set | 99.6 % by chance | "
        f"{share((z[sets] < 3.5).sum(), sets.sum())} |",
        "| ... in ambiguous campaigns, J and K given the first of the set | - | "
        f"{share((good['max_abs_z'][sets] < 3.5).sum(), sets.sum())} |",
        f"| ... then slews held out of the fit predicted better | - | {share(better, len(good))} |",
    ]


def weaker_lines(rows: pd.DataFrame, where: str) -> list[str]:
    """One hidden effect that an ideal test would miss more often."""
    lines = []
    for power in LOWER:
        if not ((rows["kind"] == "single") & (rows["power"] == power)).any():
            continue
        single = judged(rows[(rows["kind"] == "single") & (rows["power"] == power)])
        missed = single[single["verdict"] == "consistent"]
        near = share((missed["max_abs_z"] < 3.5).sum(), len(missed))
        lines += [
            f"| one effect at ideal power {power:g}, {where}: "
            f"truth named or in the set | - | {share(single['right'].sum(), len(single))} |",
            "| ... wrong name without the truth beside it | - | "
            f"{share(single['wrong'].sum(), len(single))} |",
            f"| ... where nothing is found, all nine of J and K within 3.5 sd | - | {near} |",
        ]
    return lines


def many_times_lines(rows: pd.DataFrame, where: str) -> list[str]:
    """Effects at several times the size that is easily found, if they were studied."""
    strong = rows[rows["kind"] == "strong"]
    lines = []
    for factor in sorted(strong["factor"].unique()) if len(strong) else ():
        of_factor = strong[strong["factor"] == factor]
        flown = of_factor[of_factor["verdict"].notna()]
        if not len(flown):
            continue
        named = flown.apply(lambda r: r["hidden"][0] in set.union(*candidates_of(r)), axis=1)
        beyond = flown.apply(lambda r: r["prior_sds"][r["hidden"][0]] > _CLEARLY_BEYOND, axis=1)
        said = flown["beyond_prior"].map(bool)
        lines += [
            f"| one effect at {factor:g} times that size, {where}: named or in the set | "
            f"at least 98 % | {share(named.sum(), len(flown))} |",
            f"| ... not flown: no size that is physical | - | {len(of_factor) - len(flown)} |",
        ]
        if (beyond & named).any():
            told = share((said & beyond & named).sum(), (beyond & named).sum())
            lines.append(
                f"| ... more than {_CLEARLY_BEYOND:g} prior sd: said to be beyond its prior | "
                f"all | {told} |"
            )
    return lines


def together_lines(rows: pd.DataFrame, where: str) -> list[str]:
    """Several hidden effects at once, if they were studied."""
    lines = []
    for kind, (number, wanted) in _TOGETHER.items():
        of_kind = rows[rows["kind"] == kind]
        if not len(of_kind):
            continue
        found = sum(set(r["hidden"]) <= set.union(*candidates_of(r)) for _, r in of_kind.iterrows())
        ideal = of_kind["ideal_powers"].map(np.prod).sum()
        lines += [
            f"| {number} effects at once, {where}: all named or in the sets | "
            f"at least {wanted} % | {share(found, len(of_kind))} |",
            "| ... expected of ideal tests, each with the other effects fitted | - | "
            f"{ideal:.1f} of {len(of_kind)} |",
        ]
    return lines


def outside_lines(rows: pd.DataFrame, where: str) -> list[str]:
    """Effects outside the library."""
    outside = rows[rows["kind"] == "outside"]
    if not len(outside):
        return []
    unknown = outside.apply(nameless, axis=1)
    lines = [
        f"| effects outside the library, {where}: "
        "unknown, or a shape without a name in the set | at least 90 % | "
        f"{share(unknown.sum(), len(outside))} |"
    ]
    for name in OUTSIDE:
        verdicts = unknown[outside["label"] == name]
        lines.append(
            f"| ... {name.removeprefix('outside_').replace('_', ' ')} | | "
            f"{share(verdicts.sum(), len(verdicts))} |"
        )
    return lines


@style.styled
def confusion(rows: pd.DataFrame) -> Figure:
    """Share of campaigns by hidden effect (row) and by what was named (column)."""
    single = rows[(rows["kind"] == "single") & (rows["power"] == PROMISED)]
    columns = [*NAMES, _OTHER, *ENDS]
    table = np.zeros((len(NAMES), len(columns)))
    counts = single["label"].value_counts()
    for _, row in single.iterrows():
        end = outcome(row)
        column = columns.index(end if end in columns else _OTHER)
        table[NAMES.index(row["label"]), column] += 1.0 / counts[row["label"]]
    figure = Figure(figsize=(style.WIDTH, 7.6))
    axes = figure.add_axes((0.2, 0.06, 0.76, 0.66))
    axes.imshow(table, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(table), strict=True):
        color = "white" if table[i, j] > 0.55 else style.INK
        text = f"{100 * table[i, j]:.0f}"
        axes.text(j, i, text, ha="center", va="center", color=color, fontsize=8)
    axes.axvline(len(NAMES) - 0.5, color=style.MUTED, lw=1.0)
    labels = [name.replace("_", " ") for name in columns]
    axes.set_xticks(range(len(columns)), labels, rotation=55, ha="left", rotation_mode="anchor")
    axes.xaxis.tick_top()
    labels = [f"{name.replace('_', ' ')} ({counts.get(name, 0)})" for name in NAMES]
    axes.set_yticks(range(len(NAMES)), labels)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    title = "What is named, where an ideal test would find the hidden effect in 99 % of campaigns"
    figure.text(0.02, 0.965, title, fontsize=11)
    subtitle = (
        "per cent of campaigns; row: the hidden effect (campaigns); column: "
        "the name given, with and without tachometers together"
    )
    figure.text(0.02, 0.94, subtitle, color=style.MUTED)
    return figure


def main() -> None:
    """Draw the figure, write the page."""
    rows = read()
    confusion(rows).savefig(FIGURES / "diagnosis_confusion.png", dpi=130)
    write_page(FOLDER / "diagnosis.md", rows)


def write_page(path: Path, rows: pd.DataFrame) -> None:
    """Write the page of all rows."""
    lines = [
        "# How well the diagnosis names hidden effects",
        "",
        "Every campaign has its own J, K, bias, slews and wheel momenta, drawn from the prior; "
        "the amplitude is that at which an ideal test of the",
        "true effect alone, at the level of one candidate's share of the false alarms, would find "
        "it with the stated probability.",
        "Made by `analyses/diagnosis_study.py` and `analyses/diagnosis_figures.py`. All rows are "
        "of version 0.4: those of one effect at ideal power 0.99 from number 15 on with and from "
        "number 8 on without tachometers are of its last states, the others of earlier ones.",
        "Some are few: read the intervals. Effects without a fixed shape: [naming.md](naming.md).",
        "The ideal test knows a flexible mode's frequency; the diagnosis has to find it. "
        "Where nothing is found a hidden effect is still there, and moves",
        "J and K: every diagnosis says by how much at most (`could_hide`).",
        "",
        *promised(rows),
        "",
        "![What is named, against what was hidden](../../figures/diagnosis_confusion.png)",
    ]
    write_atomically(path, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
