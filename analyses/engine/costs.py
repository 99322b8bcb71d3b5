"""What tasks, rows, fits and diagnoses cost: processor time, bytes and memory."""

from __future__ import annotations

import os
import resource
import shutil
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil

import bayes_inertia
from analyses.engine.tasks import RowLikeAFit, nothing
from bayes_inertia.app.many_folder import fit_many
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.studies.engine import NAME, run_work
from bayes_inertia.studies.work import Work
from bayes_inertia.studies.workers import open_workers

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
# Calls that a driver keeps submitted to 256 workers.
_CALLS_OF_256 = 512
_WARM_UP = 8


@dataclass(frozen=True)
class Cost:
    """What tasks or rows cost."""

    what: str  # in words
    count: int  # tasks
    driver: float  # processor time of this process, a local scheduler included [s]
    wall: float  # on the clock [s]
    memory: int  # by how much this process grew [bytes]
    size: int = 0  # of the file of rows [bytes]


@dataclass(frozen=True)
class FitCosts:
    """What `fit-many` costs for one spacecraft, measured on the example campaign."""

    # Processor time of a fit in a process that has fitted such a campaign before, and that has
    # not [s].
    fit: float
    first: float
    # Of the digest of a campaign's files, which the driver makes before it begins [s].
    digest: float
    campaign: int  # size of the campaign [bytes]
    memory: int  # largest memory of the process [bytes]
    row: dict[str, Any]  # the row of `fit-many`


@dataclass(frozen=True)
class DiagnosisCosts:
    """What a diagnosis of the example campaign costs."""

    # Processor time in a process that has diagnosed such a campaign before, and that has not [s].
    diagnosis: float
    first: float
    memory: int  # largest memory of the process [bytes]


def cost_of(
    what: str, work: Work, engine: str, folder: Path | None = None, *, wide: bool = False
) -> Cost:
    """Do a work and say what it took; the pool is open and warm when the clock starts."""
    with open_workers(engine, 1 if engine == "process" else 2) as workers:
        run_work(Work("warm up", nothing, tuple(map(str, range(_WARM_UP)))), workers)
        if wide:
            workers = replace(workers, room=lambda: _CALLS_OF_256)
        memory, before, began = _memory(), time.process_time(), time.monotonic()
        result = run_work(work, workers, folder)
        driver, wall = time.process_time() - before, time.monotonic() - began
        grown = _memory() - memory
    if len(result.rows) < len(work.ids):
        raise SystemExit(f"{what}: {len(result.failures)} tasks failed: {result.failures[0]}")
    size = 0 if folder is None else (folder / NAME).stat().st_size
    cost = Cost(what, len(work.ids), driver, wall, grown, size)
    print(cost, flush=True)
    return cost


def costs_of_tasks(count: int) -> list[Cost]:
    """Empty tasks through every engine."""
    work = Work("tasks", nothing, tuple(map(str, range(count))))
    costs = [cost_of(engine, work, engine) for engine in ("process", "joblib", "dask")]
    return [*costs, cost_of("dask, 512 at once", work, "dask", wide=True)]


def costs_of_rows(row: dict[str, Any], count: int, folder: Path) -> list[Cost]:
    """Rows of fits: in memory, onto the disk, and read again."""
    shutil.rmtree(folder, ignore_errors=True)
    # As `fit-many` names its tasks.
    ids = tuple(f"spacecraft_{i:05d}@{'ab' * 32}" for i in range(count))
    work = Work("rows", RowLikeAFit(row), ids, seed=1)
    return [
        cost_of("in memory", work, "process"),
        cost_of("onto the disk", work, "process", folder),
        cost_of("again: only read", work, "process", folder),
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
