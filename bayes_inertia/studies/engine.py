"""The engine: does the tasks of a work that have no row yet, and keeps what they give.

The driver alone writes files. It keeps a few batches with every worker, takes results as they come,
and writes each shard whole. Whatever ends it, the same call goes on with what is missing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import batched
from pathlib import Path

from bayes_inertia.errors import StudyError
from bayes_inertia.folder_lock import working_in
from bayes_inertia.progress import Progress
from bayes_inertia.studies.pools import Engine, Pool, open_pool
from bayes_inertia.studies.store import Store
from bayes_inertia.studies.work import TaskFailure, Work, WorkResult
from bayes_inertia.studies.worker import Outcome, do_tasks

Notice = Callable[[str], None]

# How long the driver waits for a result before it looks whether the pool is still there [s].
_LOOK_EVERY = 1.0
# Workers that may die with a task before it counts as failed.
_MOST_DEATHS = 3


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
        """Do a work with a pool of its own, see `run_work`.

        Parameters
        ----------
        work : Work
            The tasks.
        folder : Path or None
            Of the shards.

        Returns
        -------
        WorkResult
            Rows and failures.
        """
        with open_pool(self.engine, self.jobs, self.scheduler) as pool:
            return run_work(work, pool, folder, progress=self.progress, notice=self.notice)


def run_work(
    work: Work,
    pool: Pool,
    folder: Path | None = None,
    *,
    progress: Progress | None = None,
    notice: Notice | None = None,
) -> WorkResult:
    """Do all tasks of a work; those that are in the folder already are only read.

    Parameters
    ----------
    work : Work
        The tasks.
    pool : Pool
        Where they run, from `open_pool`.
    folder : Path or None
        Of the shards; made if absent. None keeps everything in memory.
    progress : callable or None
        Called with (tasks in the plural, done, of).
    notice : callable or None
        Called with a sentence about each damaged file and each failed task.

    Returns
    -------
    WorkResult
        Rows and failures in the order of the tasks: the same bits for every pool and interruption.

    Raises
    ------
    StudyError
        If the pool is lost. What was finished is kept.
    OutputError
        If another process works in the folder, or it cannot be written.
    """
    say = notice or _silent
    with working_in(folder) if folder is not None else nullcontext():
        store = Store(work, folder)
        for damage in store.damages:
            say(damage)
        left = store.open_tasks()
        done = len(work.ids) - len(left)
        try:
            for outcomes in _outcomes(work, left, pool):
                for outcome in outcomes:
                    store.add(outcome)
                    if isinstance(outcome, TaskFailure):
                        say(f"{work.name}: {outcome.task} failed: {outcome.reason}")
                store.save_due()
                done += len(outcomes)
                if progress is not None:
                    progress(work.name, done, len(work.ids))
        finally:
            store.save()
        return store.result()


def _silent(sentence: str) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class _Batch:
    """Tasks that go to a worker together, and how many workers died with them."""

    ids: tuple[str, ...]
    deaths: int = 0


def _outcomes(work: Work, left: list[str], pool: Pool) -> Iterator[list[Outcome]]:
    """What becomes of the tasks, batch by batch, in the order in which they end."""
    queue = deque(_Batch(ids) for ids in batched(left, work.batch_size))
    running: dict[Future, _Batch] = {}
    while queue or running:
        _submit(work, queue, running, pool)
        done, _ = wait(running, timeout=_LOOK_EVERY, return_when=FIRST_COMPLETED)
        pool.check()
        for future in done:
            batch = running.pop(future)
            outcomes = _result(future, batch, pool, queue)
            if outcomes:
                yield outcomes


def _submit(work: Work, queue: deque, running: dict[Future, _Batch], pool: Pool) -> None:
    """Keep the pool busy. Batches with which a worker died run alone: so the guilty one is told."""
    window = pool.window()
    while queue and len(running) < window:
        suspects = queue[0].deaths or any(batch.deaths for batch in running.values())
        if suspects and running:
            return
        batch = queue.popleft()
        try:
            running[pool.submit(do_tasks, work.task, work.seed, batch.ids)] = batch
        except Exception as error:
            # A worker died since the last look. All calls end with that before new workers begin.
            if not pool.worker_died(error):
                raise
            queue.appendleft(batch)
            wait(running)
            return


def _result(future: Future, batch: _Batch, pool: Pool, queue: deque) -> list[Outcome]:
    """What a batch gave; empty if it is in the queue again."""
    try:
        return future.result()
    except CancelledError as error:
        pool.check()
        raise StudyError(
            "calls to workers were cancelled",
            where=", ".join(batch.ids[:1]),
            advice="the same command goes on with what was finished",
        ) from error
    except Exception as error:
        if not pool.worker_died(error):
            # What a task raises stands in its outcome: this came from the way there or back.
            raise StudyError(
                f"a worker cannot do the tasks ({type(error).__name__}: {error})",
                where=batch.ids[0],
                advice="install the same versions of bayes-inertia and Python for all workers",
            ) from error
    deaths = batch.deaths + 1
    if deaths < _MOST_DEATHS:
        queue.extendleft(_Batch((task,), deaths) for task in reversed(batch.ids))
        return []
    reason = f"its worker died {deaths} times; was there enough memory?"
    return [TaskFailure(task, "WorkerDied", reason, final=False) for task in batch.ids]
