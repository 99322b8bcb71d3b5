"""Imported high-rate readings as block means, and a folder that reads back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.campaign.block_means import longest_block, reduced
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, Wheel
from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import write_campaign
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


def written(campaign: Campaign, folder) -> dict[str, bytes]:
    write_campaign(campaign, folder)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_block_means_take_the_place_of_the_readings(tmp_path):
    campaign = campaign_at(4000.0)
    content = written(campaign, tmp_path) | {"record.json": b"{}"}
    files, means = reduced_content(content, campaign)
    assert files["record.json"] == b"{}"
    block = longest_block(campaign)
    assert f"means of {block} readings".encode() in files["campaign.toml"]
    expected = reduced(campaign)
    assert means.rate_sensor.sigma == pytest.approx(expected.rate_sensor.sigma)
    np.testing.assert_allclose(means.slews[0].time, expected.slews[0].time, rtol=1e-12)
    other = tmp_path / "other"
    other.mkdir()
    for name, data in files.items():
        (other / name).write_bytes(data)
    again = read_campaign(other)
    np.testing.assert_allclose(again.slews[0].rate, expected.slews[0].rate, rtol=1e-9)


def test_slow_telemetry_stays_as_it_is(tmp_path):
    campaign = campaign_at(4.0)
    slow = replace(campaign, rate_sensor=replace(campaign.rate_sensor, sigma=(1e-5,) * 3))
    content = written(slow, tmp_path)
    files, same = reduced_content(content, slow)
    assert files == content
    assert same is slow
