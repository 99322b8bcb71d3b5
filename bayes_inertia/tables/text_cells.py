"""Bytes of a text file as rows of cells, each with its line."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from bayes_inertia.errors import CampaignError

WHITESPACE = "whitespace"
_SAMPLE_BYTES = 2**20  # By which an encoding is told.
COMMENTS = ("#", "%", "//")
_LINE_END = re.compile("\r\n|\n|\r")
_MOST_CUT = 3  # Lines that losses of power may cut in a short file; in a long one, every 20th.
_CONTROL = re.compile("[\x01-\x08\x0e-\x19\x1b-\x1f]")  # Signs of a binary file.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


class CellRow(NamedTuple):  # A log has a million of them: a dataclass takes twice the time.
    """The line (from 1) where a row of a text starts, and its cells without white space around."""

    line: int
    cells: tuple[str, ...]


def decoded(data: bytes, label: str, encoding: str = "") -> str:
    """The text of a file without byte-order mark; an encoding "" is told from its content.

    By its mark, as UTF-16 by its NUL bytes, as UTF-8, else as Windows-1252.

    Examples
    --------
    >>> decoded("t;°/s".encode("utf-16-le"), "a.csv"), decoded("t;°/s".encode("latin-1"), "a.csv")
    ('t;°/s', 't;°/s')
    """
    text = _text_of(data, label, encoding)
    if "\0" in text:
        raise _zero_bytes(_LINE_END.split(text), label)
    return text


def whole_lines(data: bytes, label: str, encoding: str = "") -> tuple[str, tuple[str, ...]]:
    """The text of a file without lines that a loss of power cut, and notes that say so.

    A logger that loses power leaves NUL bytes where its last lines were to stand. Lines with zero
    bytes become empty, so that the others keep their numbers.

    Examples
    --------
    >>> whole_lines(b"t,w\\n0,1\\n1,2\\n2,\\0\\0", "a.csv")
    ('t,w\\n0,1\\n1,2\\n', ('NUL bytes in line 4 (a loss of power?): 1 line cut left out',))
    """
    text = _text_of(data, label, encoding)
    if "\0" not in text:
        return text, ()
    lines = _LINE_END.split(text)
    zeros = [number for number, line in enumerate(lines, start=1) if "\0" in line]
    cut = [number for number in zeros if lines[number - 1].strip("\0 \t")]
    kept = ["" if "\0" in line else line for line in lines]
    whole = sum(bool(line.strip()) for line in kept)
    if len(cut) > max(_MOST_CUT, whole // 20) or not whole or _CONTROL.search("".join(kept)):
        raise _zero_bytes(lines, label)
    where = f"line{'s' * (len(zeros) > 1)} {', '.join(map(str, zeros[:5]))}"
    gone = f"{len(cut)} line{'s' * (len(cut) > 1)} cut left out" if cut else "left out"
    more = f" and {len(zeros) - 5} more" if len(zeros) > 5 else ""
    return "\n".join(kept), (f"NUL bytes in {where}{more} (a loss of power?): {gone}",)


def _zero_bytes(lines: Sequence[str], label: str) -> CampaignError:
    """The refusal of a file with NUL bytes."""
    first = next(number for number, line in enumerate(lines, start=1) if "\0" in line)
    if not "".join(lines).strip("\0 \t"):
        return CampaignError(
            "holds nothing but NUL bytes",
            where=label,
            advice="the logger lost power before it wrote: take another copy, or leave it out",
        )
    return CampaignError(
        "NUL bytes: no text, or a logger that lost power",
        where=f"{label}, line {first}",
        advice="a text: take the NUL bytes and the lines that they cut out; another format: give "
        "the file its suffix, or export it as CSV",
    )


def _text_of(data: bytes, label: str, encoding: str) -> str:
    """The text of a file, with its NUL bytes, without a byte-order mark."""
    chosen = encoding or _encoding(data)
    try:
        return data.decode(chosen).removeprefix("\ufeff")
    except (UnicodeError, LookupError) as error:
        raise CampaignError(
            f"cannot be read as {chosen} text",
            where=label,
            advice="export it again as UTF-8, or state another encoding",
        ) from error


def _encoding(data: bytes) -> str:
    for mark, name in _MARKS:
        if data.startswith(mark):
            return name
    # No text of UTF-16 holds four NUL bytes in a row; a logger that lost power leaves them.
    head = re.sub(rb"\0{4,}", b"", data[:_SAMPLE_BYTES])[:4000]
    if len(head) >= 4 and len(head[1::2]) and head[1::2].count(0) > 0.4 * len(head[1::2]):
        return "utf-16-le"
    if len(head) >= 4 and head[::2].count(0) > 0.4 * len(head[::2]):
        return "utf-16-be"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252" if not set(data) & {0x81, 0x8D, 0x8F, 0x90, 0x9D} else "latin-1"
    return "utf-8"


def content_lines(
    text: str, signs: tuple[str, ...] = COMMENTS
) -> tuple[list[tuple[int, str]], dict[int, str]]:
    """Lines that hold cells, each with its number from 1, and comments by number without sign."""
    lines, comments = [], {}
    for number, line in enumerate(_LINE_END.split(text), start=1):
        stripped = line.strip()
        if not stripped:
            continue
        if signs and stripped.startswith(signs):
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
