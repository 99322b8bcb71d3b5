"""Tables of the pages that studies write, in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table_lines(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table, line by line.

    Examples
    --------
    >>> table_lines(["plan", "gain"], [["designed", "1.7"]])
    ['| plan | gain |', '|---|---|', '| designed | 1.7 |']
    """
    return [
        f"| {' | '.join(columns)} |",
        "|" + "---|" * len(columns),
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
