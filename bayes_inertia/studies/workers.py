"""Workers of a study's tasks: this process, joblib's worker processes, or a dask cluster.

All are executors of `concurrent.futures`. joblib's own way to dask is not taken: joblib 1.6 waits
for ever where a task kills its workers, and does all tasks in the driver where dask has one thread.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from threading import Thread
from time import sleep
from typing import TYPE_CHECKING, Any, Literal, get_args
from warnings import catch_warnings, filterwarnings

from joblib.externals.loky import ProcessPoolExecutor

from bayes_inertia.errors import SettingsError, StudyError, is_one_of, library_of_extra, require
from bayes_inertia.studies.limits import LIMITS

if TYPE_CHECKING:
    import distributed

Engine = Literal["process", "joblib", "dask"]

# Two workers that share their cores with each other gain nothing from threads.
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


@dataclass(frozen=True)
class Workers:
    """Workers that run calls.

    `submit` begins one; `room` says how many may be begun at a time, or raises StudyError where the
    workers are lost; `died` are the errors of a call whose worker was killed.
    """

    submit: Callable[..., Future]
    room: Callable[[], int] = lambda: 1
    died: tuple[type[Exception], ...] = ()


def _at_once(function: Callable[..., Any], *arguments: Any) -> Future:
    future: Future = Future()
    future.set_result(function(*arguments))
    return future


IN_PROCESS = Workers(_at_once)


@contextmanager
def open_workers(
    engine: Engine | None = None, jobs: int = 1, scheduler: str | None = None
) -> Iterator[Workers]:
    """Workers while the context lasts; by `jobs` and `scheduler` where no engine is named."""
    if jobs < 1:
        raise SettingsError(f"is {jobs}", where="jobs", advice="give 1 or more")
    engine = engine or ("dask" if scheduler else "process" if jobs == 1 else "joblib")
    if not is_one_of(engine, get_args(Engine)):
        names = ", ".join(get_args(Engine))
        raise SettingsError(f"is {engine!r}", where="engine", advice=f"choose one of {names}")
    what, advice = f"the engine {engine} has no scheduler", "use --engine dask"
    require(not scheduler or engine == "dask", "scheduler", what, advice, error=SettingsError)
    if engine == "process":
        what, advice = "the engine process is one process", "use --engine joblib"
        require(jobs <= 1, "jobs", what, advice, error=SettingsError)
        yield IN_PROCESS
        return
    with _loky(jobs) if engine == "joblib" else _dask(scheduler, jobs) as workers:
        yield workers


@contextmanager
def _loky(jobs: int) -> Iterator[Workers]:
    """Processes of joblib on this machine; all are new after one of them died."""

    def processes() -> ProcessPoolExecutor:
        driver = (os.getpid(),)
        return ProcessPoolExecutor(jobs, initializer=_live_with, initargs=driver, env=_ONE_THREAD)

    executor = processes()

    def submit(*call: Any) -> Future:
        nonlocal executor
        try:
            return executor.submit(*call)
        except BrokenExecutor:
            executor.shutdown(kill_workers=True)
            executor = processes()
            return executor.submit(*call)

    with catch_warnings():
        # loky replaces a worker whose memory has grown; its calls are not lost.
        filterwarnings("ignore", message="A worker stopped while some jobs")
        try:
            yield Workers(submit, lambda: LIMITS.calls_a_worker * jobs, (BrokenExecutor,))
        finally:
            executor.shutdown(kill_workers=True)


def _live_with(driver: int) -> None:
    """Let this worker end with its driver, even a killed one, which alone decides about Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == driver:
            sleep(LIMITS.worker_looks_every_s)
        os._exit(1)

    Thread(target=watch, daemon=True, name="watch of the driver").start()


@contextmanager
def _dask(scheduler: str | None, jobs: int) -> Iterator[Workers]:
    """Workers of a scheduler, or of a cluster on this machine. They may come and go."""
    dask = library_of_extra(
        "distributed",
        "cluster",
        where="engine",
        otherwise="use --engine joblib",
        error=SettingsError,
    )
    with ExitStack() as closing:
        address = scheduler or ""
        if not scheduler:
            # Any free port: the usual one may be taken.
            quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL}
            cluster = dask.LocalCluster(n_workers=jobs, threads_per_worker=1, **quiet)
            closing.callback(_close, cluster)
            # A worker that is killed while it starts is given up otherwise.
            cluster.adapt(minimum=jobs, maximum=jobs)
            address = cluster.scheduler_address
        try:
            client = dask.Client(address, timeout=LIMITS.connect_seconds, set_as_default=False)
        except (OSError, ValueError) as error:
            advice = "start one with `dask scheduler`, and give the address that it prints"
            raise StudyError("no dask scheduler answers", where=address, advice=advice) from error
        closing.callback(_close, client)
        try:
            client.wait_for_workers(1, timeout=LIMITS.first_worker_seconds)
        except (TimeoutError, CancelledError) as error:
            what = f"the dask scheduler has had no worker for {LIMITS.first_worker_seconds:.0f} s"
            advice = "start workers with `dask worker ADDRESS`"
            raise StudyError(what, where=address, advice=advice) from error
        executor = client.get_executor(pure=False)
        lost = (dask.scheduler.KilledWorker,)
        yield Workers(executor.submit, lambda: _room(client, address), lost)


def _room(client: distributed.Client, address: str) -> int:
    """Calls for all threads of the workers that are there now."""
    try:
        if client.status != "running" or client.scheduler is None:
            raise OSError("no connection")
        threads = client.sync(client.scheduler.ncores, callback_timeout=LIMITS.answer_seconds)
    except OSError as error:
        what = "the dask scheduler is gone"
        advice = "the same command goes on with what was finished"
        raise StudyError(what, where=address, advice=advice) from error
    return max(1, LIMITS.calls_a_worker * sum(threads.values()))


def _close(what: distributed.Client | distributed.LocalCluster) -> None:
    """Leave a scheduler, or end a cluster; either may be gone."""
    with suppress(OSError, RuntimeError, AssertionError):
        what.close(timeout=LIMITS.close_seconds)
