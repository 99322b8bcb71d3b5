"""The engine: does the tasks of a work that have no row yet, and keeps what they give.

Rows are the same bits in this process, in joblib's workers and on a dask cluster, in any order and
after any interruption: the same call goes on with what is missing.

On the disk a row is a line of JSON with a seal. Only the driver writes: it adds a line as a task
ends, so a kill costs nothing that was finished; at the end the file is written anew, in the order
of the tasks.
"""

from __future__ import annotations

import io
import json
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from threadpoolctl import threadpool_limits

from bayes_inertia.errors import BayesInertiaError, OutputError, StudyError, library_of_extra
from bayes_inertia.files import read_bytes, refused_by_system, write_atomically
from bayes_inertia.folder_lock import working_in
from bayes_inertia.progress import Progress
from bayes_inertia.sealing import SEAL_KEY, sealed, sha256_of
from bayes_inertia.studies.limits import LIMITS
from bayes_inertia.studies.work import Row, Task, TaskFailure, Work, WorkResult, task_seed
from bayes_inertia.studies.workers import IN_PROCESS, Engine, Workers, open_workers

NAME = "rows.jsonl"
Outcome = tuple[str, Row] | TaskFailure


class RowFile:
    """Rows of a study so far, in memory and in a folder (None: in memory alone)."""

    def __init__(self, folder: Path | None, study: str) -> None:
        self._path = None if folder is None else folder / NAME
        self._study = study
        self._outcomes: dict[str, Outcome] = {}
        self._lines: dict[str, bytes] = {}
        self.damages: list[str] = []
        if folder is not None:
            for task, row in _rows_of_0_4(folder, study):
                self._take((task, row))
            self._load(folder / NAME)
            # Without lines that are no use; and a folder that cannot be written is told now.
            self.settle(())

    def __contains__(self, task: str) -> bool:
        """Whether a task has a row, or a failure that would come again."""
        return task in self._outcomes

    def add(self, outcome: Outcome) -> None:
        """Take what became of one task, and put it on the disk."""
        line = self._take(outcome)
        if self._path is None:
            return
        advice = "check that the folder is writable and has space"
        with (
            refused_by_system(OutputError, "cannot be written", self._path, advice),
            self._path.open("ab") as file,
        ):
            file.write(line)

    def settle(self, ids: Sequence[str]) -> WorkResult:
        """Write all, these tasks first and in their order; give what became of these."""
        ordered = dict.fromkeys((*(task for task in ids if task in self), *self._lines))
        content = b"".join(self._lines[task] for task in ordered)
        if self._path is not None and not (
            self._path.exists() and read_bytes(self._path) == content
        ):
            write_atomically(self._path, content)
        found = [self._outcomes[task] for task in ids if task in self]
        rows = ({"task": o[0], **o[1]} for o in found if not isinstance(o, TaskFailure))
        failures = (o for o in found if isinstance(o, TaskFailure))
        return WorkResult(tuple(rows), tuple(failures), tuple(self.damages))

    def _take(self, outcome: Outcome) -> bytes:
        """Keep an outcome, and give its line."""
        content: dict[str, Any] = {"study_sha256": self._study}
        if isinstance(outcome, TaskFailure):
            task = outcome.task
            content["failure"] = asdict(outcome)
        else:
            task, content["row"] = outcome
        self._lines[task] = json.dumps(sealed({"task": task, **content})).encode() + b"\n"
        self._outcomes[task] = outcome
        return self._lines[task]

    def _load(self, path: Path) -> None:
        """Take every line that is whole and of this study; say of the others, and drop them."""
        damaged = foreign = 0
        for line in read_bytes(path).splitlines() if path.exists() else ():
            try:
                content = json.loads(line)
                intact = content.get(SEAL_KEY) == sealed(content)[SEAL_KEY]
            except (ValueError, AttributeError, RecursionError):
                intact = False
            if not intact:
                damaged += 1
            elif content["study_sha256"] != self._study:
                foreign += 1
            elif "row" in content:
                self._take((content["task"], content["row"]))
            elif (failure := TaskFailure(**content["failure"])).final:
                self._take(failure)
        for count, what in ((damaged, "cut short or changed"), (foreign, "of another study")):
            if count:
                self.damages.append(f"{path.name}: {count} lines are {what}; done anew")


