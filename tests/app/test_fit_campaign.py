"""`fit`: which seed it uses."""

from __future__ import annotations

import pytest

from bayes_inertia.app import fit_campaign
from bayes_inertia.inference.settings import Settings


class Sampling(Exception):
    """Ends a fit where it would begin to sample."""


@pytest.mark.parametrize(
    ("given", "seed"),
    [
        ({}, 0),
        ({"settings": Settings(seed=5)}, 5),
        ({"seed": 7}, 7),
        ({"seed": 7, "settings": Settings(seed=5)}, 7),
        ({"seed": 0, "settings": Settings(seed=5)}, 0),
    ],
)
def test_the_seed_is_the_one_given_or_that_of_the_settings(flown, monkeypatch, given, seed):
    seeds = []

    def estimate(model, *, seed):
        seeds.append(seed)

    def sample(_, settings, **__):
        seeds.append(settings.seed)
        raise Sampling

    monkeypatch.setattr(fit_campaign.optimizer, "estimate", estimate)
    for passed_on in ("restarted_with_mode", "with_likely_inputs"):
        monkeypatch.setattr(fit_campaign, passed_on, lambda estimate: estimate)
    monkeypatch.setattr(fit_campaign, "sample", sample)
    with pytest.raises(Sampling):
        fit_campaign.fit(flown.campaign, as_stated=True, **given)
    assert seeds == [seed, seed]
