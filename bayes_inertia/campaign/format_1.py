"""Format 1 of `campaign.toml`: one function rewrites it to format 2; messages keep its own keys."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from bayes_inertia.campaign.hardware import require_key
from bayes_inertia.campaign.schema import FORMAT_2, Names, Part
from bayes_inertia.errors import CampaignError

_Keys = dict[str, Any]


class WheelColumns(Part):
    """`wheel_torque`, `wheel_momentum` or `wheel_speed` of `[columns]`."""

    model_config = ConfigDict(extra="allow")

    names: Names = Field(description='names = ["...", ...], one column a wheel')


class ColumnsPart(Part):
    """`[columns]`: which entries there are."""

    time: _Keys = Field(description='time = { names = ["..."], unit = "s" }')
    rate: _Keys = Field(description='rate = { names = ["...", "...", "..."], unit = "rad/s" }')
    wheel_torque: WheelColumns | None = None
    wheel_momentum: WheelColumns | None = None
    wheel_speed: WheelColumns | None = None
    attitude: _Keys | None = None
    magnetic_field: _Keys | None = None
    position: _Keys | None = None


class Tables(Part):
    """Which tables there are. What stands in them is checked when they are those of format 2."""

    # What to do with a key of the other format.
    other_format: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("actuators", "sensors", "environment", "changes", "time"),
        f'it is of format 2: write format = "{FORMAT_2}", and [[sensors]], [[actuators]] in place '
        "of [columns]",
    )

    # A file of format 2 has another form; here its name stands for messages.
    format: Literal["bayes-inertia-campaign/1", "bayes-inertia-campaign/2"]
    rate_sensor: _Keys = Field(description="[rate_sensor] with at least sigma")
    columns: ColumnsPart = Field(description="[columns] with at least time and rate")
    wheels: list[_Keys] = Field(default=[])
    star_tracker: _Keys | None = None
    name: Any = None
    inertia: Any = None
    slews: Any = None
    mission: Any = None
    prior: Any = None


# What a wheel of format 2 calls its columns, and the tables of the sensors.
_OF_WHEEL = {"wheel_torque": "torque", "wheel_momentum": "momentum", "wheel_speed": "speed"}
_SENSORS = {"rate": "rate_sensor", "attitude": "star_tracker"}
_ENVIRONMENT = ("magnetic_field", "position")
_AS_THEY_ARE = ("name", "inertia", "slews", "mission", "prior")


def upgrade(content: Mapping[str, Any]) -> dict[str, Any]:
    """A document that has the form of `Tables`, rewritten to format 2 with every value as it is.

    Each entry of `[columns]` is a stream of its name.
    """
    columns = {k: _with(v, f"columns.{k}", stream=k) for k, v in content["columns"].items()}
    del columns["time"]["stream"]
    actuators = []
    read = [(columns[old], new) for old, new in _OF_WHEEL.items() if old in columns]
    for k, wheel in enumerate(content.get("wheels", [])):
        own = {new: stated | {"names": stated["names"][k : k + 1]} for stated, new in read}
        actuators.append(_with(wheel, f"wheels.{wheel.get('name')}", type="wheel", **own))
    for key in (key for key in _OF_WHEEL if key in columns):
        count = len(columns[key]["names"])
        what = f"{count} column(s) for {len(actuators)} [[wheels]]"
        advice = "name one column a wheel, in the same order"
        require_key(count == len(actuators), f"columns.{key}.names", what, advice)
    tracked = "attitude" not in columns or "star_tracker" in content
    advice = "add [star_tracker] with boresight and sigmas, or leave the columns out"
    require_key(tracked, "columns.attitude", "no [star_tracker]", advice)
    sensors = []
    for kind, table in _SENSORS.items():
        if table in content or kind in columns:
            named = {"name": table.replace("_", " "), **content.get(table, {})}
            sensors.append(_with(named, table, type=kind, **{kind: columns.get(kind)}))
    environment = [
        {"name": key, "type": key, "vector": columns[key]} for key in _ENVIRONMENT if key in columns
    ]
    return {
        **{key: value for key, value in content.items() if key in _AS_THEY_ARE},
        **{"format": FORMAT_2, "time": columns["time"], "actuators": actuators},
        **{"sensors": sensors, "environment": environment},
    }


def _with(table: Mapping[str, Any], path: str, **more: Any) -> dict[str, Any]:
    """A table with keys that only format 2 has."""
    for key in table.keys() & more.keys():
        advice = "leave it out: it is of format 2"
        raise CampaignError("unknown key", where=f"key {path}.{key}", advice=advice)
    return {**table, **more}


def keys_as_written(upgraded: Mapping[str, Any]) -> Callable[[str], str]:
    """From a text about a document that `upgrade` returns to one in the keys of its file."""
    keys = {"actuators": "wheels", "key time": "key columns.time"}
    keys |= {f"environment.{key}.vector": f"columns.{key}" for key in _ENVIRONMENT}
    for wheel in upgraded["actuators"]:
        place = f"actuators.{wheel.get('name')}"
        keys |= {f"{place}.{new}": f"columns.{old}" for old, new in _OF_WHEEL.items()}
    for sensor in upgraded["sensors"]:
        place, kind = f"sensors.{sensor['name']}", sensor["type"]
        keys |= {place: _SENSORS[kind], f"{place}.{kind}": f"columns.{kind}"}
    # A message tells where a stray key belongs.
    keys |= {f'[[sensors]] with type = "{kind}"': f"[{table}]" for kind, table in _SENSORS.items()}
    keys['[[actuators]] with type = "wheel"'] = "[[wheels]]"
    longest_first = "|".join(map(re.escape, sorted(keys, key=len, reverse=True)))
    return partial(re.sub, rf"({longest_first})(?!\w)", lambda match: keys[match[0]])
