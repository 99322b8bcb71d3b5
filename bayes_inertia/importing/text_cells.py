"""Bytes of a text file as rows of cells, each with its line; encoding and delimiter are told."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.raw_table import EMPTY_CELLS, number_of
from bayes_inertia.importing.text_options import TextOptions
from bayes_inertia.importing.time_texts import is_date

WHITESPACE = "whitespace"
_DELIMITERS = ("\t", ";", ",", "|", WHITESPACE)
_SAMPLE = 200  # Rows by which a file is judged.
_COMMENTS = ("#", "%", "//")
_TIME = re.compile(r"\d{4}[-/]\d{1,3}([-/]\d{1,2})?[T ]\d.*|\d{1,3}:\d{2}(:\d{2}.*)?")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


class CellRow(NamedTuple):  # A log has a million of them: a dataclass takes twice the time.
    """One row of a text file.

    Parameters
    ----------
    line : int
        The line where it starts, from 1.
    cells : tuple of str
        Its cells without white space around them.
    """

    line: int
    cells: tuple[str, ...]


@dataclass(frozen=True)
class TextForm:
    """How a text file separates its cells.

    Parameters
    ----------
    delimiter : str
        One character, or "whitespace".
    decimal : str
        "." or ",".
    """

    delimiter: str
    decimal: str


def decoded(data: bytes, label: str, encoding: str = "") -> str:
    """The text of a file.

    Parameters
    ----------
    data : bytes
        The file's content.
    label : str
        The file, as messages name it.
    encoding : str, optional
        "" to tell from the content: by its mark, as UTF-16 by its zero bytes, as UTF-8, else as
        Windows-1252.

    Returns
    -------
    str
        The text without a byte-order mark.

    Raises
    ------
    CampaignError
        If it is no text.

    Examples
    --------
    >>> decoded("t;°/s".encode("utf-16-le"), "a.csv"), decoded("t;°/s".encode("latin-1"), "a.csv")
    ('t;°/s', 't;°/s')
    """
    chosen = encoding or _encoding(data)
    try:
        text = data.decode(chosen)
    except (UnicodeError, LookupError) as error:
        raise CampaignError(
            f"cannot be read as {chosen} text",
            where=label,
            advice="export it again as UTF-8, or state another encoding",
        ) from error
    if "\0" in text:
        raise CampaignError(
            "is no text: it holds zero bytes",
            where=label,
            advice="give the file the suffix of its format, or export it as CSV",
        )
    return text.removeprefix("\ufeff")


def _encoding(data: bytes) -> str:
    for mark, name in _MARKS:
        if data.startswith(mark):
            return name
    head = data[:4000]
    if len(head) >= 4 and len(head[1::2]) and head[1::2].count(0) > 0.4 * len(head[1::2]):
        return "utf-16-le"
    if len(head) >= 4 and head[::2].count(0) > 0.4 * len(head[::2]):
        return "utf-16-be"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252" if not set(data) & {0x81, 0x8D, 0x8F, 0x90, 0x9D} else "latin-1"
    return "utf-8"


def content_lines(text: str, comment: str = "") -> tuple[list[tuple[int, str]], dict[int, str]]:
    """Lines that hold cells, and comments, each with its number.

    Parameters
    ----------
    text : str
        The text of the file.
    comment : str, optional
        What a comment begins with; "" for "#", "%" and "//".

    Returns
    -------
    lines : list of (int, str)
        Number from 1, and the line.
    comments : dict of int to str
        Comments by their number, without their sign.
    """
    signs = (comment,) if comment else _COMMENTS
    lines, comments = [], {}
    for number, line in enumerate(re.split("\r\n|\n|\r", text), start=1):
        stripped = line.strip()
        if not stripped:
            continue
        if stripped.startswith(signs):
            sign = next(sign for sign in signs if stripped.startswith(sign))
            comments[number] = stripped.lstrip(sign).strip()
        else:
            lines.append((number, line))
    return lines, comments


def split_rows(
    lines: Sequence[tuple[int, str]], delimiter: str, label: str = ""
) -> Iterator[CellRow]:
    """Lines cut into cells; a quoted cell may hold the delimiter and span lines.

    Parameters
    ----------
    lines : sequence of (int, str)
        Number and text.
    delimiter : str
        One character, or "whitespace".
    label : str, optional
        The file, as messages name it.

    Yields
    ------
    CellRow
        One for each row.

    Raises
    ------
    CampaignError
        If a quote is not closed.
    """
    if delimiter == WHITESPACE:
        for number, line in lines:
            yield CellRow(number, tuple(line.replace('"', " ").split()))
        return
    if not any('"' in line for _, line in lines):
        for number, line in lines:
            yield CellRow(number, tuple(map(str.strip, line.split(delimiter))))
        return
    taken: list[int] = []

    def feed() -> Iterator[str]:
        for number, line in lines:
            taken.append(number)
            yield line + "\n"

    reader = csv.reader(feed(), delimiter=delimiter, strict=True, skipinitialspace=True)
    try:
        for cells in reader:
            yield CellRow(taken[0], tuple([cell.strip() for cell in cells]))
            taken.clear()
    except csv.Error as error:
        raise CampaignError(
            f"the cells cannot be told apart ({error})",
            where=f"{label}, line {taken[0] if taken else 1}",
            advice="close every quote, or remove the quotes",
        ) from error


def is_reading(cell: str, decimal: str) -> bool:
    """Whether a cell holds a number or a time.

    Parameters
    ----------
    cell : str
        The cell.
    decimal : str
        The decimal sign.

    Returns
    -------
    bool
        False for an empty cell too.
    """
    if number_of(cell, decimal) == number_of(cell, decimal):
        return not (decimal == "," and "." in cell and "," in cell)
    return bool(_TIME.fullmatch(cell)) or is_date(cell)


def told_form(lines: Sequence[tuple[int, str]], options: TextOptions, label: str) -> TextForm:
    """How a file separates its cells: the way that gives most rows of one length with readings.

    Parameters
    ----------
    lines : sequence of (int, str)
        The lines that hold cells.
    options : TextOptions
        What the mapping states.
    label : str
        The file, as messages name it.

    Returns
    -------
    TextForm
        Delimiter and decimal sign.
    """
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


# A table of one column is the last resort: every file is one by some delimiter. White space comes
# after signs, for it takes the empty cells of a table with tabs away.
_TRUST = MappingProxyType({WHITESPACE: 0.8})
_ONE_COLUMN = 0.5
