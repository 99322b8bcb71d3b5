"""Conventions that a campaign's telemetry says nothing about: by nature, or in this campaign."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.clocks import fixes_in_motion
from bayes_inertia.conventions.hypothesis import Mistake
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, DRIVE
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.search import worst


def invisible(misfits: Misfits, stated: Reading, singles: Sequence[Mistake]) -> tuple[str, ...]:
    """What cannot be shown, in plain words.

    Parameters
    ----------
    misfits : Misfits
        The telemetry and its laws.
    stated : Reading
        Conventions as stated, which agree with the data.
    singles : sequence of Mistake
        Mistakes; those that would leave the data as consistent are named.

    Returns
    -------
    tuple of str
        One sentence each.
    """
    laws = misfits.of(stated)
    said = [*_by_nature(misfits), *_without_telemetry(misfits, set(laws))]
    largest = limits.EQUAL_FACTOR * worst(laws) + limits.EQUAL_MISFIT
    for mistake in singles:
        if misfits.mends(mistake.mend(stated), min(largest, limits.ORDINARY)):
            keys = ", ".join(dict.fromkeys(change.key for change in mistake.changes))
            said.append(f"{keys}: the data would be as content if {mistake.words}")
    return tuple(dict.fromkeys(said))


def _by_nature(misfits: Misfits) -> list[str]:
    """What no campaign of this kind can show."""
    campaign = misfits.campaign
    said = ["inertia.includes_wheel_spin: the difference is within what J may be wrong by"]
    said.append("inertia.tensor: the sign of the products is within what they may be wrong by")
    if campaign.wheels:
        said.append("a common sign of wheel torque, wheel momentum and wheel axes changes nothing")
        said.append(
            "a common factor of inertia, wheel torque and wheel momentum changes nothing but the "
            "inertia"
        )
    if misfits.slews.fixes.any():
        said.append("a constant rotation of the star tracker's inertial axes changes nothing")
        said.append("star_tracker.boresight: it only shares out the tracker's noise")
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
