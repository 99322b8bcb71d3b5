"""Conventions that a campaign's telemetry says nothing about: by nature, or in this campaign."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.clocks import fixes_in_motion
from bayes_inertia.conventions.hypothesis import Mistake
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, DRIVE
from bayes_inertia.conventions.linear_fit import worst
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.reading import Reading

_TENSOR = MappingProxyType(
    {
        "inertia.includes_wheel_spin: the difference is within what J may be wrong by": (
            "inertia.includes_wheel_spin"
        ),
        "inertia.tensor: the sign of the products is within what they may be wrong by": (
            "the sign of the products of inertia"
        ),
    }
)
_WHEELS = MappingProxyType(
    {
        "a common sign of wheel torque, wheel momentum and wheel axes changes nothing": (
            "a common sign of wheel torque, momentum and axes"
        ),
        "a common factor of inertia, wheel torque and wheel momentum changes nothing but the "
        "inertia": "a common factor of inertia, torque and momentum",
    }
)
_TRACKER = MappingProxyType(
    {
        "a constant rotation of the star tracker's inertial axes changes nothing": (
            "the star tracker's inertial axes"
        ),
        "star_tracker.boresight: it only shares out the tracker's noise": "star_tracker.boresight",
    }
)
_AS_CONTENT = ": the data would be as content if "


def invisible(misfits: Misfits, stated: Reading, singles: Sequence[Mistake]) -> tuple[str, ...]:
    """What cannot be shown, in plain words.

    `singles`: mistakes; those that would leave the data as consistent are named.
    """
    laws = misfits.of(stated)
    said = [*_by_nature(misfits), *_without_telemetry(misfits, set(laws))]
    largest = limits.EQUAL_FACTOR * worst(laws) + limits.EQUAL_MISFIT
    for mistake in singles:
        if misfits.mends(mistake.mend(stated), min(largest, limits.ORDINARY)):
            keys = ", ".join(dict.fromkeys(change.key for change in mistake.changes))
            said.append(f"{keys}{_AS_CONTENT}{mistake.words}")
    return tuple(dict.fromkeys(said))


def invisible_in_brief(cannot_show: Sequence[str]) -> list[str]:
    """The same in a few lines: equal keys together, with how many other values they could have.

    Returns: one line each for what is missing, one for keys whose other values would do as well,
    and one for what no campaign shows.

    Examples
    --------
    >>> alike = "columns.time.unit: the data would be as content if time is in "
    >>> invisible_in_brief([f"{alike}ms, not in s", f"{alike}us, not in s", "no fixes"])
    ['no fixes', 'other values would do as well: columns.time.unit (2)']
    """
    brief: Mapping[str, str] = {**_TENSOR, **_WHEELS, **_TRACKER}
    nature = [brief[line] for line in cannot_show if line in brief]
    lines: list[str] = []
    others: dict[str, list[str]] = {}
    for line in cannot_show:
        keys, alike, words = line.partition(_AS_CONTENT)
        if alike:
            others.setdefault(_any_wheel(keys), []).append(words)
        elif line not in brief:
            lines.append(line)
    if others:
        counted = [
            f"{keys} ({words[0] if len(words) == 1 else len(words)})"
            for keys, words in others.items()
        ]
        lines.append(f"other values would do as well: {', '.join(counted)}")
    return [*lines, f"as no campaign can: {'; '.join(nature)}"] if nature else lines


def _any_wheel(keys: str) -> str:
    """Keys of which those of several wheels are one."""
    named = (re.sub(r"^wheels\..*\.", "wheels.*.", key) for key in keys.split(", "))
    return " with ".join(dict.fromkeys(named))


def _by_nature(misfits: Misfits) -> list[str]:
    """What no campaign of this kind can show."""
    campaign = misfits.campaign
    said = list(_TENSOR)
    if campaign.wheels:
        said += _WHEELS
    if misfits.slews.fixes.any():
        said += _TRACKER
        if not fixes_in_motion(misfits):
            said.append(
                "columns.attitude.offset_s: all fixes are at rest, where a star tracker that is "
                "late by seconds shows the same attitude"
            )
    return said


def _without_telemetry(misfits: Misfits, laws: set[str]) -> list[str]:
    """What is invisible because telemetry is missing."""
    said = []
    if CLOSURE not in laws:
        said.append("no two star-tracker fixes in a slew: nothing checks the rates' closure")
    if CONSERVATION not in laws:
        said.append("neither wheel momentum nor commands: nothing checks the rates against torques")
    if DRIVE not in laws and misfits.campaign.wheels:
        said.append("torque commands and tachometers are not both there: neither checks the other")
    return said
