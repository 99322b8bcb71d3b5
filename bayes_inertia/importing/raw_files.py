"""The reader of raw logs: the format is told by content and suffix, each has its own file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.raw_table import RawTable
from bayes_inertia.importing.text_options import TextOptions
from bayes_inertia.importing.text_table import read_text_table

_HEAD = 1024  # Bytes by which a format is told.


def file_format(path: Path) -> str:
    """The format of a file, by its first bytes and else its suffix.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    str
        "text", ...

    Raises
    ------
    CampaignError
        If there is no such file, or its format is one that nobody reads here.
    """
    try:
        with path.open("rb") as file:
            file.read(_HEAD)
    except OSError as error:
        raise CampaignError(
            f"cannot be opened ({error.strerror})", where=str(path), advice="check the path"
        ) from error
    return "text"


def read_raw(
    path: str | Path,
    *,
    table: str = "",
    columns: Sequence[str] = (),
    options: TextOptions | None = None,
) -> RawTable:
    """One table of a raw log.

    Parameters
    ----------
    path : str or Path
        The file.
    table : str, optional
        The group, struct or segment, as `tables_in` names it; "" for the whole file, whose nested
        columns are then named with dots.
    columns : sequence of str, optional
        The columns that are wanted; () for all. Needed where those of one table differ in length.
    options : TextOptions, optional
        How a text file is written, where it cannot be told from its content.

    Returns
    -------
    RawTable
        Its columns.

    Raises
    ------
    CampaignError
        If the file cannot be read, or its columns differ in length.
    """
    return read_text_table(Path(path), options or TextOptions())


def tables_in(path: str | Path) -> list[str]:
    """The tables that a raw log holds.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    list of str
        Names for `read_raw`; one empty name where the file is one table.
    """
    file_format(Path(path))
    return [""]
