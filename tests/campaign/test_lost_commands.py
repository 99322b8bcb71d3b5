"""Commands that were lost and that no tachometer tells: guessed, with an honest sd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.campaign_files import assert_same
from support.dirty_example import EXAMPLE, SLEWING, dirty, kinds, rows_of, without_rows
from support.other_spacecraft import two_axes_and_vectors

import bayes_inertia as bi
from bayes_inertia.campaign.commands import with_lost_commands
from bayes_inertia.campaign.reader import campaign_of, read_campaign
from bayes_inertia.campaign.slew_parts import with_known_momentum
from bayes_inertia.campaign.writer import content_of, write_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign

LOST = (60, 100, 102, SLEWING, SLEWING + 1, 300)


def true_torque() -> np.ndarray:
    """Commands of the example's first slew."""
    header, rows = rows_of((EXAMPLE / "slew_01.csv").read_text())
    at = [header.index(f"u{k}_Nm") for k in (1, 2, 3)]
    return np.array([[float(row[k]) for k in at] for row in rows])


def test_a_slew_with_lost_commands_stays_whole(tmp_path):
    campaign = read_campaign(dirty(tmp_path / "c", without_rows(*LOST), without="tachometers"))
    assert kinds(campaign)[0] == ("gap", "torque", "modelled")
    assert "5 gaps" in campaign.dirt[0].note
    slew = campaign.slews[0]
    assert np.flatnonzero(slew.lost_command).tolist() == list(LOST)
    assert slew.lost_command[list(LOST)].tolist() == [1, 2, 3, 4, 5, 6]
    assert np.isnan(slew.rate[list(LOST)]).all()
    assert campaign.slews[1].lost_command is None
    torque = true_torque()
    known = slew.lost_command == 0
    np.testing.assert_array_equal(slew.wheel_torque[known], torque[known])
    error = (slew.wheel_torque - torque)[~known] / slew.lost_command_sd[~known]
    assert 0.2 < np.sqrt(np.mean(error**2)) < 2.0
    again = read_campaign(write_campaign(campaign, tmp_path / "again"))
    assert_same(replace(again, dirt=()), replace(campaign, dirt=()))


def test_guesses_err_as_much_as_they_say(tmp_path):
    """Many rows of the example, lost one by one: the errors over their sd, steps included."""
    torque, errors = true_torque(), []
    for lost in range(12, 700, 29):
        rows = list(range(lost, min(lost + 2, len(torque) - 2)))
        given = {"time": np.arange(len(torque)) * 0.25, "wheel_torque": torque.copy()}
        given = {name: np.delete(values, rows, axis=0) for name, values in given.items()}
        ends = (0.25 * (rows[0] - 1), 0.25 * (rows[-1] + 1)) if rows else None
        if ends is not None:
            marked = with_lost_commands(given, [ends], 0.25, 0.02)
            gap = marked["wheel_torque"][rows] - torque[rows]
            errors.append(gap / marked["lost_command_sd"][rows])
    squares = np.square(np.concatenate(errors))
    assert 0.2 < np.mean(squares) < 1.5
    assert np.mean(squares > 9.0) < 0.05


def test_a_step_inside_a_gap_is_allowed_for():
    rng = np.random.default_rng(1)
    torque = 1e-5 * rng.normal(size=(200, 1)) + np.where(np.arange(200) < 100, 0.0, 1e-3)[:, None]
    given = {"time": np.delete(np.arange(200.0), 100), "wheel_torque": np.delete(torque, 100, 0)}
    sd = with_lost_commands(given, [(99.0, 101.0)], 1.0, 0.02)["lost_command_sd"]
    assert sd[100] == pytest.approx(5e-4, rel=0.05)
    quiet = {"time": np.delete(np.arange(200.0), 50), "wheel_torque": np.delete(torque, 50, 0)}
    sd = with_lost_commands(quiet, [(49.0, 51.0)], 1.0, 0.02)["lost_command_sd"]
    assert 1e-5 < sd[50] < 3e-5
    assert not np.delete(sd, 50).any()


def test_long_gaps_have_pieces_and_no_readings():
    time = np.arange(0.0, 400.0)
    channels = {
        "time": time,
        "wheel_torque": np.where((time > 99) & (time < 140), np.nan, 1e-3)[:, None],
        "rate": np.zeros((400, 3)),
    }
    marked = with_lost_commands(channels, [(99.0, 140.0)], 1.0, 0.02)
    pieces = marked["lost_command"]
    assert set(pieces[100:140]) == set(range(1, 9))
    assert (np.diff(pieces[100:140]) >= 0).all()
    assert np.isfinite(marked["rate"][:101]).all()
    assert np.isnan(marked["rate"][101:140]).all()
    assert np.isfinite(marked["rate"][140:]).all()


