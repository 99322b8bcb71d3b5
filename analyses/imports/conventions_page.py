"""The page of `conventions.py`, from its rows.

    python -m analyses.imports.conventions_page

writes `results/imports/conventions.md` from `results/imports/conventions.json` anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from analyses import results_of
from analyses.imports.conventions_cases import KINDS
from analyses.pages.table import table_lines
from bayes_inertia.files import write_atomically

Row = Mapping[str, Any]
ROWS, PAGE = (results_of(__file__) / f"conventions.{kind}" for kind in ("json", "md"))
# Telemetry of others, and how the names of its campaigns begin.
_OTHERS = {"thrown bodies": "real", "the other simulator": "Basilisk"}
DIRTY = "dirty, "


def page(rows: Sequence[Row]) -> str:
    """The result as Markdown."""
    spoilt = [row for row in rows if row["part"] == "wrong"]
    dirty = [row for row in spoilt if row["campaign"].startswith(DIRTY)]
    wrong = [row for row in spoilt if not row["campaign"].startswith(DIRTY)]
    right = [row for row in rows if row["part"] == "right"]
    timed = [row for row in rows if row["part"] == "time"]
    seconds = sum(row["seconds"] for row in rows if row["part"] == "cost")
    parts = [
        "# Wrong conventions",
        "`python -m analyses.imports.conventions` measures and "
        "`analyses/imports/conventions_page.py` writes "
        "this page. A wrong convention counts as "
        "named if the first change that `doctor` proposes mends it, key and value. Which campaigns "
        "can show it was reasoned beforehand; the reasons and the exact equivalences stand in "
        "`conventions_wrong.py`.",
        _missing(rows),
        "## Wrong conventions that the data can show",
        _shown(wrong),
        _failures(wrong),
        "## Wrong conventions beside dirt",
        _beside_dirt(dirty),
        "## Wrong conventions that the data cannot show",
        "All these campaigns are consistent, and none may be accused.",
        _hidden(wrong),
        "## Right campaigns",
        _right(right),
        "## Processor time",
        _seconds(spoilt + right, timed, seconds),
        _versions(spoilt, right, timed),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _missing(rows: Sequence[Row]) -> str:
    names = [row.get("campaign", "") for row in rows]
    absent = [
        what for what, begin in _OTHERS.items() if not any(name.startswith(begin) for name in names)
    ]
    return f"Left out, because the telemetry is not at hand: {', '.join(absent)}." if absent else ""


def _beside_dirt(dirty: Sequence[Row]) -> str:
    """One line a dirt: how many of the wrong conventions are named although it is there."""
    if not dirty:
        return "Not measured."
    lines = []
    for campaign in dict.fromkeys(row["campaign"] for row in dirty):
        lines.append([campaign.removeprefix(DIRTY), *_counts(dirty, campaign)])
    lines.append(["**all**", *_counts(dirty, "")])
    header = ["dirt", "named", "not accused, of those that the data cannot show"]
    text = "Spacecraft drawn at random; `conventions_faults.py` says what each dirt is."
    failures = _failures(dirty)
    return "\n\n".join([text, _table(header, lines), *([failures] if failures else [])])


def _counts(dirty: Sequence[Row], campaign: str) -> list[str]:
    rows = [row for row in dirty if campaign in ("", row["campaign"])]
    shown = [row for row in rows if row["shown"]]
    hidden = [row for row in rows if not row["shown"]]
    quiet = sum(row["verdict"] == "consistent" for row in hidden)
    named = sum(row["named"] for row in shown)
    said = f"{named} / {len(shown)}" if campaign else f"**{_interval(named, len(shown))}**"
    return [said, f"{quiet} / {len(hidden)}"]


def _versions(spoilt: Sequence[Row], right: Sequence[Row], timed: Sequence[Row]) -> str:
    """With which version of the package each part was measured."""
    dirty = [row for row in spoilt if row["campaign"].startswith(DIRTY)]
    groups = {
        "wrong conventions": [row for row in spoilt if row not in dirty],
        "beside dirt": dirty,
        "right campaigns": right,
        "processes": timed,
    }
    lines = []
    for name, rows in groups.items():
        versions = dict.fromkeys(row.get("version", "unknown") for row in rows)
        counts = {v: sum(row.get("version", "unknown") == v for row in rows) for v in versions}
        lines.append([name, ", ".join(f"{v} ({n})" for v, n in counts.items())])
    return _table(["part", "measured with version (rows)"], lines)


def short(row: Row) -> dict[str, Any]:
    """The row without what is empty, and without proposed values that are right."""
    kept = {key: value for key, value in row.items() if value not in ("", [])}
    if kept.get("named"):
        kept["changes"] = [{"key": change["key"]} for change in kept["changes"]]
    return kept


def merged(old: Iterable[Row], new: Iterable[Row]) -> list[Row]:
    """All rows; of two of the same case the newer one."""
    rows: dict[tuple, Row] = {}
    for row in (*old, *new):
        rows[_case(row)] = row
    return list(rows.values())


def _case(row: Row) -> tuple:
    """What a row is about; calls of one command are told apart by their number."""
    names = ("part", "convention", "group", "kind", "campaign", "command", "number", "piece")
    return tuple(row.get(name, "") for name in names)


def write_page(rows: Sequence[Row]) -> None:
    """Store the rows and write the page from them."""
    content = ",\n".join(json.dumps(short(row)) for row in rows)
    write_atomically(ROWS, f"[{content}]\n")
    write_atomically(PAGE, page(rows))


def _table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(table_lines(header, lines))


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
        lines.append([group, str(len(of_group)), *(str(n) for n in _not_consistent(of_group))])
    totals = (f"**{_interval(number, len(right))}**" for number in _not_consistent(right))
    lines.append(["**all**", str(len(right)), *totals])
    table = _table(["group", "campaigns", "called wrong", "called doubtful"], lines)
    cases = [
        [row["group"], row["kind"], row["campaign"], row["verdict"], _changes(row)]
        for row in right
        if row["verdict"] != "consistent"
    ]
    header = ["group", "kind", "campaign", "verdict", "proposed"]
    return table + (f"\n\n{_table(header, cases)}" if cases else "")


def _not_consistent(rows: Sequence[Row]) -> tuple[int, int]:
    """How many are called wrong (or refused, or crash), and how many doubtful."""
    doubtful = sum(row["verdict"] == "doubtful" for row in rows)
    return sum(row["verdict"] != "consistent" for row in rows) - doubtful, doubtful


def _seconds(judged: Sequence[Row], timed: Sequence[Row], seconds: float) -> str:
    def of(rows: Sequence[Row], what: Callable[[np.ndarray], Any]) -> str:
        return f"{float(what(np.array([row['seconds'] for row in rows]))):.2f}"

    lines = [["the check in Python", str(len(judged)), of(judged, np.median), of(judged, np.max)]]
    for command in dict.fromkeys(row["command"] for row in timed):
        rows = [row for row in timed if row["command"] == command]
        name = f"`bayes-inertia {command}` as a process, five slews"
        lines.append([name, str(len(rows)), of(rows, np.median), of(rows, np.max)])
    table = _table(["", "calls", "median [s]", "largest [s]"], lines)
    return f"{table}\n\nThe study took {seconds / 60.0:.0f} minutes of processor time."


def stored_rows() -> list[Row]:
    """The rows so far; none where there is no file."""
    return json.loads(ROWS.read_text(encoding="utf-8")) if ROWS.exists() else []


if __name__ == "__main__":
    write_page(stored_rows())
