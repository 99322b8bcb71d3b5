"""Plans: profiles of slews, times and star-tracker fixes."""

from __future__ import annotations

import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.flight.plan import PlannedSlew, angle_and_rate, paper_like_plan

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