def test_commands_at_half_the_rate_of_the_gyro_lose_one():
    time = np.arange(0.0, 100.0)
    torque = np.where((time % 2 == 0) & (time != 50), 1e-3, np.nan)[:, None]
    channels = {"time": time, "wheel_torque": torque, "rate": np.zeros((100, 3))}
    marked = with_lost_commands(channels, [(48.0, 52.0)], 2.0, 0.02)
    assert np.flatnonzero(marked["lost_command"]).tolist() == [50, 51]
    assert np.isfinite(marked["rate"]).all()


def test_a_slew_needs_to_say_what_may_have_happened():
    rows = {"rate": np.zeros((3, 3)), "lost_command": [0, 1, 0]}
    with pytest.raises(CampaignError, match="lost_command_sd"):
        bi.Slew("a", 0.0, np.arange(3.0), **rows)


def test_a_model_takes_lost_commands_where_commands_drive_it(tmp_path):
    lost = read_campaign(dirty(tmp_path / "a", without_rows(*LOST), without="tachometers"))
    whole = read_campaign(dirty(tmp_path / "b", lambda h, r: None, without="tachometers"))
    assert Model(lost).structure.coefficients == (18,)
    assert Model(lost).effects == ()
    assert Model(whole).structure.coefficients == ()


@pytest.mark.long
@pytest.mark.slow
def test_lost_commands_move_the_estimate_by_less_than_its_sd(tmp_path):
    """And widen it by what the noise of the lost commands explains, not by what a cut costs."""
    rng = np.random.default_rng(3)
    rows = [SLEWING, SLEWING + 1, *rng.choice(np.arange(5, 455), 9, replace=False).tolist()]
    clean = read_campaign(dirty(tmp_path / "a", lambda h, r: None, without="tachometers"))
    campaign = read_campaign(dirty(tmp_path / "b", without_rows(*rows), without="tachometers"))
    reference, modelled = (bi.estimate(Model(c), starts=1) for c in (clean, campaign))
    assert not modelled.discounted
    shift = np.abs((modelled.theta - reference.theta) / modelled.sd)
    assert shift.max() < 3.0
    assert np.sqrt(np.mean(shift**2)) < 1.2
    assert (modelled.sd / reference.sd).max() < 2.5
    # The control: the last command held in the gaps, and taken for what the wheels did.
    lost = campaign.slews[0].lost_command > 0
    torque = campaign.slews[0].wheel_torque
    held = torque[np.maximum.accumulate(np.where(lost, 0, np.arange(len(lost))))]
    slew = replace(campaign.slews[0], wheel_torque=held, lost_command=None, lost_command_sd=None)
    wrong = bi.estimate(Model(replace(campaign, slews=(slew, *campaign.slews[1:]))), starts=1)
    off = np.abs((wrong.theta - reference.theta) / wrong.sd)
    assert wrong.discounted or off.max() > 3.0


def test_lost_commands_are_seen_where_directions_alone_tell_the_motion():
    """Without gyro and star tracker every gap was negligible: the last command held across it."""
    given = two_axes_and_vectors()
    slews = tuple(replace(s, rate=None, wheel_momentum=None) for s in given.slews)
    wheels = tuple(replace(wheel, momentum_sigma=None) for wheel in given.wheels)
    description, tables = content_of(replace(given, rate_sensor=None, slews=slews, wheels=wheels))
    file, table = next(iter(tables.items()))
    lost = {f"u{k}_Nm": table.numbers(f"u{k}_Nm").copy() for k in (1, 2, 3)}
    for torque in lost.values():
        torque[21:27] = np.nan  # The push ends at row 24.
    tables |= {file: table.changed(lost)}
    slew = campaign_of(description, "campaign.toml", tables).slews[0]
    assert np.flatnonzero(slew.lost_command).tolist() == list(range(21, 27))


def test_a_gap_of_one_tachometer_with_a_clock_of_its_own_cuts_the_slew():
    """No row has the readings of both wheels: a line across the gap of one was never doubted."""
    small, time = small_campaign(), np.sort(np.concatenate([np.arange(400) * 0.1, np.arange(40)]))
    time[1::11] += 0.03
    time = np.unique(time)
    slow = np.isin(time, np.arange(40) + 0.03)
    ramp = 0.02 * np.maximum(time - 15.0, 0.0)
    silent = slow & ~((time > 12.0) & (time < 25.0))
    momentum = np.stack([np.where(slow, np.nan, 0.1), np.where(silent, ramp, np.nan)], axis=1)
    rate = np.where(slow[:, None], np.nan, np.full((len(time), 3), 1e-3))
    slew = bi.Slew("a", 0.0, time, rate=rate, wheel_momentum=momentum)
    campaign = replace(small, wheels=small.wheels[1:], star_tracker=None, slews=(slew,))
    assert len(with_known_momentum(campaign).slews) == 2
