"""From the columns of a table to the channels of a slew: checks by line, units, signs, senses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bayes_inertia.campaign.gaps import is_regular
from bayes_inertia.campaign.schema import (
    AttitudeColumns,
    ColumnsPart,
    MagneticFieldColumns,
    MomentumColumns,
    PositionColumns,
    RateColumns,
    SpeedColumns,
    TorqueColumns,
)
from bayes_inertia.campaign.slew import bad_quaternion
from bayes_inertia.campaign.streams import Stream
from bayes_inertia.campaign.units import to_si
from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.number_table import Table

# Entry of [columns] -> field of `Slew`.
_CHANNELS = {
    "rate": "rate",
    "wheel_torque": "wheel_torque",
    "wheel_momentum": "wheel_momentum",
    "wheel_speed": "wheel_momentum",
    "attitude": "attitude",
    "magnetic_field": "magnetic_field_N",
    "position": "position_N",
}


def stream_from_table(
    table: Table, columns: ColumnsPart, stream: Stream, spin_inertias: np.ndarray
) -> dict[str, np.ndarray]:
    """The channels of a stream, in SI units, with the package's signs and senses.

    A star tracker or an environment whose columns are all empty is left out.

    `table`: the telemetry, in the file's own units and in the order of time. `stream`: which
    entries of `columns` to take from the table, and their clock. `spin_inertias` (wheels,): spin
    inertia of each wheel [kg m^2], to turn wheel speed into momentum. Returns: channels (rows,
    width), named as `Slew` names them, and their true "time" (rows,) [s].
    """
    time = to_si(table.columns[stream.time.names[0]], "time", stream.time.unit)
    # Adding nothing would make a zero of -0.0.
    channels = {"time": time + stream.offset_s if stream.offset_s else time}
    readers: dict[str, Callable[[Table, Any], np.ndarray | None]] = {
        "rate": _rate,
        "wheel_torque": lambda table, entry: _torque(table, entry, time),
        "wheel_momentum": _momentum,
        "wheel_speed": _momentum,
        "attitude": _attitude,
    }
    for key in stream.keys:
        entry = getattr(columns, key)
        reader = readers.get(key)
        values = reader(table, entry) if reader else _environment(table, entry, key)
        if values is not None:
            speed = key == "wheel_speed"
            channels[_CHANNELS[key]] = values * spin_inertias if speed else values
    return channels


def _rate(table: Table, entry: RateColumns) -> np.ndarray:
    _refuse_empty_columns(table, entry.names)
    return to_si(table.stack(entry.names), "rate", entry.unit)


def _torque(table: Table, entry: TorqueColumns, time: np.ndarray) -> np.ndarray:
    _refuse_empty_columns(table, entry.names)
    values = to_si(table.stack(entry.names), "wheel_torque", entry.unit)
    missing = np.isnan(values).any(axis=1)
    if not is_regular(time[~missing]):
        # A log of changes does not show that a command is missing.
        advice = "repair the row: commands that come at no regular step need every wheel"
        _refuse_half_empty_rows(table, entry.names, advice)
    # Without one wheel's command, what all wheels did is unknown.
    values = np.where(missing[:, None], np.nan, values)
    # 0 - values, because -values would make zeros negative.
    return 0.0 - values if entry.acts_on == "body" else values


def _momentum(table: Table, entry: MomentumColumns | SpeedColumns) -> np.ndarray:
    _refuse_empty_columns(table, entry.names)
    speed = isinstance(entry, SpeedColumns)
    return to_si(table.stack(entry.names), "wheel_speed" if speed else "wheel_momentum", entry.unit)


def _environment(
    table: Table, entry: MagneticFieldColumns | PositionColumns, key: str
) -> np.ndarray | None:
    if _all_empty(table, entry.names):
        return None
    _refuse_half_empty_rows(table, entry.names, "fill all three cells, or leave all three empty")
    return to_si(table.stack(entry.names), key, entry.unit)


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


def _refuse_half_empty_rows(table: Table, names: Sequence[str], advice: str) -> None:
    """Refuse columns that are empty everywhere, and rows of which some cells are given."""
    _refuse_empty_columns(table, names)
    empty = np.isnan(table.stack(names))
    _refuse_empty_cells(table, names, empty & ~empty.all(axis=1, keepdims=True), advice)


def _refuse_empty_cells(table: Table, names: Sequence[str], empty: np.ndarray, advice: str) -> None:
    if empty.any():
        row = int(np.argmax(empty.any(axis=1)))
        raise CampaignError(
            "the cell is empty",
            where=table.place(row, names[int(np.argmax(empty[row]))]),
            advice=advice,
        )


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
