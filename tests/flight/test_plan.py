"""Plans: profiles of slews, times and star-tracker fixes."""

from __future__ import annotations

import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_inertia
import bayes_inertia as bi
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.plan import PlannedSlew, angle_and_rate, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_paths
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.studies import plan_comparison
from bayes_inertia.studies.plan_comparison import compare_plans

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


@pytest.mark.parametrize("profile", ["trapezoid", "smooth"])
@pytest.mark.parametrize("degrees", [2.0, 45.0])
def test_profile_turns_the_angle_within_its_limits(profile, degrees):
    slew = PlannedSlew((0.0, 1.0, 0.0), math.radians(degrees), profile=profile)
    t = jnp.linspace(-5.0, slew.motion_time + 5.0, 20001)
    angle, rate = angle_and_rate(slew.angle, slew.rate, slew.acceleration, profile == "smooth", t)
    assert angle[0] == 0.0
    assert angle[-1] == pytest.approx(slew.angle, rel=1e-12)
    assert float(rate.max()) <= slew.rate * (1 + 1e-12)
    step = float(t[1] - t[0])
    # The second difference of an angle whose rate is linear by parts is its mean acceleration;
    # rounding of the angle over step^2 remains.
    assert float(jnp.abs(jnp.diff(rate)).max()) / step <= slew.acceleration * (1 + 1e-6)
    trapezoid_rule = float(jnp.sum(0.5 * (rate[1:] + rate[:-1])) * step)
    assert trapezoid_rule == pytest.approx(slew.angle, rel=1e-6)
    before_end = angle_and_rate(
        slew.angle,
        slew.rate,
        slew.acceleration,
        profile == "smooth",
        jnp.asarray(slew.motion_time - 0.5),
    )
    assert float(before_end[1]) > 0.0


def test_paper_like_plan_is_the_one_flown_in_basilisk():
    plan, flown = paper_like_plan(), read_campaign(EXAMPLE)
    np.testing.assert_allclose(plan.starts, [s.start for s in flown.slews], atol=1e-9)
    for i, (planned, slew) in enumerate(zip(plan.slews, flown.slews, strict=True)):
        np.testing.assert_allclose(planned.axis_B, slew.axis_B, atol=1e-6)
        assert planned.angle == pytest.approx(slew.angle, rel=1e-9)
        np.testing.assert_allclose(plan.times(i), slew.time, atol=1e-9)
        fixes = np.flatnonzero(np.isfinite(slew.attitude).all(axis=1))
        np.testing.assert_array_equal(np.concatenate(plan.fixes(i)), fixes)


SLEW = PlannedSlew((1.0, 0.0, 0.0), 0.5)


def design(**settings):
    return bi.design_plan(most_like_mission(), **settings)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: PlannedSlew("x", 0.5), "slews.axis: no array of numbers"),
        (lambda: PlannedSlew((1, 0, 0), "30 deg"), "slews.angle: '30 deg' is not positive"),
        (lambda: bi.Plan("one", SLEW), "slews: a PlannedSlew is no list"),
        (lambda: bi.Plan("one", [(1, 0, 0)]), "slews: a tuple is no PlannedSlew"),
        (lambda: bi.Plan("one", (SLEW,), start_attitude="x"), "start_attitude: no array"),
        (lambda: bi.Plan("one", (SLEW,), first_fix=None), "first_fix: None is no time"),
        (
            lambda: bi.Limits(keep_out=bi.KeepOut("Sun", (0, 0, 1), 0.5)),
            "keep_out: a KeepOut is no",
        ),
        (lambda: PlannedSlew((1, 0, 0), [0.5, 0.5]), r"slews.angle: \[0.5, 0.5\] is not positive"),
        (lambda: PlannedSlew((1, 0, 0), 0.5, duration="9"), "slews.duration: '9' is not positive"),
        (lambda: bi.Plan("one", (SLEW,), settle="1"), "settle: '1' is not positive"),
        (lambda: bi.Controller(np.eye(3), bandwidth="1"), "controller.bandwidth: '1' is not"),
        (lambda: bi.Limits(rate="1"), "limits.rate: '1' is not positive"),
        (lambda: bi.Limits(tolerance=None), "limits.tolerance: None is not positive"),
        (lambda: bi.Limits(wheel_reserve="0.2"), "limits.wheel_reserve: '0.2' is no fraction"),
        (
            lambda: bi.Limits(end_attitude=(math.nan, 0, 0, 1)),
            "end_attitude: .* no unit",
        ),
        (lambda: bi.KeepOut("Sun", "up", 0.5), "keep_out.Sun.direction_N: no array of numbers"),
        (lambda: bi.KeepOut("Sun", (0, 0, 1), "30"), "keep_out.Sun.half_angle: '30' is no half"),
        (lambda: design(goal=None), "unknown goal 'None'; choose"),
        (lambda: design(limits={"rate": 0.01}), "limits: a dict is no Limits; give a Limits"),
        (lambda: design(effects="wheel_friction"), "effects: a str is no list"),
        (lambda: bi.next_slew(most_like_mission()), "estimate: a Mission is no Estimate"),
        (lambda: bi.Goal(None), "unknown goal None; choose"),
        (lambda: bi.compare_plans(bi.Plan("one", (SLEW,)), None), "plans: a Plan is no list"),
        (
            lambda: bi.Spacecraft(np.eye(3), (1.0, 1.0), (), bi.RateSensor(1e-5)),
            "scale_factor: .*nor one for each of 3 axes",
        ),
    ],
)
def test_what_is_no_plan_or_spacecraft_is_said_with_its_key(make, says):
    with pytest.raises(bi.CampaignError, match=says):
        make()


@pytest.mark.parametrize("key", ["n_slews", "candidates", "starts", "draws"])
@pytest.mark.parametrize("count", [0, 2.0, "2"])
def test_a_design_refuses_what_is_no_count(key, count):
    with pytest.raises(bi.SettingsError, match=f"{key}: is .*; give a whole number, 1 or more"):
        design(**{key: count})


def test_a_plan_with_momenta_of_other_wheels_is_refused():
    campaign = small_campaign()
    plan = bi.Plan("one", (SLEW,), wheel_momentum=(0.1,))
    craft = Mission.of(campaign).spacecraft
    with pytest.raises(bi.CampaignError, match="wheel_momentum_Nms: 1 momenta for 3 wheels"):
        planned_paths(plan, craft)


@pytest.mark.parametrize("seed", [-1, 0.5, "one"])
def test_a_flight_refuses_what_is_no_seed(seed, tmp_path):
    plan = bi.Plan("one", (SLEW,))
    with pytest.raises(bi.SettingsError, match=r"seed: is .*; give a whole number"):
        bi.fly(plan, most_like_mission(), seed)
    with pytest.raises(bi.SettingsError, match=r"seed: is .*; give a whole number"):
        bi.simulate(plan, most_like_mission(), tmp_path, seed)


def test_plans_are_compared_for_a_campaign_as_for_its_mission(monkeypatch):
    monkeypatch.setattr(
        plan_comparison, "assess_plan", lambda name, plan, mission, *_, **__: mission
    )
    campaign = small_campaign()
    (of_campaign,) = compare_plans([paper_like_plan()], campaign)
    assert (of_campaign,) == compare_plans([paper_like_plan()], Mission.of(campaign))
    with pytest.raises(bi.CampaignError, match="a str is no Campaign or Mission"):
        compare_plans([paper_like_plan()], "campaign.toml")
