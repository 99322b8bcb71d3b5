"""Signals, full disks, memory: one message, the right exit code, nothing lost."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import psutil
import pytest

import bayes_inertia
from bayes_inertia.app import cli, run_folder
from bayes_inertia.app.interruption import how_to_go_on
from bayes_inertia.errors import OutputError
from bayes_inertia.folder_lock import working_in
from bayes_inertia.inference.settings import Settings

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
# Commands that take long: one that Python can interrupt, one in compiled code with a worker.
SLEEPS = "import time; time.sleep(60)"
COMPUTES = """
import hashlib, subprocess, sys
print(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]).pid, flush=True)
hashlib.pbkdf2_hmac("sha256", b"", b"", 2 * 10**9)
"""
# A test run in the background may ignore SIGINT, and its children inherit that.
PROGRAM = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from bayes_inertia.app import cli
def command():
    print("ready", flush=True)
    exec({body!r})
cli.COMMANDS["doctor"] = command
cli.main(["doctor"])
"""


def interrupted(body: str, *signals: int) -> tuple[int, str, str, float]:
    """Exit code, output, errors and seconds of a command that is sent signals."""
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(body=body)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    lines = [program.stdout.readline() for _ in range(1 + ("Popen" in body))]
    began = time.monotonic()
    for number in signals:
        program.send_signal(number)
        time.sleep(0.3)
    try:
        output, errors = program.communicate(timeout=30)
    finally:
        program.kill()
    return program.returncode, "".join(lines) + output, errors, time.monotonic() - began


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGINT, 130, "interrupted: "), (signal.SIGTERM, 143, "terminated: ")],
)
def test_a_signal_ends_a_command_with_its_code_and_one_message(number, code, word):
    returned, _, errors, _ = interrupted(SLEEPS, number)
    assert returned == code
    assert errors.strip().startswith(word)
    assert len(errors.strip().splitlines()) == 1
    assert "same command begins again" in errors


@pytest.mark.slow
def test_compiled_code_is_ended_within_seconds_and_its_workers_too():
    returned, output, errors, seconds = interrupted(COMPUTES, signal.SIGTERM)
    assert returned == 143
    assert errors.startswith("terminated: ")
    assert seconds < 15.0  # 3 s on a machine with nothing else to do.
    worker = int(output.splitlines()[1])
    assert not psutil.pid_exists(worker) or psutil.Process(worker).status() == "zombie"


def test_a_second_signal_does_not_wait():
    returned, _, errors, _ = interrupted(COMPUTES, signal.SIGINT, signal.SIGINT)
    assert returned == 130
    assert errors.count("interrupted") == 1


def test_what_to_do_next_is_said_of_the_folder(tmp_path):
    run = tmp_path / "run"
    assert "begins again" in how_to_go_on(["fit", "c", "-o", str(run)])
    run.mkdir()
    (run / "run.json").write_text("{}")
    for words in (
        ["fit", "c", "-o", str(run)],
        ["diagnose", "c", f"--out={run}"],
        ["update", "former", "c", "-o", str(run)],
        ["resume", "--no-report", str(run)],
        ["demo", f"-o{tmp_path}"],
    ):
        if words[0] == "demo":
            run.rename(tmp_path / "fit")
            run = tmp_path / "fit"
        assert f"`bayes-inertia resume {run}` goes on" in how_to_go_on(words)
    assert "the same command goes on" in how_to_go_on(["study", "c", "-o", str(tmp_path)])


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "out of memory"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes"), "out of memory"),
        (OSError(28, "No space left on device", "/run/a"), "No space left on device"),
        (RuntimeError("(write failed: errno = 28, error message = 'No space', buf)"), "No space"),
        (BrokenProcessPool("a worker died"), "a worker process was ended"),
    ],
    ids=["memory", "xla", "disk", "hdf5", "worker"],
)
def test_what_the_machine_does_is_said_in_one_message(capsys, monkeypatch, error, words):
    def fails() -> None:
        raise error

    monkeypatch.setitem(cli.COMMANDS, "doctor", fails)
    with pytest.raises(SystemExit) as stop:
        cli.main(["doctor"])
    said = capsys.readouterr().err
    assert stop.value.code == 2
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert words in said


def test_a_fault_of_the_program_is_no_message(monkeypatch):
    def fails() -> None:
        raise KeyError("x")

    monkeypatch.setitem(cli.COMMANDS, "doctor", fails)
    with pytest.raises(KeyError):
        cli.main(["doctor"])


def test_one_process_at_a_time_works_in_a_folder(tmp_path):
    run = tmp_path / "run"
    hold = (
        "import sys, time; from pathlib import Path\n"
        "from bayes_inertia.folder_lock import working_in\n"
        "with working_in(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold, str(run)], stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(OutputError, match="another process works in this folder"):
            run_folder.start(EXAMPLE, run, settings=Settings(seed=3))
        assert not (run / "run.json").exists()
        other.kill()
    # The system lifts the lock of a process that was killed.
    with working_in(run):
        pass
    run_folder.start(EXAMPLE, run, settings=Settings(seed=3))
