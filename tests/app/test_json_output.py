"""`--json`, `--quiet`, examples and completion: one document, the documented keys, nothing else."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from time import sleep
from types import SimpleNamespace

import pytest
import typer
from support.commands import run

import bayes_inertia
from bayes_inertia.app.cli import COMMANDS, command_line
from bayes_inertia.app.commands.runs import run_result_json
from bayes_inertia.app.options import EXAMPLES, example_of
from bayes_inertia.app.terminal import progress_bar, quietly, say

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
DOCUMENTED = Path(bayes_inertia.__file__).parents[1] / "docs" / "how_to" / "json_output.md"


@pytest.fixture
def document(capsys):
    """The document that was printed; its format and keys are documented."""

    def parsed() -> dict:
        content = json.loads(capsys.readouterr().out)
        rows = [r.split("|") for r in DOCUMENTED.read_text().splitlines() if r.startswith("| `")]
        by_format = {re.search(r"`(.+?)`", row[2])[1]: row[3] for row in rows}
        described = by_format[content["format"]]
        if "the content of `" not in described or content["format"].endswith("run-result/1"):
            missing = [k for k in content if k != "format" and f"`{k}`" not in described]
            assert missing == []
        return content

    return parsed


def test_check(document):
    assert run("check", EXAMPLE, "--json") == 0
    content = document()
    assert [slew["rows"] for slew in content["slews"]] == [461, 521, 581, 501, 561]
    assert content["possible_drives"] == ["commanded", "measured"]


def test_bad_input_leaves_stdout_empty(tmp_path, capsys):
    assert run("check", tmp_path, "--json") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ")


@pytest.mark.slow
def test_doctor_of_the_installation(document):
    assert run("doctor", "--json") == 0
    assert document()["self_test_passed"]


def test_import_start(document, tmp_path):
    mapping = tmp_path / "mapping.toml"
    assert run("import", EXAMPLE / "slew_01.csv", "--start", mapping, "--json") == 0
    assert document()["mapping"] == str(mapping)


def test_simulate(document, tmp_path, monkeypatch):
    flight = SimpleNamespace(campaign=SimpleNamespace(slews=(SimpleNamespace(name="slew 1"),)))
    where = "bayes_inertia.app.plan_folder.simulate"
    monkeypatch.setattr(where, lambda *_, **__: flight)
    assert run("simulate", "-o", tmp_path, "--json") == 0
    assert document()["slews"] == ["slew 1"]


def test_a_run(document, capsys):
    diagnosis = {"verdict": "named", "pictures": {"long": 1}, "content_sha256": "ab"}
    content = run_result_json(Path("run"), {"format": "x"}, diagnosis, True)
    print(json.dumps(content))
    assert document()["diagnosis"] == {"verdict": "named"}


@pytest.mark.parametrize(
    ("command", "where", "file", "further"),
    [
        ("observe", "observe_folder.run_observe", "observability.json", ()),
        ("design", "plan_folder.run_design", "design.json", ()),
        ("compare", "plan_folder.run_compare", "compare.json", ("paper",)),
        ("study", "study_folder.run_study", "study.json", ()),
    ],
)
def test_commands_that_write_a_document_print_it(
    command, where, file, further, document, tmp_path, monkeypatch
):
    """Only what is printed is tried here, not what is computed."""
    content = {"format": f"bayes-inertia-{Path(file).stem}/1", "value": 1.5}
    (tmp_path / file).write_text(json.dumps(content))
    result = SimpleNamespace(kept=True, too_small=(), failures=())
    monkeypatch.setattr(f"bayes_inertia.app.{where}", lambda *_, **__: result)
    assert run(command, EXAMPLE, *further, "-o", tmp_path, "--json") == 0
    assert document() == content


@pytest.mark.parametrize("command", sorted(set(COMMANDS) - {"export"}))
def test_every_command_has_json(command, capsys):
    assert run(command, "--help") == 0
    assert "--json" in capsys.readouterr().out


def test_quiet_prints_errors_alone_wherever_it_stands(tmp_path, capsys):
    for words in (("--quiet", "check", EXAMPLE), ("check", EXAMPLE, "-q")):
        assert run(*words) == 0
        assert capsys.readouterr() == ("", "")
    assert run("check", EXAMPLE, "--json", "--quiet") == 0
    assert json.loads(capsys.readouterr().out)["format"] == "bayes-inertia-check/1"
    assert run("check", tmp_path, "--quiet") == 2
    assert "error: " in capsys.readouterr().err


def test_progress_shows_the_stage_what_it_counts_and_the_time_that_is_left(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with progress_bar() as progress:
        progress("refitting with wheel_friction", 0, 0)
        for done in (0, 25, 50):
            progress("sampling, steps", done, 100)
            sleep(0.4)  # Shown ten times a second.
        say("warning: a slew is short")
        progress("writing the report", 0, 0)
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err)
    assert re.search(r"0:00:0\d  refitting with wheel_friction\s", shown)
    assert re.search(r"0:00:0\d  sampling, steps 50/100, 0:00:0\d left", shown)
    assert re.search(r"0:00:0\d  writing the report\s", shown)
    assert re.search(r"(?m)^warning: a slew is short$", shown.replace("\r", "\n"))


@pytest.mark.parametrize("quiet", [True, False])
def test_progress_is_silent_in_quiet_and_where_nobody_looks(quiet, capsys):
    with quietly(quiet), progress_bar() as progress:
        progress("fitting", 0, 0)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_stand_in_the_help_and_are_commands(command, capsys):
    assert run(command, "--help") == 0
    printed = capsys.readouterr().out
    for words in EXAMPLES[command]:
        assert f"bayes-inertia {words}" in printed
        name, *arguments = shlex.split(words)
        assert name == command
        parser = typer.main.get_command(command_line()).commands[command]
        parser.make_context(name, arguments)
    assert max(map(len, example_of(command).splitlines())) <= 80


def test_shells_complete_commands():
    asked = {"COMP_WORDS": "bayes-inertia fit", "COMP_CWORD": "1"}
    code = (
        "from bayes_inertia.app.cli import main; import sys; sys.argv[0] = 'bayes-inertia'; main()"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"_BAYES_INERTIA_COMPLETE": "complete_bash"} | asked,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.stdout.split() == ["fit", "fit-many"]
