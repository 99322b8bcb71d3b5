"""Noise that wanders as the campaign states it: taken by itself, nothing estimated."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from bayes_inertia.campaign.hardware import RateSensor, StarTracker
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.inference.noise_model import noise_memory
from bayes_inertia.physics.effects import (
    RateBiasInstability,
    RateRandomWalk,
    StarTrackerLowFrequency,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict_all
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


def test_the_walk_of_a_further_gyro_counts_as_that_of_the_first():
    small = wandering()
    slews = tuple(replace(slew, more={"second": slew.rate}) for slew in small.slews)
    steady = replace(small.rate_sensor, **dict.fromkeys(STATED))
    second = (("second", small.rate_sensor),)
    model = Model(replace(small, rate_sensor=steady, more_sensors=second, slews=slews))
    assert stated_terms(model.campaign)[0] == "rate_random_walk[second]"
    of_first = noise_memory(Model(small), model.channels[0], Model(small).space.mean)
    assert noise_memory(model, model.channels[0], model.space.mean) is None
    of_second = noise_memory(model, model.channels[-1], model.space.mean)
    for own, wanted in zip(of_second, of_first, strict=True):
        np.testing.assert_allclose(own, wanted)


@pytest.mark.slow
def test_groups_of_fixes_of_a_further_tracker_are_turned_each_by_its_own():
    small = small_campaign()
    kept = np.isin(np.arange(64), [0, 1, 2, 61, 62, 63])
    slews = [
        replace(s, more={"second": np.where(kept[:, None], s.attitude, np.nan)})
        for s in small.slews
    ]
    second = StarTracker((1.0, 0.0, 0.0), 2.4e-5, 1.4e-4, low_frequency_sigma=1e-3)
    model = Model(replace(small, more_sensors=(("second", second),), slews=tuple(slews)))
    structure = model.structure
    assert [effect.name for effect in structure.effects] == ["low_frequency[second]"]
    assert structure.coefficients == (6,)
    local = np.zeros((3, structure.n_local))
    predicted = jax.jit(predict_all, static_argnums=0)
    at = [
        predicted(structure, model.space.mean, x, np.zeros(3), model.data)
        for x in (local, local + np.eye(structure.n_local)[structure.n_start + 3])
    ]
    for channel, still, turned in zip(model.channels, *at, strict=True):
        moved = np.abs(np.asarray(channel.gap(still, turned))).max(axis=(0, 2))
        wanted = np.zeros(len(moved))
        if channel.name == "second":
            wanted[3:6] = 1e-3
        np.testing.assert_allclose(moved[:6], wanted[:6], atol=1e-9)


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
