"""Text files: bytes as rows of cells, each with its line, and the form of the cells."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import refused_by_system
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.table import is_empty, number_of
from bayes_inertia.tables.time_texts import is_date

WHITESPACE = "whitespace"
COMMENTS = ("#", "%", "//")
_CONTROL = re.compile("[\x01-\x08\x0e-\x19\x1b-\x1f]")  # Signs of a binary file.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


_PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bz2", b"\xfd7zXZ": "lzma"}


def packing(path: Path) -> str:
    """The module that unpacks a file; "" for one that is not packed."""
    with (
        refused_by_system(CampaignError, "cannot be opened", path, "check the path"),
        path.open("rb") as file,
    ):
        start = file.read(max(map(len, _PACKED)))
    return next((name for mark, name in _PACKED.items() if start.startswith(mark)), "")


def content(path: Path, first: int = -1) -> bytes:
    """All or the first bytes of a log, out of a gzip, bzip2 or xz archive where it is one."""
    packed = packing(path)
    most = LIMITS.most_content + 1 if packed and first < 0 else first
    advice = "check that it is a readable file, whole if it is packed"
    with refused_by_system(CampaignError, "cannot be read", path, advice):
        try:
            with import_module(packed or "io").open(path, "rb") as file:
                data: bytes = file.read(most)
        except OSError:
            raise
        except Exception as error:  # Each of the three modules has errors of its own.
            raise OSError(f"damaged: {error}") from error
        if len(data) > LIMITS.most_content and packed:
            raise OSError(f"unpacked it has more than {LIMITS.most_content / 2**30:.0f} GiB")
    return data


class CellRow(NamedTuple):  # A log has a million of them: a dataclass takes twice the time.
    """The line (from 1) where a row of a text starts, and its cells without white space around."""

    line: int
    cells: tuple[str, ...]


def decoded(data: bytes, label: str) -> str:
    """The text of a file without byte-order mark; its encoding is told from its bytes."""
    text = _text_of(data, label, "")
    if "\0" in text:
        raise _zero_bytes(lines_in(text), label)
    return text


def whole_lines(data: bytes, label: str, encoding: str = "") -> tuple[str, tuple[str, ...]]:
    """The text of a file without lines that a loss of power cut, and notes that say so.

    A logger that loses power leaves NUL bytes where its last lines were to stand. Lines with zero
    bytes become empty, so that the others keep their numbers.

    >>> whole_lines(b"t,w\\n0,1\\n1,2\\n2,\\0\\0", "a.csv")
    ('t,w\\n0,1\\n1,2\\n', ('NUL bytes in line 4 (a loss of power?): 1 line cut left out',))
    """
    text = _text_of(data, label, encoding)
    if "\0" not in text:
        return text, ()
    lines = lines_in(text)
    zeros = [number for number, line in enumerate(lines, start=1) if "\0" in line]
    cut = [number for number in zeros if lines[number - 1].strip("\0 \t")]
    kept = ["" if "\0" in line else line for line in lines]
    whole = sum(bool(line.strip()) for line in kept)
    damaged = not whole or len(cut) > max(LIMITS.most_cut_lines, whole // 20)
    if damaged or _CONTROL.search("".join(kept)):
        raise _zero_bytes(lines, label)
    where = f"line{'s' * (len(zeros) > 1)} {', '.join(map(str, zeros[:5]))}"
    gone = f"{len(cut)} line{'s' * (len(cut) > 1)} cut left out" if cut else "left out"
    more = f" and {len(zeros) - 5} more" if len(zeros) > 5 else ""
    return "\n".join(kept), (f"NUL bytes in {where}{more} (a loss of power?): {gone}",)


def _zero_bytes(lines: Sequence[str], label: str) -> CampaignError:
    """The refusal of a file with NUL bytes."""
    first = next(number for number, line in enumerate(lines, start=1) if "\0" in line)
    if not "".join(lines).strip("\0 \t"):
        what = "holds nothing but NUL bytes"
        advice = "the logger lost power before it wrote: take another copy, or leave it out"
        return CampaignError(what, where=label, advice=advice)
    what = "NUL bytes: no text, or a logger that lost power"
    advice = "a text: take the NUL bytes and the lines that they cut out; another format: give the "
    advice += "file its suffix, or export it as CSV"
    return CampaignError(what, where=f"{label}, line {first}", advice=advice)


def _text_of(data: bytes, label: str, encoding: str) -> str:
    """The text of a file, NUL bytes too, without byte-order mark; an encoding "" is told."""
    chosen = encoding or _encoding(data)
    try:
        # Files that were put together have several marks.
        return data.decode(chosen).replace("\ufeff", "")
    except (UnicodeError, LookupError) as error:
        what = f"cannot be read as {chosen} text"
        advice = "export it again as UTF-8, or state another encoding"
        raise CampaignError(what, where=label, advice=advice) from error


def _encoding(data: bytes) -> str:
    for mark, name in _MARKS:
        if data.startswith(mark):
            return name
    # No text of UTF-16 holds four NUL bytes in a row; a logger that lost power leaves them.
    head = re.sub(rb"\0{4,}", b"", data[: LIMITS.encoding_sample_bytes])[:4000]
    for half, name in ((head[1::2], "utf-16-le"), (head[::2], "utf-16-be")):
        if len(head) >= 4 and half.count(0) > 0.4 * len(half):
            return name
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252" if not set(data) & {0x81, 0x8D, 0x8F, 0x90, 0x9D} else "latin-1"
    return "utf-8"


def lines_in(text: str) -> list[str]:
    """The lines of a text, as editors count them: they end with CR LF, LF or CR."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def content_lines(
    text: str, signs: tuple[str, ...] = COMMENTS
) -> tuple[list[tuple[int, str]], dict[int, str]]:
    """Lines that hold cells, each with its number from 1, and comments by number without sign."""
    lines, comments = [], {}
    for number, line in enumerate(lines_in(text), start=1):
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
    """Lines cut into cells; a quoted cell may hold the delimiter and span lines."""
    if delimiter == WHITESPACE:
        for number, line in lines:
            yield CellRow(number, tuple(line.replace('"', " ").split()))
        return
    if not any('"' in line for _, line in lines):
        for number, line in lines:
            cells = line.split(delimiter)
            # All white space but the blank is not printable.
            bare = " " not in line and line.isprintable()
            yield CellRow(number, tuple(cells if bare else map(str.strip, cells)))
        return
    written, first = (f"{line}\n" for _, line in lines), 0
    reader = csv.reader(written, delimiter=delimiter, strict=True, skipinitialspace=True)
    try:
        for cells in reader:
            yield CellRow(lines[first][0], tuple([cell.strip() for cell in cells]))
            first = reader.line_num
    except csv.Error as error:
        what = f"the cells cannot be told apart ({error})"
        where = f"{label}, line {lines[first][0]}"
        advice = "close every quote, or remove the quotes"
        raise CampaignError(what, where=where, advice=advice) from error


