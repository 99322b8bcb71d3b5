"""Result of every reader of tables: named columns with what the file itself states.

A column keeps its numbers or texts as they lie in the file, with the unit that the file states (a
row of units, an attribute of netCDF or HDF5) and, where a format defines them, the conventions of
its attitudes (CCSDS AEM). What it means, the description of a campaign or a mapping says.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import vocabulary
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.tables.limits import LIMITS

_EMPTY_WORDS = tuple(vocabulary("tables")["no_reading"]["words"].split())


def is_empty(cell: str) -> bool:
    """Whether a cell of a text holds no reading: nothing, signs alone, or a word that says so.

    >>> [is_empty(cell) for cell in ("", "--.--", "N/A", "Invalid", "-nan(ind)", "0", "off")]
    [True, True, True, True, True, False, False]
    """
    return not cell.strip("-\u2013\u2212_.*?#~ ") or cell.strip().lower() in _EMPTY_WORDS


# Names as CCSDS (SANA registry), ground systems and 42 write them, in capitals.
_INERTIAL = re.compile(
    r"N|(EME|J)2000|B1950|ECI.*|(ICRF|GCRF|GCRS|CIRS|TEME|MEME).*|(TOD|MOD)([_ /].*)?|.*INERTIAL.*"
)


@array_dataclass
class Column:
    """One column as it lies in the file."""

    # (rows,): floats (NaN for no reading), integers, or texts where not every cell is a number
    values: np.ndarray
    unit: str = ""  # The unit that the file itself states; "" where it states none
    single: bool = False  # Whether the file stores 32-bit floats
    # (rows,) of str: the cells of a text file with more digits than a 64-bit float holds
    exact: np.ndarray | None = None

    @property
    def is_text(self) -> bool:
        """Whether some cell is no number."""
        return self.values.dtype.kind not in "iuf"

    @property
    def texts(self) -> list[str]:
        """The cells as texts, as the file writes them where it has more digits than a float."""
        values = self.values if self.exact is None else self.exact
        return [str(cell).strip() for cell in values.tolist()]

    def only(self, rows: np.ndarray | Sequence[int]) -> Column:
        """Some rows of the column."""
        exact = None if self.exact is None else self.exact[rows]
        return replace(self, values=self.values[rows], exact=exact)


@dataclass(frozen=True)
class StatedAttitude:
    """Attitude convention that the file states, so that no mapping need say it."""

    names: tuple[str, ...]  # The columns: a quaternion or three angles, in the order of the file
    scalar: Literal["first", "last", ""]  # Where the scalar of a quaternion stands; "" for angles
    # from_frame, to_frame: v_to = C v_from with the rotation that the columns describe, such as
    # "EME2000" and "SC_BODY_1"
    from_frame: str
    to_frame: str
    # Axes of Euler angles in the order of the rotations, such as "ZYX"; "" for a quaternion
    sequence: str = ""
    angle_unit: str = ""  # Unit of the angles; "" for a quaternion

    @property
    def maps(self) -> Literal["inertial_to_body", "body_to_inertial", ""]:
        """The direction as campaign.toml names it; "" where no frame is known as inertial."""
        start, end = is_inertial(self.from_frame), is_inertial(self.to_frame)
        if start == end:
            return ""
        return "inertial_to_body" if start else "body_to_inertial"


def is_inertial(frame: str) -> bool:
    """Whether a name is that of an inertial frame, as CCSDS or 42 names it.

    >>> [is_inertial(frame) for frame in ("EME2000", "icrf_3", "SC_BODY_1", "ITRF2000")]
    [True, True, False, False]
    """
    return bool(_INERTIAL.fullmatch(frame.strip().upper()))


@array_dataclass
class Table:
    """The columns of one table of one file."""

    label: str  # The file (and its table), as messages name it
    columns: dict[str, Column]  # All of one length
    # (rows,) of int: line numbers as a text editor shows them; None for files without lines
    lines: np.ndarray | None = None
    time_names: tuple[str, ...] = ()  # Columns that hold the time, where the format says so
    # Their kind as `time_stamps.times_to_seconds` names it, where the format says so
    time_kind: str = ""
    attitude: StatedAttitude | None = None  # What the format says of its attitudes
    notes: tuple[str, ...] = ()  # What a user should know of the file, such as too few decimals

    @classmethod
    def of(cls, label: str, columns: Mapping[str, np.ndarray]) -> Table:
        """A table of plain numbers, with the lines that they have below a header."""
        made = cls(label, {name: Column(values) for name, values in columns.items()})
        return replace(made, lines=np.arange(made.rows) + 2)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return max((column.values.size for column in self.columns.values()), default=0)

    def place(self, row: int, name: str = "") -> str:
        """File, line (or row from 1) and column of a cell, for a message."""
        return f"{self.label}, {self.row(row)}{f', column {name}' if name else ''}"

    def row(self, row: int) -> str:
        """A row as people count: "line 12" of a text file, else "row 11"."""
        return row_name(self.lines, row)

    def column(self, name: str) -> Column:
        """A column by name, or an error that names the nearest."""
        if name not in self.columns:
            raise no_column(name, list(self.columns), self.label)
        return self.columns[name]

    def numbers(self, name: str) -> np.ndarray:
        """(rows,) array of a column in the file's own unit; a cell without a reading is NaN."""
        column = self.column(name)
        if column.is_text:
            row, cell = _first_text(column.values)
            stored = "is not a number" if math.isnan(number_of(cell)) else "is stored as a text"
            what, where = f"{shortened(cell)!r} {stored}", self.place(row, name)
            raise CampaignError(what, where=where, advice=_number_in_place_of(cell))
        values = column.values.astype(float)
        advice = "leave the cell empty, or remove the row"
        self.refuse(np.isinf(values), name, "an infinite value", advice)
        # Damage can make NaNs of which every calculation would warn.
        return np.where(np.isnan(values), np.nan, values)

    def refuse(self, wrong: np.ndarray, name: str, what: str, advice: str) -> None:
        """Raise an error at the first row (rows,) that is wrong; "{}" in `what`: its number."""
        if wrong.any():
            row = int(np.argmax(wrong))
            what = what.format(float(self.columns[name].values[row]))
            raise CampaignError(what, where=self.place(row, name), advice=advice)

    def stack(self, names: Sequence[str]) -> np.ndarray:
        """(rows, len(names)) array of columns of numbers, in the file's own units."""
        return np.stack([self.numbers(name) for name in names], axis=1)

    def only(self, names: Sequence[str]) -> Table:
        """The table with some of its columns, refused if a cell is no number, or infinite."""
        columns = {
            name: Column(self.numbers(name), single=self.columns[name].single) for name in names
        }
        return replace(self, columns=columns)

    def signed(self, names: Sequence[str]) -> Table:
        """The columns of these names; one that begins with a minus has the other sign."""
        columns = {}
        for name in names:
            column = self.columns[name.removeprefix("-")]
            # 0 - values, because -values would make zeros negative.
            negated = replace(column, values=0.0 - column.values)
            columns[name] = negated if name.startswith("-") else column
        return replace(self, columns=columns)

    def changed(self, columns: Mapping[str, np.ndarray]) -> Table:
        """The table with other numbers in some of its columns."""
        changed = {name: Column(values) for name, values in columns.items()}
        return replace(self, columns=self.columns | changed)

    def taking(self, rows: np.ndarray | Sequence[int]) -> Table:
        """Some rows of the table."""
        lines = None if self.lines is None else self.lines[rows]
        columns = {name: column.only(rows) for name, column in self.columns.items()}
        return replace(self, columns=columns, lines=lines)


