"""`fit`: which seed it uses."""

from __future__ import annotations

import pytest
from support.chains import SHORT

from bayes_inertia.app import fit_campaign
from bayes_inertia.inference.settings import Settings
from bayes_inertia.report.page import write_report
from bayes_inertia.report.verdict import verdict_sentence


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


@pytest.mark.long
@pytest.mark.slow
def test_without_predicted_telemetry_the_result_is_the_same_and_can_be_shown(flown, tmp_path):
    told = fit_campaign.fit(flown.campaign, settings=SHORT)
    brief = fit_campaign.fit(flown.campaign, settings=SHORT, predict=False)
    assert brief.summary()["parameters"] == told.summary()["parameters"]
    assert brief.summary()["gates"] == told.summary()["gates"]
    assert "rate" in told.tree["posterior_predictive"]
    assert not brief.tree["posterior_predictive"].data_vars
    page = write_report(brief, tmp_path / "report.html")
    assert verdict_sentence(told.summary()) in page.read_text(encoding="utf-8")
