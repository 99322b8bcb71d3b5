"""The page of `dirt_study.py`: results/dirt_study.md from its rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from page_table import table_lines

from bayes_inertia.files import write_atomically

# A trusted result further than this from the truth is wrong [quoted sd, the worst of nine].
WRONG = 3.5
_TITLES = {
    "table": "Every kind of dirt alone",
    "random": "Random combinations of dirt",
    "uncleaned": "Negative control: the same without cleaning",
    "hidden": "A missing physical effect, alone and with dirt",
    "throws": "Thrown bodies, real telemetry (truth known to 1 %)",
    "diagnose": "The package's own `diagnose`",
    "fit": "The package's own `fit`",
}
_COLUMNS = ("case", "result", "policy", "dirt said", "shift", "abs z", "sd", "CPU s")

Rows = Sequence[dict]


def wrong(row: dict) -> bool:
    """Whether a result is trusted and further from the truth than it may be."""
    return row["status"] == "trusted" and row["z"] is not None and row["z"] > WRONG


def write_page(parts: dict[str, list[dict]], path: Path) -> Path:
    """All parts that have rows."""
    lines = ["# Faults in telemetry", "", *_INTRODUCTION]
    for name, title in _TITLES.items():
        if rows := parts.get(name):
            earlier = {row["case"]: row for row in parts.get(f"{name}.before", ())}
            lines += ["", f"## {title}", "", _summary(rows), *_section(name, rows, earlier)]
    return write_atomically(path, "\n".join(lines) + "\n")


_INTRODUCTION = (
    "`python analyses/dirt_study.py table random uncleaned hidden diagnose fit --work FOLDER`, "
    "then `page`.",
    "",
    "Each case is a campaign folder whose tables were made dirty. *shift*: the largest of the nine "
    "elements of J and K against the fit of the clean twin, in quoted sds (the larger of both "
    "fits). *abs z*: the largest distance from the truth in quoted sds; of nine right Gaussian "
    f"numbers one is beyond {WRONG} in 0.4 % of campaigns. *sd*: how much wider the sds became "
    "(median). *policy*: what happened to the dirt: an error with its row, masked, modelled, "
    "recorded only, or silent. Numbers are of the Laplace estimate with all gates but that of the "
    "chains, unless the part is `diagnose` or `fit`.",
)


def _summary(rows: Rows) -> str:
    """In one line: how many of what."""
    status = Counter(row["status"] for row in rows)
    bad = [row["case"] for row in rows if wrong(row)]
    seconds = sum(row["seconds"] for row in rows)
    counts = ", ".join(f"{count} {name}" for name, count in status.most_common())
    said = f"**{len(bad)} trusted and wrong**" + (f" ({'; '.join(bad)})" if bad else "")
    return f"{len(rows)} cases: {counts}; {said}; {seconds:.0f} s of processor time."


def _section(name: str, rows: Rows, earlier: dict[str, dict]) -> list[str]:
    """The table of a part; of the random ones the extremes and the reasons only."""
    shown = _extreme(rows) if name in ("random", "uncleaned") else rows
    extra = {
        "before": lambda row: _result(earlier[row["case"]]) if row["case"] in earlier else "",
        "verdict": lambda row: " ".join([row["verdict"], *row["named"]]),
    }
    wanted = (["before"] if earlier else []) + (["verdict"] if name == "diagnose" else [])
    cells = [[*_cells(row), *(extra[key](row) for key in wanted)] for row in shown]
    head = ["", *_by_reason(rows)] if shown is not rows else []
    return [*head, "", *table_lines((*_COLUMNS, *wanted), cells)]


def _cells(row: dict) -> list[str]:
    result = _result(row)
    return [
        row["case"],
        f"{result}: {_short(row['says'])}" if row["says"] else result,
        row["policy"],
        _short(", ".join(row["dirt"])),
        *(_number(row[key]) for key in ("shift", "z", "widened")),
        f"{row['seconds']:.1f}",
    ]


def _result(row: dict) -> str:
    """Trusted, untrusted, error or crash; with its distance where it is wrong."""
    return f"**trusted and wrong ({row['z']:.1f})**" if wrong(row) else row["status"]


def _short(text: str, limit: int = 110) -> str:
    return text.replace("|", "/") if len(text) <= limit else text[:limit].replace("|", "/") + "..."


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _by_reason(rows: Rows) -> list[str]:
    """Why results are not trusted, by kind of dirt."""
    refused = [row for row in rows if row["status"] != "trusted"]
    kinds = Counter(kind for row in refused for kind in row["kinds"])
    tried = Counter(kind for row in rows for kind in row["kinds"])
    cells = [[kind, f"{kinds[kind]} of {tried[kind]}"] for kind in sorted(tried)]
    return table_lines(("kind (alone or with others)", "not trusted"), cells)


def _extreme(rows: Rows) -> list[dict]:
    """The trusted results furthest from the truth."""
    trusted = [row for row in rows if row["status"] == "trusted"]
    return sorted(trusted, key=lambda row: -row["z"])[:15]
