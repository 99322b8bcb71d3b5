"""The page of `stochastic.py`: how often what has no fixed shape is named."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from analyses.naming.stochastic_campaigns import POWER, RANDOM
from analyses.naming.unlisted_disturbances import SHAPELESS
from analyses.pages.table import table_lines
from bayes_inertia.files import write_atomically

_ABOUT = """Made by `python -m analyses.naming.stochastic`. Campaigns are of another simulator
(`second_simulator.py`); those beside wandering noise and outliers are of the package's own. Each
has its own J, K, bias, slews, wheel momenta and noise. Random effects are as large as an ideal test
finds in 99 % (or 90 %) of such campaigns (`ideal_power.py`), or so many times as large. The ideal
test knows the effect, its size and its correlation time. Random processes are drawn every 0.05 s.
Intervals are binomial, 95 % (Clopper and Pearson). Words: the
[glossary](../../../docs/glossary.md#studies).

Some of these campaigns served to improve the code: random effects at 99 % below number 20, effects
at 10 and 30 times the size below number 10. The code had not seen those after. Three kinds were run
with older code: effects beside wandering noise, stated noise without tachometers below number 50,
and clean campaigns from number 60 on."""


def write_page(folder: Path) -> None:
    """Write naming.md beside the rows."""
    rows = [
        json.loads(line)
        for path in sorted(folder.glob("naming_*.jsonl"))
        for line in path.read_text().splitlines()
    ]
    # Those drawn from the prior judge probabilities: `reliability.py`.
    rows = [row for row in rows if row["kind"] != "prior"]
    lines = ["# Random effects, and disturbances outside the library", "", _ABOUT, ""]
    for tachometers, title in ((True, "With tachometers"), (False, "Without tachometers")):
        some = [row for row in rows if row["tachometers"] is tachometers]
        hidden = [row for row in some if row["kind"] not in ("clean", "stated")]
        lines += [f"## {title}", "", *_summary(some), *(_by_label(hidden) if hidden else [])]
    write_atomically(folder / "naming.md", "\n".join(lines))


def share(count: int, total: int) -> str:
    """A count with its binomial interval.

    >>> share(3, 4)
    '3 of 4 (75 %, 95 %: 19 to 99 %)'
    """
    if not total:
        return "0 of 0"
    interval = stats.binomtest(count, total).proportion_ci(0.95)
    low, high = 100.0 * interval.low, 100.0 * interval.high
    return f"{count} of {total} ({100.0 * count / total:.0f} %, 95 %: {low:.0f} to {high:.0f} %)"


def in_a_set(row: dict) -> bool:
    """Whether the truth is named, alone or in an ambiguous set."""
    sets = [name for names in row.get("ambiguous_with", []) for name in names]
    return row["label"] in (*row.get("named", []), *sets)


def nameless(row: dict) -> bool:
    """Whether the verdict is unknown, or leaves open that the signal has no name."""
    sets = [name for names in row.get("ambiguous_with", []) for name in names]
    return row.get("verdict") == "unknown" or any(name.startswith("nameless") for name in sets)


def _summary(rows: Sequence[dict]) -> list[str]:
    hidden = [row for row in rows if row["kind"] == "random"]
    outside = [row for row in rows if row["kind"] == "outside"]
    shaped = [row for row in outside if row["label"] not in SHAPELESS]
    shapeless = [row for row in outside if row["label"] in SHAPELESS]
    table: list[tuple[str, str]] = []
    for size in sorted({_size(row) for row in hidden}):
        table += _of_size(size, [row for row in hidden if _size(row) == size])
    beside = [row for row in rows if row["kind"] == "beside"]
    table += _counted(
        "effects of a fixed shape beside noise that wanders as stated and outliers", beside
    )
    table += [
        *_of_outside("outside the library, with a shape", shaped),
        *_of_outside("outside the library, without a fixed shape", shapeless),
        (
            "... or the random effect of the library that enters there",
            share(_n(shapeless, lambda row: nameless(row) or _of_its_kind(row)), len(shapeless)),
        ),
        *_as_quoted([row for row in outside if "quoted_z" in row]),
        *_of_clean("clean campaigns", [row for row in rows if row["kind"] == "clean"]),
        *_of_clean(
            "campaigns whose noise wanders as stated (random walk, bias instability, star tracker)",
            [row for row in rows if row["kind"] == "stated"],
        ),
    ]
    named = [row for row in hidden if in_a_set(row)]
    if named:
        z = [row["max_abs_z"] for row in named]
        held = sum(row["holds_90"] for row in named)
        table += [
            (
                "where named, 90 % intervals of J and K that hold the truth",
                f"{100.0 * held / (9 * len(named)):.0f} % of {9 * len(named)}",
            ),
            (
                "... largest error of J and K, median and worst",
                f"{np.median(z):.1f} and {max(z):.1f} sd",
            ),
        ]
    seconds = [row["seconds"] for row in rows]
    if seconds:
        table.append(
            (
                "processor time, median and largest",
                f"{np.median(seconds):.0f} and {max(seconds):.0f} s",
            )
        )
    counted = [row for row in table if row[1] != "0 of 0"]
    return [*table_lines(("", "measured"), counted), ""]


def _size(row: dict) -> tuple[float, float]:
    """Power of the ideal test, and the size over that which it finds."""
    return row.get("power", POWER), row["times"]


def _of_size(size: tuple[float, float], rows: Sequence[dict]) -> list[tuple[str, str]]:
    """Rows of random effects of one size."""
    power, times = size
    of_size = f"ideal power {power:g}" if times == 1.0 else f"{times:g} times that size"
    return _counted(f"random effects, {of_size}", rows)


def _counted(title: str, rows: Sequence[dict]) -> list[tuple[str, str]]:
    """What diagnoses of campaigns with one hidden effect say."""
    counted = (
        (f"{title}: named or in the set", in_a_set),
        (
            "... named alone",
            lambda row: row["named"] == [row["label"]] and not row["ambiguous_with"],
        ),
        ("... unknown", lambda row: row["verdict"] == "unknown"),
        ("... nothing found", lambda row: row["verdict"] == "consistent"),
        ("... taken for correlated noise, which is listed and modelled", _as_noise),
        ("... a wrong name without the truth", _wrong),
        ("... a wrong name beside the truth", _wrong_beside),
    )
    return [(what_for, share(_n(rows, what), len(rows))) for what_for, what in counted]


def _of_outside(title: str, rows: Sequence[dict]) -> list[tuple[str, str]]:
    unknown = _n(rows, lambda row: row["verdict"] == "unknown")
    return [
        (f"{title}: unknown", share(unknown, len(rows))),
        ("... or a set with an unmodelled disturbance", share(_n(rows, nameless), len(rows))),
        ("... nothing found", share(_n(rows, lambda r: r["verdict"] == "consistent"), len(rows))),
    ]


def _of_clean(title: str, rows: Sequence[dict]) -> list[tuple[str, str]]:
    named = _n(rows, lambda row: row["verdict"] != "consistent")
    random = _n(rows, lambda row: any(name in RANDOM for name in row["named"]))
    return [
        (f"{title} in which anything is named", share(named, len(rows))),
        ("... a random effect", share(random, len(rows))),
    ]


def _as_quoted(rows: Sequence[dict]) -> list[tuple[str, str]]:
    """Coverage of what is quoted for J and K, whatever the verdict."""
    if not rows:
        return []
    z = np.abs([row["quoted_z"] for row in rows])
    held = f"{100.0 * np.mean(z < stats.norm.ppf(0.95)):.0f} % of {z.size}"
    return [
        ("... 90 % intervals of J and K, as quoted, that hold the truth", held),
        ("... largest error of J and K, as quoted", f"{z.max():.1f} sd"),
    ]


def _of_its_kind(row: dict) -> bool:
    """Whether what is named enters where the hidden signal does, without a shape as that."""
    sets = [name for names in row["ambiguous_with"] for name in names]
    return SHAPELESS[row["label"]] in (*row["named"], *sets)


def _n(rows: Sequence[dict], counted) -> int:
    return sum(bool(counted(row)) for row in rows if "error" not in row)


def _wrong(row: dict) -> bool:
    return row["verdict"] in ("named", "ambiguous") and not in_a_set(row)


def _as_noise(row: dict) -> bool:
    """Whether the truth is not named, but noise that is correlated in time is listed as dirt."""
    return "coloured" in row["dirt"] and not in_a_set(row)


def _wrong_beside(row: dict) -> bool:
    """Whether the truth is named and something else is too, as sure."""
    sure = [name for name in row["named"] if not any(name in s for s in row["ambiguous_with"])]
    return in_a_set(row) and any(name != row["label"] for name in sure)


def _by_label(rows: Sequence[dict]) -> list[str]:
    table = []
    for row in rows:
        power, times = _size(row)
        size = f"{power:g}, {times:g}" if row["kind"] == "random" else ""
        sets = "; ".join(" or ".join(names) for names in row.get("ambiguous_with", []))
        said = sets or ", ".join(row.get("named", [])) or row.get("source", "")
        table.append((row["label"], size, row.get("verdict", "error"), said))
    columns = (
        "hidden",
        "power, times",
        "verdict",
        "named, or where the nameless shape sits",
        "campaigns",
    )
    counted = [(*row, str(count)) for row, count in sorted(Counter(table).items())]
    return [*table_lines(columns, counted), ""]
