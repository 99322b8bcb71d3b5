"""Page of `table_study.py`: names, and J and K as quoted, beside the search of version 0.4."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import stats

from bayes_inertia.files import write_atomically

_ABOUT = """Made by `python -m analyses.naming.table_study`, one row a campaign, of seeds that the
code had not seen. Effects are as large as an ideal test finds in 99 % of such campaigns (`strong`:
3, 10 and 30 times that). "Last": campaigns flown last, by one state of the code; "earlier": by
states before the rule of sets was mended (nothing, or fewer effects, with a twentieth of a name's
probability make a set as well); "search": committed rows of the search of version 0.4, other
campaigns of the same kinds. All else counts last and earlier campaigns together. Ranges, 95 %: of
counts Wilson, of J and K bootstrap over campaigns. Without tachometers a lag of the wheels and a
delay of the rate sensor do the same (canonical correlation 1.00)."""
LAST = 2000  # number of the first campaign of each label that was flown last
_FIXED_KINDS = ("clean", "single", "strong", "pair", "triple")
_KINDS = (*_FIXED_KINDS, "random", "random_x10", "outside", "stated", "prior")
_NOTHING = ("clean", "stated")  # kinds in which nothing is hidden
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


def _read(path: Path) -> list[Row]:
    lines = path.read_text().splitlines() if path.exists() else []
    rows = [{"hidden": [row["label"]]} | row for row in map(json.loads, lines)]
    told = [row | {"hidden": [n for n in row["hidden"] if n not in _NOTHING]} for row in rows]
    return [row for row in told if "verdict" in row]


def read(folder: Path, kind: str, measured: str) -> list[Row]:
    """Rows of the table, of a kind of campaigns with or without tachometers."""
    return _read(folder / f"table_{kind}_{measured}.jsonl")


def of_prior_and_others(folder: Path) -> tuple[list[Row], list[Row]]:
    """Rows of campaigns drawn from the prior, and of all other kinds."""
    every = [
        (kind, read(folder, kind, measured)) for kind in _KINDS for measured in ("tacho", "notacho")
    ]
    of_prior = [row for kind, rows in every if kind == "prior" for row in rows]
    return of_prior, [row for kind, rows in every if kind != "prior" for row in rows]


def _searched(folder: Path, kind: str, measured: str) -> list[Row]:
    """Rows of the search of version 0.4."""
    name = f"diagnosis_{kind}_0.99" if kind in _FIXED_KINDS else f"naming_{kind}"
    return _read(folder / f"{name}_{measured}.jsonl")


def write_page(folder: Path) -> None:
    """Write table.md of the rows in a folder."""
    lines = ["# One table of hypotheses, on campaigns it had not seen", "", _ABOUT, ""]
    lines += ["| campaigns | | last | earlier | search of 0.4 |", "|---|---|---|---|---|"]
    every: list[Row] = []
    for kind in _KINDS:
        for measured in ("tacho", "notacho"):
            rows = read(folder, kind, measured)
            every += rows
            if rows and kind != "prior":
                lines += _names(f"{kind}, {measured}", rows, _searched(folder, kind, measured))
    drawn = [row for row in every if row["kind"] == "prior"]
    lines += ["", *_parameters(every), *_probabilities(drawn)]
    write_atomically(folder / "table.md", "\n".join(lines) + "\n")


def _names(what: str, rows: Sequence[Row], searched: Sequence[Row]) -> list[str]:
    told: list[tuple[str, Holds]] = [
        ("nothing named" if what.startswith(_NOTHING) else "named or in the set", in_the_set),
        ("the only name", alone),
        ("a wrong name", wrong_name),
        ("`unknown` or `partial`", has_no_name),
    ]
    if what.startswith(_NOTHING):
        told = [told[0], *told[2:]]
    last, earlier = ([row for row in rows if (row["index"] >= LAST) is x] for x in (True, False))
    parts = (last, earlier, searched)
    lines = [f"| | {said} | {' | '.join(share(x, f) for x in parts)} |" for said, f in told]
    lines[0] = f"| {what} {lines[0].removeprefix('| ')}"
    seconds = np.median([row["seconds"] for row in rows if "seconds" in row])
    return [*lines, f"| | processor time, median of all [s] | {seconds:.0f} | | |"]


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
        f"{len(rows)} campaigns drawn from the prior that a diagnosis assumes; every hypothesis"
        " of their tables.",
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
    """From, to, and hypotheses of such a probability `p`, with `true`; empty ones left out."""
    told = [
        {"p": p, "true": _is_true(row, kind, effects)}
        for row in rows
        for kind, effects, p, _ in row["rows"]
    ]
    bins = [(low, high, [x for x in told if low <= x["p"] < high]) for low, high in pairwise(_BINS)]
    return [each for each in bins if each[2]]


def _covered(z: np.ndarray) -> str:
    """Share of 90 % intervals that hold, and its range over campaigns."""
    held = np.mean(np.abs(z) < _NORMAL_90, axis=1)
    rng = np.random.default_rng(0)
    drawn = rng.choice(held, (_DRAWS, len(held))).mean(1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{held.mean():.0%} ({100 * low:.0f} to {100 * high:.0f})"
