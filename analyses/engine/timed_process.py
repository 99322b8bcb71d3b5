"""What a Python process costs, by the clock and of its processors."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import monotonic


@dataclass(frozen=True)
class TimedProcess:
    """How a process ended, and what it cost."""

    exit_code: int
    message: str  # what it wrote to its standard error
    clock_seconds: float  # imports included
    processor_seconds: float


def timed_process(
    words: Sequence[str], environment: Mapping[str, str] | None = None
) -> TimedProcess:
    """Run Python code to its end.

    `words`: the code and its arguments. `environment`: its environment variables; None for those of
    this process.

    Examples
    --------
    >>> timed_process(["import sys; sys.exit(3)"]).exit_code
    3
    """
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), monotonic()
    ended = subprocess.run(
        [sys.executable, "-c", *words],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    clock, after = monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return TimedProcess(ended.returncode, ended.stderr, clock, seconds)