def joined_values(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Parts of one column end to end; texts where one of them holds texts."""
    if any(part.dtype.kind == "T" for part in parts):
        parts = [part.astype(np.dtypes.StringDType()) for part in parts]
    return np.concatenate(parts)


def _first_text(values: np.ndarray) -> tuple[int, str]:
    """Row and text of the first cell that is no number."""
    for row, cell in enumerate(values.tolist()):
        if math.isnan(number_of(cell)) and not is_empty(cell):
            return row, cell
    return 0, str(values[0])


def _number_in_place_of(cell: str) -> str:
    """What to write in the place of a cell that is no number."""
    if not math.isnan(number_of(cell)):
        return "store the column as numbers"
    if re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell):
        return "write a decimal point, not a comma"
    if re.search(r"\d[-/:T]\d", cell):
        return "write times as seconds (or another unit of time) from an epoch, not as dates"
    marks = ", ".join(map(repr, ("-", *_EMPTY_WORDS[: LIMITS.most_marks_told])))
    return f"write a number, or leave the cell empty; texts that mean no reading are {marks}"


def row_name(lines: np.ndarray | None, row: int) -> str:
    """A row (from 0) as people count: "line 12" of a text, or "row 11"."""
    return f"row {row + 1}" if lines is None else f"line {int(lines[row])}"


def shortened(cell: str) -> str:
    """At most forty characters of a cell, for a message."""
    return cell if len(cell) <= 40 else cell[:37] + "..."


def no_column(name: str, available: Sequence[str], where: str, why: str = "") -> CampaignError:
    """The refusal of a column that a table has not, with the nearest that it has."""
    near = difflib.get_close_matches(name, available, 1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    what = f"no column {name!r}{why}"
    return CampaignError(what, where=where, advice=f"{hint}The table has: {_listed(available)}")


def negated_name(name: str) -> str:
    """The name of a column with the other sign.

    >>> negated_name("rate_x"), negated_name("-rate_x")
    ('-rate_x', 'rate_x')
    """
    return name.removeprefix("-") if name.startswith("-") else f"-{name}"


def _listed(names: Sequence[str]) -> str:
    """Names of columns on one line, whatever a damaged header holds."""
    most, told = LIMITS.longest_name_told, names[: LIMITS.most_names_told]
    plain = [name if name.isprintable() else ascii(name)[1:-1] for name in told]
    short = [name if len(name) <= most else f"{name[:most]}..." for name in plain]
    return ", ".join([*short, *["..."] * (len(names) > LIMITS.most_names_told)]) or "no column"


def number_of(cell: str, decimal: str = ".") -> float:
    """The number in a cell of text with the decimal sign "." or ","; NaN where it is none.

    >>> number_of("1,5e-3", ","), number_of("1_000"), number_of("1.5D+02")
    (0.0015, nan, 150.0)
    """
    # Python reads 1_000 as a number; in telemetry it is a damaged cell.
    if "_" in cell:
        return math.nan
    text = (cell.replace(",", ".") if decimal == "," else cell).replace("\u2212", "-")
    try:  # The D is Fortran's double exponent.
        return float(text.replace("D", "E").replace("d", "e"))
    except ValueError:
        return math.nan
