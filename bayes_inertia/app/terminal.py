"""Console of all commands, which shows every text as it is, and progress.

Rich reads `[s]` and `[/run 3]` as markup. Units and names must be shown as they are written, so
nothing here is markup: style is given beside a text, never inside it.
"""

from __future__ import annotations

import codecs
import errno
import io
import json
import os
import re
import sys
import textwrap
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TextIO

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.progress import Progress
from bayes_inertia.progress import progress_bar as bar_on

# Whether the command at hand prints nothing but errors and what was asked for as JSON.
_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)
# What writing fails with where the reader went away: a pipe, one on Windows, a terminal.
_NOBODY_READS = (errno.EPIPE, errno.EINVAL, errno.EIO)


# How letters are written that an encoding lacks, by the name of this way among Python's.
_PLAIN_LETTERS = "bayes-inertia-plain-letters"
_RAISED = re.compile("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+")
_PLAIN = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−–×“”", '-0123456789--x""') | {
    ord("±"): "+-",
    ord("χ"): "chi",
    ord("°"): " deg",
    ord("→"): "->",
}


class _Stream(io.FileIO):
    """A descriptor whose reader may go away, as `head` does: what comes later is dropped."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            if error.errno not in _NOBODY_READS:
                raise
        return super().write(data)


@contextmanager
def usable_streams() -> Iterator[None]:
    """Let a command print while the context lasts, whatever stdout and stderr lack.

    Letters that their encoding lacks are replaced. Where they are closed, or their reader goes
    away, what is printed is dropped, and the work goes on.

    >>> with usable_streams():
    ...     print("5 slews")
    5 slews
    """
    codecs.register_error(_PLAIN_LETTERS, in_plain_letters)
    # A file that is opened later must not get the number of a closed stream, and what C libraries
    # write there.
    while (free := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(free, True)
    os.close(free)
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_usable(stream) for stream in before)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        sys.stdout, sys.stderr = before


def _usable(stream: TextIO | None) -> TextIO:
    """A stream on the same descriptor that replaces letters and survives its reader."""
    if stream is None or stream.closed:
        return open(os.devnull, "w", encoding="utf-8")
    buffer = getattr(stream, "buffer", None)
    raw = getattr(buffer, "raw", buffer)
    if type(raw) is io.FileIO:
        stream.flush()
        pipe = io.BufferedWriter(_Stream(raw.fileno(), "w", closefd=False))
        return io.TextIOWrapper(pipe, stream.encoding, _PLAIN_LETTERS, line_buffering=True)
    # A console of Windows, or what a notebook or a test captures.
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors=_PLAIN_LETTERS)
    return stream


def in_plain_letters(error: UnicodeError) -> tuple[str, int]:
    """Text in the letters of an encoding: a minus stays one, others become "?".

    >>> codecs.register_error("plain", in_plain_letters)
    >>> "−0.26 ± 0.04 × 10⁻⁴ kg m², 5 µ".encode("ascii", "plain")
    b'-0.26 +- 0.04 x 10^-4 kg m^2, 5 ?'
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacked = error.object[error.start : error.end]
    text = _RAISED.sub(lambda raised: f"^{raised[0]}", lacked).translate(_PLAIN)
    return text.encode("ascii", "replace").decode("ascii"), error.end


def plain_console(*, stderr: bool = False) -> Console:
    """A console that prints every text as it is: brackets and colons mean nothing to it."""
    return Console(stderr=stderr, markup=False, emoji=False, highlight=False, quiet=_QUIET.get())


@contextmanager
def quietly(quiet: bool) -> Iterator[None]:
    """Print no tables, sentences and progress while the context lasts.

    >>> with quietly(True):
    ...     plain_console().print("a table")
    """
    before = _QUIET.set(quiet)
    try:
        yield
    finally:
        _QUIET.reset(before)


def print_json(content: Mapping[str, Any]) -> None:
    """Print one JSON document on stdout, quiet or not.

    >>> print_json({"format": "bayes-inertia-note/1"})
    {
     "format": "bayes-inertia-note/1"
    }
    """
    typer.echo(json.dumps(content, indent=1, allow_nan=False))


def print_or_show(
    content: Mapping[str, Any], as_json: bool, show: Callable[..., None], *told: Any
) -> None:
    """Print one JSON document, or `show(*told)`."""
    if as_json:
        print_json(content)
    else:
        show(*told)


