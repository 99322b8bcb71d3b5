"""Plans that begin where a campaign ended, with the wheel momentum that is known there."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.app import plan_folder
from bayes_inertia.app.commands.plans import show_design
from bayes_inertia.app.options import DesignRequest
from bayes_inertia.app.plan_folder import run_design
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.design import after_campaign, designer
from bayes_inertia.design.after_campaign import final_wheel_momentum, plan_after
from bayes_inertia.design.designer import next_slew
from bayes_inertia.flight.mission import following_plan, most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


@pytest.fixture(scope="module")
def flight():
    """Two slews of a spacecraft without tachometers."""
    mission = most_like_mission()
    craft = mission.spacecraft
    craft = replace(craft, wheels=tuple(replace(w, momentum_sigma=None) for w in craft.wheels))
    plan = paper_like_plan()
    plan = replace(plan, slews=plan.slews[:2], telemetry_period=1.0)
    return fly(plan, replace(mission, spacecraft=craft), 5)


@pytest.fixture(scope="module")
def estimate(flight):
    return optimizer.estimate(Model(flight.campaign), starts=1)


class Captured(Exception):
    """Ends a design as soon as its arguments are known."""


@pytest.fixture
def captured(monkeypatch):
    """The arguments of the one call of `design_plan`."""
    arguments = SimpleNamespace()

    def design_plan(mission, goal, limits, **keywords):
        vars(arguments).update(keywords, limits=limits)
        raise Captured

    monkeypatch.setattr(designer, "design_plan", design_plan)
    monkeypatch.setattr(plan_folder, "design_plan", design_plan)
    return arguments


@pytest.mark.long
@pytest.mark.slow
def test_the_fit_knows_the_wheel_momentum_at_the_end(flight, estimate):
    assert not flight.campaign.has_tachometers
    truth = flight.truth[-1].wheel_momentum[-1]
    # Momentum along the axis of the last slew leaves hardly a trace in its motion.
    error = np.linalg.norm(final_wheel_momentum(estimate) - truth)
    assert error < 0.1 * np.linalg.norm(truth)
    assert plan_after(estimate).wheel_momentum == tuple(final_wheel_momentum(estimate).tolist())


@pytest.mark.slow
def test_the_correction_forecast_begins_with_the_momentum_that_the_fit_knows(estimate, monkeypatch):
    """Wheels at rest, where the last slew left some spinning, would turn without torque."""
    flown = []

    def predict_correction_slew(thetas, plan, *arguments, **keywords):
        flown.append(plan)
        return np.ones(len(thetas))

    monkeypatch.setattr(after_campaign, "predict_correction_slew", predict_correction_slew)
    assert after_campaign.correction_forecast(estimate, estimate, draws=2)
    expected = tuple(final_wheel_momentum(estimate).tolist())
    assert np.abs(expected).max() > 1e-3
    assert {plan.wheel_momentum for plan in flown} == {expected}


@pytest.mark.parametrize(("telemetry", "control"), [(10.0, 1.0), (0.25, 0.25)])
def test_the_correction_forecast_is_flown_by_a_loop_faster_than_slow_telemetry(
    monkeypatch, telemetry, control
):
    """A loop of 10 s adds 12 arc seconds of its own to what J and K do."""
    small, flown = small_campaign(), []
    slews = [replace(slew, time=telemetry * slew.time) for slew in small.slews]
    draws = np.array([[*small.inertia.elements, 1.0, 1.0, 1.0]])

    def predict_correction_slew(thetas, plan, *arguments, **keywords):
        flown.append(plan.telemetry_period)
        return np.ones(len(thetas))

    monkeypatch.setattr(after_campaign, "predict_correction_slew", predict_correction_slew)
    campaign = replace(small, slews=tuple(slews))
    assert after_campaign.correction_with_update(campaign, draws, draws[0], draws[0])
    assert set(flown) == {control}


@pytest.mark.slow
def test_tachometers_are_believed_before_the_fit(flight):
    last = flight.campaign.slews[-1]
    measured = np.tile([0.1, 0.2, np.nan], (len(last.time), 1))
    measured[:-1, 2] = 0.3
    wheels = tuple(replace(w, momentum_sigma=1e-5) for w in flight.campaign.wheels)
    slews = (flight.campaign.slews[0], replace(last, wheel_momentum=measured))
    campaign = replace(flight.campaign, wheels=wheels, slews=slews)
    assert following_plan(campaign, np.ones(3)).wheel_momentum == (0.1, 0.2, 0.3)
    assert following_plan(flight.campaign, np.ones(3)).wheel_momentum == (1.0, 1.0, 1.0)
    assert following_plan(flight.campaign).wheel_momentum == ()


@pytest.mark.slow
def test_next_slew_without_tachometers_begins_with_the_wheels_turning(estimate, captured):
    with pytest.raises(Captured):
        next_slew(estimate)
    np.testing.assert_array_equal(captured.base.wheel_momentum, final_wheel_momentum(estimate))


@pytest.mark.slow
def test_design_after_a_campaign_begins_with_the_wheels_turning(flight, captured, tmp_path):
    write_campaign(flight.campaign, tmp_path / "campaign")
    with pytest.raises(Captured):
        run_design(tmp_path / "campaign", tmp_path / "run", DesignRequest(after=True))
    truth = flight.truth[-1].wheel_momentum[-1]
    assert np.linalg.norm(captured.base.wheel_momentum - truth) < 0.1 * np.linalg.norm(truth)
    with pytest.raises(Captured):
        run_design(tmp_path / "campaign", tmp_path / "run", DesignRequest(after=False))
    assert captured.base.wheel_momentum == ()


@pytest.mark.long
@pytest.mark.slow
def test_what_a_design_fits_along_takes_from_what_the_campaign_tells(flight, captured, tmp_path):
    """Without it the campaign would seem to tell more of J and K than it does."""
    write_campaign(flight.campaign, tmp_path / "campaign")
    request = DesignRequest(after=True, effects="constant_torque")
    with pytest.raises(Captured):
        run_design(tmp_path / "campaign", tmp_path / "run", request)
    assert [effect.name for effect in captured.after.model.effects] == ["constant_torque"]
    plain = optimizer.estimate(Model(captured.after.model.campaign))
    assert (captured.after.sd[:6] / plain.sd[:6]).max() > 1.01


def in_alternate_rows(campaign):
    """The campaign with the rate about x in even rows, those about y and z in odd ones."""
    slews = []
    for slew in campaign.slews:
        rate = slew.rate.copy()
        rate[1::2, 0] = rate[::2, 1:] = np.nan
        slews.append(replace(slew, rate=rate))
    return replace(campaign, slews=tuple(slews))


def saturated(campaign):
    """The campaign with one reading in ten at the end of the rate sensor's range, 0.1 rad/s."""
    slews = []
    for slew in campaign.slews:
        rate = slew.rate.copy()
        rate[::10, 2] = 0.1
        slews.append(replace(slew, rate=rate))
    sensor = replace(campaign.rate_sensor, range=0.1)
    return replace(campaign, rate_sensor=sensor, slews=tuple(slews))


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [in_alternate_rows, saturated])
def test_the_largest_rate_of_a_campaign_is_that_of_its_motion(
    flight, estimate, captured, tmp_path, spoil
):
    campaign = spoil(flight.campaign)
    flown = max(np.linalg.norm(path.rate_B, axis=1).max() for path in flight.truth)
    with pytest.raises(Captured):
        next_slew(replace(estimate, model=Model(campaign)))
    assert captured.limits.rate == pytest.approx(1.1 * flown, rel=0.05)
    write_campaign(campaign, tmp_path / "campaign")
    with pytest.raises(Captured):
        run_design(tmp_path / "campaign", tmp_path / "run", DesignRequest())
    reserve = captured.limits.rate_reserve
    assert captured.limits.rate == pytest.approx(flown / (1.0 - reserve), rel=0.05)


@pytest.mark.long
@pytest.mark.slow
def test_a_design_says_where_it_takes_the_wheels_to_be_at_rest(
    flight, monkeypatch, tmp_path, capsys
):
    small = partial(designer.design_plan, candidates=30, starts=1, draws=1)
    monkeypatch.setattr(plan_folder, "design_plan", small)
    write_campaign(flight.campaign, tmp_path / "campaign")
    folder = tmp_path / "run"
    show_design(run_design(tmp_path / "campaign", folder, DesignRequest(slews=1)), folder)
    said = "the wheels are taken to be at rest at the start"
    assert said in " ".join(capsys.readouterr().out.split())
    assert said in (folder / "plan.toml").read_text()
    content = json.loads((folder / "design.json").read_text())
    assert content["start_wheel_momentum_Nms"] == [0.0, 0.0, 0.0]
    assert content["start_wheel_momentum_from"] == "unknown, taken to be zero"
