"""What is wrong by little, in one column or beside gaps is named, with its place and its cause."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.campaign_files import edited
from support.commands import run
from support.marks import LIKE_ANOTHER

import bayes_inertia
from bayes_inertia.app.commands.check import show_check
from bayes_inertia.campaign.hardware import Wheel
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.conventions.candidates import mistakes
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.conventions.columns import faulty_columns
from bayes_inertia.conventions.reading import Stated, stated_by
from bayes_inertia.conventions.wording import invisible_in_brief, verdict_in_words
from tests.support.wrong_conventions import with_keys

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


def with_rates(matrix: np.ndarray, **channels: None):
    """The example, whose rates are multiplied by a matrix, without some of the other channels."""
    campaign = read_campaign(EXAMPLE)
    slews = [
        replace(slew, rate=np.asarray(slew.rate) @ matrix.T, **channels) for slew in campaign.slews
    ]
    return replace(campaign, slews=tuple(slews))


# Faults of which another one like it is tried in the fast tests.
HAS_ITS_LIKE = {
    "the same, scaled",
    "the same, negated",
    "the same without commands",
    "one command for two",
    "one column for two axes",
    "one tachometer for two",
    "all axes",
    "an axis at a value",
    "a dead command",
    "tachometers half",
    "one in thousandths",
    "one with its sign",
    "one tachometer",
    "commands twice",
    "one",
    "without commands",
}


def for_releases(names) -> list:
    """Names as parameters of a test; long where another name stands for them."""
    return [pytest.param(n, marks=LIKE_ANOTHER if n in HAS_ITS_LIKE else ()) for n in names]


NO_WHEELS = {"wheel_torque": None, "wheel_momentum": None}


def test_a_change_that_explains_doubtful_data_far_better_is_proposed():
    turned = Rotation.from_rotvec(np.radians([9.0, -12.0, 10.0])).as_matrix()
    check = check_conventions(with_rates(turned, **NO_WHEELS), quick=True)
    assert 1.0 < max(check.misfits.values()) < 3.0
    assert check.verdict == "wrong"
    assert check.changes[0].key == "rate_sensor.axes"
    assert np.allclose(check.changes[0].mended, turned, atol=0.05)
    assert "hardly agree" in check.sentence


def test_doubtful_data_that_no_change_explains_are_left_alone():
    check = check_conventions(with_rates(np.diag([1.25, 0.75, 1.2]), **NO_WHEELS), quick=True)
    assert 1.0 < max(check.misfits.values()) < 3.0
    assert check.verdict == "consistent"


def with_gaps(folder: Path) -> Path:
    """Leave out a twelfth of the rows of every table, in its middle."""
    for path in folder.glob("*.csv"):
        header, *rows = path.read_text().splitlines()
        first = len(rows) // 2
        kept = rows[:first] + rows[first + len(rows) // 12 :]
        path.write_text("\n".join([header, *kept]) + "\n")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["mN m", "N m"])
def test_commands_with_gaps_are_held_against_the_tachometers(tmp_path, unit):
    wrong = with_keys(EXAMPLE, tmp_path / "campaign", {"columns.wheel_torque.unit": unit})
    check = check_conventions(with_gaps(wrong))
    assert "drive" in check.misfits
    keys = [change.key for change in check.changes if change.proposal == 1]
    assert keys == (["columns.wheel_torque.unit"] if unit == "mN m" else [])
    # The record says what a fit does with them: tachometers have the same gaps.
    notes = [dirt["note"] for dirt in check.dirt if dirt["channel"] == "torque"]
    assert all("what the wheels did there is integrated out" in note for note in notes)
    assert notes


def test_what_cannot_be_shown_is_said_in_a_few_lines():
    campaign, rng = read_campaign(EXAMPLE), np.random.default_rng(5)
    slews = [
        replace(
            slew,
            rate=2e-5 * rng.normal(size=slew.rate.shape),
            wheel_torque=0.0 * np.asarray(slew.wheel_torque),
            wheel_momentum=0.0 * np.asarray(slew.wheel_momentum),
            attitude=None,
        )
        for slew in campaign.slews
    ]
    still = replace(campaign, slews=tuple(slews), star_tracker=None)
    said = check_conventions(still).cannot_show
    brief = invisible_in_brief(said)
    assert len(said) > 20
    assert len(brief) <= 4
    assert any("columns.time.unit" in line for line in brief)
    assert brief[-1].startswith("as no campaign can")


@pytest.mark.slow
def test_a_dead_rate_sensor_is_impossible_and_no_change_is_proposed():
    check = check_conventions(with_rates(np.zeros((3, 3))))
    assert (check.verdict, check.changes) == ("wrong", ())


def test_a_locked_wheel_that_is_not_the_last_leaves_the_others_their_columns(tmp_path):
    campaign = read_campaign(EXAMPLE)
    off = Wheel("off", (0.0, 0.6, 0.8), 1e-3, state="locked")
    none = {"wheel_torque": 0.0, "wheel_momentum": np.nan}
    slews = tuple(
        replace(s, **{k: np.insert(getattr(s, k), 0, x, axis=1) for k, x in none.items()})
        for s in campaign.slews
    )
    locked = replace(campaign, wheels=(off, *campaign.wheels), slews=slews)
    folder = write_campaign(locked, tmp_path / "locked")
    assert check_conventions(folder).verdict == "consistent"
    wrong = edited(
        (folder / "campaign.toml").read_text(), ('"wx_radps", "wy_radps"', '"wy_radps", "wx_radps"')
    )
    (folder / "campaign.toml").write_text(wrong)
    assert check_conventions(folder).verdict == "wrong"


def test_a_still_wheel_whose_tachometer_shows_noise_alone_is_not_accused():
    campaign = read_campaign(EXAMPLE)
    rng, sd = np.random.default_rng(6), 3e-3
    slews = []
    for slew in campaign.slews:
        torque, momentum = np.array(slew.wheel_torque), np.array(slew.wheel_momentum)
        torque[:, 2], momentum[:, 2] = 0.0, 0.02
        momentum += sd * rng.normal(size=momentum.shape)
        slews.append(replace(slew, wheel_torque=torque, wheel_momentum=momentum))
    wheels = tuple(replace(wheel, momentum_sigma=sd) for wheel in campaign.wheels)
    noisy = replace(campaign, slews=tuple(slews), wheels=wheels)
    assert max(np.ptp(s.wheel_momentum[:, 2]) for s in slews) > 0.1 * max(
        np.ptp(s.wheel_momentum[:, 0]) for s in slews
    )
    assert faulty_columns(noisy, Stated((), {})) == ()
    moving = tuple(
        replace(new, wheel_momentum=np.c_[new.wheel_momentum[:, :2], old.wheel_momentum[:, 2]])
        for new, old in zip(slews, campaign.slews, strict=True)
    )
    (said,) = faulty_columns(replace(noisy, slews=moving), Stated((), {}))
    assert "stuck, or the wrong column" in said


def with_channel(channel: str, change, **others: None):
    """The example with one channel changed, and some of the others taken away."""
    campaign = read_campaign(EXAMPLE)
    slews = [
        replace(slew, **{channel: change(np.array(getattr(slew, channel)))}, **others)
        for slew in campaign.slews
    ]
    return replace(campaign, slews=tuple(slews))


def column(k: int, value):
    """A change of column k to what `value` makes of all columns."""

    def change(values: np.ndarray) -> np.ndarray:
        values[:, k] = value(values)
        return values

    return change


NO_COMMANDS = {"wheel_torque": None}
FAULTY = {
    "one column for two axes": ("rate", column(1, lambda w: w[:, 0]), {}, "about y", "one column"),
    "the same, negated": ("rate", column(2, lambda w: -w[:, 1]), {}, "about z", "other sign"),
    "the same, scaled": ("rate", column(1, lambda w: 1.3 * w[:, 0]), {}, "about y", "times 0.769"),
    "a dead axis": ("rate", column(0, lambda w: 0.0 * w[:, 0]), {}, "about x", "stays 0 to the"),
    "an axis at a value": ("rate", column(1, lambda w: 0.0 * w[:, 1] + 1e-3), {}, "y", "0.001"),
    "all axes": ("rate", lambda w: 0.0 * w, {}, "about z", "while the star tracker turns"),
    "one tachometer for two": (
        "wheel_momentum",
        column(1, lambda h: h[:, 0]),
        {},
        "tachometer of wheel_y",
        "one column for two",
    ),
    "a stuck tachometer": (
        "wheel_momentum",
        column(1, lambda h: 0.0 * h[:, 1] + 0.03),
        {},
        "tachometer of wheel_y",
        "stays 0.03",
    ),
    "the same without commands": (
        "wheel_momentum",
        column(1, lambda h: 0.0 * h[:, 1] + 0.03),
        NO_COMMANDS,
        "tachometer of wheel_y",
        "others show noise",
    ),
    "a dead command": (
        "wheel_torque",
        column(2, lambda u: 0.0 * u[:, 2]),
        {},
        "command of wheel_z",
        "stays 0 to",
    ),
    "one command for two": (
        "wheel_torque",
        column(1, lambda u: u[:, 0]),
        {},
        "command of wheel_y",
        "one column for two",
    ),
}


@pytest.mark.parametrize("name", for_releases(FAULTY))
def test_a_column_that_is_no_reading_is_named_and_no_change_proposed(name):
    channel, change, others, place, what = FAULTY[name]
    check = check_conventions(with_channel(channel, change, **others), quick=True)
    assert check.verdict in ("doubtful", "wrong")
    assert check.changes == ()
    assert any(place in doubt and what in doubt for doubt in check.doubts), check.doubts
    assert "look for a torque" not in check.sentence


def test_a_dead_axis_is_doubtful_although_all_laws_hold():
    campaign = with_channel(*FAULTY["a dead axis"][:2])
    check = check_conventions(replace(campaign, slews=campaign.slews[1:2]), quick=True)
    assert max(check.misfits.values()) < 1.0
    assert check.verdict == "doubtful"


def test_columns_are_not_accused_where_steps_are_coarse_noise_is_absent_or_a_wheel_is_off():
    campaign = read_campaign(EXAMPLE)
    coarse = with_channel("rate", lambda w: np.round(w / 3e-4) * 3e-4 * [0.0, 1.0, 1.0])
    assert faulty_columns(coarse, Stated((), {})) == ()
    ramp = np.linspace(0.0, 0.01, 200)[:, None] * [1.0, 1.0, -2.0]
    noiseless = replace(campaign.slews[0], time=np.arange(200.0), rate=ramp, attitude=None,
                        magnetic_field_N=None, position_N=None, **NO_WHEELS)  # fmt: skip
    assert faulty_columns(replace(campaign, slews=(noiseless,)), Stated((), {})) == ()
    off = [
        replace(
            slew,
            wheel_torque=np.pad(slew.wheel_torque, ((0, 0), (0, 1))),
            wheel_momentum=np.pad(slew.wheel_momentum, ((0, 0), (0, 1))),
        )
        for slew in campaign.slews
    ]
    spare = replace(campaign.wheels[2], name="spare")
    with_spare = replace(campaign, wheels=(*campaign.wheels, spare), slews=tuple(off))
    assert check_conventions(with_spare, quick=True).verdict == "consistent"


ALL = "wheel_x, wheel_y, wheel_z"
FACTORS = {
    "tachometers twice": ("wheel_momentum", 2.0, ALL, "factor of 2 (t", "with the commands"),
    "tachometers half": ("wheel_momentum", 0.5, ALL, "factor of 2 (c", "with the commands"),
    "one tachometer": ("wheel_momentum", [1, 10, 1], "of wheel_y", "factor of 10 (t", "with the c"),
    "commands twice": ("wheel_torque", 2.0, ALL, "factor of 2 (c", "with the tachometers"),
    "one in thousandths": ("wheel_torque", [1, 1, 1e-3], "wheel_z", "factor of 1000 (t", "with"),
    "one with its sign": ("wheel_torque", [1, 1, -1], "wheel_z", "opposite signs", "with the t"),
}


@pytest.mark.parametrize("name", for_releases(FACTORS))
def test_a_factor_between_commands_and_tachometers_is_named_with_its_wheels(name):
    channel, factor, wheels, size, side = FACTORS[name]
    check = check_conventions(with_channel(channel, lambda v: v * factor), quick=True)
    assert check.verdict in ("doubtful", "wrong")
    said = [doubt for doubt in check.doubts if doubt.startswith("commands and tachometers")]
    assert len(said) == 1
    assert all(part in said[0] for part in (wheels, size, side)), said


@pytest.mark.parametrize("still", [0.07, 700.0 * 2.0 * np.pi / 60.0 * 1e-3])
def test_a_tachometer_that_stands_still_within_its_steps_tells_no_factor(still):
    campaign = with_channel("wheel_momentum", column(2, lambda h: np.full(len(h), still)))
    check = check_conventions(replace(campaign, slews=campaign.slews[:1]), quick=True)
    assert not [doubt for doubt in check.doubts if "differ by a factor" in doubt]


def test_doubtful_says_which_law_fails_where():
    check = check_conventions(with_channel("wheel_momentum", lambda h: h * [1, 2, 1]), quick=True)
    assert check.verdict == "doubtful"
    assert 3.0 < max(check.misfits.values()) < 8.0
    assert "conservation of momentum: slew" in check.sentence
    assert "about y" in check.sentence
    assert "agree" not in check.sentence


@pytest.mark.parametrize(("law", "torque"), [("closure", False), ("conservation", True)])
def test_where_nothing_mends_the_advice_is_of_the_law_that_fails(law, torque):
    said = verdict_in_words({law: 12.0}, (), "wrong", ())
    assert ("look for a torque" in said) == torque


def test_a_mistake_of_the_star_tracker_is_named_whatever_a_wheel_does():
    campaign = with_channel("wheel_torque", lambda u: u)
    first, *rest = campaign.slews
    slews = (replace(first, wheel_torque=first.wheel_torque * [3.0, 1.0, 1.0]), *rest)
    turned = [replace(slew, attitude=slew.attitude * [-1.0, -1.0, -1.0, 1.0]) for slew in slews]
    check = check_conventions(replace(campaign, slews=tuple(turned)), quick=True)
    assert [c.key for c in check.changes if c.proposal == 1] == ["columns.attitude.maps"]
    assert "the commanded torque against the tachometers: wheel_x of" in check.sentence


def test_a_component_of_all_wheel_axes_may_have_the_other_sign():
    campaign = read_campaign(EXAMPLE)
    axes_B = np.array([[0.8, 0.0, 0.6], [-0.4, 0.7, 0.6], [-0.4, -0.7, 0.6]])
    axes_B /= np.linalg.norm(axes_B, axis=1, keepdims=True)
    slews = [
        replace(
            slew,
            wheel_torque=slew.wheel_torque @ np.linalg.inv(axes_B),
            wheel_momentum=slew.wheel_momentum @ np.linalg.inv(axes_B),
        )
        for slew in campaign.slews
    ]
    wheels = [
        replace(wheel, axis_B=axis * [1.0, 1.0, -1.0])
        for wheel, axis in zip(campaign.wheels, axes_B, strict=True)
    ]
    wrong = replace(campaign, slews=tuple(slews), wheels=tuple(wheels))
    check = check_conventions(wrong, quick=True)
    assert "z of the wheels' axes has the other sign" in check.sentence
    mended = [change.mended for change in check.changes if change.proposal == 1]
    assert mended == pytest.approx(axes_B)


def test_every_mistake_of_wheels_in_one_plane_changes_a_key():
    *wheels, last = read_campaign(EXAMPLE).wheels
    locked = replace(read_campaign(EXAMPLE), wheels=(*wheels, replace(last, state="locked")))
    planar = locked.without_locked_wheels()
    assert all(mistake.changes for mistake in mistakes(planar, stated_by(planar), 3, False))


UNSIGNED = {
    "all tachometers": ("wheel_momentum", np.abs, {}, "tachometers (wheel_x, wheel_y, |h|)"),
    "one": ("wheel_momentum", column(1, lambda h: np.abs(h[:, 1])), {}, "(wheel_y, |h|)"),
    "without commands": ("wheel_momentum", np.abs, NO_COMMANDS, "wheel_y"),
    "commands": ("wheel_torque", np.abs, {}, "torque commands (wheel_x, wheel_y, wheel_z, |u|)"),
}


@pytest.mark.parametrize("name", for_releases(UNSIGNED))
def test_a_lost_sign_is_the_cause_that_is_named(name):
    channel, change, others, words = UNSIGNED[name]
    check = check_conventions(with_channel(channel, change, **others), quick=True)
    assert (check.verdict, check.changes) == ("wrong", ())
    assert words in check.sentence
    assert "lost their sign" in check.sentence


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("wheels.wheel_z.max_momentum", 0.005, "wheels.wheel_z.max_momentum: 0.005"),
        ("wheels.wheel_y.max_torque", 5e-5, "wheels.wheel_y.max_torque: 5e-05"),
        ("rate_sensor.range", 1e-3, "rate_sensor.range: 0.001"),
    ],
)
def test_a_limit_that_is_far_exceeded_is_doubtful(tmp_path, key, value, words):
    folder = with_keys(EXAMPLE, tmp_path / "campaign", {key: value})
    check = check_conventions(folder, quick=True)
    assert check.verdict == "doubtful"
    assert any(words in doubt and "the limit is wrong" in doubt for doubt in check.doubts)


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, "consistent"), (180.0 / np.pi, "wrong")])
def test_slow_tachometers_leave_what_rates_and_attitudes_tell(factor, verdict):
    campaign = with_rates(factor * np.eye(3))
    slews = []
    for slew in campaign.slews:
        momentum = np.full_like(slew.wheel_momentum, np.nan)
        rare = slice(None, None, len(momentum) // 8)
        momentum[rare] = np.asarray(slew.wheel_momentum)[rare]
        slews.append(replace(slew, wheel_momentum=momentum, wheel_torque=None))
    check = check_conventions(replace(campaign, slews=tuple(slews)), quick=True)
    assert "closure" in check.misfits
    assert check.verdict == verdict


def test_a_campaign_that_no_law_can_check_is_not_said_to_agree(capsys):
    campaign = with_rates(np.eye(3), attitude=None, **NO_WHEELS)
    check = check_conventions(replace(campaign, star_tracker=None), quick=True)
    assert check.misfits == {}
    show_check(check, EXAMPLE)
    out = capsys.readouterr().out
    assert "nothing to check" in out
    assert "agrees" not in out


def test_doubtful_ends_with_3_and_the_next_command_warns(tmp_path, capsys):
    folder = with_keys(EXAMPLE, tmp_path / "campaign", {"rate_sensor.range": 1e-3})
    assert run("doctor", folder) == 3
    assert ": doubtful" in capsys.readouterr().out
    assert run("check", folder) == 0
    assert "warning: The data are doubtful" in capsys.readouterr().err
    assert run("doctor", EXAMPLE) == 0
    assert ": agrees" in capsys.readouterr().out


@pytest.mark.slow
def test_the_slew_that_closure_fails_in_is_named_where_another_has_no_fixes():
    campaign = read_campaign(EXAMPLE)
    first, second, third, *rest = campaign.slews
    half = len(third.time) // 2
    turn = Rotation.from_rotvec([1.0, 0.0, 0.0])
    attitude = np.array(third.attitude)
    late = np.flatnonzero(np.isfinite(attitude[half:, 0])) + half
    attitude[late] = (Rotation.from_quat(attitude[late]) * turn).as_quat()
    slews = (replace(first, attitude=None), second, replace(third, attitude=attitude), *rest)
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    (closure,) = (doubt for doubt in check.doubts if "against the star tracker" in doubt)
    assert third.name in closure
