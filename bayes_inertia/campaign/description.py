"""What `campaign.toml` says: hardware, columns, tables of slews."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bayes_inertia.campaign.actuators import Actuator, Change
from bayes_inertia.campaign.format_2 import SlewPart
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.schema import PriorPart, TimeColumn
from bayes_inertia.errors import CampaignError

# Where a slew has what is called otherwise.
FIELDS: Mapping[str, str] = {
    "magnetic_field": "magnetic_field_N",
    "position": "position_N",
    "wheel_speed": "wheel_momentum",
}


@dataclass(frozen=True)
class Entry:
    """What some columns of the tables hold."""

    key: str  # Its kind: "rate", "wheel_torque", "attitude", "direction", "magnetic_field", ...
    # Of `Slew`, where it goes; "more.NAME" for a further sensor, "inputs.NAME" for a device
    field: str
    columns: Any  # Its names, unit, sense and clock: a form of `OfStream`
    # Its key in the file, such as "sensors.gyro.rate"; one a column where each has its own
    paths: tuple[str, ...]
    # The wheels that the columns are of, counted from 0; empty: of none
    wheels: tuple[int, ...] = ()

    @property
    def path(self) -> str:
        """Its key in the description, or the first of them."""
        return self.paths[0]

    def path_of(self, column: int) -> str:
        """The key of one of its columns."""
        return self.paths[column if self.wheels else 0]


@dataclass(frozen=True)
class Description:
    """The content of a `campaign.toml`."""

    name: str  # The campaign
    time: TimeColumn  # The time of every entry that has no other
    entries: tuple[Entry, ...]  # What the tables hold
    slews: tuple[SlewPart, ...]  # In which tables
    inertia: InertiaPrior
    wheels: tuple[Wheel, ...]
    rate_sensor: RateSensor | None
    star_tracker: StarTracker | None
    mission: tuple[tuple[str, str], ...]
    prior: PriorPart | None  # The former result that takes the place of other knowledge
    more_sensors: tuple[tuple[str, Any], ...] = ()
    names: tuple[str, str] = ("rate sensor", "star tracker")
    reference: str | None = None
    actuators: tuple[Actuator, ...] = ()
    changes: tuple[Change, ...] = ()
    # A file of two-line elements, and UTC at time zero of the campaign
    orbit: tuple[str, str] | None = None
    # What a file of format 2 calls a table of format 1, such as "wheels"; empty in format 1
    devices: Mapping[str, str] = field(default_factory=dict)

    def clock(self, entry: Entry) -> TimeColumn:
        """The time of an entry."""
        return self.time if entry.columns.time is None else entry.columns.time

    def tables(self, slew: SlewPart) -> list[str]:
        """The tables of a slew, each once."""
        given = (slew.file_of(entry.columns) for entry in self.entries)
        return list(dict.fromkeys(file for file in given if file is not None))


AS_CAMPAIGN = (
    *("name", "inertia", "wheels", "rate_sensor", "star_tracker", "mission", "more_sensors"),
    *("names", "reference", "actuators", "changes"),
)
"""What a `Campaign` has as its description does."""

# A field in body axes that the description does not call the same without its "_B".
_KEY, _FIELD = "torques", "torque_B"


def keys_of(hardware: Any) -> dict[str, Any]:
    """The fields of hardware, as keys of the description; none of None."""
    stated = {} if hardware is None else vars(hardware)
    return {_KEY if f == _FIELD else f.removesuffix("_B"): value for f, value in stated.items()}


def stated_keys(part: Any) -> dict[str, Any]:
    """The keys of a part of the description that are there."""
    return {
        key: value for key in type(part).model_fields if (value := getattr(part, key)) is not None
    }


def built(kind: Any, part: Any, was: str = "", now: str = "", **more: Any) -> Any:
    """Hardware of a part; errors say `now` where the record's own key is `was`."""
    known, given = kind.__dataclass_fields__, more
    for key, value in stated_keys(part).items():
        in_body_axes = _FIELD if key == _KEY else f"{key}_B"
        given |= {f: value for f in (key, in_body_axes) if f in known}
    try:
        return kind(**given)
    except CampaignError as error:
        where = error.where.replace(was, now) if was else error.where
        raise CampaignError(error.what, where=where, advice=error.advice) from None
