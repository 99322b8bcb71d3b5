"""Imported high-rate readings as block means, and a folder that reads back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.campaign.block_means import longest_block, reduced
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, Wheel
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import content_of, files_of
from bayes_inertia.importing.import_logs import reduced_content


def campaign_at(rows_a_second: float) -> Campaign:
    time = np.arange(2000) / rows_a_second
    rng = np.random.default_rng(0)
    rate = 5.0 * np.sin(time[:, None] + np.arange(3)) + 0.01 * rng.normal(size=(len(time), 3))
    momentum = np.full((len(time), 1), 3e-4)
    wheel = Wheel("z", (0.0, 0.0, 1.0), 1e-6, momentum_sigma=1e-5)
    prior = InertiaPrior(np.diag([4.8e-4, 2.5e-4, 5.6e-4]), 0.3, 5e-5)
    slew = Slew("throw", 0.0, time, rate, None, None, momentum)
    return Campaign("c", prior, (wheel,), RateSensor(sigma=0.01), None, (slew,))


def test_block_means_take_the_place_of_the_readings(tmp_path):
    campaign = campaign_at(4000.0)
    *content, means = reduced_content(*content_of(campaign), campaign)
    block = longest_block(campaign)
    assert f"means of {block} readings" in content[0]
    expected = reduced(campaign)
    assert means.rate_sensor.sigma == pytest.approx(expected.rate_sensor.sigma)
    np.testing.assert_allclose(means.slews[0].time, expected.slews[0].time, rtol=1e-12)
    for name, data in files_of(*content).items():
        (tmp_path / name).write_bytes(data)
    again = read_campaign(tmp_path)
    np.testing.assert_allclose(again.slews[0].rate, expected.slews[0].rate, rtol=1e-9)
    np.testing.assert_array_equal(again.slews[0].rate, means.slews[0].rate)


def test_slow_telemetry_stays_as_it_is():
    campaign = campaign_at(4.0)
    slow = replace(campaign, rate_sensor=replace(campaign.rate_sensor, sigma=(1e-5,) * 3))
    content = content_of(slow)
    *files, same = reduced_content(*content, slow)
    assert tuple(files) == content
    assert same is slow
