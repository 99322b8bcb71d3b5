"""Text outputs of the spacecraft simulator 42 of NASA Goddard: columns without names, one quantity
a file, all with the rows of time.42.

Names and units are those of 42's `Report` (Source/42report.c). Its qbn is the rotation from N to
the first body's frame B with the scalar last: v_B = C(q) v_N, as in this package. Its wheel
momentum H obeys H' = motor torque: it is the whole axial momentum, J_s (wheel speed + g.w).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import read_bytes, vocabulary
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.raw_table import RawColumn, RawTable, StatedAttitude
from bayes_inertia.tables.text_cells import TextOptions, decoded
from bayes_inertia.tables.text_table import read_text_table

# Number of columns (0: any), and unit, of each output.
_UNITS = MappingProxyType(vocabulary("tables")["nasa_42"])
_UTC = re.compile(r"\s*(\d{4}):(\d{1,2}):(\d{1,2}):(\d{1,2}):(\d{2}):(\d{2}\.\d+)\s*")
_OPTIONS = TextOptions(delimiter="whitespace", decimal=".", header_line=-1, units_line=-1)


def read_42(path: Path) -> RawTable:
    """The columns of an output of 42, such as qbn[0], with the stamps of the time.42 beside it.

    Columns of a file that is not known are c1, c2, ...
    """
    stem = path.stem
    if stem == "UTC":
        return _utc(path)
    table = read_text_table(path, _OPTIONS)
    count, unit = _UNITS.get(stem, (0, ""))
    found = len(table.columns)
    if count and found != count:
        raise CampaignError(
            f"{found} columns, but 42 writes {count}", where=str(path), advice="write it again"
        )
    columns = {
        _name(stem, index, found): RawColumn(column.values, unit, column.single, column.exact)
        for index, column in enumerate(table.columns.values())
    }
    notes = _notes(path, stem, columns)
    columns = {**_stamps(path, table.rows), **columns}
    attitude = None
    if stem == "qbn":
        attitude = StatedAttitude(tuple(f"qbn[{i}]" for i in range(4)), "last", "N", "BODY")
    timed = "time" in columns
    return RawTable(
        str(path),
        columns,
        table.lines,
        ("time",) if timed else (),
        "s" if timed else "",
        attitude,
        notes,
    )


def _name(stem: str, index: int, count: int) -> str:
    if stem not in _UNITS:
        return f"c{index + 1}"
    return stem if count == 1 else f"{stem}[{index}]"


def _stamps(path: Path, rows: int) -> dict[str, RawColumn]:
    """The time of each row, from the file that 42 writes beside all others."""
    beside = path.with_name("time.42")
    if path.stem in ("time", "DynTime") or not beside.is_file():
        return {}
    time = next(iter(read_text_table(beside, _OPTIONS).columns.values()))
    if time.values.size != rows:
        raise CampaignError(
            f"{rows} rows, but {beside.name} beside it has {time.values.size}",
            where=str(path),
            advice="take both from one run",
        )
    return {"time": RawColumn(time.values, "s")}


def _notes(path: Path, stem: str, columns: Mapping[str, RawColumn]) -> tuple[str, ...]:
    """Say where the six decimals that 42 writes leave few digits."""
    if stem not in ("Hwhl", "MTB", "Thr"):
        return ()
    size = max(
        (float(np.abs(c.values).max()) for c in columns.values() if not c.is_text), default=0.0
    )
    if size >= 10.0 ** (LIMITS.least_digits - 6):
        return ()
    return (
        f"{path.name}: 42 writes six decimals, so a reading of up to {size:.3g} {_UNITS[stem][1]} "
        'is rounded to 1e-6; "%le" instead of "%lf" in 42report.c keeps seven digits',
    )


def _utc(path: Path) -> RawTable:
    """UTC.42: year:month:day:hour:minute:second, as ISO 8601."""
    texts, numbers = [], []
    for number, line in enumerate(decoded(read_bytes(path), str(path)).splitlines(), start=1):
        if not line.strip():
            continue
        match = _UTC.fullmatch(line)
        if match is None:
            raise CampaignError(
                f"{line.strip()[:40]!r} is no time as 42 writes it",
                where=f"{path}, line {number}",
                advice="write it again",
            )
        year, month, day, hour, minute = (int(part) for part in match.groups()[:5])
        texts.append(f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{match[6]}Z")
        numbers.append(number)
    column = RawColumn(np.array(texts, dtype=np.dtypes.StringDType()))
    return RawTable(str(path), {"UTC": column}, np.array(numbers), ("UTC",), "utc")
