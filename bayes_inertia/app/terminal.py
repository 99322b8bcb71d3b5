"""What all commands print with: a console that shows every text as it is, and progress.

Rich reads `[s]` and `[/run 3]` as markup. Units and names must be shown as they are written, so
nothing here is markup: style is given beside a text, never inside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.padding import Padding
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

# Characters of a message, and how many of them are its end, which says what to do.
_LONGEST, _END = 4000, 1000


def plain_console(*, stderr: bool = False) -> Console:
    """A console that prints every text as it is: brackets and colons mean nothing to it.

    Parameters
    ----------
    stderr : bool
        Whether to print on stderr instead of stdout.

    Returns
    -------
    Console
        The console.
    """
    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)


def safe_message(text: str) -> str:
    """A message of bearable length without control characters, whatever a file wrote into it.

    Parameters
    ----------
    text : str
        The message.

    Returns
    -------
    str
        Its lines, and its middle left out where it is long.

    Examples
    --------
    >>> safe_message("no column '\\x1b[31m'")
    "no column '\\\\x1b[31m'"
    """
    shown = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)
    if len(shown) <= _LONGEST:
        return shown
    return f"{shown[: _LONGEST - _END]} [...] {shown[-_END:]}"


def headed(head: str, rest: str = "", *, style: str = "bold") -> Text:
    """A line whose first words stand out.

    Parameters
    ----------
    head : str
        The first words.
    rest : str
        What follows them.
    style : str
        Style of the first words, in Rich's terms.

    Returns
    -------
    Text
        The line.

    Examples
    --------
    >>> str(headed("MOST [/run 3]", ": 5 slews"))
    'MOST [/run 3]: 5 slews'
    """
    return Text.assemble((head, style), rest)


def indented(line: str) -> Padding:
    """A line two columns to the right, on all the rows that it takes.

    Parameters
    ----------
    line : str
        The text.

    Returns
    -------
    Padding
        To be printed.
    """
    return Padding(Text(line), (0, 0, 0, 2), expand=False)


def say(sentence: str) -> None:
    """Print a sentence on stderr, whether it is a terminal or not.

    Parameters
    ----------
    sentence : str
        What should be known.
    """
    plain_console(stderr=True).print(sentence, soft_wrap=True)


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None] | None]:
    """A callback that draws progress on stderr while the context lasts.

    Yields
    ------
    callable or None
        To be called with (what, done, of). None if stderr is not a terminal.
    """
    console = plain_console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("starting", total=None)
        yield lambda what, done, of: progress.update(
            task, description=what, completed=done, total=of
        )
