"""How a text file is written: what a mapping states of it, and what its rows tell."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.raw_table import EMPTY_CELLS, number_of
from bayes_inertia.tables.text_cells import WHITESPACE, split_rows
from bayes_inertia.tables.time_texts import is_date

_DELIMITERS = ("\t", ";", ",", "|", WHITESPACE)
_SAMPLE = 200  # Rows by which a file is judged.
# A table of one column is the last resort: every file is one by some delimiter. White space comes
# after signs, for it takes the empty cells of a table with tabs away.
_TRUST = MappingProxyType({WHITESPACE: 0.8})
_ONE_COLUMN = 0.5
# Not a whole row that a time begins.
_ZONE = r"(\s?[A-Za-z]{1,4})?([+-]\d\d:?\d\d)?"
_TIME = re.compile(
    rf"\d{{4}}[-/]\d{{1,3}}([-/]\d{{1,2}})?[T ]\d[\d:]*([.,]\d*)?{_ZONE}|"
    rf"\d{{1,3}}:\d{{2}}(:\d{{2}}([.,]\d*)?{_ZONE})?"
)


@dataclass(frozen=True)
class TextOptions:
    """What a mapping may say of a text file; everything else is told from the file.

    Parameters
    ----------
    delimiter : str, optional
        What separates cells, such as ";", "\\t" or "whitespace"; "" to tell from the file.
    decimal : str, optional
        "." or ","; "" to tell from the file.
    encoding : str, optional
        Such as "latin-1"; "" to tell from the file.
    comment : str, optional
        What a comment row begins with; "" for "#" and "%".
    header_line : int, optional
        Line of the column names, from 1; 0 to tell from the file, -1 for a file without names,
        whose columns are then called c1, c2, ...
    units_line : int, optional
        Line of the units, from 1; 0 to tell from the file, -1 for none.
    """

    delimiter: str = ""
    decimal: str = ""
    encoding: str = ""
    comment: str = ""
    header_line: int = 0
    units_line: int = 0


class TextForm(NamedTuple):
    """What separates the cells of a text (a character, or "whitespace"), and the decimal sign."""

    delimiter: str
    decimal: str


def is_reading(cell: str, decimal: str) -> bool:
    """Whether a cell holds a number or a time; an empty one does not."""
    if number_of(cell, decimal) == number_of(cell, decimal):
        return not (decimal == "," and "." in cell and "," in cell)
    return bool(_TIME.fullmatch(cell)) or is_date(cell)


def told_form(lines: Sequence[tuple[int, str]], options: TextOptions, label: str) -> TextForm:
    """How a file separates its cells: the way that gives most rows of one length with readings."""
    middle = max(len(lines) - _SAMPLE, 0) // 2
    sample = list(lines[:10]) + list(lines[max(middle, 10) : middle + _SAMPLE])
    best, best_score = TextForm(",", "."), -1.0
    for delimiter in [options.delimiter] if options.delimiter else _DELIMITERS:
        try:
            rows = [row.cells for row in split_rows(sample, delimiter, label)]
        except CampaignError:  # A quote that is not closed: the reading itself will say where.
            rows = [tuple(line.split(delimiter)) for _, line in sample]
        for decimal in [options.decimal] if options.decimal else (".", ","):
            trust = _TRUST.get(delimiter, 1.0) * (1.0 if _width(rows) > 1 else _ONE_COLUMN)
            score = trust * _score(rows, decimal)
            if score > best_score + 1e-9:
                best, best_score = TextForm(delimiter, decimal), score
    return best


def _width(rows: Sequence[tuple[str, ...]]) -> int:
    """The most common number of cells."""
    lengths = [len(cells) for cells in rows]
    return max(set(lengths), key=lengths.count, default=0)


def _score(rows: Sequence[tuple[str, ...]], decimal: str) -> float:
    """How well rows look like a table: of one length, and with readings in the lower half."""
    width = _width(rows)
    regular = [cells for cells in rows if len(cells) == width]
    cells = [cell for row in regular[len(regular) // 2 :] for cell in row]
    if not rows:
        return 0.0
    full = [cell for cell in cells if cell.lower() not in EMPTY_CELLS]
    readings = sum(is_reading(cell, decimal) for cell in full) / max(len(full), 1)
    return readings * len(regular) / len(rows)
