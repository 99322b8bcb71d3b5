"""Noise that wanders as the campaign states it: taken by itself, nothing estimated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.campaign.hardware import RateSensor
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.physics.effects import (
    RateBiasInstability,
    RateRandomWalk,
    StarTrackerLowFrequency,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.physics.stated_noise import stated_noise, stated_terms

STATED = {"rate_random_walk": 3e-6, "bias_instability": 1e-6, "bias_instability_time": 40.0}


def wandering():
    campaign = small_campaign()
    tracker = replace(campaign.star_tracker, low_frequency_sigma=2e-5)
    sensor = replace(campaign.rate_sensor, **STATED)
    return replace(campaign, rate_sensor=sensor, star_tracker=tracker)


def test_a_campaign_keeps_the_stated_terms_in_its_folder(tmp_path):
    campaign = wandering()
    write_campaign(campaign, tmp_path / "campaign")
    again = read_campaign(tmp_path / "campaign")
    assert {key: getattr(again.rate_sensor, key) for key in STATED} == STATED
    assert again.star_tracker.low_frequency_sigma == 2e-5


def test_a_model_takes_what_is_stated_and_estimates_none_of_it():
    plain, model = Model(small_campaign()), Model(wandering())
    assert model.effects == ()
    assert model.space.names == plain.space.names
    assert not model.structure.hyperparameters
    assert [effect.name for effect in model.structure.effects] == ["star_tracker_low_frequency"]
    assert plain.structure.effects == ()
    names = ("rate_random_walk", "rate_bias_instability", "star_tracker_low_frequency")
    assert stated_terms(wandering()) == names


def test_what_is_asked_for_is_estimated_around_the_stated_size():
    campaign = wandering()
    assert stated_noise(campaign, (StarTrackerLowFrequency(),)) == ()
    assert len(stated_noise(campaign, (RateRandomWalk(),))) == 1
    medians = {
        effect: [p.priors[0].median for p in effect.parameters(campaign)]
        for effect in (RateRandomWalk(), RateBiasInstability(), StarTrackerLowFrequency())
    }
    assert list(medians.values()) == [[3e-6], [1e-6, 40.0], [2e-5]]


def test_a_known_size_gives_the_prior_of_an_estimated_one_there():
    campaign, estimated = wandering(), StarTrackerLowFrequency()
    model = Model(campaign)
    known = next(e for e in model.structure.effects if e.name == estimated.name)
    (parameter,) = estimated.parameters(campaign)
    count = known.coefficient_count(campaign)
    slew = model.data.arrays.slews.context
    first = type(slew)(*(None if part is None else part[0] for part in slew))
    root = known.coefficient_root({}, first, count)
    size = {parameter.name: parameter.priors[0].median}
    np.testing.assert_array_equal(root, estimated.coefficient_root(size, first, count))
    doubled = estimated.coefficient_root({parameter.name: 2.0 * size[parameter.name]}, first, count)
    assert not np.allclose(root, doubled)


@pytest.mark.parametrize(
    "given",
    [
        {"bias_instability": 1e-6},
        {"bias_instability_time": 10.0},
        {"rate_random_walk": 0.0},
        {"rate_random_walk": -1e-6},
    ],
)
def test_half_a_statement_or_a_wrong_one_is_refused(given):
    with pytest.raises(CampaignError, match=next(iter(given)).removesuffix("_time")):
        RateSensor(sigma=2e-5, **given)
