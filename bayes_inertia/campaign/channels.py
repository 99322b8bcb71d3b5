"""From the columns of a table to the channels of a slew: checks by line, units, signs, senses."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.cells import all_empty, refuse_empty_columns, refuse_half_empty_rows
from bayes_inertia.campaign.schema import (
    ColumnsPart,
    MagneticFieldColumns,
    PositionColumns,
    TorqueColumns,
)
from bayes_inertia.campaign.sensors import BY_KEY
from bayes_inertia.campaign.streams import Stream
from bayes_inertia.campaign.units import to_si
from bayes_inertia.faults.gaps import is_regular
from bayes_inertia.tables.number_table import Table

# Entry of [columns] -> field of `Slew`, of the environment.
_ENVIRONMENT = {"magnetic_field": "magnetic_field_N", "position": "position_N"}


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
    for key in stream.keys:
        entry = getattr(columns, key)
        if key in BY_KEY:
            field, values = BY_KEY[key].field, BY_KEY[key].read(table, entry, spin_inertias)
        elif key in _ENVIRONMENT:
            field, values = _ENVIRONMENT[key], _environment(table, entry, key)
        else:
            field, values = key, _torque(table, entry, time)
        if values is not None:
            channels[field] = values
    return channels


def _torque(table: Table, entry: TorqueColumns, time: np.ndarray) -> np.ndarray:
    refuse_empty_columns(table, entry.names)
    values = to_si(table.stack(entry.names), "wheel_torque", entry.unit)
    missing = np.isnan(values).any(axis=1)
    if not is_regular(time[~missing]):
        # A log of changes does not show that a command is missing.
        advice = "repair the row: commands that come at no regular step need every wheel"
        refuse_half_empty_rows(table, entry.names, advice)
    # Without one wheel's command, what all wheels did is unknown.
    values = np.where(missing[:, None], np.nan, values)
    # 0 - values, because -values would make zeros negative.
    return 0.0 - values if entry.acts_on == "body" else values


def _environment(
    table: Table, entry: MagneticFieldColumns | PositionColumns, key: str
) -> np.ndarray | None:
    if all_empty(table, entry.names):
        return None
    refuse_half_empty_rows(table, entry.names, "fill all three cells, or leave all three empty")
    return to_si(table.stack(entry.names), key, entry.unit)
