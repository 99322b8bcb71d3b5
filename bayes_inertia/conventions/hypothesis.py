"""A supposed mistake: keys of campaign.toml that were written wrong, and what mending them does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bayes_inertia.conventions.reading import Reading


@dataclass(frozen=True)
class KeyChange:
    """One key of campaign.toml and the value it should have.

    Parameters
    ----------
    key : str
        Path of the key, such as "columns.rate.unit" or "wheels.x.axis".
    stated, mended : object
        Its value as written, and the value that it should have.
    """

    key: str
    stated: Any
    mended: Any


@dataclass(frozen=True)
class Mistake:
    """One mistake that somebody may have made.

    Parameters
    ----------
    changes : tuple of KeyChange
        What mends it; several keys where one mistake shows in several.
    rarity : int
        How seldom the mistake is made, from 1; of two that explain the data alike the more common
        one is proposed.
    mend : callable
        From the reading as stated to the reading without the mistake.
    words : str
        What went wrong, as the end of a sentence that begins with "It looks as if".
    companions : int, optional
        How many of the changes, the last ones, only follow: noises in the same unit.
    """

    changes: tuple[KeyChange, ...]
    rarity: int
    mend: Callable[[Reading], Reading]
    words: str
    companions: int = 0


def both(first: Mistake, second: Mistake) -> Mistake:
    """Two mistakes at once."""
    return Mistake(
        changes=first.changes + second.changes,
        rarity=first.rarity + second.rarity,
        mend=lambda reading: second.mend(first.mend(reading)),
        words=f"{first.words}, and {second.words}",
    )
