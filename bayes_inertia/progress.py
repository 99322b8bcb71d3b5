"""Progress of long work: one callback, passed down to whatever takes seconds."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, of); `of` is 0 for a stage that is not counted.

A counted stage ends with what is counted: ("sampling, steps", 10, 128).
"""


def silent(stage: str, done: int, of: int) -> None:
    """Tell nobody: the progress of work that nobody watches."""
