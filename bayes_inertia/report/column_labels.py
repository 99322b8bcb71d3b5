"""Cells that know their column: a narrow screen shows rows as cards, each number with its name."""

from __future__ import annotations

import re

_TABLE = re.compile(r"<table.*?</table>", re.S)
_HEADING = re.compile(r'<th scope="col"[^>]*>(.*?)</th>', re.S)
_CELL = re.compile(r"<td(?=[\s>])")
_TAG = re.compile(r"<[^>]*>")


def with_column_labels(html: str) -> str:
    """A section's body whose cells carry the heading of their column.

    Parameters
    ----------
    html : str
        With tables: a row of `<th scope="col">`, then rows of one `<th scope="row">` and cells.

    Returns
    -------
    str
        The same with `data-label` at each cell; tables without such headings are left as they are.

    Examples
    --------
    >>> head = '<tr><th scope="col">name</th><th scope="col">sd</th></tr>'
    >>> row = '<tr><th scope="row">Jxx</th><td>1</td></tr>'
    >>> with_column_labels(f"<table>{head}{row}</table>")[-39:]
    '<td data-label="sd">1</td></tr></table>'
    """
    return _TABLE.sub(lambda table: _labelled(table[0]), html)


def _labelled(table: str) -> str:
    headings = [
        _TAG.sub(" ", heading).strip().replace('"', "&quot;") for heading in _HEADING.findall(table)
    ][1:]
    if not headings:
        return table
    rows = table.split("<tr")
    return "<tr".join(_labelled_row(row, headings) for row in rows)


def _labelled_row(row: str, headings: list[str]) -> str:
    labels = iter(headings)
    return _CELL.sub(lambda _: f'<td data-label="{next(labels, "")}"', row)
