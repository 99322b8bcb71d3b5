"""`new`: commented campaigns to begin with, each with a simulated flight."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from support.commands import run

from bayes_inertia.app.commands.campaigns import templates
from bayes_inertia.app.told_torques import check_conventions
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign

NAMES = sorted(templates())
# Seed 1 flies the simulation; a sd this far off does not happen by chance among 90 numbers.
MOST_SDS = 4.0


def keys_without_remark(text: str) -> list[str]:
    """Keys that have no remark where they stand first, on their line or the one above."""
    seen, bare, above = set(), [], ""
    for line in text.splitlines():
        key = re.match(r"(\w+) = ", line)
        if key and key[1] not in seen:
            seen.add(key[1])
            if "#" not in line and not above.startswith("#"):
                bare.append(key[1])
        above = line
    return bare


@pytest.mark.parametrize("name", NAMES)
def test_every_key_of_a_template_is_explained(name):
    text = templates()[name]
    assert text.startswith("# ")
    assert set(keys_without_remark(text)) <= {"format", "name", "type"}
    assert len(parse_description(text, name).slews) > 3


def test_a_key_without_a_remark_is_found():
    assert keys_without_remark("# unit\na = 1\nb = 2  # unit\n\nc = 3\na = 4\n") == ["c"]


def flown(name, folder):
    assert run("new", folder, "--like", name) == 0
    return folder


def worked(name, tmp_path):
    """A template's folder, which `check` and `doctor` find right and which is copied to the bit."""
    folder = flown(name, tmp_path / name)
    assert (folder / "campaign.toml").read_text() == templates()[name]
    assert run("check", folder) == 0
    assert check_conventions(folder).verdict == "consistent"
    campaign = read_campaign(folder)
    assert not campaign.dirt
    again = read_campaign(write_campaign(campaign, tmp_path / "copy"))
    for slew, other in zip(campaign.slews, again.slews, strict=True):
        np.testing.assert_array_equal(slew.time, other.time)
        for key in slew.inputs or {}:
            np.testing.assert_array_equal(slew.inputs[key].values, other.inputs[key].values)
    return folder


@pytest.mark.slow
def test_a_spinner_is_written_and_agrees_with_physics(tmp_path):
    folder = worked("spinner", tmp_path)
    before = (folder / "slew_01_gyro.csv").read_bytes()
    assert run("new", folder, "--like", "spinner") == 0
    assert (folder / "slew_01_gyro.csv").read_bytes() == before


# The spinner is flown above; these two have most kinds of devices that the others have.
IN_CI = ("cubesat",)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in IN_CI else pytest.mark.long)
        for name in NAMES
        if name != "spinner"
    ],
)
def test_a_template_is_written_and_agrees_with_physics(name, tmp_path):
    worked(name, tmp_path)


def test_an_unknown_spacecraft_is_refused_with_the_known_ones(tmp_path, capsys):
    assert run("new", tmp_path / "x", "--like", "cube") == 2
    said = capsys.readouterr().err
    assert all(name in said for name in NAMES)
    assert not (tmp_path / "x").exists()


def test_another_campaign_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "campaign.toml").write_text("mine")
    assert run("new", tmp_path, "--like", "spinner") == 2
    assert "would overwrite" in capsys.readouterr().err
    assert (tmp_path / "campaign.toml").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_fit_of_a_template_finds_its_truth(name, tmp_path):
    folder = flown(name, tmp_path / name)
    assert run("fit", folder, "-o", tmp_path / "run", "--no-report") == 0
    result = json.loads((tmp_path / "run" / "summary.json").read_text())
    truth = json.loads((folder / "truth.json").read_text())["parameters"]
    found = result["parameters"]
    if name == "spinner":  # Nothing ties the size of J.
        assert found["Jxx"]["quoted_sd"] is None
        trace = sum(truth[key] for key in ("Jxx", "Jyy", "Jzz"))
        found |= result["ratios"]
        truth = {
            key if key[0] == "K" else f"{key}/trace": value / (1 if key[0] == "K" else trace)
            for key, value in truth.items()
        }
    for key, value in truth.items():
        assert abs(found[key]["mean"] - value) < MOST_SDS * found[key]["quoted_sd"], key
    devices = {part["device"] for part in result["scale_of_J"]}
    own = {"spinner": set(), "thruster": {"jets"}, "torquers": {"torquers"}}
    assert devices == own[name] if name in own else len(devices) > 0
