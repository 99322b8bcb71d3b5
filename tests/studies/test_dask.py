"""A dask cluster: the same bits as one process, also where workers and scheduler are killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from support.cheap_tasks import Flaky, Slow, exact, work_of

from bayes_inertia.errors import StudyError
from bayes_inertia.studies.engine import NAME, run_work
from bayes_inertia.studies.limits import LIMITS
from bayes_inertia.studies.workers import IN_PROCESS, open_workers

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def workers():
    with open_workers("dask", 2) as workers:
        yield workers


def test_a_cluster_gives_the_same_bits(tmp_path, workers):
    here = run_work(work_of(30), IN_PROCESS, tmp_path / "here")
    there = run_work(work_of(30), workers, tmp_path / "there")
    assert exact(here) == exact(there)
    files = [tmp_path / place / NAME for place in ("here", "there")]
    assert files[0].read_bytes() == files[1].read_bytes()
    failed = run_work(work_of(9, Flaky(bad=("2",), broken=("5",))), workers)
    assert [(f.task, f.final) for f in failed.failures] == [("2", True), ("5", False)]


@pytest.mark.long
def test_a_task_that_kills_its_workers_is_named_and_the_others_are_done(workers):
    result = run_work(work_of(8, Flaky(deadly=("4",))), workers)
    assert [f.task for f in result.failures] == ["4"]
    assert "died 3 times" in result.failures[0].reason
    assert exact(result) == [r for r in exact(run_work(work_of(8), IN_PROCESS)) if r[0] != "4"]


def test_a_killed_worker_costs_nothing(tmp_path, workers):
    (tmp_path / "pids").mkdir()
    work = work_of(24, Slow(0.25, tmp_path / "pids"))

    def kill_one() -> None:
        while not (pids := list((tmp_path / "pids").iterdir())):
            time.sleep(0.05)
        time.sleep(0.6)
        os.kill(int(pids[0].name), signal.SIGKILL)

    killer = threading.Thread(target=kill_one)
    killer.start()
    result = run_work(work, workers)
    killer.join()
    assert result.failures == ()
    assert exact(result) == exact(run_work(work_of(24), IN_PROCESS))
    assert len(list((tmp_path / "pids").iterdir())) == 3  # Two workers, and who replaced one.


@contextmanager
def program(name: str, *arguments: str) -> Iterator[psutil.Popen]:
    """One of dask's programs while the context lasts."""
    words = [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments, "--no-dashboard"]
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    process = psutil.Popen(
        words,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": path},
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_lost_scheduler_is_reported_and_what_was_finished_is_kept(tmp_path):
    file, work, told = tmp_path / "scheduler.json", work_of(40, Slow(0.2)), []
    with program("scheduler", "--host", "127.0.0.1", "--scheduler-file", str(file)) as scheduler:
        address = address_in(file)
        with program("worker", address, "--nthreads", "1", "--no-nanny"):

            def progress(what: str, done: int, of: int) -> None:
                told.append(done)
                if done == 6:
                    scheduler.kill()

            with (
                pytest.raises(StudyError, match="the same command goes on"),
                open_workers("dask", 1, address) as workers,
            ):
                run_work(work, workers, tmp_path / "run", progress=progress)
    assert 6 <= len(told) < 40
    done: list[int] = []
    result = run_work(work, IN_PROCESS, tmp_path / "run", progress=lambda *a: done.append(a[1]))
    assert done[0] > 6
    assert exact(result) == exact(run_work(work_of(40), IN_PROCESS))


def test_no_scheduler_is_one_message(monkeypatch):
    soon = replace(LIMITS, connect_seconds=2.0)
    monkeypatch.setattr("bayes_inertia.studies.workers.LIMITS", soon)
    with (
        pytest.raises(StudyError, match="no dask scheduler answers"),
        open_workers("dask", 1, "tcp://127.0.0.1:9"),
    ):
        pass


def address_in(file: Path) -> str:
    """The address that a scheduler writes when it is ready."""
    for _ in range(600):
        if file.exists() and (text := file.read_text()):
            return json.loads(text)["address"]
        time.sleep(0.1)
    raise AssertionError("no scheduler")


def test_the_script_for_slurm_writes_a_job(tmp_path):
    script = Path(__file__).parents[2] / "docs" / "how_to" / "cluster_slurm.py"
    words = [sys.executable, str(script), "--dry-run", "--partition", "main", "--hours", "3"]
    job = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "#SBATCH -p main" in job
    assert "#SBATCH -t 03:00:00" in job
    assert "--nthreads 1" in job
    assert "--lifetime 175m" in job
