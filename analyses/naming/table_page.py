"""Page of `table_study.py`: names, and J and K as quoted, beside the search of version 0.4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import stats

from analyses import rows_of
from analyses.naming.confusion import write_confusion
from analyses.naming.kinds import NOTHING
from analyses.naming.unlisted_disturbances import SHAPELESS
from bayes_inertia.files import write_atomically

_ABOUT = """Made by `python -m analyses.naming.table_study`, one row a campaign, of seeds that the
code had not seen. Effects are as large as an ideal test finds in 99 % of such campaigns; `0.9`: in
90 %; `x10`: ten times as large; `strong`: 3, 10 and 30 times. The ideal test knows the effect and
its correlation time. `outside`: twelve disturbances that the library does not hold. `stated`:
nothing is hidden beside noise that wanders as stated; `beside`: an effect in such noise, with
outliers. "Now": campaigns flown last, by one state of the code; "earlier": by states before it;
"search": rows of the search of version 0.4, other campaigns of the same kinds. All else counts
campaigns of now and earlier together. Ranges, 95 %: of counts Wilson, of J and K bootstrap over
campaigns. Without tachometers a lag of the wheels and a delay of the rate sensor do the same
(canonical correlation 1.00)."""
LAST = 3000  # number of the first campaign of each label that was flown last
KINDS = (
    *("clean", "single", "single_0.9", "strong", "pair", "triple"),
    *("random", "random_0.9", "random_x3", "random_x10", "random_x30"),
    *("outside", "stated", "beside", "prior"),
)
_NORMAL_90 = 1.6449
_DRAWS = 2000
_BINS = (0.02, 0.1, 0.3, 0.7, 0.9, 0.97, 1.01)  # of stated probabilities

Row = dict
Holds = Callable[[Row], bool]


def in_the_set(row: Row) -> bool:
    """Whether all that is hidden is named or in a set; of clean campaigns, nothing is named."""
    if not row["hidden"]:
        return row["verdict"] == "consistent"
    found = {*row["named"], *(name for names in row["ambiguous_with"] for name in names)}
    return set(row["hidden"]) <= found


def wrong_name(row: Row) -> bool:
    """Whether a name is wrong, and neither the truth nor "nothing" stands beside it."""
    by_first = {names[0]: set(names) for names in row["ambiguous_with"]}
    sets = (by_first.get(name, {name}) for name in row["named"])
    return any(not (names & {*row["hidden"], "nothing"}) for names in sets)


def alone(row: Row) -> bool:
    """Whether just what is hidden is named, and nothing beside it."""
    return row["verdict"] == "named" and set(row["named"]) == set(row["hidden"])


def has_no_name(row: Row) -> bool:
    """Whether the verdict is that something has no name."""
    return row["verdict"] in ("unknown", "partial")


def share(rows: Sequence[Row], holds: Holds) -> str:
    """How many rows hold, and the 95 % interval of the share (Wilson)."""
    if not rows:
        return "-"
    count = sum(map(holds, rows))
    interval = stats.binomtest(count, len(rows)).proportion_ci(0.95, method="wilson")
    low, high = 100.0 * interval.low, 100.0 * interval.high
    return f"{count} of {len(rows)} ({100.0 * count / len(rows):.0f} %, {low:.0f} to {high:.0f})"


def is_open(row: Row) -> bool:
    """Whether what has no name is the verdict, or stands among the answers."""
    answers = {name for names in row["ambiguous_with"] for name in names}
    unnamed = any(name.startswith(("nameless", "formula")) for name in answers)
    return unnamed or row["verdict"] in ("unknown", "partial", "formula")


def is_open_or_akin(row: Row) -> bool:
    """The same, or the random effect of the library that enters where a shapeless one does."""
    (label,) = row["hidden"]
    answers = {*row["named"], *(name for names in row["ambiguous_with"] for name in names)}
    return is_open(row) or SHAPELESS.get(label) in answers


def nothing_found(row: Row) -> bool:
    """Whether nothing is named."""
    return row["verdict"] == "consistent"


def _told(row: Row) -> Row:
    """The row with what is hidden; none of it where nothing is."""
    hidden = row.get("hidden", [row["label"]])
    return row | {"hidden": [name for name in hidden if name not in NOTHING]}


def read(folder: Path, kind: str, measured: str) -> list[Row]:
    """Rows of the table, of a kind of campaigns with or without tachometers."""
    rows = rows_of(folder / f"table_{kind}_{measured}.jsonl")
    return [_told(row) for row in rows if "verdict" in row]


def of_prior_and_others(folder: Path) -> tuple[list[Row], list[Row]]:
    """Rows of campaigns drawn from the prior, and of all other kinds."""
    every = [
        (kind, read(folder, kind, measured)) for kind in KINDS for measured in ("tacho", "notacho")
    ]
    of_prior = [row for kind, rows in every if kind == "prior" for row in rows]
    return of_prior, [row for kind, rows in every if kind != "prior" for row in rows]


def write_page(folder: Path) -> None:
    """Write table.md of the rows in a folder, and draw its figure."""
    searched = [_told(row) for row in rows_of(folder / "search_0.4.jsonl")]
    lines = ["# One table of hypotheses, on campaigns it had not seen", "", _ABOUT, ""]
    lines += ["| campaigns | | now | earlier | search of 0.4 |", "|---|---|---|---|---|"]
    every: list[Row] = []
    for kind in KINDS:
        for measured in ("tacho", "notacho"):
            rows, text = read(folder, kind, measured), f"{kind}/{measured}"
            every += rows
            if rows and kind != "prior":
                lines += _names(text, rows, [row for row in searched if row["kind"] == text])
    drawn = [row for row in every if row["kind"] == "prior"]
    lines += ["", *_parameters(every), *_probabilities(drawn)]
    single = [row for measured in ("tacho", "notacho") for row in read(folder, "single", measured)]
    write_confusion(single)
    lines += ["", "![What is named, by what is hidden](../../../figures/diagnosis_confusion.png)"]
    write_atomically(folder / "table.md", "\n".join(lines) + "\n")


def _names(kind: str, rows: Sequence[Row], searched: Sequence[Row]) -> list[str]:
    last, earlier = ([row for row in rows if (row["index"] >= LAST) is x] for x in (True, False))
    parts = (last, earlier, searched)
    what, seconds = kind.replace("/", ", "), [row["seconds"] for row in rows if "seconds" in row]
    lines = [
        f"| {'' if k else what} | {said} | {' | '.join(share(x, holds) for x in parts)} |"
        for k, (said, holds) in enumerate(_counted(kind.split("/")[0]))
    ]
    return [*lines, f"| | processor time, median of all [s] | {np.median(seconds):.0f} | | |"]


def _counted(kind: str) -> list[tuple[str, Holds]]:
    """What is counted of a kind of campaigns."""
    if kind == "outside":
        return [
            ("`unknown` or `partial`", has_no_name),
            ("... or an unmodelled disturbance or a formula among the answers", is_open),
            (
                "... or the random effect that enters where one without a shape does",
                is_open_or_akin,
            ),
            ("nothing found", nothing_found),
        ]
    if kind in NOTHING:
        named = [("nothing named", in_the_set)]
    else:
        named = [("named or in the set", in_the_set), ("the only name", alone)]
    return [*named, ("a wrong name", wrong_name), ("`unknown` or `partial`", has_no_name)]


def _parameters(rows: Sequence[Row]) -> list[str]:
    """J and K as quoted: how often 90 % intervals hold, and their width."""
    clean = [row for row in rows if not row["hidden"]]
    hidden = [row for row in rows if row not in clean]
    groups = {
        "clean": clean,
        "hidden, nothing found": [r for r in hidden if r["verdict"] == "consistent"],
        "hidden, named": [r for r in hidden if r["verdict"] == "named"],
        "hidden, ambiguous": [r for r in hidden if r["verdict"] == "ambiguous"],
        "hidden, unknown or partial": [r for r in hidden if has_no_name(r)],
        "all hidden": hidden,
        "drawn from the prior": [row for row in rows if row["kind"] == "prior"],
        "all": list(rows),
    }
    lines = [
        "## J and K as quoted",
        "",
        "| campaigns | | 90 % intervals hold | rms z | sd over true model's: mean, median |",
        "|---|---|---|---|---|",
    ]
    for what, some in groups.items():
        if some:
            z = np.array([row["quoted_z"] for row in some])
            ratio = np.array([row["sd_ratio"] for row in some])
            lines.append(
                f"| {what} | {len(some)} | {_covered(z)} | {np.sqrt(np.mean(z**2)):.2f} |"
                f" {np.nanmean(ratio):.2f}, {np.nanmedian(ratio):.2f} |"
            )
    lines += ["", "What is outside the library: the true model is the fit as if it were known."]
    return lines


def _is_true(row: Row, kind: str, effects: Sequence[str]) -> bool:
    """Whether a hypothesis is what is hidden."""
    named = {name for name in row["hidden"] if not name.startswith("outside")}
    has_no_name = len(named) < len(row["hidden"])
    if kind == "others":
        return not any(_is_true(row, *told[:2]) for told in row["rows"] if told[0] != "others")
    return named == set(effects) and has_no_name == (kind == "nameless")


def _probabilities(rows: Sequence[Row]) -> list[str]:
    """Stated probabilities of hypotheses, and how many are true."""
    if not rows:
        return []
    lines = [
        "",
        "## Stated probabilities",
        "",
        f"{len(rows)} campaigns drawn from the prior that a diagnosis assumes; every hypothesis of"
        f" their tables, but of {misfits(rows)} campaigns whose residuals fit no row.",
        "",
        "| stated | mean | true |",
        "|---|---|---|",
    ]
    for low, high, some in by_probability(rows):
        mean = np.mean([x["p"] for x in some])
        lines.append(
            f"| {low:.0%} to {min(high, 1.0):.0%} | {mean:.0%} |"
            f" {share(some, lambda x: x['true'])} |"
        )
    return lines


def by_probability(rows: Sequence[Row]) -> list[tuple[float, float, list[Row]]]:
    """From, to, and hypotheses of such a probability `p`, with `true`; empty ones left out.

    Where the residuals fit no row, probabilities only compare rows, and a report says so.
    """
    told = [
        {"p": _stated(row, kind, p), "true": _is_true(row, kind, effects)}
        for row in rows
        if row.get("why_unknown") != "misfit"
        for kind, effects, p, _ in row["rows"]
    ]
    bins = [(low, high, [x for x in told if low <= x["p"] < high]) for low, high in pairwise(_BINS)]
    return [each for each in bins if each[2]]


def misfits(rows: Sequence[Row]) -> int:
    """How many campaigns have residuals that fit no row of their tables."""
    return sum(row.get("why_unknown") == "misfit" for row in rows)


def _stated(row: Row, kind: str, probability: float) -> float:
    """What is stated of a hypothesis; of all others, what the listed ones leave."""
    if kind != "others":
        return probability
    return 1.0 - sum(p for listed, _, p, _ in row["rows"] if listed != "others")


def _covered(z: np.ndarray) -> str:
    """Share of 90 % intervals that hold, and its range over campaigns."""
    held = np.mean(np.abs(z) < _NORMAL_90, axis=1)
    rng = np.random.default_rng(0)
    drawn = rng.choice(held, (_DRAWS, len(held))).mean(1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{held.mean():.0%} ({100 * low:.0f} to {100 * high:.0f})"
