"""Where tasks run: in this process, in joblib's worker processes, or on a dask cluster."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from contextlib import contextmanager
from typing import Any, Literal, Protocol, get_args

from joblib.externals.loky import ProcessPoolExecutor

from bayes_inertia.errors import SettingsError
from bayes_inertia.studies.worker import live_with

Engine = Literal["process", "joblib", "dask"]

# Batches submitted for every worker: the next one waits there already.
_BATCHES_A_WORKER = 2
# Two workers that share their cores with each other gain nothing from threads.
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


class Pool(Protocol):
    """Runs functions somewhere else; what the engine needs of an executor."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """Run a function.

        Parameters
        ----------
        function : callable
            The function; it and its arguments can be sent to another process.
        *arguments
            Of the function.

        Returns
        -------
        concurrent.futures.Future
            Of its result.
        """

    def window(self) -> int:
        """How many calls to keep submitted.

        Returns
        -------
        int
            At least 1.
        """

    def worker_died(self, error: BaseException) -> bool:
        """Whether an error says that the worker of a call was killed.

        The pool can be used again then.

        Parameters
        ----------
        error : BaseException
            Of a call.

        Returns
        -------
        bool
            False: the error is the caller's.
        """

    def check(self) -> None:
        """Raise StudyError if the pool can no longer be reached."""

    def close(self, *, at_once: bool) -> None:
        """End the workers.

        Parameters
        ----------
        at_once : bool
            Whether calls that still run are given up.
        """


class InProcess:
    """Runs every call at once, in this process."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """As `Pool.submit`; the result is there when it returns."""
        future: Future = Future()
        future.set_result(function(*arguments))
        return future

    def window(self) -> int:
        """One call."""
        return 1

    def worker_died(self, error: BaseException) -> bool:
        """Never: this process would have died too."""
        return False

    def check(self) -> None:
        """Nothing can be lost."""

    def close(self, *, at_once: bool) -> None:
        """Nothing to end."""


class JoblibWorkers:
    """Worker processes of joblib (loky), which end with this process.

    Parameters
    ----------
    jobs : int
        How many.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._executor: ProcessPoolExecutor | None = None

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """As `Pool.submit`."""
        if self._executor is None:
            # loky replaces a worker whose memory has grown; its calls are not lost.
            warnings.filterwarnings("ignore", message="A worker stopped while some jobs")
            self._executor = ProcessPoolExecutor(
                max_workers=self._jobs,
                initializer=live_with,
                initargs=(os.getpid(),),
                env=_ONE_THREAD,
            )
        return self._executor.submit(function, *arguments)

    def window(self) -> int:
        """Two calls a worker."""
        return _BATCHES_A_WORKER * self._jobs

    def worker_died(self, error: BaseException) -> bool:
        """As `Pool.worker_died`; the next call starts new workers."""
        if not isinstance(error, BrokenExecutor):
            return False
        self.close(at_once=True)
        return True

    def check(self) -> None:
        """Workers that die break their calls."""

    def close(self, *, at_once: bool) -> None:
        """End the workers; those that still work are killed."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=at_once)
            self._executor = None


@contextmanager
def open_pool(
    engine: Engine | None = None, jobs: int = 1, scheduler: str | None = None
) -> Iterator[Pool]:
    """A pool while the context lasts; an error or an interrupt ends its workers at once.

    Parameters
    ----------
    engine : {"process", "joblib", "dask"} or None
        Where tasks run. None: dask if a scheduler is given, this process for one job, joblib for
        more.
    jobs : int
        Worker processes, where the engine starts them.
    scheduler : str or None
        Address of a running dask scheduler ("tcp://host:8786"); None starts a local cluster.

    Yields
    ------
    Pool
        For `run_work`.

    Raises
    ------
    SettingsError
        If engine, jobs and scheduler do not go together, or dask is not installed.
    StudyError
        If no scheduler answers.
    """
    pool = _pool(engine, jobs, scheduler)
    finished = False
    try:
        yield pool
        finished = True
    finally:
        pool.close(at_once=not finished)


def _pool(engine: Engine | None, jobs: int, scheduler: str | None) -> Pool:
    if jobs < 1:
        raise SettingsError(f"is {jobs}", where="jobs", advice="give 1 or more")
    if engine is None:
        engine = "dask" if scheduler else "process" if jobs == 1 else "joblib"
    if scheduler and engine != "dask":
        raise SettingsError(
            f"the engine {engine} has no scheduler", where="scheduler", advice="use --engine dask"
        )
    if engine == "process":
        if jobs > 1:
            raise SettingsError(
                "the engine process is one process", where="jobs", advice="use --engine joblib"
            )
        return InProcess()
    if engine == "joblib":
        return JoblibWorkers(jobs)
    if engine != "dask":
        names = ", ".join(get_args(Engine))
        raise SettingsError(f"is {engine!r}", where="engine", advice=f"choose one of {names}")
    from bayes_inertia.studies.dask_pool import DaskWorkers

    return DaskWorkers(scheduler, jobs)