def show_result(
    document: Path, as_json: bool, open_page: bool, show: Callable[..., None], *told: Any
) -> None:
    """Print the JSON document that a command wrote, or `show(*told)`; open its page if wanted."""
    print_or_show(json.loads(document.read_text(encoding="utf-8")), as_json, show, *told)
    open_in_browser(document.with_suffix(".html"), open_page)


def safe_message(text: str) -> str:
    """A message of bearable length without control characters, whatever a file wrote into it.

    >>> safe_message("no column '\\x1b[31m'")
    "no column '\\\\x1b[31m'"
    """
    shown = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)
    longest, end = LAYOUT.longest_message, LAYOUT.message_end
    return shown if len(shown) <= longest else f"{shown[: longest - end]} [...] {shown[-end:]}"


def headed(head: str, rest: str = "", *, style: str = "bold") -> Text:
    """A line whose first words stand out.

    >>> str(headed("MOST [/run 3]", ": 5 slews"))
    'MOST [/run 3]: 5 slews'
    """
    return Text.assemble((head, style), rest)


def _in_lines(heading: str) -> str:
    """A heading with its first word on a line of its own, the others on short ones."""
    first, _, others = heading.partition(" ")
    return "\n".join([first, *textwrap.wrap(others, LAYOUT.heading_width)])


def print_table(
    columns: Iterable[str], rows: Iterable[Sequence[str]], wrapping: Sequence[str] = ()
) -> None:
    """Print a table that fits the terminal: the first column gives way, numbers never do.

    Columns that find no room beside it follow below, in a table with the same first column.
    """
    console = plain_console()
    narrow = console.width < LAYOUT.narrow_columns
    first, *others = columns
    headings = [first, *(_in_lines(x) if narrow and x not in wrapping else x for x in others)]
    cells = [headings, *rows]
    widths = [
        _width(heading.split() if heading in wrapping else [row[k] for row in cells])
        for k, heading in enumerate(headings)
    ]
    kept = min(widths[0], console.width // LAYOUT.widest_first_column)
    for block in _blocks([width + 2 for width in widths[1:]], console.width - kept):
        if 1 not in block:
            console.print()
        table = Table(box=SIMPLE, show_edge=False, pad_edge=False, collapse_padding=True)
        table.add_column(headings[0], overflow="fold")
        for k in block:
            if headings[k] in wrapping:
                table.add_column(headings[k], overflow="fold", min_width=widths[k])
            else:
                table.add_column(headings[k], no_wrap=True)
        for row in cells[1:]:
            table.add_row(row[0], *(row[k] for k in block))
        console.print(table)


def _width(texts: Iterable[str]) -> int:
    """Letters of the longest line."""
    return max(len(line) for text in texts for line in text.splitlines() or [""])


def _blocks(widths: Sequence[int], room: int) -> list[list[int]]:
    """Which columns, counted from 1, stand beside each other in so much room.

    >>> _blocks([5, 5, 9, 20], 11)
    [[1, 2], [3], [4]]
    """
    blocks: list[list[int]] = [[]]
    used = 0
    for k, width in enumerate(widths, 1):
        if blocks[-1] and used + width > room:
            blocks.append([])
            used = 0
        blocks[-1].append(k)
        used += width
    return blocks


def indented(line: str) -> Padding:
    """A line two columns to the right, on all the rows that it takes."""
    return Padding(Text(line), (0, 0, 0, 2), expand=False)


def say(sentence: str) -> None:
    """Print a sentence on stderr, whether it is a terminal or not."""
    if not _QUIET.get():
        # By way of sys.stderr, which Rich redirects: so it stands above a progress bar.
        print(sentence, file=sys.stderr, flush=True)


def open_in_browser(page: Path, wanted: bool) -> None:
    """Open a page in the user's browser if that is wanted; without either nothing happens."""
    if not (wanted and page.is_file()):
        return
    with suppress(webbrowser.Error, OSError):
        browser = webbrowser.get()
        # One without windows would take the terminal, unless the user chose it.
        if type(browser) is not webbrowser.GenericBrowser or "BROWSER" in os.environ:
            browser.open(page.resolve().as_uri())


def progress_bar() -> AbstractContextManager[Progress]:
    """A callback that shows the stage of a command on stderr while the context lasts."""
    return bar_on(plain_console(stderr=True))
