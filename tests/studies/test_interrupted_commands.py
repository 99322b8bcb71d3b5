"""`study` under signals: rows are saved, the command says how to go on, workers end with it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from support.cheap_tasks import Slow, exact, work_of

from bayes_inertia.studies.engine import run_work
from bayes_inertia.studies.workers import IN_PROCESS

pytestmark = pytest.mark.slow

# A command of the package, but with tasks that only sleep.
# A test run in the background may ignore SIGINT, and its children inherit that.
DRIVER = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import sys
from support.cheap_tasks import Slow, work_of
from bayes_inertia.app import cli
from pathlib import Path
from bayes_inertia.studies.engine import Execution

def study(engine: str, jobs: int, out: Path) -> None:
    def progress(what, done, of):
        print(done, flush=True)
    Execution(engine, jobs, None, progress).run(work_of(400, Slow(0.1)), out)

cli.COMMANDS["study"] = study
cli.main(sys.argv[1:])
"""


def started(folder: Path, engine: str, jobs: int) -> psutil.Popen:
    """A driver that has finished ten tasks."""
    path = [str(Path(__file__).parents[1]), *sys.path]
    words = [sys.executable, "-c", f"import sys; sys.path[:0] = {path!r}\n" + DRIVER]
    driver = psutil.Popen(
        [*words, "study", "--engine", engine, "--jobs", str(jobs), "-o", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while (line := driver.stdout.readline()).strip() != "10":
        assert line, driver.stderr.read()
    return driver


@pytest.mark.parametrize(
    ("engine", "jobs", "number", "code"),
    [
        pytest.param("process", 1, signal.SIGINT, 130, marks=pytest.mark.long),
        pytest.param("joblib", 2, signal.SIGTERM, 143, marks=pytest.mark.long),
        ("joblib", 2, signal.SIGKILL, -9),
        pytest.param("dask", 2, signal.SIGINT, 130, marks=pytest.mark.long),
    ],
)
def test_a_signal_ends_driver_and_workers_and_nothing_is_lost(tmp_path, engine, jobs, number, code):
    driver = started(tmp_path / "run", engine, jobs)
    family = driver.children(recursive=True)
    assert len(family) >= (jobs if jobs > 1 else 0)
    began = time.monotonic()
    driver.send_signal(number)
    try:
        _, said = driver.communicate(timeout=60)
    finally:
        with suppress(psutil.NoSuchProcess):
            driver.kill()
    seconds = time.monotonic() - began
    assert driver.returncode == code
    if code > 0:
        assert "the same command goes on" in said
        assert "Traceback" not in said
    # A machine that is busy with other things may take its time.
    assert seconds < 30.0
    assert psutil.wait_procs(family, timeout=30.0)[1] == []
    done: list[int] = []
    work = work_of(400, Slow(0.0))
    result = run_work(work, IN_PROCESS, tmp_path / "run", progress=lambda *a: done.append(a[1]))
    # Nothing that was finished is done again, not even after SIGKILL.
    assert done[0] > 10
    assert exact(result) == exact(run_work(work_of(400), IN_PROCESS))
