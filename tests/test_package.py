"""What a wheel needs: data files are packed, dependencies state their lowest version; recipes."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

import bayes_inertia
from bayes_inertia.version import versions

ROOT = Path(bayes_inertia.__file__).parent
PROJECT = tomllib.loads((ROOT.parent / "pyproject.toml").read_text(encoding="utf-8"))
# Without the marker that says for which versions of Python.
DEPENDENCIES = [line.partition(";")[0] for line in PROJECT["project"]["dependencies"]]


def unpacked(patterns: list[str]) -> list[str]:
    """Data files of the package that no pattern takes along."""
    files = {path for path in ROOT.rglob("*") if path.is_file()}
    packed = {path for pattern in patterns for path in ROOT.glob(pattern)}
    code = {path for path in files if path.suffix == ".py" or "__pycache__" in path.parts}
    return sorted(str(path.relative_to(ROOT)) for path in files - packed - code)


def test_every_data_file_is_packed():
    assert unpacked(PROJECT["tool"]["setuptools"]["package-data"]["bayes_inertia"]) == []


def test_the_check_of_data_files_can_fail():
    assert "example/campaign.toml" in unpacked(["report/*"])


def test_every_dependency_states_its_lowest_version():
    assert [name for name in DEPENDENCIES if not re.fullmatch(r"[\w.-]+>=[\d.]+", name)] == []


def test_pinned_versions_keep_the_lowest():
    lines = (ROOT.parent / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {name.lower(): version for name, version in (line.split("==") for line in lines)}
    for dependency in DEPENDENCIES:
        name, lowest = dependency.split(">=")
        assert parts(pinned[name.lower()]) >= parts(lowest), name


def parts(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in version.split("."))


def test_a_package_that_is_not_installed_knows_its_version(monkeypatch):
    asked = []

    def of_installed(name: str) -> str:
        asked.append(name)
        return "1.0"

    monkeypatch.setattr("bayes_inertia.version.metadata.version", of_installed)
    found = versions()
    assert found.pop("bayes-inertia") == bayes_inertia.__version__
    assert asked == list(found)


def test_the_recipe_for_conda_needs_what_the_project_needs():
    recipe = yaml.safe_load((ROOT.parent / "packaging/conda/meta.yaml").read_text("utf-8"))
    # conda-forge's matplotlib brings a window system along.
    run = {line.replace("matplotlib-base", "matplotlib") for line in recipe["requirements"]["run"]}
    needed = {line.strip().replace(">=", " >=") for line in DEPENDENCIES}
    assert run == needed | {f"python {PROJECT['project']['requires-python']}"}
    assert recipe["package"]["version"] == bayes_inertia.__version__
    name, target = recipe["build"]["entry_points"][0].split(" = ")
    assert PROJECT["project"]["scripts"] == {name: target}


def test_images_hold_what_a_wheel_is_built_from():
    copied = re.findall(r"^COPY (.+) \S+$", (ROOT.parent / "Dockerfile").read_text(), re.MULTILINE)
    definition = (ROOT.parent / "packaging/bayes-inertia.def").read_text()
    files = re.search(r"^%files\n((?:    .+\n)+)", definition, re.MULTILINE)
    assert files
    of_apptainer = [line.split()[0] for line in files[1].splitlines()]
    assert " ".join(copied).split() == of_apptainer
    licence = PROJECT["project"].get("license-files", ["LICENSE"])
    sources = {"pyproject.toml", "bayes_inertia", PROJECT["project"]["readme"], *licence}
    assert sources <= set(of_apptainer)
    assert [name for name in of_apptainer if not (ROOT.parent / name).exists()] == []
    install = "pip install --no-cache-dir -c constraints.txt ."
    assert install in definition
    assert f"RUN {install}" in (ROOT.parent / "Dockerfile").read_text()


@pytest.mark.parametrize("new_branch", [False, True])
def test_the_workflow_fits_what_a_push_changed(tmp_path, new_branch):
    """Its script runs in a repository of two campaigns; the command is one that says its words."""
    workflow = yaml.safe_load((ROOT.parent / "docs/how_to/new_telemetry.yaml").read_text("utf-8"))
    steps = workflow["jobs"]["fit"]["steps"]
    script = next(step["run"] for step in steps if step.get("name") == "fit what the push changed")
    command = tmp_path / "bin" / "bayes-inertia"
    command.parent.mkdir()
    command.write_text('#!/bin/sh\necho "$@" >> ../said\ncase "$2" in *bad) exit 3;; esac\n')
    command.chmod(0o755)
    folder = tmp_path / "telemetry"

    def run(*words: str, **given: str) -> subprocess.CompletedProcess[str]:
        who = {f"GIT_{a}_{b}": "a" for a in ("AUTHOR", "COMMITTER") for b in ("NAME", "EMAIL")}
        path = f"{command.parent}{os.pathsep}{os.environ['PATH']}"
        env = {**os.environ, **who, **given, "PATH": path}
        return subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True)

    for name in ("old", "bad", "good"):
        (folder / "campaigns" / name).mkdir(parents=True)
        (folder / "campaigns" / name / "campaign.toml").write_text(name)
        run("git", "init", "-q")
        run("git", "add", ".")
        assert run("git", "commit", "-q", "-m", name).returncode == 0
    before = "0" * 40 if new_branch else run("git", "rev-parse", "HEAD~2").stdout.strip()
    # As GitHub runs a step: the first command that fails ends it.
    done = run("bash", "-e", "-c", script, BEFORE=before)
    changed = ["bad", "good", *(["old"] if new_branch else [])]
    said = (tmp_path / "said").read_text().splitlines()
    assert said == [f"fit campaigns/{name} -o runs/{name}" for name in changed]
    assert done.returncode == 3
