"""A dask cluster as a pool: one that runs somewhere, or one on this machine."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from time import monotonic
from typing import Any

from bayes_inertia.errors import SettingsError, StudyError

try:
    import distributed
except ImportError as error:  # pragma: no cover
    raise SettingsError(
        "dask is not installed",
        where="engine",
        advice="pip install 'bayes-inertia[cluster]', or use --engine joblib",
    ) from error

# How long to look for a scheduler, and for its first worker [s].
_CONNECT_SECONDS = 20.0
_FIRST_WORKER_SECONDS = 300.0
# How long workers may take to end [s].
_CLOSE_SECONDS = 2.0
_BATCHES_A_THREAD = 2
# How often workers are counted [s], and how long the scheduler may take to answer [s].
_COUNT_EVERY = 2.0
_ANSWER_SECONDS = 10.0


class DaskWorkers:
    """Workers of a dask scheduler. They may come and go; all see the same files.

    Parameters
    ----------
    scheduler : str or None
        Address of a running scheduler; None starts a cluster on this machine.
    jobs : int
        Workers of the cluster that is started.

    Raises
    ------
    StudyError
        If no scheduler answers, or none of its workers does.
    """

    def __init__(self, scheduler: str | None, jobs: int) -> None:
        self._address, self._cluster = scheduler, None
        if scheduler is None:
            self._cluster = distributed.LocalCluster(
                n_workers=jobs,
                threads_per_worker=1,
                processes=True,
                # Any free port: the usual one may be taken.
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
        try:
            self._client = distributed.Client(
                self._cluster or scheduler, timeout=_CONNECT_SECONDS, set_as_default=False
            )
        except (OSError, ValueError) as error:
            raise StudyError(
                "no dask scheduler answers",
                where=str(scheduler),
                advice="start one with `dask scheduler`, and give the address that it prints",
            ) from error
        self._executor = self._client.get_executor(pure=False)
        self._threads, self._counted_at = 0, -_COUNT_EVERY
        self._wait_for_workers()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """As `Pool.submit`."""
        return self._executor.submit(function, *arguments)

    def window(self) -> int:
        """Two calls a thread of the workers that are there now."""
        if monotonic() - self._counted_at > _COUNT_EVERY:
            self.check()
            scheduler = self._client.scheduler
            if scheduler is None:
                raise self.lost()
            try:
                threads = self._client.sync(scheduler.ncores, callback_timeout=_ANSWER_SECONDS)
            except OSError as error:
                raise self.lost() from error
            self._threads, self._counted_at = sum(threads.values()), monotonic()
        return max(1, _BATCHES_A_THREAD * self._threads)

    def worker_died(self, error: BaseException) -> bool:
        """As `Pool.worker_died`; dask has tried such a call on several workers already."""
        return isinstance(error, distributed.scheduler.KilledWorker)

    def check(self) -> None:
        """Raise StudyError if the scheduler is gone."""
        if self._client.status != "running":
            raise self.lost()

    def lost(self) -> StudyError:
        """The error of a scheduler that is gone.

        Returns
        -------
        StudyError
            To be raised.
        """
        return StudyError(
            "the dask scheduler is gone",
            where=self._address or "local cluster",
            advice="the same command goes on with what was finished",
        )

    def close(self, *, at_once: bool) -> None:
        """Leave the scheduler; a cluster that was started here ends."""
        with suppress(OSError, RuntimeError, AssertionError):
            self._client.close(timeout=_CLOSE_SECONDS)
        if self._cluster is not None:
            with suppress(OSError, RuntimeError):
                self._cluster.close(timeout=_CLOSE_SECONDS)

    def _wait_for_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_SECONDS)
        except (TimeoutError, CancelledError) as error:
            self.close(at_once=True)
            raise StudyError(
                f"the dask scheduler has had no worker for {_FIRST_WORKER_SECONDS:.0f} s",
                where=self._address or "local cluster",
                advice="start workers with `dask worker ADDRESS`",
            ) from error
