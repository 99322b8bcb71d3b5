"""A slow sensor that was polled faster: each reading counts once, and rounding is no hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.campaign_files import assert_same
from support.dirty_example import dirty

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.faults.held import held_readings
from bayes_inertia.faults.stuck import stuck_readings

ROWS, STEP = 480, 0.25
TIME = STEP * np.arange(ROWS)
RATES, WHEELS = ("wx_radps", "wy_radps", "wz_radps"), ("h1_Nms", "h2_Nms", "h3_Nms")
FIX = ("q1", "q2", "q3", "q4")


def slew(rng: np.random.Generator, noise: float, width: int = 3) -> np.ndarray:
    """Readings of a body that rests, turns and rests again."""
    phase = np.clip((TIME - 20.0) / 60.0, 0.0, 1.0)
    motion = (1.0 - np.cos(2.0 * np.pi * phase))[:, None] * rng.uniform(-0.02, 0.02, width)
    return motion + noise * rng.normal(size=(ROWS, width))


def held_by(readings: np.ndarray, factor: float, jitter: float = 0.0, seed: int = 3) -> np.ndarray:
    """Readings of which every `factor`-th stands until the next."""
    rng = np.random.default_rng(seed)
    at = np.floor(np.arange(len(readings)) / factor + jitter / factor * rng.uniform(-1, 1, ROWS))
    return readings[np.clip(np.ceil(at * factor), 0, ROWS - 1).astype(int)]


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1.5, "1 to 2 times"),
        (2, "stands twice"),
        (2.5, "2 to 3 times"),
        (4, "four times"),
        (5, "five times"),
        (10, "ten times"),
        (16, "stands 16 times"),
    ],
)
def test_every_factor_is_recognised(width, factor, said):
    rng = np.random.default_rng(1)
    series = [(TIME, held_by(slew(rng, 2e-5, width), factor)) for _ in range(2)]
    for (_, readings), held in zip(series, held_readings(series), strict=True):
        assert held is not None
        assert said in str(held)
        new = np.append(True, np.any(np.diff(readings, axis=0) != 0.0, axis=1))
        np.testing.assert_array_equal(held.repeats, np.repeat(~new[:, None], width, axis=1))


def test_a_jittered_hold_is_recognised():
    rng = np.random.default_rng(1)
    (held,) = held_readings([(TIME, held_by(slew(rng, 2e-5), 4, jitter=0.4))])
    assert str(held) == "each reading stands 3 to 5 times"


def test_a_hold_of_rounded_readings_is_recognised():
    rng = np.random.default_rng(1)
    series = [(TIME, np.round(held_by(slew(rng, 2e-5), 4) / 1e-5) * 1e-5) for _ in range(3)]
    assert [str(held) for held in held_readings(series)] == ["each reading stands four times"] * 3


def test_wheels_that_are_read_in_turn_are_held_each_by_itself():
    readings = slew(np.random.default_rng(1), 2e-5)
    turns = [np.roll(held_by(readings, 3), k, axis=0)[:, k] for k in range(3)]
    (held,) = held_readings([(TIME, np.stack(turns, axis=1))])
    assert str(held) == "each reading stands three times"
    assert held_readings([(TIME, np.stack(turns, axis=1))], by_axis=False) == [None]


def test_what_stands_much_longer_can_be_called_stuck():
    readings = held_by(slew(np.random.default_rng(1), 2e-5), 4)
    readings[200:240] = readings[200]
    (held,) = held_readings([(TIME, readings)])
    assert held is not None
    assert held.repeats.mean() == 0.75
    stuck = stuck_readings(np.where(held.repeats, np.nan, readings), [2e-5] * 3)
    assert np.flatnonzero(stuck[:, 0]).tolist() == list(range(200, 240, 4))


def test_what_stands_since_the_slew_before_is_no_reading():
    readings = held_by(slew(np.random.default_rng(1), 2e-5), 4)
    one, two = held_readings([(TIME[:202], readings[:202]), (TIME[202:], readings[202:])])
    assert one is not None
    assert two is not None
    assert two.repeats[:2].all()
    assert not two.repeats[2].any()
    later = np.append(TIME[:202], TIME[202:] + 300.0)
    (whole,) = held_readings([(later, readings)])
    assert whole is not None
    np.testing.assert_array_equal(whole.repeats, np.concatenate([one.repeats, two.repeats]))


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize("step_over_noise", [0.1, 1.0, 2.0, 3.0, 5.0, 30.0])
@pytest.mark.parametrize(
    "motion",
    [
        pytest.param(lambda rng, k: np.zeros((ROWS, k)), id="rest"),
        pytest.param(lambda rng, k: np.full((ROWS, k), 1e-3) * rng.uniform(1, 2, k), id="turning"),
        pytest.param(lambda rng, k: np.outer(TIME, rng.uniform(2e-7, 2e-4, k)), id="running up"),
        pytest.param(lambda rng, k: slew(rng, 0.0, k), id="slew"),
    ],
)  # fmt: skip
def test_rounding_is_no_hold(motion, step_over_noise, width):
    rng = np.random.default_rng(5)
    for _ in range(10):
        readings = motion(rng, width) + 2e-5 * rng.normal(size=(ROWS, width))
        step = 2e-5 * step_over_noise
        assert held_readings([(TIME, step * np.round(readings / step))]) == [None]


def test_a_few_digits_of_any_size_are_no_hold():
    rng = np.random.default_rng(5)
    readings = slew(rng, 2e-5) + np.array([1e-2, -2e-2, 1e-6])
    short = np.vectorize(lambda value: float(f"{value:.2g}"))(readings)
    assert held_readings([(TIME, short)]) == [None]


def test_readings_without_noise_that_rest_are_no_hold():
    rng = np.random.default_rng(5)
    assert held_readings([(TIME, slew(rng, 0.0)) for _ in range(9)]) == [None] * 9


def hold(names, factor: int, empty: bool = False):
    """A change of a table: of a reading in every row only each `factor`-th is new.

    The others repeat it, or are empty. The example's star tracker gives a fix in every fourth row.
    """

    def change(header, rows):
        columns = [header.index(name) for name in names]
        new = [k for k, row in enumerate(rows) if row[columns[0]]]
        for k in new[::factor] if len(new) == len(rows) else new:
            for row in rows[k + 1 : k + factor]:
                for column in columns:
                    row[column] = "" if empty else rows[k][column]

    return change


CHANNELS = {"rate": RATES, "wheel_momentum": WHEELS, "attitude": FIX}


@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("field", CHANNELS)
def test_a_held_channel_reads_as_if_repeats_were_empty(tmp_path, field, factor):
    """So sds are those of the readings that there are."""
    held = read_campaign(dirty(tmp_path / "held", hold(CHANNELS[field], factor)))
    once = read_campaign(dirty(tmp_path / "once", hold(CHANNELS[field], factor, empty=True)))
    assert_same(replace(held, dirt=()), replace(once, dirt=()))
    (record,) = [d for d in held.dirt if d.kind == "duplicate"]
    assert (record.channel, record.treated) == (field.removeprefix("wheel_"), "masked")
    assert {2: "stands twice", 4: "four times"}[factor] in record.note
    empty = np.isnan(getattr(held.slews[0], field)).all(axis=1)
    assert np.all(empty[list(record.rows)])
