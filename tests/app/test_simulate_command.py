"""`simulate` on the command line: whose spacecraft flies, what is hidden, what is refused."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.commands import run

import bayes_inertia
from bayes_inertia.app.plan_folder import note_of_broken_limits
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_file import write_plan
from bayes_inertia.physics.forward_model import Model

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


@pytest.fixture
def campaign(tmp_path):
    folder = tmp_path / "campaign"
    shutil.copytree(EXAMPLE, folder)
    return folder


@pytest.mark.slow
def test_simulate_writes_a_campaign_with_its_truth_and_hidden_effects(tmp_path, capsys):
    out = tmp_path / "simulated"
    assert (
        run("simulate", "-o", out, "--seed", "3", "--hide", "constant_torque.torque=1e-5,0,0") == 0
    )
    truth = json.loads((out / "truth.json").read_text())
    assert truth["effects"]["constant_torque"]["torque"] == [1e-5, 0.0, 0.0]
    assert run("check", out) == 0
    assert run("simulate", "-o", tmp_path / "other", "--hide", "constant_torque.torque=a") == 2
    assert "constant_torque.torque" in capsys.readouterr().err


def simulated_truth(out: Path, *options) -> dict:
    assert run("simulate", "-o", out, "--seed", "3", *options) == 0
    return json.loads((out / "truth.json").read_text())


@pytest.mark.slow
def test_simulate_flies_the_spacecraft_of_a_campaign(campaign, tmp_path, capsys):
    given = read_campaign(campaign)
    truth = simulated_truth(tmp_path / "mean", "--campaign", campaign)
    flown = read_campaign(tmp_path / "mean")
    np.testing.assert_allclose(truth["J_kgm2"], given.inertia.tensor, rtol=1e-12)
    assert truth["K"] == list(given.rate_sensor.scale_factor)
    assert [w.name for w in flown.wheels] == [w.name for w in given.wheels]
    assert flown.rate_sensor.sigma == given.rate_sensor.sigma
    np.testing.assert_array_equal(flown.inertia.sd, given.inertia.sd)
    # It begins where the campaign ended.
    start, end = truth["slews"][0]["q0"], given.slews[-1].attitude[given.slews[-1].fixes][-1]
    assert abs(np.dot(start, end)) > 1.0 - 1e-4
    assert f"flown by the spacecraft of {campaign}" in capsys.readouterr().out
    drawn = simulated_truth(tmp_path / "drawn", "--campaign", campaign, "--draw")
    off = (np.diag(drawn["J_kgm2"]) - np.diag(given.inertia.tensor)) / given.inertia.sd[:3]
    assert 0.01 < np.abs(off).max() < 5.0


@pytest.mark.slow
def test_simulate_says_what_a_spacecraft_lacks(campaign, tmp_path, capsys):
    assert run("simulate", "-o", tmp_path / "out", "--draw") == 2
    assert "--campaign" in capsys.readouterr().err
    plan = tmp_path / "plan.toml"
    write_plan(replace(paper_like_plan(), wheel_momentum=(0.0, 0.0, 0.0, 0.0)), plan)
    assert run("simulate", "-o", tmp_path / "out", "--campaign", campaign, "--plan", plan) == 2
    assert "wheel_momentum_Nms" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_simulate_says_which_limits_the_plan_breaks_and_flies_it(tmp_path, capsys):
    quick = PlannedSlew((1.0, 0.0, 0.0), 0.1, acceleration=0.02)
    write_plan(replace(paper_like_plan(), slews=(quick,)), tmp_path / "plan.toml")
    assert run("simulate", "-o", tmp_path / "out", "--plan", tmp_path / "plan.toml") == 0
    out, told = capsys.readouterr()
    assert "wrote 1 slew and truth.json" in out
    assert "limits broken" in told
    assert "torque of wheel_x: 0.06" in told
    assert "0.02 N m allowed" in told


def test_a_wheel_at_its_momentum_limit_takes_up_no_more(tmp_path, capsys):
    fast = PlannedSlew((1.0, 0.0, 0.0), 3.0, rate=0.12, acceleration=0.005)
    plan = replace(paper_like_plan(), slews=(fast,), wheel_momentum=(0.0, 0.0, 0.0))
    write_plan(plan, tmp_path / "plan.toml")
    assert run("simulate", "-o", tmp_path / "out", "--plan", tmp_path / "plan.toml") == 0
    assert "momentum of wheel_x" in capsys.readouterr().err
    flown = read_campaign(tmp_path / "out")
    reached = np.abs(flown.slews[0].wheel_momentum).max(axis=0)
    limit = flown.wheels[0].max_momentum
    assert 0.99 * limit < reached[0] < limit + 6.0 * flown.wheels[0].momentum_sigma


@pytest.mark.parametrize(
    ("like", "hidden", "says"),
    [
        ("gyroless", "rate_bias_drift", "needs a rate sensor"),
        ("gyroless", "rate_sensor_nonlinearity", "needs a rate sensor"),
        ("thruster", "wheel_torque_gain", "needs wheels"),
    ],
)
def test_an_effect_of_a_device_that_is_not_on_board_cannot_be_hidden(
    tmp_path, capsys, like, hidden, says
):
    assert run("new", tmp_path / "c", "--like", like) == 0
    asked = "--campaign", tmp_path / "c", "--hide", hidden
    assert run("simulate", "-o", tmp_path / "out", *asked) == 2
    assert f"{hidden}: {says}" in capsys.readouterr().err


def test_nothing_on_board_limits_the_angle_of_a_slew():
    far = replace(paper_like_plan(), slews=(PlannedSlew((1.0, 0.0, 0.0), 4.0),))
    assert note_of_broken_limits(far, most_like_mission()) == ()


@pytest.mark.long
@pytest.mark.slow
def test_a_spacecraft_that_no_plan_flies_flies_its_own_slews_again(tmp_path, capsys):
    assert run("new", "--like", "torquers", tmp_path / "given", "--seed", "1") == 0
    truth = simulated_truth(tmp_path / "again", "--campaign", tmp_path / "given", "--draw")
    given, flown = (read_campaign(tmp_path / name) for name in ("given", "again"))
    assert "flown again, from where each began" in capsys.readouterr().err
    assert [slew.name for slew in flown.slews] == [slew.name for slew in given.slews]
    dipoles = [campaign.slews[1].inputs["torquers"].values for campaign in (flown, given)]
    np.testing.assert_allclose(*dipoles)
    assert truth["J_locked_kgm2"] == truth["J_kgm2"]  # no wheels
    # The forward model at the truth explains what was written.
    model = Model(flown)
    theta = np.array(model.space.nulls)
    theta[:9] = [truth["parameters"][name] for name in model.space.names[:9]]
    shown = model.predict(theta)["rate"][0, 0]
    read = flown.slews[0].rate
    spread = (read - shown[: len(read)]) / np.array(flown.rate_sensor.sigma)
    assert np.abs(np.diff(spread, axis=0)).max() < 7.0 * 2**0.5