def _rows_of_0_4(folder: Path, study: str) -> Iterator[tuple[str, Row]]:
    """Rows in Parquet files of version 0.4, which hold their SHA-256 with zeros in its place."""
    for path in sorted((*folder.glob("*.parquet"), *folder.glob("shards/*.parquet"))):
        pq = library_of_extra("pyarrow.parquet", "parquet", where=str(path))
        data = read_bytes(path)
        for stated in list(re.finditer(rb"bayes-inertia-sha256:([0-9a-f]{64})", data))[-1:]:
            bare = data[: stated.start(1)] + b"0" * 64 + data[stated.end(1) :]
            if sha256_of(bare).encode() == stated[1]:
                table = pq.read_table(io.BytesIO(data))
                if json.loads(table.schema.metadata[b"bayes_inertia"])["study"] == study:
                    yield from ((row.pop("task"), row) for row in table.to_pylist())


Notice = Callable[[str], None]


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

    def run(self, work: Work, folder: str | Path | None) -> WorkResult:
        """Do all tasks of a work; those whose rows are in the folder already are only read.

        Parameters
        ----------
        work : Work
            The tasks.
        folder : str or Path or None
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
    folder: str | Path | None = None,
    *,
    progress: Progress | None = None,
    notice: Notice | None = None,
) -> WorkResult:
    """Do a work as `Execution.run`, with workers that are there."""
    say, folder = notice or (lambda sentence: None), None if folder is None else Path(folder)
    with nullcontext() if folder is None else working_in(folder):
        rows = RowFile(folder, work.digest)
        for damage in rows.damages:
            say(damage)
        left = [task for task in work.ids if task not in rows]
        done = len(work.ids) - len(left)
        for outcome in _outcomes(work, left, workers):
            rows.add(outcome)
            if isinstance(outcome, TaskFailure):
                say(f"{work.name}: {outcome.name} failed: {outcome.reason}")
            done += 1
            if progress is not None:
                progress(work.name, done, len(work.ids))
        return rows.settle(work.ids)


def _outcomes(work: Work, left: Sequence[str], workers: Workers) -> Iterator[Outcome]:
    """Outcomes of the tasks, in the order in which they end."""
    suspects = []
    for task, outcome in _calls(work, left, workers):
        if outcome is None:
            suspects.append(task)
        else:
            yield outcome
    for task in suspects:
        alone = (_calls(work, [task], workers) for _ in range(LIMITS.tries_alone))
        reason = f"its worker died {1 + LIMITS.tries_alone} times; was there enough memory?"
        failure = TaskFailure(task, "WorkerDied", reason, final=False)
        yield next((outcome for tries in alone for _, outcome in tries if outcome), failure)


def _calls(
    work: Work, tasks: Sequence[str], workers: Workers
) -> Iterator[tuple[str, Outcome | None]]:
    """Each task with what became of it; with None where its worker died."""
    queue, running = deque(tasks), dict[Future, str]()
    room, looked = 0, -LIMITS.driver_looks_every_s
    while queue or running:
        if monotonic() - looked >= LIMITS.driver_looks_every_s:
            room, looked = workers.room(), monotonic()
        while queue and len(running) < room:
            task = queue.popleft()
            running[workers.submit(_do, work.task, work.seed, task)] = task
        done, _ = wait(running, timeout=LIMITS.driver_looks_every_s, return_when=FIRST_COMPLETED)
        for future in done:
            task = running.pop(future)
            yield task, _result(future, task, workers)


def _result(future: Future, task: str, workers: Workers) -> Outcome | None:
    """Result of a call. What a task raises stands there: other errors come from the way to it."""
    try:
        return future.result()
    except workers.died:
        return None
    except CancelledError as error:
        advice = "the same command goes on with what was finished"
        raise StudyError("calls to workers were cancelled", where=task, advice=advice) from error
    except Exception as error:
        what = f"a worker cannot do the tasks ({type(error).__name__}: {error})"
        advice = "install the same versions of bayes-inertia and Python for all workers"
        raise StudyError(what, where=task, advice=advice) from error


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
