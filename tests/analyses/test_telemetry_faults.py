"""Injected telemetry faults are what it says: pure, seeded, and in the cells that it names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.physics.effects import by_name

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


@pytest.fixture(scope="module")
def dirt(analysis):
    return analysis("data_quality.faults")


@pytest.fixture(scope="module")
def kinds(analysis):
    return analysis("data_quality.kinds").KINDS


@pytest.fixture(scope="module")
def raw(dirt):
    return dirt.read_raw(EXAMPLE)


def same(a, b) -> bool:
    return a.description == b.description and all(
        table.equals(b.tables[file]) for file, table in a.tables.items()
    )


def test_a_folder_is_written_as_it_was_read(dirt, raw, tmp_path):
    again = read_campaign(dirt.write_raw(raw, tmp_path / "copy"))
    first = read_campaign(EXAMPLE)
    for one, other in zip(first.slews, again.slews, strict=True):
        np.testing.assert_array_equal(one.rate, other.rate)
        np.testing.assert_array_equal(one.attitude, other.attitude)


@pytest.mark.slow
def test_every_kind_changes_the_campaign_leaves_its_input_and_is_seeded(dirt, raw, kinds):
    pristine = dirt.read_raw(EXAMPLE)
    for kind in kinds.values():
        if not kind.possible(raw):
            continue
        first, second = (kind.inject(raw, np.random.default_rng(3), 1.0) for _ in range(2))
        assert same(first, second), kind.name
        assert not same(first, raw), kind.name
        assert same(raw, pristine), kind.name
        assert kind.sizes[0] <= kind.size(np.random.default_rng(1)) <= kind.sizes[1]


def test_hidden_effects_are_drawn_for_as_many_wheels_as_a_spacecraft_has(analysis):
    draws = analysis("naming.fixed_shape_campaigns")
    flights = analysis("data_quality.campaigns")
    for spacecraft, wheels in (("three_wheels", 3), ("four_wheels", 4)):
        campaign = flights.template(spacecraft)
        for effect in by_name(flights.HIDDEN):
            along = draws.direction(effect, np.random.default_rng(1), campaign)
            step = draws.unit_step(effect, along, campaign)
            assert np.count_nonzero(step) == draws.degrees_of_freedom(effect, campaign)
        (gain,) = by_name(["wheel_torque_gain"])
        assert draws.degrees_of_freedom(gain, campaign) == wheels


def test_half_a_percent_of_outliers_are_half_a_percent(dirt, raw, kinds):
    dirty = kinds["outliers in rate"].inject(raw, np.random.default_rng(1), 1.0)
    names, file = raw.names("rate"), next(iter(raw.tables))
    before, after = (dirt.numbers(r.tables[file], names) for r in (raw, dirty))
    moved = np.abs(after - before)[after != before] / raw.sigma("rate")
    assert len(moved) == round(0.005 * before.size)
    assert moved.min() >= 5.0
    assert moved.max() <= 1000.0


def test_added_noise_is_as_coloured_as_stated(dirt, raw, kinds):
    dirty = kinds["coloured rate, phi 0.9"].inject(raw, np.random.default_rng(1), 1.0)
    names = raw.names("rate")
    gap = np.concatenate(
        [
            (dirt.numbers(dirty.tables[f], names) - dirt.numbers(raw.tables[f], names))
            for f in raw.tables
        ]
    )
    noise = gap / raw.sigma("rate")
    # About 2,400 rows of three axes, each worth (1 - phi) / (1 + phi) of one: 2 % in the sd.
    assert noise.std() == pytest.approx(1.0, abs=0.1)
    lagged = np.corrcoef(noise[1:].ravel(), noise[:-1].ravel())[0, 1]
    assert lagged == pytest.approx(0.9, abs=0.03)
