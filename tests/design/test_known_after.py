"""What a fit says of the slews after its campaign: J after changes, as wide as it is quoted."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.campaign.actuators import Change
from bayes_inertia.design.after_campaign import known_after, mission_after
from bayes_inertia.flight.mission import Mission
from bayes_inertia.physics.effects.inertia_change import InertiaChange
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def fitted(model, theta, sd, **said):
    """What is asked of an estimate, with parameters that know nothing of each other."""
    d, b = len(theta), model.n_bias
    found = {
        "model": model,
        "theta": theta,
        "free": np.arange(d),
        "joint_covariance": np.diag(np.concatenate([np.square(sd), np.ones(b)])),
        "dispersion_factor": 1.0,
        "prior_beyond_shifts": np.zeros((0, d)),
        "discount": np.ones((model.n_slews, len(model.channels))),
    }
    return SimpleNamespace(**(found | said))


@pytest.mark.parametrize("stated", [True, False])
def test_after_a_change_of_the_inertia_tensor_J_is_the_one_after_it(stated):
    campaign = small_campaign()
    if stated:
        campaign = replace(campaign, changes=(Change("fuel", campaign.slews[-1].start),))
    model = Model(campaign, () if stated else (InertiaChange(),))
    theta, sd = model.space.mean.copy(), 1e-3 * np.ones(model.space.size)
    name = "fuel" if stated else "inertia_change"
    theta[model.space.slice_of(name)] = change = 0.01 * np.arange(6.0)
    after, covariance = known_after(fitted(model, theta, sd))
    np.testing.assert_allclose(after[:6], theta[:6] + change)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance))[:6], np.sqrt(2.0) * 1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance))[6:9], 1e-3)
    mission = mission_after(Mission.of(campaign), fitted(model, theta, sd))
    np.testing.assert_allclose(mission.theta[:6], theta[:6] + change)
    np.testing.assert_allclose(mission.base.sd[:6], np.sqrt(2.0) * 1e-3)


def test_a_mission_after_a_fit_is_as_uncertain_and_as_loud_as_the_fit_quotes():
    """Slews that disagree widen it; noise that was louder than stated is flown as loud."""
    campaign = small_campaign()
    model = Model(campaign)
    sd = 1e-3 * np.ones(model.space.size)
    quiet, loud = (
        fitted(model, model.space.mean, sd, dispersion_factor=factor, discount=discount)
        for factor, discount in (
            (1.0, np.ones((model.n_slews, len(model.channels)))),
            (3.0, np.full((model.n_slews, len(model.channels)), 0.25)),
        )
    )
    stated = Mission.of(campaign)
    assert mission_after(stated, quiet).spacecraft == stated.spacecraft
    found = mission_after(stated, loud)
    np.testing.assert_allclose(found.base.sd, 3e-3)
    assert found.spacecraft.rate_sensor.sigma == tuple(2.0 * x for x in campaign.rate_sensor.sigma)
    tracker = found.spacecraft.star_tracker
    assert tracker.sigma_roll == 2.0 * campaign.star_tracker.sigma_roll
    wheels = zip(found.spacecraft.wheels, campaign.wheels, strict=True)
    assert all(a.momentum_sigma == 2.0 * b.momentum_sigma for a, b in wheels)


def test_a_dated_change_makes_J_less_known_before_any_fit():
    campaign = small_campaign()
    change = Change("fuel", campaign.slews[-1].start, sigma_fraction=0.05)
    before, after = (Mission.of(c).base for c in (campaign, replace(campaign, changes=(change,))))
    added = 0.05 * campaign.scale_of_motion()[2]
    np.testing.assert_allclose(after.sd[:6], np.hypot(before.sd[:6], added))
    np.testing.assert_allclose(after.sd[6:], before.sd[6:])
    np.testing.assert_allclose(after.mean, before.mean)
