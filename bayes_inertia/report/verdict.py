"""The answer that stands first in a report: one line, and sentences that say why and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["good", "caution", "bad"]


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
