"""Simulated campaigns: in a folder with their truth, and drawn for studies."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.information_forecast import prepare_forecast
from bayes_inertia.errors import EffectError, OutputError
from bayes_inertia.flight.example_flight import flown_again
from bayes_inertia.flight.mission import Mission, prior_mean
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight, draw_spacecraft, simulate
from bayes_inertia.flight.spacecraft import spin_tensor
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.physics.small_campaign import small_campaign

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


def test_simulated_campaign_is_written_with_its_truth(mission, craft, tmp_path):
    flight = simulate(paper_like_plan(), mission, tmp_path / "run", 5)
    again = read_campaign(tmp_path / "run")
    for a, b in zip(flight.campaign.slews, again.slews, strict=True):
        for key in (
            "time",
            "rate",
            "attitude",
            "wheel_torque",
            "wheel_momentum",
            "magnetic_field_N",
            "position_N",
        ):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
    truth = json.loads((tmp_path / "run" / "truth.json").read_text())
    np.testing.assert_array_equal(truth["J_kgm2"], craft.inertia_B)
    np.testing.assert_array_equal(truth["b_radps"], flight.spacecraft.bias)
    assert truth["seed"] == 5
    assert set(json.loads((EXAMPLE / "truth.json").read_text())) - set(truth) <= {
        "bdot_radps2",
        "star_tracker_rotation_B",
        "star_tracker_shift_B",
        "vary",
        "integration_dt_s",
    }
    simulate(paper_like_plan(), mission, tmp_path / "run", 5)
    with pytest.raises(OutputError, match="overwrite"):
        simulate(paper_like_plan(), mission, tmp_path / "run", 6)


def test_studies_draw_truth_from_the_prior(mission, craft):
    template = planned_campaign(paper_like_plan(), mission)
    rng = np.random.default_rng(8)
    drawn = np.array(
        [
            np.concatenate([Mission(c, mission.prior).theta, c.bias])
            for c in (draw_spacecraft(template, rng) for _ in range(300))
        ]
    )
    sensor, prior = craft.rate_sensor, mission.prior
    mean = np.concatenate([prior.elements, sensor.scale_factor, sensor.bias])
    sd = np.concatenate([prior.sd, sensor.scale_factor_sigma, sensor.bias_sigma])
    # The prior's tensor is far from the edge of the physical ones, so that hardly any draw is
    # refused. Four sigma of 24 numbers.
    assert np.all(np.abs(drawn.mean(axis=0) - mean) < 4.0 * sd / math.sqrt(300))
    assert np.all(np.abs(drawn.std(axis=0) / sd - 1.0) < 4.0 / math.sqrt(600))


def test_studies_vary_the_slews_and_keep_their_length(mission):
    template = planned_campaign(paper_like_plan(), mission)
    flights = [draw_flight(template, paper_like_plan(), seed) for seed in (1, 2)]
    lengths = {len(s.time) for f in flights for s in f.campaign.slews}
    assert len(lengths) == 1
    angles = np.array([[s.angle for s in f.campaign.slews] for f in flights])
    assert len(np.unique(angles)) == angles.size
    assert angles.min() >= math.radians(20.0)
    assert angles.max() <= math.radians(60.0)
    repeated = draw_flight(template, paper_like_plan(), 2)
    np.testing.assert_array_equal(
        repeated.campaign.slews[3].rate, flights[1].campaign.slews[3].rate
    )


@pytest.mark.slow
def test_the_truth_of_slews_flown_again_leaves_the_wheels_spin_out():
    small = small_campaign()
    inertia = replace(small.inertia, includes_wheel_spin=True)
    campaign = replace(small, inertia=inertia, slews=small.slews[:1])
    with pytest.raises(EffectError, match="stochastic"):  # none would act, whatever the truth says
        flown_again(campaign, by_name(["torque_noise"]), {}, 0, draw=False)
    _, truth = flown_again(campaign, (), {}, 0, draw=False)
    np.testing.assert_allclose(truth["J_locked_kgm2"], inertia.tensor, rtol=1e-12)
    spin = np.subtract(truth["J_locked_kgm2"], truth["J_kgm2"])
    np.testing.assert_allclose(spin, spin_tensor(small.wheels), atol=1e-12)


@pytest.mark.long
@pytest.mark.slow
def test_a_former_result_is_what_flies_and_what_is_drawn():
    """A campaign whose J and K are known by a former run: its [inertia] is not the prior."""
    stated = small_campaign()
    center = 1.001 * prior_mean(stated)
    sd = 1e-3 * np.abs(center) + 1e-4
    correlation = 0.5 * np.eye(9) + 0.5
    known = GaussianPrior(BASE_NAMES, center, correlation * np.outer(sd, sd))
    mission = Mission.of(replace(stated, prior=known))
    np.testing.assert_allclose(mission.theta, center, rtol=1e-12)
    np.testing.assert_allclose(mission.at_prior_mean().theta, center, rtol=1e-12)
    np.testing.assert_allclose(mission.controller().scale_factor, center[6:], rtol=1e-12)
    planned = planned_campaign(paper_like_plan(), mission)
    assert planned.prior == known
    rng, n = np.random.default_rng(0), 400
    crafts = [draw_spacecraft(planned, rng) for _ in range(n)]
    drawn = np.array([[*np.diag(c.inertia_B), *c.scale_factor] for c in crafts])
    # 4.5 Monte Carlo errors of a sd, and of a correlation of a half.
    both = [0, 1, 2, 6, 7, 8]
    np.testing.assert_allclose(drawn.std(axis=0) / sd[both], 1.0, atol=4.5 / np.sqrt(2.0 * n))
    off = (np.corrcoef(drawn.T) - correlation[np.ix_(both, both)])[np.triu_indices(6, 1)]
    assert np.abs(off).max() < 4.5 * 0.75 / np.sqrt(n)
    forecast = prepare_forecast(paper_like_plan(), mission)
    before = np.linalg.inv(np.asarray(forecast.arrays.prior)[:9, :9])
    np.testing.assert_allclose(before, known.covariance, rtol=1e-6)
