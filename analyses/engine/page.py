"""The page of `studies.py`: kills, throughput, costs, and a fleet of 10,000 worked out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from analyses.engine.costs import Cost, DiagnosisCosts, FitCosts
from analyses.engine.kills import KilledStudy
from analyses.engine.throughput import Throughput, gain
from analyses.pages.table import table_lines

FLEET = 10_000
WORKERS = (1, 16, 256)
# More calls than this are kept submitted where there are more workers than this.
_MANY_WORKERS = 100


@dataclass(frozen=True)
class FleetWeek:
    """10,000 spacecraft fitted once, with so many workers."""

    workers: int  # one core each
    # Hours until all are fitted, and until all are diagnosed besides; NaN where that was not
    # measured.
    fits: float
    diagnoses: float
    driver: float  # share of its core that driver and scheduler are busy while fits run
    rows: float  # share of its core that the driver writes rows
    read: float  # telemetry that workers read [bytes/s]
    memory: float  # of all workers [bytes]


def fleet_weeks(
    costs: Sequence[Cost], fits: FitCosts, diagnoses: DiagnosisCosts | None
) -> list[FleetWeek]:
    """The fleet with each number of workers."""
    by = {cost.what: cost for cost in costs}
    call, wide = _each(by["dask"]), _each(by["dask, 512 at once"])
    row = max(_each(by["onto the disk"]) - _each(by["in memory"]), 0.0)
    diagnosis = float("nan") if diagnoses is None else diagnoses.diagnosis
    weeks = []
    for workers in WORKERS:
        rate = workers / fits.fit
        weeks.append(
            FleetWeek(
                workers,
                FLEET / rate / 3600.0,
                FLEET * diagnosis / workers / 3600.0,
                rate * (wide if workers > _MANY_WORKERS else call),
                rate * row,
                rate * fits.campaign,
                workers * fits.memory,
            )
        )
    return weeks


def _each(cost: Cost) -> float:
    """Processor time of the driver for one task [s]."""
    return cost.driver / cost.count


def page(
    kills: KilledStudy,
    runs: Sequence[Throughput],
    costs: Sequence[Cost],
    fits: FitCosts | None,
    diagnoses: DiagnosisCosts | None,
) -> str:
    """All that was measured; the fleet needs the costs of rows and of fits."""
    fleet = fits is not None and any(cost.size for cost in costs)
    lines = [
        "# Many fits: what they cost, and what a kill does to them",
        "",
        "Made by `python -m analyses.engine.studies` on two cores shared with ten processes "
        "and more: processor times and ratios hold elsewhere, times on the clock do not.",
        "",
        *_of_kills(kills),
        *_of_throughput(runs),
        *_of_costs(costs),
        *(_of_fleet(costs, fits, diagnoses) if fleet else ()),
        "",
    ]
    return "\n".join(lines)


def _of_kills(kills: KilledStudy) -> list[str]:
    lines = [
        "## Killed",
        "",
        f"{kills.fits} fits: campaigns of two slews at one row a second, drawn from the prior, "
        "flown in closed loop and fitted, as `bayes-inertia study` does (optimizer, no chain: the",
        f"cheapest fit of the package, {kills.serial_seconds:.2f} s of processor time, the start "
        "of the process included). A local dask cluster of two workers.",
        "Three times a worker and then the driver got SIGKILL at random moments; the same command "
        "went on, and at last ran to its end.",
        "",
    ]
    columns = (
        "worker killed after",
        "driver killed",
        "rows on the disk then",
        "processes alive 5 s later",
    )
    rows = [
        (f"{kill.done} fits", f"{kill.seconds:.1f} s later", f"{kill.rows}", f"{kill.orphans}")
        for kill in kills.kills
    ]
    return [
        *lines,
        *table_lines(columns, rows),
        "",
        f"Fits without a row at the end: {kills.failures}. Against an undisturbed serial run in "
        f"one process: rows the same bits: **{_yes(kills.same_rows)}**; "
        f"files the same bytes: **{_yes(kills.same_files)}**.",
        "",
    ]


def _yes(right: bool) -> str:
    return "yes" if right else "NO"


def _of_throughput(runs: Sequence[Throughput]) -> list[str]:
    if not runs:
        return []
    lines = [
        "## Two workers against one",
        "",
        "Tasks of a quarter of a second that keep a core busy. A worker's wait for a core that "
        "others had is known from the kernel's account of it (schedstat);",
        '"alone" is the throughput without that wait.',
        "",
    ]
    columns = (
        "engine",
        "workers",
        "tasks",
        "on the clock [s]",
        "waited for a core [s]",
        "processor time a task [s]",
        "tasks a second alone",
    )
    rows = [
        (
            run.engine,
            f"{run.jobs}",
            f"{run.tasks}",
            f"{run.wall:.1f}",
            f"{run.waited:.1f}",
            f"{run.ran / run.tasks:.3f}",
            f"{run.alone:.2f}",
        )
        for run in sorted(runs, key=lambda run: (run.engine, run.jobs))
    ]
    lines += [*table_lines(columns, rows), ""]
    for engine in ("joblib", "dask"):
        alone, wall = gain(runs, engine)
        lines.append(
            f"- {engine}: two workers do **{alone:.2f}** times the tasks of one "
            f"({wall:.2f} on the clock of the busy machine)."
        )
    return [*lines, ""]


def _of_costs(costs: Sequence[Cost]) -> list[str]:
    lines = [
        "## What tasks and rows cost",
        "",
        "Empty tasks (process: in the driver itself; joblib and dask: two workers). Then rows with "
        "the keys of a row of `fit-many` and numbers of their own.",
        "The driver's time includes the local dask scheduler, which lives in its process.",
        "",
    ]
    columns = (
        "what",
        "count",
        "driver [ms each]",
        "on the clock [s]",
        "driver grew [bytes each]",
        "bytes a row",
    )
    rows = [
        (
            cost.what,
            f"{cost.count:,}",
            f"{1e3 * _each(cost):.3g}",
            f"{cost.wall:.1f}",
            f"{max(cost.memory, 0) / cost.count:,.0f}",
            f"{cost.size / cost.count:.0f}" if cost.size else "",
        )
        for cost in costs
    ]
    return [*lines, *table_lines(columns, rows), ""]


def _of_fleet(costs: Sequence[Cost], fits: FitCosts, diagnoses: DiagnosisCosts | None) -> list[str]:
    by = {cost.what: cost for cost in costs}
    row = by["onto the disk"]
    kept = by["in memory"]
    rows_size = FLEET * row.size / row.count
    lines = [
        "## 10,000 spacecraft, fitted every week",
        "",
        f"Measured on the example campaign (five slews, {fits.campaign / 1e6:.2f} MB), in "
        "processor time:",
        "",
        f"- a fit {fits.fit:.1f} s, the first of a worker {fits.first:.1f} s;",
        *_of_diagnoses(diagnoses),
        f"- the digest of a campaign's files, which the driver makes, {1e3 * fits.digest:.1f} ms;",
        f"- a row on the disk {row.size / row.count:.0f} bytes;",
        f"- the process that fitted held {fits.memory / 1e9:.2f} GB at most.",
        "",
        "From these, by arithmetic:",
        "",
        *_weeks(fleet_weeks(costs, fits, diagnoses)),
    ]
    call = _each(by["dask, 512 at once"])
    return [
        *lines,
        "",
        "What binds:",
        "",
        f"- **The scheduler** and the driver take {1e3 * call:.1f} ms a call with 512 calls "
        f"submitted: {fits.fit / call:,.0f} workers would keep them busy with fits.",
        f"- **The file system**: rows of the whole fleet are {rows_size / 1e6:.0f} MB "
        "in one file, which only the driver writes; before the first fit it reads "
        f"all {FLEET * fits.campaign / 1e9:.1f} GB of telemetry once for the digests "
        f"({FLEET * fits.digest / 60.0:.1f} minutes of processor time), and all "
        "workers wait for that.",
        f"- **Memory**: a worker that fits holds {fits.memory / 1e9:.1f} GB: a machine has as many "
        "workers as cores only with that much a core. The driver holds all rows: "
        f"{max(kept.memory, 0) * FLEET / kept.count / 1e6:.0f} MB.",
        "",
        "Not measured: 256 real workers. Their connections cost the scheduler heartbeats besides.",
    ]


def _weeks(weeks: Sequence[FleetWeek]) -> list[str]:
    columns = (
        "workers",
        "all fitted [h]",
        "all diagnosed [h]",
        "driver and scheduler busy",
        "writing rows",
        "telemetry read [MB/s]",
        "memory of workers [GB]",
    )
    rows = [
        (
            f"{w.workers}",
            f"{w.fits:.2g}",
            _hours(w.diagnoses),
            f"{100 * w.driver:.2g} %",
            f"{100 * w.rows:.2g} %",
            f"{w.read / 1e6:.2g}",
            f"{w.memory / 1e9:.3g}",
        )
        for w in weeks
    ]
    return table_lines(columns, rows)


def _of_diagnoses(diagnoses: DiagnosisCosts | None) -> list[str]:
    if diagnoses is None:
        return ["- a diagnosis: not measured in this run;"]
    return [
        f"- a diagnosis {diagnoses.diagnosis:.1f} s, the first {diagnoses.first:.1f} s, "
        f"{diagnoses.memory / 1e9:.2f} GB at most;"
    ]


def _hours(hours: float) -> str:
    return "not measured" if hours != hours else f"{hours:.3g}"
