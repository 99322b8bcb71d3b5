"""The page of `import_distortions.py`: results/import_distortions.md from its rows."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from page_table import table_lines

from bayes_inertia.files import write_atomically

# A trusted result further than this from the truth is wrong [quoted sd, the worst of nine].
WRONG = 4.0
# Share of a stream's readings that an import may leave out without a word.
MOST_LOST = 0.05
_LETTERS = 200  # Of a message.
# What every verdict of `doctor` begins with, and says of its sds.
_ALIKE = re.compile(
    r"^(\w+: (wrong|doubtful) |error: )|The data are (impossible|doubtful) under the stated "
    r"conventions[: ]*| \(in sds of [\w ,%]+make\)|, in sds of [\w ,%]+make(?=\))"
)
Row = dict
Rows = Sequence[Row]


def wrong(row: Row) -> bool:
    """Whether a result is trusted, and further from the truth than it may be."""
    return row.get("fit") == "trusted" and row["off"] > WRONG


def unseen(row: Row) -> bool:
    """Whether nothing says that a result is wrong."""
    return wrong(row) and row["doctor"] == "agrees" and not beyond_sight(row)


def beyond_sight(row: Row) -> bool:
    """Whether inertia and momentum are wrong by one factor, which only the prior could tell."""
    return any(words.startswith("wheel all") for words in row["parameters"])


def silent(row: Row) -> bool:
    """Whether readings are lost and nothing says so."""
    return any(
        share > MOST_LOST and not _said(row, holds) for holds, share in row.get("lost", {}).items()
    )


def _said(row: Row, holds: str) -> bool:
    """Whether the import has a note on a stream, or says what of the log is no slew."""
    called = (f"{holds}:", f"{holds.replace('momentum', 'speed')}:", "left out,")
    return any(note.startswith(called) for note in row["notes"])


def outcome(row: Row) -> str:
    """In a few words."""
    if row["traceback"]:
        return "**traceback**"
    if row["status"] != "imported":
        return row["status"]
    if row["doctor"] == "wrong":
        return "refused by doctor"
    doubt = "doubtful, " if row["doctor"] == "doubtful" else ""
    if not wrong(row):
        return f"{doubt}{row['fit']}"
    seen = " within the prior" if beyond_sight(row) else ""
    return f"{doubt}**trusted and wrong{seen}**"


def write_page(path: Path, seed: int) -> Path:
    """The page of rows, one a line."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    rows.sort(key=lambda row: row["case"])
    lines = ["# Distorted raw logs", "", *_introduction(seed), "", *_summary(rows)]
    lines += ["", "## By kind", "", *_by_kind(rows), "", "## Every case", "", *_cases(rows)]
    return write_atomically(path.with_suffix(".md"), "\n".join(lines) + "\n")


def _introduction(seed: int) -> list[str]:
    return [
        f"`python analyses/import_distortions.py` (seed {seed}), then `--page`.",
        "",
        "Each case distorts the raw logs of the example once, or in a third of the cases twice, "
        "with random parameters. Then run `import` (with the mapping that `--start` proposes, or "
        "with that of a user who may not know of the distortion), `doctor`, and what `fit` does "
        f"without sampling. *Wrong* is a trusted fit of which J or K lies more than {WRONG:g} "
        "quoted sds from the truth. *Off* is the largest distance of nine in quoted sds; of the "
        "undistorted log it is 1.6. *Lost* is the largest share of a stream's readings that the "
        "campaign lacks.",
        "",
        "One factor common to the tachometers of all wheels is a factor of J. Within the prior "
        "nothing can tell it but the commands, whose gain may be off as well; such cases are "
        "counted by themselves.",
    ]


def _summary(rows: Rows) -> list[str]:
    count = Counter(outcome(row).replace("*", "") for row in rows)
    failures = {
        "trusted and wrong although doctor agrees": [r for r in rows if unseen(r)],
        "with a traceback": [r for r in rows if r["traceback"]],
        f"without more than {MOST_LOST:.0%} of a stream and no word of it": [
            r for r in rows if silent(r)
        ],
    }
    lines = [f"{len(rows)} cases:", ""]
    for what, found in failures.items():
        which = f" (cases {', '.join(str(r['case']) for r in found)})" if found else ""
        lines.append(f"- **{len(found)} {what}**{which}")
    hidden = [r for r in rows if wrong(r) and beyond_sight(r)]
    if hidden:
        which = ", ".join(str(r["case"]) for r in hidden)
        lines.append(
            f"- {len(hidden)} wrong within the prior (cases {which}): one factor common to "
            "all tachometers is a factor of J, and only the prior and the commands could tell it"
        )
    warned = [r for r in rows if wrong(r) and not unseen(r) and not beyond_sight(r)]
    if warned:
        which = ", ".join(str(r["case"]) for r in warned)
        lines.append(f"- {len(warned)} trusted and wrong after `doctor` doubted (cases {which})")
    told = ", ".join(f"{number} {what}" for what, number in count.most_common())
    return [*lines, "", f"Outcomes: {told}."]


def _by_kind(rows: Rows) -> list[str]:
    kinds = sorted({kind for row in rows for kind in row["kinds"]})
    cells = []
    for kind in kinds:
        of = [row for row in rows if kind in row["kinds"]]
        offs = [row["off"] for row in of if row.get("fit") == "trusted"]
        count = Counter(_stage(row) for row in of)
        numbers = [str(count[stage] or "") for stage in _STAGES]
        cells.append([kind, str(len(of)), *numbers, f"{max(offs):.1f}" if offs else ""])
    return table_lines(("kind (alone or with another)", "cases", *_STAGES, "largest off"), cells)


_STAGES = ("import refuses", "doctor refuses", "fit not trusted", "trusted")


def _stage(row: Row) -> str:
    """What ended the way of a case."""
    if row["status"] != "imported":
        return _STAGES[0]
    if row["doctor"] not in ("agrees", "doubtful"):
        return _STAGES[1]
    return _STAGES[3] if row["fit"] == "trusted" else _STAGES[2]


def _cases(rows: Rows) -> list[str]:
    cells = []
    for row in rows:
        kinds = zip(row["kinds"], row["parameters"], strict=True)
        what = "; ".join(f"{kind}: {words}" if words else kind for kind, words in kinds)
        lost = max(row.get("lost", {}).values(), default=0.0)
        cells.append(
            [
                str(row["case"]),
                f"{what}{' (--start)' if row['started'] else ''}",
                outcome(row),
                f"{row['off']:.1f}" if "off" in row else "",
                f"{lost:.0%}" if lost > MOST_LOST else "",
                _short(_message(row)),
            ]
        )
    head = ("case", "distortion", "outcome", "off", "lost", "what is said first")
    return table_lines(head, cells)


def _message(row: Row) -> str:
    """What a user reads: the refusal, the doubt, else why the fit is not trusted, else notes."""
    if row["status"] != "imported" or row["doctor"] != "agrees":
        return row["message"]
    return "; ".join([*row.get("gates", ()), *row["notes"]])


def _short(text: str) -> str:
    text = _ALIKE.sub("", text).replace("|", "/").replace("*", "\\*")
    return text if len(text) <= _LETTERS else f"{text[:_LETTERS]} ..."
