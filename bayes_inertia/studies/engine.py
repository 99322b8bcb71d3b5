"""The engine: does the tasks of a work that have no row yet, and keeps what they give.

Rows are the same bits in this process, in joblib's workers and on a dask cluster, in any order and
after any interruption: the same call goes on with what is missing.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from threadpoolctl import threadpool_limits

from bayes_inertia.errors import BayesInertiaError, StudyError
from bayes_inertia.folder_lock import working_in
from bayes_inertia.progress import Progress
from bayes_inertia.studies.row_file import Outcome, RowFile
from bayes_inertia.studies.work import Task, TaskFailure, Work, WorkResult, task_seed
from bayes_inertia.studies.workers import IN_PROCESS, Engine, Workers, open_workers

Notice = Callable[[str], None]

# How often the driver looks whether workers came or went [s].
_LOOK_EVERY = 1.0
# A task whose worker died beside others is done again alone, so often: then it is the guilty one.
_TRIES_ALONE = 2


@dataclass(frozen=True)
class Execution:
    """How a study is done: where its tasks run, and who is told.

    Parameters
    ----------
    engine : {"process", "joblib", "dask"} or None
        Where tasks run; None for this process or joblib's workers, by `jobs`.
    jobs : int
        Worker processes.
    scheduler : str or None
        Address of a dask scheduler.
    progress : callable or None
        Called with (tasks in the plural, done, of).
    notice : callable or None
        Called with a sentence about each damaged file and each failed task.
    """

    engine: Engine | None = None
    jobs: int = 1
    scheduler: str | None = None
    progress: Progress | None = None
    notice: Notice | None = None

    def run(self, work: Work, folder: Path | None) -> WorkResult:
        """Do all tasks of a work; those whose rows are in the folder already are only read.

        Parameters
        ----------
        work : Work
            The tasks.
        folder : Path or None
            Of rows.jsonl; made if absent. None keeps everything in memory.

        Returns
        -------
        WorkResult
            Rows and failures in the order of the tasks: the same bits for every engine.

        Raises
        ------
        SettingsError
            If engine, jobs and scheduler do not go together, or dask is not installed.
        StudyError
            If the workers are lost. What was finished is kept.
        OutputError
            If another process works in the folder, or it cannot be written.
        """
        with open_workers(self.engine, self.jobs, self.scheduler) as workers:
            return run_work(work, workers, folder, progress=self.progress, notice=self.notice)


def run_work(
    work: Work,
    workers: Workers = IN_PROCESS,
    folder: Path | None = None,
    *,
    progress: Progress | None = None,
    notice: Notice | None = None,
) -> WorkResult:
    """Do a work as `Execution.run`, with workers that are there."""
    say = notice or (lambda sentence: None)
    with nullcontext() if folder is None else working_in(folder):
        rows = RowFile(folder, work.digest)
        for damage in rows.damages:
            say(damage)
        left = [task for task in work.ids if task not in rows]
        done = len(work.ids) - len(left)
        for outcome in _outcomes(work, left, workers):
            rows.add(outcome)
            if isinstance(outcome, TaskFailure):
                say(f"{work.name}: {outcome.task} failed: {outcome.reason}")
            done += 1
            if progress is not None:
                progress(work.name, done, len(work.ids))
        return rows.settle(work.ids)


def _outcomes(work: Work, left: Sequence[str], workers: Workers) -> Iterator[Outcome]:
    """What becomes of the tasks, in the order in which they end."""
    suspects = []
    for task, outcome in _calls(work, left, workers):
        if outcome is None:
            suspects.append(task)
        else:
            yield outcome
    for task in suspects:
        alone = (_calls(work, [task], workers) for _ in range(_TRIES_ALONE))
        reason = f"its worker died {1 + _TRIES_ALONE} times; was there enough memory?"
        failure = TaskFailure(task, "WorkerDied", reason, final=False)
        yield next((outcome for tries in alone for _, outcome in tries if outcome), failure)


def _calls(
    work: Work, tasks: Sequence[str], workers: Workers
) -> Iterator[tuple[str, Outcome | None]]:
    """Each task with what became of it; with None where its worker died."""
    queue, running = deque(tasks), dict[Future, str]()
    room, looked = 0, -_LOOK_EVERY
    while queue or running:
        if monotonic() - looked >= _LOOK_EVERY:
            room, looked = workers.room(), monotonic()
        while queue and len(running) < room:
            task = queue.popleft()
            running[workers.submit(_do, work.task, work.seed, task)] = task
        done, _ = wait(running, timeout=_LOOK_EVERY, return_when=FIRST_COMPLETED)
        for future in done:
            task = running.pop(future)
            yield task, _result(future, task, workers)


def _result(future: Future, task: str, workers: Workers) -> Outcome | None:
    """What a call gave. What a task raises stands there: other errors come from the way to it."""
    try:
        return future.result()
    except workers.died:
        return None
    except CancelledError as error:
        raise StudyError(
            "calls to workers were cancelled",
            where=task,
            advice="the same command goes on with what was finished",
        ) from error
    except Exception as error:
        raise StudyError(
            f"a worker cannot do the tasks ({type(error).__name__}: {error})",
            where=task,
            advice="install the same versions of bayes-inertia and Python for all workers",
        ) from error


def _do(task: Task, seed: int, task_id: str) -> Outcome:
    """Do one task, where a worker is; its row as JSON would give it back.

    Linear algebra runs in one thread: its sums do not depend on the number of cores then.
    """
    try:
        with threadpool_limits(1):
            row = dict(task(task_id, task_seed(seed, task_id)))
        return task_id, json.loads(json.dumps(row, default=lambda array: array.tolist()))
    except Exception as error:
        # The package's own errors are about the data: they would come again.
        final = isinstance(error, BayesInertiaError)
        return TaskFailure(task_id, type(error).__name__, str(error) or type(error).__name__, final)
