"""Keys as a campaign's own description writes them; the check itself names those of format 1."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Description, Entry
from bayes_inertia.conventions.reading import KeyChange, Mistake

# A campaign built in memory is in SI units and has the package's senses.
_IN_MEMORY: dict[str, dict[str, Any]] = {
    "time": {"names": ["time"], "unit": "s"},
    "rate": {"names": ["rate_x", "rate_y", "rate_z"], "unit": "rad/s"},
    "wheel_torque": {"unit": "N m", "acts_on": "wheel"},
    "wheel_momentum": {"unit": "N m s", "relative_to": "body"},
    "attitude": {
        "names": ["q1", "q2", "q3", "q4"],
        "scalar": "last",
        "maps": "inertial_to_body",
    },
}


def stated_columns(
    campaign: Campaign, description: Description | None = None
) -> dict[str, Mapping[str, Any]]:
    """What a campaign states of its columns, under the keys of `[columns]`.

    A campaign in memory is in SI units. Wheels whose columns are in several units or tables are
    left out.

    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_columns(small_campaign())["rate"]["unit"]
    'rad/s'
    """
    if description is not None:
        stated: dict[str, Any] = {"rate": _rates_in_memory(0)}
        for entry in _first(description):
            if not entry.wheels or len(entry.wheels) == len(campaign.wheels):
                stated[entry.key] = entry.columns.model_dump()
        return {"time": description.time.model_dump(), **stated}
    axes = len(campaign.rate_sensor.axes) if campaign.rate_sensor else 0
    columns: dict[str, Mapping[str, Any]] = {"time": _IN_MEMORY["time"]}
    columns["rate"] = _rates_in_memory(axes)
    for key in ("wheel_torque", "wheel_momentum", "attitude"):
        if any(getattr(slew, key) is not None for slew in campaign.slews):
            names = [f"{key}.{wheel.name}" for wheel in campaign.wheels]
            columns[key] = {"names": names, **_IN_MEMORY[key]}
    return columns


def _rates_in_memory(axes: int) -> dict[str, Any]:
    names = [f"rate_{i + 1}" for i in range(axes)]
    return _IN_MEMORY["rate"] if axes == 3 else {"names": names, "unit": "rad/s"}


def _first(description: Description) -> Iterator[Entry]:
    """Entries of the sensors, wheels and environment that format 1 knows."""
    return (entry for entry in description.entries if "." not in entry.field)


def as_written(mistake: Mistake, description: Description | None) -> Mistake:
    """A mistake with the keys of the campaign's own description."""
    if description is None or not description.devices:
        return mistake
    entries = {entry.key: entry for entry in _first(description)}
    rewritten = [tuple(_rewritten(old, entries, description)) for old in mistake.changes]
    companions = sum(len(new) for new in rewritten[len(rewritten) - mistake.companions :])
    changes = tuple(new for each in rewritten for new in each)
    return replace(mistake, changes=changes, companions=companions)


def _rewritten(
    change: KeyChange, entries: Mapping[str, Entry], description: Description
) -> Iterator[KeyChange]:
    table, _, rest = change.key.partition(".")
    key, _, last = rest.rpartition(".")
    if table == "columns" and key in entries:
        entry = entries[key]
        for k, path in enumerate(entry.paths):
            stated, mended = change.stated, change.mended
            if last == "names" and len(entry.paths) > 1:
                stated, mended = [stated[k]], [mended[k]]
            if stated != mended:
                yield KeyChange(f"{path}.{last}", stated, mended)
    elif table == "wheels" and last == "momentum_sigma":
        yield replace(change, key=f"actuators.{key}.momentum.sigma")
    else:
        yield replace(change, key=in_words(change.key, description))


def in_words(text: str, description: Description | None) -> str:
    """A text in which keys are those of the campaign's own description."""
    if description is None or not description.devices:
        return text
    paths = {entry.key: _any_wheel(entry.paths) for entry in _first(description)}
    text = re.sub(r"\bcolumns\.(\w+)", lambda m: paths.get(m[1], m[1]), text)
    for old, new in description.devices.items():
        text = re.sub(rf"\b{re.escape(old)}\.", f"{new}.".replace("\\", r"\\"), text)
    return text


def _any_wheel(paths: Sequence[str]) -> str:
    """One key for those of all wheels."""
    if len(paths) == 1:
        return paths[0]
    return f"actuators.*.{paths[0].rpartition('.')[2]}"
