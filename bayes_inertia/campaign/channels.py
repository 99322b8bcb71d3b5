"""From the columns of a table to the channels of a slew: checks by line, units, signs, senses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.campaign.schema import AttitudeColumns, ColumnsPart, TimeColumn
from bayes_inertia.campaign.slew import bad_quaternion
from bayes_inertia.campaign.table import Table
from bayes_inertia.campaign.units import to_si
from bayes_inertia.errors import CampaignError

_ENVIRONMENT = {
    "magnetic_field": "magnetic_field_N",
    "position": "position_N",
}


def slew_from_table(
    table: Table, columns: ColumnsPart, spin_inertias: np.ndarray
) -> dict[str, np.ndarray | None]:
    """The channels of a slew, in SI units, with the package's signs and senses.

    A star tracker or an environment whose columns are all empty is left out.

    Parameters
    ----------
    table : Table
        The telemetry, in the file's own units.
    columns : ColumnsPart
        What each column means.
    spin_inertias : (wheels,) array
        Spin inertia of each wheel [kg m^2], to turn wheel speed into momentum.

    Returns
    -------
    dict of str to array or None
        Channels (rows, width), named as `Slew` names them.

    Raises
    ------
    CampaignError
        If a cell is empty that must not be, times do not increase, or a quaternion is bad; the
        error names the line.
    """
    given = columns.given()
    channels: dict[str, np.ndarray | None] = {"time": _time(table, columns.time)}
    _refuse_empty_columns(table, columns.rate.names)
    channels["rate"] = to_si(table.stack(columns.rate.names), "rate", columns.rate.unit)
    for key in ("wheel_torque", "wheel_momentum", "wheel_speed"):
        if key in given:
            _refuse_empty_cells(
                table,
                given[key].names,
                "the simulator needs every wheel at every row: "
                "repair the row, or leave the columns out of [columns]",
            )
            values = to_si(table.stack(given[key].names), key, given[key].unit)
            if key == "wheel_torque" and given[key].acts_on == "body":
                values = 0.0 - values  # not -values, which makes zeros negative
            channels["wheel_momentum" if key == "wheel_speed" else key] = (
                values * spin_inertias if key == "wheel_speed" else values
            )
    if columns.attitude is not None:
        channels["attitude"] = _attitude(table, columns.attitude)
    for key, channel in _ENVIRONMENT.items():
        if key in given and not _all_empty(table, given[key].names):
            _refuse_empty_cells(
                table,
                given[key].names,
                "fill every row, or leave the columns of this slew entirely empty",
            )
            channels[channel] = to_si(table.stack(given[key].names), key, given[key].unit)
    return channels


def _all_empty(table: Table, names: Sequence[str]) -> bool:
    return bool(np.isnan(table.stack(names)).all())


def _refuse_empty_columns(table: Table, names: Sequence[str]) -> None:
    for name in names:
        if np.isnan(table.columns[name]).all():
            raise CampaignError(
                "every cell is empty",
                where=f"{table.label}, column {name}",
                advice="export it again, or leave the slew out",
            )


def _refuse_empty_cells(table: Table, names: Sequence[str], advice: str) -> None:
    _refuse_empty_columns(table, names)
    empty = np.isnan(table.stack(names))
    if empty.any():
        row = int(np.argmax(empty.any(axis=1)))
        raise CampaignError(
            "the cell is empty",
            where=table.place(row, names[int(np.argmax(empty[row]))]),
            advice=advice,
        )


def _time(table: Table, column: TimeColumn) -> np.ndarray:
    name = column.names[0]
    raw = table.columns[name]
    if len(raw) < 2:
        raise CampaignError(
            f"{len(raw)} row(s) of telemetry", where=table.label, advice="a slew needs at least two"
        )
    _refuse_empty_cells(table, [name], "every row needs its time: remove or repair the row")
    with np.errstate(over="ignore"):
        step = np.diff(raw)
    bad = step <= 0.0
    if name in table.single and float(np.spacing(np.float32(np.abs(raw).max()))) > 0.01 * abs(
        float(np.median(step))
    ):
        raise CampaignError(
            "times stored with 32 bits are too coarse for their spacing",
            where=f"{table.label}, column {name}",
            advice="store time with 64 bits, or count it from the start of the slew",
        )
    if bad.any():
        row = int(np.argmax(bad)) + 1
        now, before = (repr(float(x)) for x in (raw[row], raw[row - 1]))
        what = (
            f"the time {now} is repeated"
            if step[row - 1] == 0.0
            else f"the time goes back from {before} to {now}"
        )
        raise CampaignError(
            f"{what} (after {table.row(row - 1)})",
            where=table.place(row, name),
            advice="sort the rows and drop repeated times",
        )
    return to_si(raw, "time", column.unit)


def _attitude(table: Table, column: AttitudeColumns) -> np.ndarray | None:
    if _all_empty(table, column.names):
        return None
    quaternion = table.stack(column.names)
    problem = bad_quaternion(quaternion)
    if problem is not None:
        row, what = problem
        where = f"{table.place(row)}, columns {', '.join(column.names)}"
        raise CampaignError(
            f"{what}: {quaternion[row].tolist()}",
            where=where,
            advice="repair the row, or leave all four cells empty (no fix)",
        )
    if column.scalar == "first":
        quaternion = quaternion[:, [1, 2, 3, 0]]
    # The inverse rotation is the conjugate; the scalar's sign is kept.
    return quaternion * ([-1.0, -1.0, -1.0, 1.0] if column.maps == "body_to_inertial" else 1.0)
