"""The readings of a stream from the cells of a table: units, scales, flags and marks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.attitude_forms import (
    AttitudeConvention,
    bad_attitude,
    from_tracker_axes,
    rounding_of_attitudes,
    to_quaternions,
    without_solution,
)
from bayes_inertia.importing.mapping_schema import (
    AttitudeStream,
    MappedStream,
    ReadingsStream,
    TorqueStream,
    ValidRows,
)
from bayes_inertia.importing.noise_fit import rounding_sigmas
from bayes_inertia.importing.raw_table import RawTable, number_of
from bayes_inertia.importing.stated_facts import agreed_attitude, agreed_unit
from bayes_inertia.importing.unit_factors import to_si_with

# Quaternions of one length, but for this share of it, are counts; this share of the rows must be.
_EVEN_LENGTH = 1e-3
_MOST = 0.9


@dataclass(frozen=True, eq=False)
class TableReadings:
    """What one table holds of a stream.

    Parameters
    ----------
    values : (rows, width) array
        In SI units and the package's senses; NaN where there is no reading.
    rounding : tuple of float
        Standard deviation of the rounding, as of `LoggedStream`.
    notes : tuple of str
        What was taken for no reading, for people.
    """

    values: np.ndarray
    rounding: tuple[float, ...]
    notes: tuple[str, ...]


def readings_of(part: MappedStream, table: RawTable, where: str) -> TableReadings:
    """The readings of a stream in one table.

    Parameters
    ----------
    part : MappedStream
        What the mapping says of the stream.
    table : RawTable
        The table.
    where : str
        The stream's key of the mapping, for messages.

    Returns
    -------
    TableReadings
        One row for each row of the table.

    Raises
    ------
    CampaignError
        If a column is absent or no number, a row is no attitude, or mapping and file contradict.
    """
    flagged = np.zeros((1, 1), dtype=bool)
    notes = []
    if part.valid is not None:
        flagged = ~_valid_rows(part.valid, table, where)[:, None]
        notes.append(f"{int(flagged.sum())} rows are flagged as not valid")
    if isinstance(part, AttitudeStream):
        values, rounding, marked = _attitudes(part, table, flagged, where)
    else:
        values, rounding, marked = _readings(part, table, flagged, where)
    return TableReadings(values, rounding, (*notes, *([marked] if marked else [])))


def _marks(part: MappedStream, numbers: np.ndarray) -> np.ndarray:
    """Which numbers of the file are marks of "no reading"."""
    return np.isin(numbers, [] if part.missing is None else part.missing)


def _readings(
    part: ReadingsStream, table: RawTable, flagged: np.ndarray, where: str
) -> tuple[np.ndarray, tuple[float, ...], str]:
    """Columns in SI units, torques on the wheel; their rounding; what was taken for no reading."""
    columns, marked = [], 0
    for k, name in enumerate(part.names):
        unit = agreed_unit(table, name, part.holds, part.unit, where)
        scale, offset = (v[k] if isinstance(v, list) else v for v in (part.scale, part.offset))
        numbers = table.numbers(name)
        marks = _marks(part, numbers)
        marked += int(marks.sum())
        numbers = np.where(marks, np.nan, numbers)
        columns.append(to_si_with(numbers, unit, part.holds, scale=scale, offset=offset))
    values = np.where(flagged, np.nan, np.stack(columns, axis=1))
    rounding = rounding_sigmas(values)
    # 0 - values, because -values would make zeros negative.
    body = isinstance(part, TorqueStream) and part.acts_on == "body"
    said = f"{marked} cells hold a mark of no reading ({part.missing})" if marked else ""
    return 0.0 - values if body else values, rounding, said


def _attitudes(
    part: AttitudeStream, table: RawTable, flagged: np.ndarray, where: str
) -> tuple[np.ndarray, tuple[float, ...], str]:
    """Quaternions, body from inertial, scalar last; rounding [rad]; what was taken for no fix."""
    names, convention, of_tracker = agreed_attitude(table, part, where)
    read = np.where(flagged, np.nan, table.stack(names))
    values = read * np.array(part.scale)
    without = without_solution(values, convention, _marks(part, read))
    said = ""
    if without.any():
        texts = ", ".join(f"{value:.6g}" for value in np.unique(read[without])[:4])
        said = f"{int(without.sum())} rows hold {texts} in all of {', '.join(names)}: no fix"
        values = np.where(without[:, None], np.nan, values)
    problem = bad_attitude(values, convention)
    if problem is not None:
        row, what = problem
        raise CampaignError(
            f"{what}: {read[row].tolist()}",
            where=f"{table.place(row, names[0])} to {names[-1]}",
            advice=_counts(values, convention)
            or "repair the row, leave all its cells empty, say `missing = ...` in the mapping if "
            "it marks no fix, or name other columns there",
        )
    quaternions = to_quaternions(values, convention)
    rounding = rounding_of_attitudes(values, convention, rounding_sigmas(values))
    if of_tracker:
        quaternions = from_tracker_axes(quaternions, np.array(part.body_from_tracker))
    return quaternions, (rounding,), said


def _counts(values: np.ndarray, convention: AttitudeConvention) -> str:
    """What to do with quaternions that all have one length other than 1; "" if they have not."""
    lengths = np.linalg.norm(values, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    length = float(np.median(lengths)) if len(lengths) else 0.0
    even = np.abs(lengths - length) <= _EVEN_LENGTH * length
    if convention.form != "quaternion" or length == 0.0 or even.mean() < _MOST:
        return ""
    return f"if these are counts, add scale = {1.0 / length:.10g} to the stream of the mapping"


def _valid_rows(valid: ValidRows, table: RawTable, where: str) -> np.ndarray:
    column = table.column(valid.name)
    accepted = valid.equals if isinstance(valid.equals, list) else [valid.equals]
    if column.is_text:
        cells = np.array([str(cell).strip() for cell in column.values.tolist()])
        rows = np.isin(cells, [str(value) for value in accepted])
    else:
        numbers = [number_of(v) if isinstance(v, str) else float(v) for v in accepted]
        rows = np.isin(column.values.astype(float), numbers)
    if not rows.any():
        present = ", ".join(repr(v) for v in np.unique(column.values)[:8].tolist())
        raise CampaignError(
            f"no row has {valid.name} = {valid.equals!r}",
            where=f"{where}.valid.equals",
            advice=f"the column has {present}",
        )
    return rows
