"""What a study does: tasks with ids, a seed for each, and the shard that holds its row."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from bayes_inertia.errors import SettingsError

Row = Mapping[str, Any]

# "12" or "weak/12". Upper case is no part of it: some file systems take A and a for one name.
_NUMBERED = re.compile(r"(?:(?P<group>[a-z0-9][a-z0-9.-]*)/)?(?P<number>0|[1-9][0-9]{0,17})")
# Shards of tasks that have names and no numbers: two hexadecimal digits of the name's digest.
_NAMED_DIGITS = 2


class Task(Protocol):
    """Makes the row of one task: a pure function that can be sent to another process."""

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Do one task.

        Parameters
        ----------
        task_id : str
            Which one.
        seed : numpy.random.SeedSequence
            All its random numbers come from here.

        Returns
        -------
        mapping of str to number, text, list or None
            The row. All tasks of a work give the same keys.
        """


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
        The tasks. A number ("12") or a group and a number ("weak/12") is kept beside its
        neighbours; any other text is allowed too.
    seed : int
        Of the study.
    options : mapping
        What else decides the rows, as JSON values. Rows of other options are never taken for these.
    shard_size : int
        Numbered tasks a shard.
    batch_size : int
        Tasks that go to a worker at once: more than one where a task takes less than 0.1 s.

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
    shard_size: int = 25
    batch_size: int = 1

    def __post_init__(self) -> None:
        if not self.ids:
            raise SettingsError("no task", where=self.name, advice="ask for one at least")
        if len(set(self.ids)) < len(self.ids):
            raise SettingsError("a task is there twice", where=self.name, advice="name each once")

    @property
    def digest(self) -> str:
        """Digest of everything but the tasks: shards of another digest hold other work."""
        content = [self.name, self.seed, self.shard_size, dict(self.options)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def shard_of(self, task_id: str) -> str:
        """The shard that holds a task's row; it depends on nothing but the task's id.

        Parameters
        ----------
        task_id : str
            The task.

        Returns
        -------
        str
            Name of the shard, fit for a file.
        """
        numbered = _NUMBERED.fullmatch(task_id)
        if numbered is None:
            digest = hashlib.sha256(task_id.encode()).hexdigest()
            return f"named_{digest[:_NAMED_DIGITS]}"
        return f"{numbered['group'] or 'tasks'}_{int(numbered['number']) // self.shard_size:05d}"

    def shards(self) -> dict[str, list[str]]:
        """The tasks of every shard.

        Returns
        -------
        dict of str to list of str
            {shard: its tasks}, in the order of the tasks.
        """
        content: dict[str, list[str]] = {}
        for task_id in self.ids:
            content.setdefault(self.shard_of(task_id), []).append(task_id)
        return content


def task_seed(seed: int, task_id: str) -> np.random.SeedSequence:
    """The source of a task's random numbers.

    It depends on the study's seed and the task's id alone: not on order, workers or interruptions.

    Parameters
    ----------
    seed : int
        Of the study.
    task_id : str
        The task. Task "12" has the spawn key (12,).

    Returns
    -------
    numpy.random.SeedSequence
        Independent of those of other tasks.

    Examples
    --------
    >>> task_seed(1, "12").spawn_key
    (12,)
    >>> len(task_seed(1, "weak/12").spawn_key)
    8
    """
    numbered = _NUMBERED.fullmatch(task_id)
    if numbered is not None and numbered["group"] is None:
        return np.random.SeedSequence(seed, spawn_key=(int(numbered["number"]),))
    words = np.frombuffer(hashlib.sha256(task_id.encode()).digest(), dtype="<u4")
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
        What was wrong with shards that were there, in words; their tasks were done anew.
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
