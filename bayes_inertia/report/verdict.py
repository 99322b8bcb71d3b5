"""The answer that stands first in a report: one line, and sentences that say why and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Level = Literal["good", "caution", "bad"]
_FROM_THE_WORST: tuple[Level, ...] = ("bad", "caution", "good")


@dataclass(frozen=True)
class Verdict:
    """The first answer of a report.

    Parameters
    ----------
    level : {"good", "caution", "bad"}
        Decides the colour.
    title : str
        The answer in one line.
    sentences : tuple of str
        Why it is so and what to do, one item each.
    """

    level: Level
    title: str
    sentences: tuple[str, ...]


def worst_level(levels: Sequence[Level]) -> Level:
    """The level of several verdicts together.

    Examples
    --------
    >>> worst_level(["good", "bad", "caution"])
    'bad'
    """
    return min(levels, key=_FROM_THE_WORST.index)
