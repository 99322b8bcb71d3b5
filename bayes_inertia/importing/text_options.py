"""How a text file of telemetry is written, where it cannot be told from its content."""

from __future__ import annotations

from dataclasses import dataclass


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
