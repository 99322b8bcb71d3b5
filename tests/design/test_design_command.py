"""`design` and `compare` on the command line."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.commands import run

import bayes_inertia
from bayes_inertia.app import plan_folder
from bayes_inertia.app.options import DesignRequest
from bayes_inertia.app.plan_folder import keep_outs, limits_asked, plans_named
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.designer import design_plan
from bayes_inertia.design.limits import (
    KeepOut,
)
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


DEGREE = math.pi / 180.0


@pytest.mark.long
@pytest.mark.slow
def test_design_command_writes_a_plan_that_simulate_flies(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        plan_folder, "design_plan", partial(design_plan, candidates=100, starts=2, draws=1)
    )
    out = tmp_path / "run"
    assert run("design", EXAMPLE, "-o", out) == 0
    content = json.loads((out / "design.json").read_text())
    assert content["kept"]
    assert content["gain"] > 1.2
    assert {m["limit"] for m in content["flown_margins"]} >= {
        "rate",
        "total time",
        "torque of wheel_x",
    }
    plan = read_plan(out / "plan.toml")
    assert plan.start_attitude == pytest.approx(read_campaign(EXAMPLE).slews[-1].attitude[-1])
    assert "axes x, y, z" in (out / "plan.toml").read_text().splitlines()[2]
    assert run("simulate", "-o", tmp_path / "flown", "--plan", out / "plan.toml") == 0
    assert run("compare", EXAMPLE, out / "plan.toml", "paper", "-o", tmp_path / "compared") == 0
    table = json.loads((tmp_path / "compared" / "compare.json").read_text())["plans"]
    assert [
        max(p["expected_sd"][k] for k in ("Jxy", "Jxz", "Jyz")) for p in table.values()
    ] == sorted(max(p["expected_sd"][k] for k in ("Jxy", "Jxz", "Jyz")) for p in table.values())
    assert (tmp_path / "compared" / "compare.png").stat().st_size > 10_000
    for page in (out / "design.html", tmp_path / "compared" / "compare.html"):
        assert page.read_text().count("<figure") == 1
    assert "Largest sd of a product of inertia" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--total-time", "1000"), ("limit total time", "1000 s allowed")),
        (("--goal", "cross_term"), ("cross_terms",)),
        (("--keep-out", "Sun,1,0"), ("Sun,1,0", "half_angle_deg")),
        (("--goal", "separate:wheel_friction,constant_tork"), ("constant_torque",)),
        (("--max-rate", "-1"), ("rate", "positive")),
        (("--max-rate", "-1"), ("error: --max-rate: -1 deg/s is not positive",)),
        (("--max-angle", "0"), ("error: --max-angle: 0 deg is not positive",)),
        (("--total-time", "nan"), ("error: --total-time: nan s is not positive",)),
        (("--total-time", "inf"), ("error: --total-time: inf s is no positive number",)),
        (("--keep-out", "Sun,1,0,0,190"), ("--keep-out 'Sun", "190.0 is too large", "than 180")),
        (("--keep-out", "Sun,0,0,0,30"), ("--keep-out 'Sun", "direction_N: ", "no direction")),
        (("--end-attitude", "0,0,1"), ("end_attitude", "quaternion")),
    ],
)
def test_bad_requests_end_with_2_and_one_message(tmp_path, capsys, arguments, words):
    assert run("design", EXAMPLE, "-o", tmp_path / "run", *arguments) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ")
    assert message.count("\n") == 1
    assert all(word in message for word in words), message
    assert not (tmp_path / "run").exists()


def test_compare_wants_plans_that_exist(tmp_path, capsys):
    assert run("compare", EXAMPLE, tmp_path / "none.toml", "-o", tmp_path / "run") == 2
    assert "none.toml" in capsys.readouterr().err
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "compare.png").write_text("mine")
    assert run("compare", EXAMPLE, "paper", "-o", tmp_path / "taken") == 2
    assert (tmp_path / "taken" / "compare.png").read_text() == "mine"


def test_a_comparison_claims_its_folder_before_fits_are_kept(tmp_path, monkeypatch):
    def interrupted(*args, folder, **kwargs):
        assert not folder.exists()
        raise KeyboardInterrupt

    monkeypatch.setattr(plan_folder, "compare_plans", interrupted)
    for simulated in (0, 2):
        with pytest.raises(KeyboardInterrupt):
            plan_folder.run_compare(EXAMPLE, ["paper"], tmp_path / "run", simulated=simulated)
        assert (tmp_path / "run" / "compare.json").exists() == bool(simulated)
    with pytest.raises(OutputError, match="other seed"):
        plan_folder.run_compare(EXAMPLE, ["paper"], tmp_path / "run", simulated=2, seed=5)


def test_what_a_plan_file_leaves_out_is_as_in_the_campaign(tmp_path, capsys):
    campaign, path = read_campaign(EXAMPLE), tmp_path / "plan.toml"
    write_plan(paper_like_plan(), path)
    slews = "[[slews]]" + path.read_text().partition("[[slews]]")[2]
    head = 'format = "bayes-inertia-plan/1"\nname = "by hand"\n'
    path.write_text(head + slews)
    paper, by_hand = plans_named(["paper", str(path)], campaign).values()
    assert replace(by_hand, name=paper.name) == paper
    path.write_text(f"{head}wheel_momentum_Nms = [0, 0, 0, 0]\n{slews}")
    assert run("compare", EXAMPLE, path, "-o", tmp_path / "run") == 2
    error = f"{path}, key wheel_momentum_Nms: 4 momenta for 3 wheels"
    assert error in capsys.readouterr().err


def at_rest(slew, rate):
    seen = np.where(np.isfinite(slew.attitude), slew.attitude[slew.fixes][0], np.nan)
    still = {key: np.zeros_like(getattr(slew, key)) for key in ("wheel_torque", "wheel_momentum")}
    return replace(slew, rate=rate, attitude=seen, **still)


@pytest.mark.parametrize(("noise", "bias"), [(2e-5, 0.0), (2e-5, 1e-4), (0.0, 0.0)])
def test_without_a_largest_rate_it_is_one_degree_a_second_after_a_campaign_at_rest(noise, bias):
    campaign, rng = read_campaign(EXAMPLE), np.random.default_rng(1)
    moved = limits_asked(DesignRequest(), campaign)
    assert moved.rate == pytest.approx(campaign.largest_rate() / (1.0 - moved.rate_reserve))
    slews = tuple(at_rest(s, bias + noise * rng.normal(size=s.rate.shape)) for s in campaign.slews)
    gyro = replace(campaign.rate_sensor, bias_sigma=(1e-4,) * 3)
    rested = replace(campaign, rate_sensor=gyro, slews=slews)
    limits = limits_asked(DesignRequest(), rested)
    assert limits.rate == pytest.approx(DEGREE / (1.0 - limits.rate_reserve))


def test_keep_out_cones_from_a_file(tmp_path):
    path = tmp_path / "cones.toml"
    path.write_text('[[keep_out]]\nname = "Earth"\ndirection_N = [0, 0, -2]\nhalf_angle_deg = 65\n')
    assert keep_outs([str(path), "Sun, 1, 0, 0, 30"]) == (
        KeepOut("Earth", (0.0, 0.0, -1.0), 65 * DEGREE),
        KeepOut("Sun", (1.0, 0.0, 0.0), 30 * DEGREE),
    )
    path.write_text('[[keep_out]]\nname = "Sun"\n')
    with pytest.raises(CampaignError, match="direction_N"):
        keep_outs([str(path)])
    path.write_text(
        '[[keep_out]]\nname = "Sun"\ndirection_N = [0, 0, 1]\nhalf_angle_deg = 5\nframe = "body"\n'
    )
    with pytest.raises(CampaignError, match="frame"):
        keep_outs([str(path)])
