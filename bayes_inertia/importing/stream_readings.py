"""The readings of a stream from the cells of a table: units, scales, flags and marks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.noise_fit import rounding_sigmas
from bayes_inertia.importing.attitude_forms import (
    AttitudeConvention,
    bad_attitude,
    from_tracker_axes,
    rounding_of_attitudes,
    to_quaternions,
    without_solution,
)
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.mapping_schema import (
    AttitudeStream,
    MappedStream,
    ReadingsStream,
    TorqueStream,
    ValidRows,
)
from bayes_inertia.importing.stated_facts import agreed_attitude, agreed_unit
from bayes_inertia.importing.unit_factors import to_si_with, unit_factor
from bayes_inertia.tables.raw_table import RawTable, number_of


@dataclass(frozen=True, eq=False)
class TableReadings:
    """Readings of a stream in one table.

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
    """The readings of a stream in one table."""
    flagged = np.zeros((1, 1), dtype=bool)
    notes = []
    if part.valid is not None:
        flagged = ~_valid_rows(part.valid, table, where)[:, None]
        notes.append(f"{int(flagged.sum())} rows are flagged as not valid")
    if isinstance(part, AttitudeStream):
        values, rounding, said = _attitudes(part, table, flagged, where)
    else:
        values, rounding, said = _readings(part, table, flagged, where)
    return TableReadings(values, rounding, (*notes, *said))


def _marks(part: MappedStream, numbers: np.ndarray) -> np.ndarray:
    """Which numbers of the file are marks of "no reading"."""
    return np.isin(numbers, [] if part.missing is None else part.missing)


def _readings(
    part: ReadingsStream, table: RawTable, flagged: np.ndarray, where: str
) -> tuple[np.ndarray, tuple[float, ...], list[str]]:
    """Columns in SI units, torques on the wheel; their rounding; what was taken for no reading."""
    read = table.stack(part.names)
    marks = _marks(part, read)
    read = np.where(flagged | marks, np.nan, read)
    roundings = rounding_sigmas(read)
    values = np.empty_like(read)
    for k, name in enumerate(part.names):
        unit = agreed_unit(table, name, part.holds, part.unit, where)
        scale, offset = (v[k] if isinstance(v, list) else v for v in (part.scale, part.offset))
        values[:, k] = to_si_with(read[:, k], unit, part.holds, scale=scale, offset=offset)
        roundings[k] *= abs(scale) * unit_factor(part.holds, unit)
    # 0 - values, because -values would make zeros negative.
    body = isinstance(part, TorqueStream) and part.acts_on == "body"
    said = [f"{marks.sum()} cells hold {part.missing}, a mark of no reading"] if marks.any() else []
    counts = np.isfinite(values).sum(axis=0)
    fewest = int(np.argmin(counts))
    # Commands may change one by one.
    if counts[fewest] < (
        1 if isinstance(part, TorqueStream) else LIMITS.complete_column * counts.max()
    ):
        said.append(f"{part.names[fewest]} has {counts[fewest]} readings, others {counts.max()}")
    return 0.0 - values if body else values, tuple(roundings.tolist()), said


def _attitudes(
    part: AttitudeStream, table: RawTable, flagged: np.ndarray, where: str
) -> tuple[np.ndarray, tuple[float, ...], list[str]]:
    """Quaternions, body from inertial, scalar last; rounding [rad]; what was taken for no fix."""
    names, convention, of_tracker = agreed_attitude(table, part, where)
    read = np.where(flagged, np.nan, table.stack(names))
    values = read * np.array(part.scale)
    without = without_solution(values, convention, _marks(part, read))
    said = []
    if without.any():
        texts = ", ".join(f"{value:.6g}" for value in np.unique(read[without])[:4])
        said = [f"{int(without.sum())} rows hold {texts} in all of {', '.join(names)}: no fix"]
        values = np.where(without[:, None], np.nan, values)
    problem = bad_attitude(values, convention)
    if problem is not None:
        row, what = problem
        raise CampaignError(
            f"{what}: {read[row].tolist()}",
            where=f"{table.place(row, names[0])} to {names[-1]}",
            advice=_advice_on(row, read, convention, part.scale != 1.0),
        )
    if not np.isfinite(values).any():
        said.append("no row holds a fix")
    quaternions = to_quaternions(values, convention)
    # Of the numbers in the file: decimals are not seen once they are scaled.
    roundings = rounding_sigmas(np.where(np.isnan(values), np.nan, read)) * np.abs(part.scale)
    rounding = rounding_of_attitudes(values, convention, roundings)
    if of_tracker:
        quaternions = from_tracker_axes(quaternions, np.array(part.body_from_tracker))
    return quaternions, (rounding,), said


def _advice_on(row: int, read: np.ndarray, convention: AttitudeConvention, scaled: bool) -> str:
    """Advice on a row that is no attitude."""
    different = np.unique(read[np.isfinite(read).all(axis=1)], axis=0)
    lengths = np.linalg.norm(different, axis=1)
    length = max(float(np.median(lengths)), 1e-300) if len(lengths) else 1.0
    even = (
        len(different) > 1
        and np.mean(np.abs(lengths / length - 1.0) <= LIMITS.even_length) >= LIMITS.most_even_rows
    )
    counts = convention.form == "quaternion" and even and abs(length - 1.0) > LIMITS.even_length
    if counts and not scaled:
        return f"if these are counts, add scale = {1.0 / length:.10g} to the stream"
    if (read == read[row]).all(axis=1).sum() > 1:
        marks = ", ".join(f"{number:.10g}" for number in np.unique(read[row]))
        return f"if such rows mark that there is no fix, add missing = [{marks}] to the stream"
    return (
        "repair the row, leave all its cells empty (no fix), or name other columns in the mapping"
    )


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
