"""Text tables: CSV and its kin, as spreadsheets, ground stations and numpy write them.

Among them those of the spacecraft simulator 42 of NASA Goddard: columns without names, one quantity
a file, all with the rows of time.42. Names and units are those of 42's `Report`
(Source/42report.c). Its qbn is the rotation from N to the first body's frame B with the scalar
last: v_B = C(q) v_N, as in this package. Its wheel momentum H obeys H' = motor torque: it is the
whole axial momentum, J_s (wheel speed + g.w).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import vocabulary
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.table import Column, StatedAttitude, Table, is_empty, number_of
from bayes_inertia.tables.text_cells import (
    COMMENTS,
    CellRow,
    TextForm,
    TextOptions,
    content,
    content_lines,
    decoded,
    is_reading,
    split_rows,
    told_form,
    usual_width,
    whole_lines,
)

_BRACKETS = re.compile(r".*?\s*[\[(<]([^\[\]()<>]*)[\])>]\s*")
_NUMBER_AND_UNIT = re.compile(r"([-+\u2212]?[\d.,]+(?:[eE][-+]?\d+)?)\s*([^\d\s.,].*)")
_Head = tuple[CellRow | None, CellRow | None]  # The rows of names and of units.
_UNIT_WORDS = frozenset(vocabulary("tables")["units"]["words"].split())


def read_text_table(path: Path, options: TextOptions) -> Table:
    """The columns of a text file, with the units that a row of units or the names state."""
    label = str(path)
    text, notes = whole_lines(content(path), label, options.encoding)
    table = parse_text(text, label, options)
    return replace(table, notes=(*notes, *table.notes))


def parse_text(text: str, label: str, options: TextOptions) -> Table:
    """The columns of a text table; what the options leave open is told from the text."""
    lines, comments = content_lines(text, (options.comment,) if options.comment else COMMENTS)
    if lines and lines[0][1].strip().lower().startswith("sep="):
        lines = lines[1:]  # A hint that Excel writes and reads.
    require(bool(lines), label, "the file is empty", "give rows of telemetry")
    form = told_form(lines, options, label)
    rows = list(split_rows(lines, form.delimiter, label))
    form = form._replace(width=usual_width([row.cells for row in rows[-_judged(rows) :]]))
    rows, notes = _without_end([_trimmed(row, form.width) for row in rows], form, text)
    stated = max(options.header_line, options.units_line) if options.header_line >= 0 else -1
    first = _first_data_row(rows, form, stated, label)
    head = _head(rows[:first], comments, rows[first].line, form, options)
    _refuse_lost_row(rows[:first], head, form, label)
    names, unit_cells = (_padded(row, form.width) for row in head)
    both = zip(unit_cells, names, strict=True)
    units = [_unit(cell) or _unit_in_name(name) for cell, name in both]
    below, repeated = _without_heads(rows[first:], head)
    names = _without_last_blank(_own_names(names), below, form.width)
    for row in below:
        if len(row.cells) < len(names) or any(row.cells[len(names) :]):
            what = f"{len(row.cells)} cells, but the table has {len(names)} columns"
            advice = "give every line as many cells as the others, or remove the line"
            raise CampaignError(what, where=f"{label}, line {row.line}", advice=advice)
    # Only the wanted cells: a last delimiter makes one more.
    cells = list(zip(*(row.cells[: len(names)] for row in below), strict=True))
    columns = {
        part: logged_column(of_part, form.decimal, unit)
        for name, values, unit in zip(names, cells, units, strict=False)
        for part, of_part in _parts(name, values).items()
    }
    numbers = np.array([row.line for row in below], dtype=int)
    return Table(label, columns, numbers, notes=(*notes, *repeated))


def _trimmed(row: CellRow, count: int) -> CellRow:
    """A row without empty cells beyond the last column, as a delimiter at its end makes them."""
    if len(row.cells) <= count or any(row.cells[count:]):
        return row
    return CellRow(row.line, row.cells[:count])


def _without_end(
    rows: list[CellRow], form: TextForm, text: str
) -> tuple[list[CellRow], tuple[str, ...]]:
    """Rows without a footer, or a last row that breaks off where a logger lost power; notes."""
    if len(rows) < LIMITS.few_rows:
        return rows, ()
    begins = [row.cells[0] for row in rows[-_judged(rows) :]]
    most = LIMITS.most_footer_lines if _holds_readings(begins, form) else 0
    last = rows[-1 - most :]
    is_footer = [_is_footer(row.cells, form) for row in last]
    gone = is_footer[::-1].index(False) if False in is_footer else 0
    if gone:
        lines = ", ".join(str(row.line) for row in rows[-gone:])
        return rows[:-gone], (f"a footer in line {lines} was left out",)
    if len(rows[-1].cells) >= form.width or text.endswith(("\n", "\r")):
        return rows, ()
    return rows[:-1], (f"line {rows[-1].line}, the last, breaks off and was left out",)


def _is_footer(cells: Sequence[str], form: TextForm) -> bool:
    """Whether words begin a row that has no readings, or not as many cells as others."""
    readings = [is_reading(cell, form.decimal) for cell in cells]
    word = not is_empty(cells[0]) and not readings[0]
    return word and (len(cells) != form.width or not any(readings))


def _without_heads(rows: list[CellRow], head: _Head) -> tuple[list[CellRow], tuple[str, ...]]:
    """Rows without repeated names and units, as of files that were put together."""
    cells = {row.cells for row in head if row}
    kept = [row for row in rows if row.cells not in cells]
    gone = next((row.line for row in rows if row.cells in cells), 0)
    return kept, (f"the names stand again in line {gone}: taken once",) if gone else ()


def _padded(row: CellRow | None, count: int) -> list[str]:
    cells = list(row.cells[:count]) if row else []
    return cells + [""] * (count - len(cells))


def _refuse_lost_row(above: Sequence[CellRow], head: _Head, form: TextForm, label: str) -> None:
    """Refuse a damaged row of telemetry that would pass for one of metadata."""
    last = max((row.line for row in head if row), default=0)
    for row in above:
        readings = any(is_reading(cell, form.decimal) for cell in row.cells)
        lost = readings if last else _holds_readings(row.cells, form)
        what = f"{len(row.cells)} cells that do not fit the columns"
        advice = "mend or remove the line; a line of metadata can begin with #"
        require(row.line <= last or not lost, f"{label}, line {row.line}", what, advice)


def _judged(rows: Sequence[CellRow]) -> int:
    """Number of last rows by which columns are judged: heads are short, but so may be files."""
    return min(LIMITS.sample_rows, (len(rows) + 1) // 2)


def _first_data_row(rows: Sequence[CellRow], form: TextForm, below: int, label: str) -> int:
    """The first row below a line most of whose cells in columns of readings hold readings.

    Where there are no names (-1), it is one below no line, and may be empty of readings.
    """
    judged = [row.cells for row in rows[-_judged(rows) :] if len(row.cells) == form.width]
    columns = [i for i, own in enumerate(zip(*judged, strict=True)) if _holds_readings(own, form)]
    for index, row in enumerate(rows):
        if row.line <= below or len(row.cells) != form.width:
            continue
        cells = [row.cells[i] for i in columns]
        # Where the mapping says that there are no names, a row of empty cells is one of telemetry.
        if _holds_readings(cells, form) or (below < 0 and all(map(is_empty, cells))):
            return index
    advice = "give rows of telemetry below the names; state delimiter and decimal sign in the "
    advice += "mapping if they were misread"
    raise CampaignError("no row of numbers", where=label, advice=advice)


def _holds_readings(cells: Sequence[str], form: TextForm) -> bool:
    full = [cell for cell in cells if not is_empty(cell)]
    return bool(full) and 2 * sum(is_reading(cell, form.decimal) for cell in full) > len(full)


def _head(
    above: Sequence[CellRow],
    comments: dict[int, str],
    data_line: int,
    form: TextForm,
    options: TextOptions,
) -> _Head:
    """The row of names and the row of units above the data."""
    stated = {row.line: row for row in above}
    for line in (options.header_line, options.units_line):
        if line in comments:
            stated[line] = _commented(comments, line, form)
    names, units = _told_head(above, comments, data_line, form)
    if options.header_line:
        names = stated.get(options.header_line)
    if options.units_line:
        units = stated.get(options.units_line)
    return names, units


def _commented(comments: dict[int, str], line: int, form: TextForm) -> CellRow:
    rows = split_rows([(line, comments[line])], form.delimiter)
    return _trimmed(next(iter(rows), CellRow(line, ())), form.width)


def _told_head(
    above: Sequence[CellRow], comments: dict[int, str], data_line: int, form: TextForm
) -> _Head:
    """The rows of names and of units, where the file has them."""
    # Spreadsheets pad rows of metadata with empty cells; a last comma may be missing.
    full = [
        row
        for row in above
        if len(row.cells) in (form.width, form.width - 1)
        and (2 * sum(map(bool, row.cells)) > form.width or _is_units(row.cells))
        and not any(is_reading(cell, form.decimal) for cell in row.cells)
    ]
    if not full:
        full = _commented_head(comments, data_line, form)
    if len(full) > 1 and _is_units(full[-1].cells):
        return full[-2], full[-1]
    if len(full) > 1 and _is_units(full[-2].cells):
        return full[-1], full[-2]
    return (full[-1], None) if full else (None, None)


def _commented_head(comments: dict[int, str], data_line: int, form: TextForm) -> list[CellRow]:
    """Comments right above the data that look like names and units, as numpy writes them."""
    full: list[CellRow] = []
    for line in sorted((n for n in comments if n < data_line), reverse=True):
        row = _commented(comments, line, form)
        if len(row.cells) == form.width and not _holds_readings(row.cells, form):
            full.insert(0, row)
            if not _is_units(row.cells):
                break
    return full


def _is_units(cells: Sequence[str]) -> bool:
    """Whether a row holds units: most of its cells that are not empty are words of units."""
    full = [cell for cell in cells if cell and cell != "-"]
    return bool(full) and 2 * sum(map(_is_unit, full)) > len(full)


def _is_unit(cell: str) -> bool:
    if cell[:1] + cell[-1:] in ("[]", "()", "<>"):
        return True
    words = re.findall("[^\\W\\d_]+|°", cell)
    return bool(words) and all(word in _UNIT_WORDS or word.lower() in _UNIT_WORDS for word in words)


def _unit(cell: str) -> str:
    bare = cell.strip()
    if bare[:1] + bare[-1:] in ("[]", "()", "<>"):
        bare = bare[1:-1].strip()
    return "" if bare in ("-", "1") else bare


def _unit_in_name(name: str) -> str:
    """The unit in a name such as "wx [deg/s]"."""
    match = _BRACKETS.fullmatch(name)
    return match[1].strip() if match and match[1] and _is_unit(match[1]) else ""


def _own_names(names: Sequence[str]) -> list[str]:
    """Names that differ: c3 for an unnamed third column, "w#2" for a second "w"."""
    own: list[str] = []
    for index, name in enumerate(names, start=1):
        tried, times = name or f"c{index}", 1
        while tried in own:
            times += 1
            tried = f"{name or f'c{index}'}#{times}"
        own.append(tried)
    return own


def _without_last_blank(names: list[str], rows: Sequence[CellRow], count: int) -> list[str]:
    """Without a last column that only a last delimiter on every line makes."""
    empty = names[-1] == f"c{count}" and count > 1
    if empty and all(len(row.cells) < count or not row.cells[count - 1] for row in rows):
        return names[:-1]
    return names


def _parts(name: str, cells: Sequence[str]) -> dict[str, Sequence[str]]:
    """A column, or one a number where its cells hold vectors such as "[0.1, 0.2, 0.3]"."""
    if not next(filter(None, cells), "").startswith(("[", "(")):
        return {name: cells}
    inner = [cell.strip("[]() ").replace(",", " ").split() for cell in cells]
    width = max(map(len, inner))
    if width < 2 or any(len(numbers) not in (0, width) for numbers in inner):
        return {name: cells}
    own = [numbers or [""] * width for numbers in inner]
    return {f"{name}[{k}]": [numbers[k] for numbers in own] for k in range(width)}


def logged_column(cells: Sequence[str], decimal: str, unit: str = "") -> Column:
    """A column of a raw log, whose cells may all state one unit, as "0.5 deg/s" does."""
    numbers, units = list[str](), {unit} - {""}
    for cell in cells:
        match = _NUMBER_AND_UNIT.fullmatch(cell)
        if not (match and _is_unit(match[2])) and not is_empty(cell):
            return text_column(cells, decimal, unit)
        numbers.append(match[1] if match else "")
        units |= {match[2]} if match else set()
    if len(units) != 1:
        return text_column(cells, decimal, unit)
    return text_column(numbers, decimal, units.pop())


def text_column(cells: Sequence[str], decimal: str, unit: str = "") -> Column:
    """A column of text cells: numbers where every cell is one or empty, else texts."""
    points = [cell.replace(",", ".") for cell in cells] if decimal == "," else cells
    try:
        values = np.array([float(cell or "nan") for cell in points])
        if "_" in "".join(cells):
            raise ValueError
    except ValueError:
        # Lazily: of a column of dates the first cell tells.
        texts = (cell for cell in cells if math.isnan(number_of(cell, decimal)))
        if not all(map(is_empty, texts)):
            return Column(np.array(cells, dtype=np.dtypes.StringDType()), unit)
        values = np.array([number_of(cell, decimal) for cell in cells])
    large = np.abs(values[np.isfinite(values)]).max(initial=0.0) >= LIMITS.lossy_size
    if large and max(sum(c.isdigit() for c in cell) for cell in points) > LIMITS.lossy_digits:
        return Column(values, unit, exact=np.array(points, dtype=np.dtypes.StringDType()))
    return Column(values, unit)


# Number of columns (0: any), and unit, of each output of 42.
_UNITS_OF_42 = vocabulary("tables")["nasa_42"]
_UTC_OF_42 = re.compile(r"\s*(\d{4}):(\d{1,2}):(\d{1,2}):(\d{1,2}):(\d{2}):(\d{2}\.\d+)\s*")
_FORM_OF_42 = TextOptions(delimiter="whitespace", decimal=".", header_line=-1, units_line=-1)


def read_42(path: Path) -> Table:
    """The columns of an output of 42, such as qbn[0], with the stamps of the time.42 beside it."""
    stem = path.stem
    if stem == "UTC":
        return _utc(path)
    table = read_text_table(path, _FORM_OF_42)
    count, unit = _UNITS_OF_42.get(stem, (0, ""))
    found = len(table.columns)
    what = f"{found} columns, but 42 writes {count}"
    require(count in (0, found), str(path), what, "write it again")
    names = [f"{stem}[{k}]" for k in range(found)] if found > 1 else [stem]
    if stem not in _UNITS_OF_42:
        names = [f"c{k + 1}" for k in range(found)]
    both = zip(names, table.columns.values(), strict=True)
    columns = {name: replace(column, unit=unit) for name, column in both}
    notes = _notes(path, stem, columns)
    columns = {**_stamps(path, table.rows), **columns}
    attitude = StatedAttitude(tuple(names), "last", "N", "BODY") if stem == "qbn" else None
    has_time = "time" in columns
    time, kind = ("time",) * has_time, "s" * has_time
    return Table(str(path), columns, table.lines, time, kind, attitude, notes)


def _stamps(path: Path, rows: int) -> dict[str, Column]:
    """The time of each row, from the file that 42 writes beside all others."""
    beside = path.with_name("time.42")
    if path.stem in ("time", "DynTime") or not beside.is_file():
        return {}
    time = next(iter(read_text_table(beside, _FORM_OF_42).columns.values()))
    what = f"{rows} rows, but {beside.name} beside it has {time.values.size}"
    require(time.values.size == rows, str(path), what, "take both from one run")
    return {"time": Column(time.values, "s")}


def _notes(path: Path, stem: str, columns: Mapping[str, Column]) -> tuple[str, ...]:
    """Say where the six decimals that 42 writes leave few digits."""
    numbers = [c.values for c in columns.values() if not c.is_text]
    size = max((float(np.abs(x).max()) for x in numbers), default=0.0)
    # Who changed 42's format has more decimals.
    millionths = (1e6 * np.abs(x) for x in numbers)
    if any(np.any(np.abs(x - np.rint(x)) > 1e-3) for x in millionths):
        return ()
    if stem not in ("Hwhl", "MTB", "Thr") or size >= 10.0 ** (LIMITS.least_digits - 6):
        return ()
    return (
        f"{path.name}: 42 writes six decimals, so a reading of up to {size:.3g} "
        f"{_UNITS_OF_42[stem][1]} is rounded to 1e-6; "
        '"%le" instead of "%lf" in 42report.c keeps seven digits',
    )


def _utc(path: Path) -> Table:
    """UTC.42: year:month:day:hour:minute:second, as ISO 8601."""
    texts, numbers = [], []
    for number, line in content_lines(decoded(content(path), str(path)), ())[0]:
        match = _UTC_OF_42.fullmatch(line)
        if match is None:
            what = f"{line.strip()[:40]!r} is no time as 42 writes it"
            raise CampaignError(what, where=f"{path}, line {number}", advice="write it again")
        parts = [part.zfill(2) for part in match.groups()]
        texts.append(f"{'-'.join(parts[:3])}T{':'.join(parts[3:])}Z")
        numbers.append(number)
    column = Column(np.array(texts, dtype=np.dtypes.StringDType()))
    return Table(str(path), {"UTC": column}, np.array(numbers), ("UTC",), "utc")