_DELIMITERS = ("\t", ";", ",", "|", WHITESPACE)
# A table of one column is the last resort: every file is one by some delimiter. White space comes
# after signs, for it takes the empty cells of a table with tabs away.
_TRUST = {WHITESPACE: 0.8}
# Not a whole row that a time begins.
_ZONE = r"(\s?[A-Za-z]{1,4})?([+-]\d\d:?\d\d)?"
_TIME = re.compile(
    rf"\d{{4}}[-/]\d{{1,3}}([-/]\d{{1,2}})?[T ]\d[\d:]*([.,]\d*)?{_ZONE}|"
    rf"\d{{1,3}}:\d{{2}}(:\d{{2}}([.,]\d*)?{_ZONE})?"
)


@dataclass(frozen=True)
class TextOptions:
    """Form of a text file as a mapping states it; everything else is recognised from the file."""

    # What separates cells, such as ";", "\\t" or "whitespace"; "" to tell from the file
    delimiter: str = ""
    decimal: str = ""  # "." or ","; "" to tell from the file
    encoding: str = ""  # Such as "latin-1"; "" to tell from the file
    comment: str = ""  # What a comment row begins with; "" for "#" and "%"
    # Line of the column names, from 1; 0 to tell from the file, -1 for a file without names, whose
    # columns are then called c1, c2, ...
    header_line: int = 0
    units_line: int = 0  # Line of the units, from 1; 0 to tell from the file, -1 for none


class TextForm(NamedTuple):
    """How the rows of a text are written."""

    delimiter: str  # What separates cells: a character, or "whitespace"
    decimal: str  # The decimal sign
    width: int = 0  # The usual number of cells; 0 where it is not known yet


def is_reading(cell: str, decimal: str) -> bool:
    """Whether a cell holds a number or a time; an empty one does not."""
    if number_of(cell, decimal) == number_of(cell, decimal):
        return not (decimal == "," and "." in cell and "," in cell)
    return bool(_TIME.fullmatch(cell)) or is_date(cell)


def told_form(lines: Sequence[tuple[int, str]], options: TextOptions, label: str) -> TextForm:
    """Separator of a file's cells: the one that gives most rows of one length with readings."""
    middle = max(len(lines) - LIMITS.sample_rows, 0) // 2
    sample = list(lines[:10]) + list(lines[max(middle, 10) : middle + LIMITS.sample_rows])
    best, best_score = TextForm(",", "."), -1.0
    for delimiter in [options.delimiter] if options.delimiter else _DELIMITERS:
        try:
            rows = [row.cells for row in split_rows(sample, delimiter, label)]
        except CampaignError:  # A quote that is not closed: the reading itself will say where.
            rows = [tuple(line.split(delimiter)) for _, line in sample]
        for decimal in [options.decimal] if options.decimal else (".", ","):
            of_width = 1.0 if usual_width(rows) > 1 else LIMITS.trust_in_one_column
            score = _TRUST.get(delimiter, 1.0) * of_width * _score(rows, decimal)
            if score > best_score + 1e-9:
                best, best_score = TextForm(delimiter, decimal), score
    return best


def usual_width(rows: Sequence[tuple[str, ...]]) -> int:
    """The most common number of cells."""
    lengths = [len(cells) for cells in rows]
    return max(set(lengths), key=lengths.count, default=0)


def _score(rows: Sequence[tuple[str, ...]], decimal: str) -> float:
    """Score of rows as a table: of one length, and with readings in the lower half."""
    width = usual_width(rows)
    regular = [cells for cells in rows if len(cells) == width]
    cells = [cell for row in regular[len(regular) // 2 :] for cell in row]
    full = [cell for cell in cells if not is_empty(cell)]
    readings = sum(is_reading(cell, decimal) for cell in full) / max(len(full), 1)
    return readings * len(regular) / max(len(rows), 1)
