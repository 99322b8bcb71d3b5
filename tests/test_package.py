"""What a wheel needs: every data file is packed, every dependency states its lowest version."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import bayes_inertia

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
