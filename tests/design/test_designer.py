"""Designed plans: gains, limits, requests that no plan can keep."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.campaign.hardware import InertiaPrior
from bayes_inertia.design.comparison import estimate_at_truth
from bayes_inertia.design.designer import design_plan, next_slew, set_up_design
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.limits import KeepOut, Limits
from bayes_inertia.design.margins import broken_limits, flown_margins
from bayes_inertia.errors import DesignError
from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference import optimizer
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.forward_model import Model


def by_limit(found) -> dict:
    return {m.limit: m for m in found}


@pytest.mark.long
@pytest.mark.slow
def test_design_beats_slews_like_the_papers_and_random_plans_within_all_limits(designed, mission):
    assert designed.gain > 1.5
    assert designed.value < 0.9 * designed.best_random
    assert designed.kept
    assert designed.plan.starts[-1] + designed.plan.durations[-1] <= designed.limits.total_time
    assert (
        designed.reference.starts[-1] + designed.reference.durations[-1]
        <= designed.limits.total_time
    )
    exact = [
        estimate_at_truth(p, mission.at_prior_mean()) for p in (designed.plan, designed.reference)
    ]
    achieved = [e.sd[3:6].max() for e in exact]
    assert achieved[1] / achieved[0] == pytest.approx(
        max(list(designed.reference_sd.values())[3:6]) / max(list(designed.sd.values())[3:6]),
        rel=0.03,
    )


@pytest.mark.long
@pytest.mark.slow
def test_same_seed_same_plan(designed, mission):
    stages = []
    again = design_plan(
        mission, candidates=150, starts=3, draws=2, seed=1, progress=lambda *a: stages.append(a)
    )
    assert again.plan == designed.plan
    assert stages == [
        ("preparing the forecast", 0, 0),
        ("scoring 150 random plans", 0, 0),
        *(("improving the best, plans", done, 4) for done in range(4)),
        ("flying the plan", 0, 0),
    ]
    # The prior is known before; every slew tells more.
    assert all(sd < again.sd_before[name] for name, sd in again.sd.items())
    assert again.units["Jxy"] == "kg m^2"


@pytest.mark.long
@pytest.mark.slow
def test_designed_plan_round_trips_and_flies_within_its_limits(designed, mission, tmp_path):
    plan = read_plan(write_plan(designed.plan, tmp_path / "plan.toml"))
    assert plan == designed.plan
    for seed in range(5):
        flight = fly(plan, mission, seed)
        assert not broken_limits(flown_margins(flight, designed.limits))
    # The check can fail: a limit just below what was used is reported as broken.
    used = by_limit(flown_margins(flight, designed.limits))["rate"].used
    assert [
        m.limit
        for m in broken_limits(flown_margins(flight, replace(designed.limits, rate=0.999 * used)))
    ] == ["rate"]


INFEASIBLE = {
    "too little time": (
        Limits(total_time=1500.0),
        "total time: 5 slews need at least .* 1500 s allowed",
    ),
    "start in the Sun": (
        Limits(keep_out=(KeepOut("Sun", (-0.35, 0.94, 0.05), 1.0),)),
        "before the first slew: keep-out Sun.* at the start, .*; start in another attitude$",
    ),
    "start with fast wheels": (
        Limits(rate=0.02),
        r"before the first slew: momentum of wheel_z: 0.07 N m s, 0.04 .*with slower wheels$",
    ),
    "end in the Moon": (
        Limits(
            end_attitude=(0.0, 0.0, 0.0, 1.0), keep_out=(KeepOut("Moon", (0.0, 0.0, 1.0), 0.2),)
        ),
        "end attitude.*keep-out Moon.* at the end, ",
    ),
}


@pytest.mark.parametrize("case", INFEASIBLE)
def test_infeasible_requests_say_which_limit_binds(case, mission):
    limits, message = INFEASIBLE[case]
    boresight = np.asarray(
        quaternion.to_inertial(
            jnp.asarray(paper_like_plan().start_attitude), jnp.array([0.0, 0.0, 1.0])
        )
    )
    if case == "start in the Sun":
        limits = Limits(keep_out=(KeepOut("Sun", tuple(boresight), 0.3),))
    if case == "start with fast wheels":
        wheels = tuple(replace(w, max_momentum=0.04) for w in mission.spacecraft.wheels)
        mission = replace(mission, spacecraft=replace(mission.spacecraft, wheels=wheels))
    with pytest.raises(DesignError, match=message):
        design_plan(mission, limits=limits)


@pytest.mark.long
@pytest.mark.slow
def test_a_limit_that_only_the_search_finds_out_is_named(craft, prior, designed):
    # At rest the wheels hold 0.07 N m s at most, which they may. A reserve of 45 % leaves 0.044,
    # less than they hold on average.
    weak = replace(craft, wheels=tuple(replace(w, max_momentum=0.08) for w in craft.wheels))
    with pytest.raises(DesignError, match=r"wheel momentum.*momentum of wheel_"):
        design_plan(
            Mission(weak, prior),
            limits=replace(designed.limits, wheel_reserve=0.45),
            candidates=100,
            starts=2,
            draws=2,
            seed=1,
        )


def test_wheels_that_do_not_span_three_axes_are_refused(craft, prior):
    with pytest.raises(DesignError, match="2 of three axes"):
        design_plan(
            Mission(replace(craft, wheels=craft.wheels[:2]), prior),
            base=replace(paper_like_plan(), wheel_momentum=()),
        )


@pytest.mark.long
@pytest.mark.slow
def test_next_slew_adds_what_is_missing(mission):
    """After slews about x and y alone, the next one teaches what they could not."""
    first = replace(paper_like_plan(), slews=paper_like_plan().slews[:2])
    flight = fly(first, mission, 5)
    estimate = optimizer.estimate(Model(flight.campaign), starts=1)
    design = next_slew(estimate)
    assert len(design.plan.slews) == 1
    assert design.kept
    assert design.value < 0.6 * estimate.sd[3:6].max()
    assert design.gain > 1.1


@pytest.mark.long
@pytest.mark.slow
def test_a_plan_for_a_nearly_flat_body_is_judged_by_tensors_that_a_body_can_have(craft):
    """A plate's draws from an estimate are unphysical half the time."""
    plate = replace(craft, inertia_B=np.diag([1.0, 1.0, 1.9999]))
    prior = InertiaPrior(plate.inertia_B, 0.04, 0.03)
    one = replace(paper_like_plan(), slews=paper_like_plan().slews[:1])
    mission = Mission(plate, prior)
    estimate = estimate_at_truth(one, mission)
    problem, _, _, truths = set_up_design(
        mission,
        parse_goal("cross_terms"),
        Limits(rate=0.02),
        one,
        1,
        seed=0,
        draws=12,
        after=estimate,
    )
    assert len(truths) == len(problem.thetas) == 12
    assert np.all(inertia_tensor.is_physical(problem.thetas[:, :6]))


def test_effects_fitted_along_stand_at_their_null():
    """A gain is one where it does nothing; an effect named twice is fitted once."""
    goal = parse_goal("separate:wheel_torque_gain,constant_torque")
    base, limits = paper_like_plan(), Limits(rate=0.0175)
    setup = set_up_design(
        most_like_mission(),
        goal,
        limits,
        base,
        5,
        seed=0,
        draws=2,
        effects=("rate_bias", "constant_torque"),
    )
    names = setup.problem.forecast.layout.names
    assert len(names) == len(set(names)) == 9 + 3 * 3
    for theta in setup.problem.thetas:
        nulls = dict(zip(names, theta, strict=True))
        assert nulls["wheel_torque_gain.gain_wheel_x"] == 1.0
        assert nulls["rate_bias.bias_x"] == 0.0
