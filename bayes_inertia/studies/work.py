"""Work of a study: tasks with ids, a seed for each, and their outcomes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from bayes_inertia.errors import SettingsError
from bayes_inertia.maths.values import whole_number
from bayes_inertia.sealing import sha256_of

Row = Mapping[str, Any]


class Task(Protocol):
    """Makes the row of one task: a pure function that can be sent to another process."""

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """The row: a number, text, array or None by name; random numbers come from `seed`."""


# What stands in a task's id before what the task depends on, such as the digest of its data.
DEPENDS_ON = "@"


@dataclass(frozen=True)
class Work:
    """Many tasks of one kind.

    Parameters
    ----------
    name : str
        What the tasks are, in the plural, for progress and messages.
    task : Task
        Makes the row of one task.
    ids : tuple of str
        The tasks; what a task depends on may stand behind its name, see `DEPENDS_ON`.
    seed : int
        Of the study.
    options : mapping
        What else decides the rows, as JSON values. Rows of other options are never taken for these.

    Raises
    ------
    SettingsError
        If there is no task, or one is there twice.
    """

    name: str
    task: Task
    ids: tuple[str, ...]
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        object.__setattr__(self, "seed", whole_number(self.seed, "seed"))
        if not self.ids:
            raise SettingsError("no task", where=self.name, advice="ask for one at least")
        if len(set(self.ids)) < len(self.ids):
            raise SettingsError("a task is there twice", where=self.name, advice="name each once")

    @property
    def digest(self) -> str:
        """Digest of everything but the tasks: rows of another digest are of another study."""
        # Tasks a Parquet file of version 0.4: its rows are still taken.
        shard_size = 25
        content = [self.name, self.seed, shard_size, dict(self.options)]
        return sha256_of(json.dumps(content, sort_keys=True))


def task_seed(seed: int, task_id: str) -> np.random.SeedSequence:
    """Source of a task's random numbers, from the study's seed and the task's id alone.

    >>> task_seed(1, "12").spawn_key
    (12,)
    >>> len(task_seed(1, "weak/12").spawn_key)
    8
    """
    if task_id.isdecimal() and task_id == str(int(task_id)):
        return np.random.SeedSequence(seed, spawn_key=(int(task_id),))
    words = np.frombuffer(bytes.fromhex(sha256_of(task_id)), dtype="<u4")
    return np.random.SeedSequence(seed, spawn_key=tuple(words.tolist()))


@dataclass(frozen=True)
class TaskFailure:
    """A task without a row, and why.

    Parameters
    ----------
    task : str
        Its id.
    error : str
        Kind of the error.
    reason : str
        Its message.
    final : bool
        Whether it would fail again (bad data, say). Others are tried anew by the next command.
    """

    task: str
    error: str
    reason: str
    final: bool

    @property
    def name(self) -> str:
        """The task's id without what it depends on."""
        return self.task.rpartition(DEPENDS_ON)[0] or self.task


@dataclass(frozen=True)
class WorkResult:
    """What a work gave.

    Parameters
    ----------
    rows : tuple of dict
        One a finished task, in the order of the tasks; the key `task` holds its id.
    failures : tuple of TaskFailure
        Tasks without a row, in the order of the tasks.
    damages : tuple of str
        What was wrong with files that were there, in words; their tasks were done anew.
    """

    rows: tuple[dict[str, Any], ...]
    failures: tuple[TaskFailure, ...] = ()
    damages: tuple[str, ...] = ()

    def column(self, name: str) -> np.ndarray:
        """One value of all rows.

        Parameters
        ----------
        name : str
            Its key.

        Returns
        -------
        (n, ...) array
            In the order of the rows.
        """
        return np.array([row[name] for row in self.rows])
