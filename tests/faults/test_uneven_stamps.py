"""Stamps that jitter about a regular clock: restored where readings or the user decide."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaign_files import assert_teaches
from support.dirty_example import EXAMPLE, dirty, kinds

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.stamps import regular_clock, slope_of_readings

STEP = 0.25
ROWS = np.arange(600)


def slews(of_stamp: float, motion: float, rng, jitter: float = 0.05) -> list:
    """Three slews whose readings were taken at clock + of_stamp * (stamp - clock)."""
    result = []
    for _ in range(3):
        clock = STEP * ROWS
        away = jitter * STEP * rng.uniform(-1.0, 1.0, len(ROWS))
        taken = clock + of_stamp * away
        rate = motion * np.sin(0.3 * taken)[:, None] * [1.0, 0.4, -0.6]
        rate += 2e-5 * rng.normal(size=rate.shape)
        result.append((clock + away, regular_clock(clock + away)[0], rate))
    return result


@pytest.mark.parametrize(
    ("of_stamp", "regular", "uneven"), [(0.0, True, False), (1.0, False, True)]
)
def test_readings_tell_whether_sampling_jitters(of_stamp, regular, uneven):
    for seed in range(20):
        slope = slope_of_readings(slews(of_stamp, 0.01, np.random.default_rng(seed)))
        assert (slope.sampling_is_regular, slope.sampling_is_uneven) == (regular, uneven)


def test_the_slope_is_as_good_as_it_says():
    slopes = [slope_of_readings(slews(0.5, 0.002, np.random.default_rng(k))) for k in range(60)]
    z = np.array([(slope.value - 0.5) / slope.sd for slope in slopes])
    assert abs(z.mean()) < 3.5 / np.sqrt(60)
    assert 0.7 < z.std() < 1.5


def test_rest_decides_nothing():
    for seed in range(20):
        slope = slope_of_readings(slews(0.0, 0.0, np.random.default_rng(seed)))
        assert not slope.sampling_is_regular
        assert not slope.sampling_is_uneven
    assert slope_of_readings([]).sd == np.inf


def test_stamps_that_no_regular_clock_explains():
    rng = np.random.default_rng(2)
    drifting = STEP * ROWS + 0.05 * np.sin(ROWS / 60.0) + 0.001 * rng.normal(size=len(ROWS))
    assert "wander" in regular_clock(drifting)[1]
    assert "off a clock" in regular_clock(np.cumsum(rng.exponential(size=600)))[1]
    assert "12 rows" in regular_clock(STEP * ROWS[:12])[1]
    lost = np.delete(STEP * ROWS, [40, 41, 300]) + 0.01 * rng.uniform(-1, 1, len(ROWS) - 3)
    clock, problem = regular_clock(lost)
    assert problem == ""
    np.testing.assert_allclose(clock, np.delete(STEP * ROWS, [40, 41, 300]), atol=2e-3)


def jittered(share: float, seed: int = 4):
    rng = np.random.default_rng(seed)

    def inject(header, rows):
        times = np.array([float(row[0]) for row in rows])
        times += share * STEP * rng.uniform(-1.0, 1.0, len(times))
        for row, time in zip(rows, times, strict=True):
            row[0] = repr(float(time))

    return inject


def all_slews(folder, inject):
    """The example with dirt in the table of every slew."""
    path = dirty(folder, inject)
    for table in sorted(path.glob("slew_*.csv"))[1:]:
        header, *rows = (line.split(",") for line in table.read_text().splitlines())
        inject(header, rows)
        table.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    return path


def test_jitter_of_the_example_is_taken_out_because_its_readings_show_it(tmp_path):
    campaign = read_campaign(all_slews(tmp_path / "c", jittered(0.05)))
    assert set(kinds(campaign)) == {("clock", "time", "modelled")}
    assert "readings follow the jitter by" in campaign.dirt[0].note
    for slew, clean in zip(campaign.slews, read_campaign(EXAMPLE).slews[:2], strict=True):
        np.testing.assert_allclose(slew.time, clean.time, atol=0.004 * STEP * 3)


def test_jitter_that_nothing_decides_is_kept_until_the_user_says_regular(tmp_path):
    folder = all_slews(tmp_path / "c", jittered(0.011))
    campaign = read_campaign(folder)
    assert set(kinds(campaign)) == {("clock", "time", "ignored")}
    assert "write regular = true" in campaign.dirt[0].note
    description = folder / "campaign.toml"
    text = description.read_text()
    stated = text.replace('unit = "s" }', 'unit = "s", regular = true }')
    assert stated != text
    description.write_text(stated)
    campaign = read_campaign(folder)
    assert set(kinds(campaign)) == {("clock", "time", "modelled")}
    steps = np.diff(campaign.slews[0].time)
    assert np.ptp(steps) < 1e-9
    assert "as stated" in campaign.dirt[0].note


def test_a_clock_that_is_not_regular_is_not_called_so(tmp_path):
    def drifting(header, rows):
        for i, row in enumerate(rows):
            row[0] = repr(float(row[0]) + 0.06 * float(np.sin(i / 30.0)))

    folder = dirty(tmp_path / "c", drifting)
    description = folder / "campaign.toml"
    description.write_text(
        description.read_text().replace('unit = "s" }', 'unit = "s", regular = true }')
    )
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["slew_01.csv", "no regular clock", "wander", "leave the key out"])


def test_a_few_rows_of_a_clock_said_to_be_regular_keep_their_stamps(tmp_path):
    folder = dirty(tmp_path / "c", lambda header, rows: rows[:19])
    stamps = read_campaign(folder).slews[0].time
    description = folder / "campaign.toml"
    stated = description.read_text().replace('unit = "s" }', 'unit = "s", regular = true }')
    description.write_text(stated)
    campaign = read_campaign(folder)
    assert campaign.slews[0].time.tolist() == stamps.tolist()
    assert ("clock", "time", "ignored") in kinds(campaign)
    assert "19 rows are too few" in campaign.dirt[0].note


def test_a_clock_that_is_exactly_regular_is_so(tmp_path):
    folder = dirty(tmp_path / "c", lambda header, rows: None)
    before = read_campaign(folder)
    description = folder / "campaign.toml"
    stated = description.read_text().replace('unit = "s" }', 'unit = "s", regular = true }')
    description.write_text(stated)
    assert read_campaign(folder) == before
