"""A study whose workers and drivers are killed, against the same study in peace.

Each driver is a process of its own: the same command every time. It is `SIGKILL`, which nobody can
catch, that ends a worker and a few seconds later the driver.
"""

from __future__ import annotations

import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from bayes_inertia.studies.calibration import cases_named
from bayes_inertia.studies.engine import NAME, Execution, RowFile
from bayes_inertia.studies.plan_comparison import simulated_fits
from bayes_inertia.studies.work import Work, WorkResult

KILLS = 3
# Between the death of a worker and that of its driver [s].
_BETWEEN = (0.5, 6.0)
# Processes that lost their driver may live on for so long [s].
_PATIENCE = 5.0


@dataclass(frozen=True)
class Kill:
    """One driver that was killed."""

    # Fits that it had counted, those of earlier drivers included, when its worker was killed.
    done: int
    seconds: float  # from then to its own death [s]
    rows: int  # rows on the disk then
    orphans: int  # processes of its family that lived five seconds later


@dataclass(frozen=True)
class KilledStudy:
    """What a killed study went through, and what is left of it."""

    fits: int  # of the study
    kills: Sequence[Kill]  # in their order
    failures: int  # fits without a row at the end
    same_rows: bool  # whether all rows are those of the serial run, bit for bit
    same_files: bool  # whether both files of rows are the same bytes
    serial_seconds: float  # processor time of a fit in the serial run [s]
    wall_serial: float  # the serial run and the last driver on the clock [s]
    wall_last: float


def work_of(fits: int) -> Work:
    """The study: campaigns of two slews from the prior, flown and fitted as `study` does."""
    (case,) = cases_named(["two-slews"])
    return simulated_fits(case.plan, case.mission, fits, seed=11, options={"case": case.name})


def drive(engine: str, fits: int, folder: Path) -> None:
    """Do what is missing of the study; a line for each fit."""

    def progress(what: str, done: int, of: int) -> None:
        print(done, flush=True)

    def notice(sentence: str) -> None:
        print(sentence, file=sys.stderr, flush=True)

    execution = Execution(engine, 1 if engine == "process" else 2, None, progress, notice)
    execution.run(work_of(fits), folder)


def study_of_kills(script: str, fits: int, work: Path) -> KilledStudy:
    """The same study twice: killed three times on a dask cluster, and in one process.

    `script`: module that starts a driver with the words --drive ENGINE FITS FOLDER. `fits`: of the
    study. `work`: for both folders, which are emptied.
    """
    killed, serial = work / "killed", work / "serial"
    for folder in (killed, serial):
        shutil.rmtree(folder, ignore_errors=True)
    words = [sys.executable, "-m", script, "--drive"]
    began, before = time.monotonic(), _children_seconds()
    subprocess.run([*words, "process", str(fits), str(serial)], check=True, stdout=sys.stderr)
    wall_serial, seconds = time.monotonic() - began, _children_seconds() - before
    moments, kills = random.Random(2026), []
    driver = [*words, "dask", str(fits), str(killed)]
    for number in range(KILLS):
        # Spread over the study, so that each driver has something to lose.
        share = (number + moments.uniform(0.2, 0.8)) / (KILLS + 1)
        kills.append(_killed_once(driver, work_of(fits), killed, share, moments))
        print(kills[-1], file=sys.stderr, flush=True)
    began = time.monotonic()
    subprocess.run(driver, check=True, stdout=subprocess.DEVNULL)
    wall_last = time.monotonic() - began
    results = [_rows(work_of(fits), folder) for folder in (killed, serial)]
    return KilledStudy(
        fits,
        kills,
        len(results[0].failures),
        len(results[0].rows) == fits and repr(results[0].rows) == repr(results[1].rows),
        (killed / NAME).read_bytes() == (serial / NAME).read_bytes(),
        seconds / fits,
        wall_serial,
        wall_last,
    )


def _killed_once(
    words: Sequence[str], work: Work, folder: Path, share: float, moments: random.Random
) -> Kill:
    """Start a driver, kill one of its workers at a share of the study, and then the driver."""
    driver = psutil.Popen(words, stdout=subprocess.PIPE, text=True)
    done = 0
    while done < share * len(work.ids):
        line = driver.stdout.readline()
        if not line:
            raise SystemExit("the study ended before it could be killed: ask for more fits")
        done = int(line)
    time.sleep(moments.uniform(0.0, 1.0))
    family = driver.children(recursive=True)
    moments.choice([p for p in family if _is_worker(p)]).kill()
    began = time.monotonic()
    time.sleep(moments.uniform(*_BETWEEN))
    family = driver.children(recursive=True)
    driver.send_signal(signal.SIGKILL)
    seconds = time.monotonic() - began
    # Not communicate: workers that live on hold the pipe open.
    driver.wait()
    driver.stdout.close()
    _, orphans = psutil.wait_procs(family, timeout=_PATIENCE)
    rows = len(_rows(work, folder).rows)
    return Kill(done, seconds, rows, len(orphans))


def _is_worker(process: psutil.Process) -> bool:
    """Whether a process does tasks: dask starts its workers so."""
    return "spawn_main" in " ".join(process.cmdline())


def _children_seconds() -> float:
    """Processor time of the children that ended [s]."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return ended.ru_utime + ended.ru_stime


def _rows(work: Work, folder: Path) -> WorkResult:
    return RowFile(folder, work.digest).settle(work.ids)
