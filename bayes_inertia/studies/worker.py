"""What happens in a worker: tasks are done one after the other, and nothing they raise escapes."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from threading import Thread
from time import sleep
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.studies.work import Row, Task, TaskFailure, task_seed

Outcome = tuple[str, Row] | TaskFailure

# How often a worker looks whether its driver lives [s].
_LOOK_EVERY = 0.5


def do_tasks(task: Task, seed: int, ids: Sequence[str]) -> list[Outcome]:
    """Do some tasks of a work.

    Linear algebra runs in one thread: its sums do not depend on the number of cores then.

    Parameters
    ----------
    task : Task
        Makes the row of one.
    seed : int
        Of the study.
    ids : sequence of str
        Which tasks.

    Returns
    -------
    list of (str, dict) or TaskFailure
        What became of each.
    """
    with threadpool_limits(1):
        return [_outcome(task, seed, task_id) for task_id in ids]


def _outcome(task: Task, seed: int, task_id: str) -> Outcome:
    try:
        row = task(task_id, task_seed(seed, task_id))
        return task_id, {key: _plain(value) for key, value in row.items()}
    except Exception as error:
        # The package's own errors are about the data: they would come again.
        final = isinstance(error, BayesInertiaError)
        reason = str(error) or type(error).__name__
        return TaskFailure(task_id, type(error).__name__, reason, final)


def _plain(value: Any) -> Any:
    """A value of a row without arrays, so that it is the same in every executor."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def live_with(driver: int) -> None:
    """Make this worker end with its driver, even where that is killed, and ignore Ctrl-C.

    The driver, which shares the terminal, decides what Ctrl-C does.

    Parameters
    ----------
    driver : int
        Process number of the driver, which started this process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == driver:
            sleep(_LOOK_EVERY)
        os._exit(1)

    Thread(target=watch, daemon=True, name="watch of the driver").start()
