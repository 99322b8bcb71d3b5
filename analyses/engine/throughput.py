"""Tasks a second with one worker and with two.

On a machine that others use too the clock says little. So each worker's own account is kept: how
long it ran, and how long it was ready to run while others had its core (Linux, schedstat). Without
that wait a run would have taken so much less.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from analyses.engine.tasks import busy
from bayes_inertia.studies.engine import run_work
from bayes_inertia.studies.work import Work
from bayes_inertia.studies.workers import open_workers

# Runs of each kind, in turns.
TRIES = 3


@dataclass(frozen=True)
class Throughput:
    """One run of tasks that keep a core busy."""

    engine: str  # where
    jobs: int  # workers
    tasks: int  # how many
    wall: float  # on the clock [s]
    ran: float  # processor time of the workers [s]
    waited: float  # how long a worker waited for a core that others had [s], on average

    @property
    def alone(self) -> float:
        """Tasks a second had the workers had their cores for themselves."""
        return self.tasks / (self.wall - self.waited)


def throughput(engine: str, jobs: int, tasks: int) -> Throughput:
    """Do some tasks with workers that are warm."""

    def work(name: str, count: int) -> Work:
        return Work(name, busy, tuple(map(str, range(count))))

    with open_workers(engine, jobs) as workers:
        seen: Counter = Counter()
        while len(seen) < jobs:
            seen.update(row["process"] for row in run_work(work("warm", 4 * jobs), workers).rows)
        before, began = _accounts(seen), time.monotonic()
        run_work(work("tasks", tasks), workers)
        wall, after = time.monotonic() - began, _accounts(seen)
    spent = [_busiest(before[process], after[process]) for process in seen]
    ran, waited = (sum(parts) for parts in zip(*spent, strict=True))
    return Throughput(engine, jobs, tasks, wall, ran, waited / jobs)


def measured_throughput(tasks: int) -> list[Throughput]:
    """Both engines with one and two workers, in turns."""
    kinds = [(engine, jobs) for engine in ("joblib", "dask") for jobs in (1, 2)]
    return [throughput(engine, jobs, tasks) for _ in range(TRIES) for engine, jobs in kinds]


def gain(runs: Iterable[Throughput], engine: str) -> tuple[float, float]:
    """Throughput of two workers over one: without waits for cores, and on the clock.

    The best run of each kind counts.
    """
    chosen = [run for run in runs if run.engine == engine]
    one, two = ([run for run in chosen if run.jobs == jobs] for jobs in (1, 2))
    alone = max(run.alone for run in two) / max(run.alone for run in one)
    return alone, min(run.wall for run in one) / min(run.wall for run in two)


def _accounts(processes: Iterable[int]) -> dict[int, dict[str, tuple[float, float]]]:
    """Of every thread of the processes: seconds that it ran, and that it waited for a core."""
    accounts: dict[int, dict[str, tuple[float, float]]] = {}
    for process in processes:
        accounts[process] = {}
        for path in Path(f"/proc/{process}/task").glob("*/schedstat"):
            ran, waited, _ = path.read_text().split()
            accounts[process][path.parent.name] = 1e-9 * int(ran), 1e-9 * int(waited)
    return accounts


def _busiest(before: dict, after: dict) -> tuple[float, float]:
    """What the thread that does the tasks ran and waited between two accounts."""
    spent = [
        (ran - before.get(thread, (0.0, 0.0))[0], waited - before.get(thread, (0.0, 0.0))[1])
        for thread, (ran, waited) in after.items()
    ]
    return max(spent)
