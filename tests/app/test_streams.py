"""stdout and stderr that lack letters or a reader, or are closed: exit code as usual."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.marks import LIKE_ANOTHER

import bayes_inertia

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
COMMAND = "import sys; from bayes_inertia.app.cli import main; main(sys.argv[1:])"
# With sentences, as JSON, by Typer itself, and an error.
CALLS = (
    ("check", str(EXAMPLE)),
    ("check", str(EXAMPLE), "--json"),
    ("--help",),
    ("check", "no/such/folder"),
)


def through_shell(redirection: str, *words: str, **environment: str):
    """A command with its streams redirected by a shell."""
    return subprocess.run(
        ["sh", "-c", f'"$@" {redirection}', "sh", sys.executable, "-c", COMMAND, *words],
        capture_output=True,
        env=os.environ | environment,
        timeout=120,
    )


def usual(words: tuple[str, ...]) -> int:
    return 2 if "no/such/folder" in words else 0


@pytest.fixture(scope="module")
def words_of_effects() -> int:
    """How many words the command prints where every letter is known."""
    return len(through_shell("", "effects", PYTHONIOENCODING="utf-8").stdout.decode().split())


@pytest.mark.slow
@pytest.mark.parametrize(
    "encoding",
    [
        "cp1252",
        pytest.param("ascii", marks=pytest.mark.long),
        pytest.param("latin-1", marks=pytest.mark.long),
        pytest.param("cp437", marks=pytest.mark.long),
    ],
)
def test_letters_that_a_code_page_lacks_are_replaced(encoding, words_of_effects):
    done = through_shell("", "effects", PYTHONIOENCODING=encoding)
    said = done.stdout.decode(encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "constant_torque" in said
    assert ("±" if encoding != "ascii" else "0 +- ") in said
    assert len(said.split()) == words_of_effects


def test_a_path_that_no_encoding_can_write_is_named_in_an_error():
    done = through_shell("", "check", "/no/w\udcffx", PYTHONIOENCODING="ascii")
    assert done.returncode == 2
    assert b"/no/w" in done.stderr
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "redirection"),
    [
        *((words, ">&-") for words in CALLS),
        (CALLS[0], "<&- >&- 2>&-"),
        (CALLS[3], "2>&-"),
        *(pytest.param(words, "<&- >&- 2>&-", marks=LIKE_ANOTHER) for words in CALLS[1:]),
        *(pytest.param(words, "2>&-", marks=LIKE_ANOTHER) for words in CALLS[:3]),
    ],
    ids=" ".join,
)
def test_closed_streams_change_no_exit_code(words, redirection):
    done = through_shell(redirection, *words)
    assert done.returncode == usual(words)
    assert b"Traceback" not in done.stderr
    assert (b"error: " in done.stderr) == (usual(words) == 2 and "2>&-" not in redirection)


@pytest.mark.parametrize(
    ("words", "redirection"),
    [
        *((words, "| head -1") for words in CALLS),
        (CALLS[3], "2>&1 | true"),
        *(pytest.param(words, "2>&1 | true", marks=LIKE_ANOTHER) for words in CALLS[:3]),
    ],
    ids=" ".join,
)
def test_a_reader_that_goes_away_changes_no_exit_code(words, redirection, tmp_path):
    code = tmp_path / "code"
    line = f'{{ "$@"; echo $? >"{code}"; }} {redirection}'
    done = subprocess.run(
        ["sh", "-c", line, "sh", sys.executable, "-c", COMMAND, *words],
        capture_output=True,
        timeout=120,
    )
    assert int(code.read_text()) == usual(words)
    assert b"Traceback" not in done.stderr
    assert b"BrokenPipe" not in done.stderr


def test_streams_that_are_none_as_with_pythonw_change_no_exit_code(tmp_path):
    said = tmp_path / "said"
    program = f"""
import sys
sys.stdout = sys.stderr = None
from bayes_inertia.app.cli import main
try:
    main(["check", {str(EXAMPLE)!r}])
except SystemExit as ended:
    open({str(said)!r}, "w").write(f"{{ended.code}} {{sys.stdout}} {{sys.stderr}}")
"""
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, timeout=120)
    # The streams of who calls are theirs again.
    assert said.read_text() == "0 None None"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_what_was_asked_for_and_does_not_fit_on_the_disk_is_an_error():
    done = through_shell(">/dev/full", "check", str(EXAMPLE), "--json")
    assert done.returncode == 2
    assert done.stderr.startswith(b"error: No space left")
    assert b"Traceback" not in done.stderr


def test_a_file_opened_later_does_not_take_the_place_of_a_closed_stream(tmp_path):
    file = tmp_path / "data"
    program = f"""
import os
from bayes_inertia.app.terminal import usable_streams
with usable_streams(), open({str(file)!r}, "w") as data:
    assert data.fileno() > 2
    os.write(2, b"a library's log")
    data.write("5 slews")
"""
    done = subprocess.run(
        ["sh", "-c", '"$@" <&- >&- 2>&-', "sh", sys.executable, "-c", program], timeout=120
    )
    assert (done.returncode, file.read_text()) == (0, "5 slews")


def test_json_stays_one_document_in_a_pipe():
    done = through_shell("| cat", "check", str(EXAMPLE), "--json")
    assert json.loads(done.stdout)["format"]
