"""`fit` with Student-t noise and sampled scales: the command, the run folder, the whole result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.noisy_campaigns import spiked

import bayes_inertia
from bayes_inertia.app import run_folder
from bayes_inertia.app.cli import main
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.errors import OutputError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.settings import Settings
from bayes_inertia.physics.channel_noise import ChannelNoise, NoiseModel
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.fit_sections import standard_sections
from bayes_inertia.report.page import write_report
from bayes_inertia.sealing import SEAL_KEY

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
HEAVY = NoiseModel(rate=ChannelNoise("student_t"), attitude=ChannelNoise(scale_sampled=True))
SHORT = Settings(seed=1, ensembles=2, steps=60, max_steps=120, target_ess=1000.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--noise", "gyro=student_t"], "no channel is called 'gyro'"),
        (["--noise", "rate=normal"], "no distribution is called 'normal'"),
        (["--sample-noise", "rate,tracker"], "no channel is called 'tracker'"),
        (["--drive", "measured", "--noise", "momentum=student_t"], "channel momentum"),
    ],
)
def test_noise_that_cannot_be_ends_with_2_and_one_message(tmp_path, capsys, options, words):
    with pytest.raises(SystemExit) as stop:
        main(["fit", str(EXAMPLE), "-o", str(tmp_path / "run"), *options])
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert error.startswith("error: ")
    assert words in error
    assert not (tmp_path / "run").exists()


def test_a_run_keeps_its_noise_and_refuses_another(tmp_path):
    started = run_folder.start(EXAMPLE, tmp_path / "run", noise=HEAVY)
    assert run_folder.read_run(tmp_path / "run") == started
    assert started.noise == HEAVY
    assert run_folder.start(EXAMPLE, tmp_path / "run", noise=HEAVY) == started
    with pytest.raises(OutputError, match="other noise"):
        run_folder.start(EXAMPLE, tmp_path / "run")


def test_a_run_of_before_has_the_noise_as_stated(tmp_path):
    started = run_folder.start(EXAMPLE, tmp_path / "run")
    claim = tmp_path / "run" / "run.json"
    content = json.loads(claim.read_text())
    # Neither noise nor a seal stood there.
    content.pop("noise")
    content.pop(SEAL_KEY, None)
    claim.write_text(json.dumps(content))
    assert run_folder.read_run(tmp_path / "run") == started
    assert run_folder.start(EXAMPLE, tmp_path / "run") == started


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("share", [0.005, 0.05])
def test_a_fit_among_outliers_is_trusted_and_near_the_clean_one(flown, tmp_path, share):
    clean = optimizer.estimate(Model(flown.campaign))
    campaign, rows = spiked(flown.campaign, share)
    posterior = fit(campaign, noise=HEAVY, settings=SHORT)
    summary = posterior.summary()
    assert summary["trusted"], summary["reasons"]
    assert summary["effects"] == []
    j_and_k = list(summary["parameters"].values())[:9]
    shift = [abs(p["mean"] - x) / p["sd"] for p, x in zip(j_and_k, clean.theta, strict=True)]
    assert max(shift) < 1.0
    dirt = [d for d in summary["dirt"] if d["kind"] == "outliers"]
    assert {(d["channel"], d["treated"]) for d in dirt} == {("rate", "modelled")}
    assert {d["slew"]: set(d["rows"]) for d in dirt} == rows
    scale = summary["parameters"]["noise.attitude_scale"]
    # 72 numbers, of which the start attitudes cost 18: sd of the logarithm 1/sqrt(2 (72 - 18)).
    assert scale["sd"] / scale["mean"] == pytest.approx(1.0 / np.sqrt(2.0 * 54.0), rel=0.15)
    assert scale["contraction"] > 0.9
    _holds_together(posterior, tmp_path)


def _holds_together(posterior, folder):
    """Predictions have the noise of the model, and all of it is kept and reported."""
    tree = Posterior.load(posterior.save(folder / "posterior.nc")).tree
    assert "noise.attitude_scale" in tree["posterior"]
    point = tree["log_likelihood_reading"]["rate_point"].values
    read = np.isfinite(tree["observed_data"]["rate"].values).any(-1)
    np.testing.assert_array_equal(np.isfinite(point), np.broadcast_to(read, point.shape))
    gap = tree["posterior_predictive"]["rate"].values - tree["observed_data"]["rate"].values
    # Draws of Student-t noise of 4 degrees of freedom: one in 150 beyond 5 scales.
    assert 0.003 < np.mean(np.abs(gap[np.isfinite(gap)]) > 5.0 * np.sqrt(2.0) * 2e-5) < 0.1
    page = write_report(posterior, folder / "report.html", standard_sections(posterior))
    text = Path(page).read_text()
    assert "attitude scale" in text
    assert "Student-t, 4 degrees of freedom" in text
