"""What tasks, rows, fits and diagnoses cost: processor time, bytes and memory."""

from __future__ import annotations

import os
import resource
import shutil
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil
from engine_tasks import RowLikeAFit, nothing

import bayes_inertia
from bayes_inertia.app.fit_many_folder import fit_many
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.studies.engine import run_work
from bayes_inertia.studies.pools import Pool, open_pool
from bayes_inertia.studies.work import Work

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
# Calls that a driver keeps submitted to 256 workers.
_CALLS_OF_256 = 512
_WARM_UP = 8


@dataclass(frozen=True)
class Cost:
    """What tasks or rows cost.

    Parameters
    ----------
    what : str
        In words.
    count : int
        Tasks.
    driver : float
        Processor time of this process, a local scheduler included [s].
    wall : float
        On the clock [s].
    memory : int
        By how much this process grew [bytes].
    files, size : int
        Written, and their bytes.
    """

    what: str
    count: int
    driver: float
    wall: float
    memory: int
    files: int = 0
    size: int = 0


@dataclass(frozen=True)
class FitCosts:
    """What `fit-many` costs for one spacecraft, measured on the example campaign.

    Parameters
    ----------
    fit, first : float
        Processor time of a fit in a process that has fitted such a campaign before, and that has
        not [s].
    digest : float
        Of the digest of a campaign's files, which the driver makes before it begins [s].
    campaign : int
        Size of the campaign [bytes].
    memory : int
        Largest memory of the process [bytes].
    row : dict
        The row of `fit-many`.
    """

    fit: float
    first: float
    digest: float
    campaign: int
    memory: int
    row: dict[str, Any]


@dataclass(frozen=True)
class DiagnosisCosts:
    """What a diagnosis of the example campaign costs.

    Parameters
    ----------
    diagnosis, first : float
        Processor time in a process that has diagnosed such a campaign before, and that has not [s].
    memory : int
        Largest memory of the process [bytes].
    """

    diagnosis: float
    first: float
    memory: int


class WideWindow:
    """A pool that takes as many calls at once as one of 256 workers would.

    Parameters
    ----------
    pool : Pool
        Where the calls run.
    """

    def __init__(self, pool: Pool) -> None:
        self._pool = pool

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """As the pool's."""
        return self._pool.submit(function, *arguments)

    def window(self) -> int:
        """That of 256 workers."""
        return _CALLS_OF_256

    def worker_died(self, error: BaseException) -> bool:
        """As the pool's."""
        return self._pool.worker_died(error)

    def check(self) -> None:
        """As the pool's."""
        self._pool.check()


def cost_of(
    what: str, work: Work, engine: str, folder: Path | None = None, *, wide: bool = False
) -> Cost:
    """Do a work and say what it took; the pool is open and warm when the clock starts."""
    with open_pool(engine, 1 if engine == "process" else 2) as pool:
        run_work(Work("warm up", nothing, tuple(map(str, range(_WARM_UP)))), pool)
        memory, before, began = _memory(), time.process_time(), time.monotonic()
        result = run_work(work, WideWindow(pool) if wide else pool, folder)
        driver, wall = time.process_time() - before, time.monotonic() - began
        grown = _memory() - memory
    if len(result.rows) < len(work.ids):
        raise SystemExit(f"{what}: {len(result.failures)} tasks failed: {result.failures[0]}")
    paths = [] if folder is None else list(folder.glob("*.parquet"))
    size = sum(path.stat().st_size for path in paths)
    cost = Cost(what, len(work.ids), driver, wall, grown, len(paths), size)
    print(cost, flush=True)
    return cost


def costs_of_tasks(many: int, few: int) -> list[Cost]:
    """Empty tasks through every engine, a hundred at once and one by one."""

    def empty(count: int, batch: int) -> Work:
        ids = tuple(map(str, range(count)))
        return Work("tasks", nothing, ids, shard_size=1000, batch_size=batch)

    return [
        *(cost_of(f"{e}, by the hundred", empty(many, 100), e) for e in _ENGINES),
        *(cost_of(f"{e}, one by one", empty(few, 1), e) for e in _ENGINES),
        cost_of("dask, one by one, 512 at once", empty(few, 1), "dask", wide=True),
    ]


_ENGINES = ("process", "joblib", "dask")


def costs_of_rows(row: dict[str, Any], count: int, folder: Path) -> list[Cost]:
    """Rows of fits: in memory, into shards, and read again."""
    shutil.rmtree(folder, ignore_errors=True)
    task = RowLikeAFit(row)

    def work(ids: tuple[str, ...]) -> Work:
        return Work("rows", task, ids, seed=1, batch_size=25)

    numbered = tuple(map(str, range(count)))
    # As `fit-many` names its tasks.
    named = tuple(f"spacecraft_{i:05d}@{'ab' * 32}" for i in range(count))
    return [
        cost_of("in memory", work(numbered), "process"),
        cost_of("into shards of 25", work(numbered), "process", folder / "numbered"),
        cost_of("into shards by name", work(named), "process", folder / "named"),
        cost_of("the last again: only read", work(named), "process", folder / "named"),
    ]


def costs_of_fits(work: Path) -> FitCosts:
    """Fit the example twice, in this process."""
    folder = work / "units"
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("first", "second"):
        shutil.copytree(EXAMPLE, folder / "fleet" / name)
        # Another text is another campaign.
        toml = folder / "fleet" / name / "campaign.toml"
        toml.write_text(f"# {name}\n" + toml.read_text())
    clock = [time.process_time()]
    result = fit_many(
        folder / "fleet", folder / "out", progress=lambda *_: clock.append(time.process_time())
    )
    first, second = (after - before for before, after in pairwise(clock))
    began = time.process_time()
    for _ in range(10):
        campaign_sha256(EXAMPLE)
    digest = (time.process_time() - began) / 10
    row = {key: value for key, value in result.rows[0].items() if key != "task"}
    size = sum(path.stat().st_size for path in EXAMPLE.iterdir())
    return FitCosts(second, first, digest, size, _peak(), row)


def costs_of_diagnoses() -> DiagnosisCosts:
    """Diagnose the example twice, in this process."""
    seconds = []
    for seed in (1, 2):
        began = time.process_time()
        diagnose(read_campaign(EXAMPLE), seed=seed)
        seconds.append(time.process_time() - began)
    return DiagnosisCosts(seconds[1], seconds[0], _peak())


def _peak() -> int:
    """Largest memory of this process so far [bytes]."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _memory() -> int:
    """Resident memory of this process [bytes]."""
    return int(psutil.Process(os.getpid()).memory_info().rss)
