"""The page of `conventions_study.py`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from conventions_cases import KINDS
from scipy import stats

Row = Mapping[str, Any]


def page(rows: Sequence[Row], missing: Sequence[str]) -> str:
    """The result as Markdown.

    Parameters
    ----------
    rows : sequence of dict
        Of all parts of the study.
    missing : sequence of str
        Folders of others' telemetry that were absent.
    """
    wrong = [row for row in rows if row["part"] == "wrong"]
    right = [row for row in rows if row["part"] == "right"]
    timed = [row for row in rows if row["part"] == "time"]
    seconds = sum(row["seconds"] for row in rows if row["part"] == "cost")
    parts = [
        "# Conventions: named where wrong, silent where right",
        "`python analyses/conventions_study.py` writes this page. A wrong convention counts as "
        "named if the first change that `doctor` proposes mends it, key and value. Which campaigns "
        "can show it was reasoned beforehand; the reasons and the exact equivalences stand in "
        "`conventions_wrong.py`.",
    ]
    if missing:
        parts.append(f"Left out, because the telemetry is not at hand: {', '.join(missing)}.")
    parts += [
        "## Wrong conventions that the data can show",
        _shown(wrong),
        _failures(wrong),
        "## Wrong conventions that the data cannot show",
        "All these campaigns are consistent, and none may be accused.",
        _hidden(wrong),
        "## Right campaigns",
        _right(right),
        "## Processor time",
        _seconds(wrong + right, timed, seconds),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rule = "|".join(["---"] * len(header))
    rows = (" | ".join(line) for line in lines)
    return "\n".join([f"| {' | '.join(header)} |", f"|{rule}|", *(f"| {row} |" for row in rows)])


def _interval(named: int, of: int) -> str:
    """A share with its 95 % interval (Clopper and Pearson)."""
    low, high = stats.binomtest(named, of).proportion_ci(0.95)
    return f"{named} of {of} ({100 * low:.1f} to {100 * high:.1f} %)"


def _shown(wrong: Sequence[Row]) -> str:
    shown = [row for row in wrong if row["shown"]]
    lines = []
    for name in dict.fromkeys(row["convention"] for row in shown):
        of_name = [row for row in shown if row["convention"] == name]
        cells = [_cell([row for row in of_name if row["kind"] == kind]) for kind in KINDS]
        named = sum(row["named"] for row in of_name)
        lines.append([name, *cells, _interval(named, len(of_name))])
    of_kind = [[row for row in shown if row["kind"] == kind] for kind in KINDS]
    cells = [
        _interval(sum(r["named"] for r in rows), len(rows)) if rows else "" for rows in of_kind
    ]
    total = _interval(sum(row["named"] for row in shown), len(shown))
    lines.append(["**all**", *cells, f"**{total}**"])
    beside = sum(row["named"] and not row["alone"] for row in shown)
    note = f"Another change stood beside a single one that is enough in {beside} cases."
    return _table(["wrong convention", *KINDS, "all, 95 % interval"], lines) + f"\n\n{note}"


def _cell(rows: Sequence[Row]) -> str:
    return f"{sum(row['named'] for row in rows)} / {len(rows)}" if rows else ""


def _failures(wrong: Sequence[Row]) -> str:
    failed = [row for row in wrong if row["shown"] and not row["named"]]
    if not failed:
        return ""
    lines = [
        [row["convention"], row["kind"], row["campaign"], row["verdict"], _changes(row)]
        for row in failed
    ]
    header = ["not named", "kind", "campaign", "verdict", "proposed instead"]
    return _table(header, lines)


def _changes(row: Row) -> str:
    return "; ".join(f"`{c['key']}`" for c in row.get("changes", ())) or "nothing"


def _hidden(wrong: Sequence[Row]) -> str:
    lines = []
    hidden = [row for row in wrong if not row["shown"]]
    for name in dict.fromkeys(row["convention"] for row in hidden):
        of_name = [row for row in hidden if row["convention"] == name]
        quiet = sum(row["verdict"] == "consistent" for row in of_name)
        lines.append([name, of_name[0]["why"], f"{quiet} of {len(of_name)}"])
    return _table(["wrong convention", "why not", "not accused"], lines)


def _right(right: Sequence[Row]) -> str:
    lines = []
    for group in dict.fromkeys(row["group"] for row in right):
        of_group = [row for row in right if row["group"] == group]
        accused = [row for row in of_group if row["verdict"] != "consistent"]
        lines.append([group, str(len(of_group)), str(len(accused))])
    accused = [row for row in right if row["verdict"] != "consistent"]
    total = _interval(len(accused), len(right))
    lines.append(["**all**", str(len(right)), f"**{total}**"])
    table = _table(["group", "campaigns", "accused"], lines)
    cases = [
        [row["group"], row["kind"], row["campaign"], row["verdict"], _changes(row)]
        for row in accused
    ]
    header = ["group", "kind", "accused campaign", "verdict", "proposed"]
    return table + (f"\n\n{_table(header, cases)}" if cases else "")


def _seconds(judged: Sequence[Row], timed: Sequence[Row], seconds: float) -> str:
    def of(rows: Sequence[Row], what: Callable[[np.ndarray], Any]) -> str:
        return f"{float(what(np.array([row['seconds'] for row in rows]))):.2f}"

    lines = [["the check in Python", str(len(judged)), of(judged, np.median), of(judged, np.max)]]
    for command in dict.fromkeys(row["command"] for row in timed):
        rows = [row for row in timed if row["command"] == command]
        name = f"`bayes-inertia {command}` as a process, five slews"
        lines.append([name, str(len(rows)), of(rows, np.median), of(rows, np.max)])
    table = _table(["", "calls", "median [s]", "largest [s]"], lines)
    return f"{table}\n\nThe whole study took {seconds / 60.0:.0f} minutes of processor time."
