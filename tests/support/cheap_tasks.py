"""Tasks of a study that cost next to nothing; workers import them from here."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.studies.work import Row, Work


def numbers(task_id: str, seed: np.random.SeedSequence) -> Row:
    """A row with every kind of value."""
    rng = np.random.default_rng(seed)
    return {
        "value": rng.standard_normal(),
        "vector": rng.standard_normal(3),
        "nothing": None,
        "whole": int(rng.integers(100)),
        "text": task_id.upper(),
        "undefined": float("nan"),
    }


@dataclass(frozen=True)
class Flaky:
    """As `numbers`, but some tasks fail: of bad data, of a bug, or by killing their worker.

    Parameters
    ----------
    bad : tuple of str
        Tasks whose data are bad.
    broken : tuple of str
        Tasks that meet a bug, as long as `mended` does not exist.
    deadly : tuple of str
        Tasks that kill their worker.
    mended : Path or None
        See `broken`.
    """

    bad: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    deadly: tuple[str, ...] = ()
    mended: Path | None = None

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """A row, or no row."""
        if task_id in self.bad:
            raise CampaignError("no telemetry", where=task_id, advice="fly again")
        if task_id in self.broken and not (self.mended and self.mended.exists()):
            raise ZeroDivisionError("a bug")
        if task_id in self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        return numbers(task_id, seed)


@dataclass(frozen=True)
class Slow:
    """As `numbers`, after a while.

    Parameters
    ----------
    seconds : float
        How long it takes.
    pids : Path or None
        Folder in which each worker leaves its process number.
    """

    seconds: float
    pids: Path | None = None

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """A row."""
        if self.pids is not None:
            (self.pids / str(os.getpid())).touch()
        time.sleep(self.seconds)
        return numbers(task_id, seed)


def work_of(n: int | Sequence[str], task=numbers, **options) -> Work:
    """A work of n numbered tasks, or of those named."""
    ids = tuple(str(i) for i in range(n)) if isinstance(n, int) else tuple(n)
    return Work("numbers", task, ids, **({"seed": 7} | options))


def exact(result) -> list[tuple[str, str]]:
    """Rows as texts in which every bit counts."""
    return [(row["task"], repr(sorted(row.items()))) for row in result.rows]
