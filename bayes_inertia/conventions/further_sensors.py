"""Further sensors, each held against the laws in place of the first one of its kind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Description
from bayes_inertia.campaign.hardware import RateSensor, StarTracker

_KINDS = {RateSensor: ("rate", "rate_sensor"), StarTracker: ("attitude", "star_tracker")}


def in_place_of_the_first(campaign: Campaign) -> Iterator[tuple[str, Campaign]]:
    """For each further rate sensor and star tracker, its name and a campaign that has it alone."""
    for name, hardware in campaign.more_sensors:
        if type(hardware) not in _KINDS:
            continue
        key, of_hardware = _KINDS[type(hardware)]
        slews = []
        for slew in campaign.slews:
            readings = (slew.more or {}).get(name)
            changed: dict[str, Any] = {"more": None, key: readings}
            slews += [] if readings is None else [replace(slew, **changed)]
        if slews:
            alone: dict[str, Any] = {of_hardware: hardware, "slews": tuple(slews), "dirt": ()}
            yield name, replace(campaign, more_sensors=(), **alone)


def unheld(campaign: Campaign) -> list[str]:
    """Names of sensors that no law here is held against."""
    return [name for name, hardware in campaign.more_sensors if type(hardware) not in _KINDS]


def description_for(description: Description | None, name: str) -> Description | None:
    """What the description says of a further sensor, as if it were the first of its kind."""
    if description is None:
        return None
    entry = next(e for e in description.entries if e.field == f"more.{name}")
    first = replace(entry, field=entry.key)
    others = [e for e in description.entries if e.field != entry.key and e is not entry]
    table = "rate_sensor" if entry.key == "rate" else "star_tracker"
    devices = {**description.devices, table: f"sensors.{name}"}
    return replace(description, entries=(first, *others), devices=devices)
