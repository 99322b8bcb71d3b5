"""The slew that separates two effects."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from bayes_inertia.design.margins import broken_limits
from bayes_inertia.design.separating_slew import forecast_separation, separating_slew
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.score_test import score_tests
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate, move_to, with_noise
from bayes_inertia.physics.effects import ConstantTorque, StarTrackerShift, by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def test_no_slew_is_proposed_that_the_wheels_cannot_fly():
    campaign = small_campaign()
    states = ("running", "free", "free")
    wheels = (replace(w, state=s) for w, s in zip(campaign.wheels, states, strict=True))
    one_wheel = replace(campaign, wheels=tuple(wheels))
    theta = np.array([*campaign.inertia.elements, 1.0, 1.0, 1.0])
    one = Mock(spec=Estimate, model=SimpleNamespace(campaign=one_wheel), theta=theta)
    with pytest.raises(CampaignError, match="about 1 of three axes"):
        separating_slew(one, ConstantTorque(), StarTrackerShift())


@pytest.mark.long
@pytest.mark.slow
def test_noise_that_was_found_louder_is_that_of_the_next_slew_too():
    at = estimate(Model(small_campaign()), starts=1, discount=False)
    effects = ConstantTorque(), StarTrackerShift()
    (plain, _), (loud, _) = (
        forecast_separation(fit, *effects) for fit in (at, with_noise(at, {"rate": 2.0}))
    )
    channels = at.model.structure.place("rate"), at.model.structure.place("attitude")
    for channel, louder in zip(channels, (2.0, 1.0), strict=True):
        before, after = (f.arrays.conditions.factors[channel] for f in (plain, loud))
        np.testing.assert_allclose(louder * np.asarray(after), before)


@pytest.mark.long
@pytest.mark.slow
def test_separating_slew_starts_from_what_the_fingerprints_say(craft, prior):
    """Without tachometers friction and a constant torque look alike.

    `analyses/design/designed_plans.py` flies what is proposed.
    """
    deaf = replace(craft, wheels=tuple(replace(w, momentum_sigma=None) for w in craft.wheels))
    names = ("wheel_friction", "constant_torque")
    effects = by_name(names)
    plan = replace(paper_like_plan(), telemetry_period=1.0)
    campaign = fly(plan, Mission(deaf, prior), 3).campaign
    at = estimate(Model(campaign), starts=1)
    found, both = separating_slew(at, *effects), move_to(at, Model(campaign, effects))
    assert found.correlation[0] == pytest.approx(
        score_tests(linear_model(both)).canonical_correlation(0, 1),
        abs=1e-6,
    )
    assert found.correlation[0] > 0.99
    assert found.correlation[1] < 0.95
    assert all(after > 2.0 * before for before, after in found.noncentrality)
    assert not broken_limits(found.margins)
