"""The pipeline of a diagnosis: the same bits with and without a folder, and after a kill."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.app import diagnosed_fit, run_folder
from bayes_inertia.app.diagnosed_fit import NextFit, fit_after_diagnosis
from bayes_inertia.app.diagnosis_json import read_diagnosis
from bayes_inertia.inference.treatment import DirtTreatment
from bayes_inertia.physics.effects import REMAINDERS, ConstantTorque

QUICK = bi.Settings(seed=4, ensembles=4, walkers=32, steps=40, max_steps=40, target_ess=100.0)


def said(posterior: bi.Posterior) -> dict:
    """The summary, without what a folder and a clock add."""
    summary = posterior.summary()
    summary["diagnostics"].pop("seconds")
    summary.pop("campaign_sha256")
    return summary


@pytest.mark.long
@pytest.mark.slow
def test_the_pipeline_gives_the_same_bits_with_and_without_a_folder(flown, tmp_path):
    folder = tmp_path / "run"
    bi.write_campaign(flown.campaign, tmp_path / "campaign")
    run_folder.start(tmp_path / "campaign", folder, settings=QUICK, kind="diagnose")
    stored = run_folder.finish(folder, report=False)
    result = bi.diagnose_and_fit(bi.read_campaign(tmp_path / "campaign"), settings=QUICK)
    assert result.diagnosis.verdict == read_diagnosis(folder)["verdict"]
    assert result.trusted == (result.posterior.trusted and result.diagnosis.verdict != "unknown")
    assert said(result.posterior) == said(stored)
    np.testing.assert_array_equal(result.posterior.samples, stored.samples)
    # Killed after its first half: diagnosis.json is there, nothing else is.
    shutil.rmtree(folder / "chains")
    (folder / "posterior.nc").unlink()
    again = run_folder.finish(folder, report=False)
    np.testing.assert_array_equal(again.samples, stored.samples)
    assert said(again) == said(stored)


@pytest.mark.parametrize("effects", [(ConstantTorque(),), REMAINDERS])
@pytest.mark.parametrize("verdict", ["named", "unknown"])
def test_noise_is_taken_as_measured_unless_something_has_no_name(
    flown, monkeypatch, verdict, effects
):
    calls = {}

    def fit(campaign, **options):
        calls.update(options, campaign=campaign)
        return "posterior"

    monkeypatch.setattr(diagnosed_fit, "fit", fit)
    noise = {"rate": 2.0, "attitude": 1.0, "momentum": 1.0}
    wanted = NextFit(verdict, effects, DirtTreatment(level=noise), "commanded")
    fit_after_diagnosis(flown.campaign, wanted, drive=None, settings=QUICK)
    assert calls["settings"].seed == 4
    assert calls["effects"] == effects
    factor = calls["campaign"].rate_sensor.sigma[0] / flown.campaign.rate_sensor.sigma[0]
    assert factor == (2.0 if verdict == "named" else 1.0)
    assert calls["as_stated"] is False
