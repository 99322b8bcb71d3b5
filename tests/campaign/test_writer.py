"""Campaigns written and read again."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.campaign_files import (
    assert_same,
    assert_teaches,
    make,
    unit,
)

import bayes_inertia
from bayes_inertia.app.commands.check import campaign_json
from bayes_inertia.campaign.actuators import Change
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import (
    CorrelatedNoise,
    InertiaPrior,
    RateSensor,
    StarTracker,
    Wheel,
)
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.reader import (
    campaign_of,
    campaign_sha256,
    read_campaign,
    read_unmasked,
)
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import content_of, write_campaign
from bayes_inertia.errors import CampaignError, OutputError


def test_write_then_read(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    folder = write_campaign(campaign, tmp_path / "out" / "deeper")
    assert sorted(p.name for p in folder.iterdir()) == [
        "campaign.toml",
        "slew_01.csv",
        "slew_02.csv",
    ]
    again = read_campaign(folder)
    assert_same(campaign, again)
    digest = campaign_sha256(folder)
    assert write_campaign(again, folder) == folder
    assert campaign_sha256(folder) == digest


def test_the_mission_is_read_and_written_and_its_unknown_keys_are_errors(tmp_path):
    folder = make(tmp_path / "in")
    assert read_campaign(folder).mission == ()
    text = (folder / "campaign.toml").read_text()
    stated = '[mission]\nname = "MOST"\nepoch = "2026-03-02"\n\n[inertia]'
    (folder / "campaign.toml").write_text(text.replace("[inertia]", stated, 1))
    campaign = read_campaign(folder)
    assert campaign.mission == (("name", "MOST"), ("epoch", "2026-03-02"))
    assert read_campaign(write_campaign(campaign, tmp_path / "out")).mission == campaign.mission
    wrong = text.replace("[inertia]", stated.replace("epoch", "documnt"), 1)
    (folder / "campaign.toml").write_text(wrong)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["key mission.documnt", 'did you mean "document"'])


def test_never_overwrites_another_campaign(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    folder = write_campaign(campaign, tmp_path / "out")
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    other = replace(
        campaign,
        slews=(replace(campaign.slews[0], rate=campaign.slews[0].rate * 2), campaign.slews[1]),
    )
    for another in (other, replace(campaign, name="other")):
        with pytest.raises(OutputError) as caught:
            write_campaign(another, folder)
        assert_teaches(caught.value, [str(folder), "overwrite"])
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    (folder / "campaign.toml").unlink()
    (folder / "slew_02.csv").unlink()
    write_campaign(campaign, folder)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


def test_refuses_what_could_not_be_read_back(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    first, second = campaign.slews
    silent = first.wheel_momentum.copy()
    silent[:, 1] = np.nan
    gap = first.magnetic_field_N.copy()
    gap[2, 1] = np.nan
    for slew, named in [
        (replace(first, wheel_momentum=silent), "column h2_Nms: it could not be read back: every"),
        (replace(first, magnetic_field_N=gap), "line 4, column By_N_T: it could not be read back"),
    ]:
        with pytest.raises(OutputError) as caught:
            write_campaign(replace(campaign, slews=(slew, second)), tmp_path / "out")
        assert_teaches(caught.value, ["slew first", named])
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write_campaign(campaign, tmp_path / "file")


def test_what_only_format_2_says_is_read_back(tmp_path):
    """A wheel without tachometer, and beside it a star tracker that saw nothing."""
    campaign = read_campaign(make(tmp_path / "in"))
    slews = [
        replace(s, wheel_momentum=s.wheel_momentum * [1.0, np.nan], attitude=None)
        for s in campaign.slews
    ]
    other = replace(campaign, slews=slews)
    again = read_campaign(write_campaign(other, tmp_path / "out"))
    assert_same(again, other)
    assert again.star_tracker == campaign.star_tracker


def test_further_readings_that_no_folder_holds_are_refused(tmp_path):
    """Names that would give two columns one name, noise and changes without a key."""
    campaign = read_campaign(make(tmp_path / "in"))
    rates = [replace(s, more={"gyro 2": s.rate, "gyro-2": s.rate}) for s in campaign.slews]
    gyros = tuple((name, campaign.rate_sensor) for name in ("gyro 2", "gyro-2"))
    coloured = replace(campaign.rate_sensor, correlated_noise=CorrelatedNoise(0.5, 2.0))
    for other, named in (
        (replace(campaign, slews=rates, more_sensors=gyros), "'gyro_2_1' is already used"),
        (replace(campaign, rate_sensor=coloured), "no key for correlated noise"),
        (replace(campaign, changes=(Change("fuel", 1e6),)), "all slews are on one side"),
    ):
        with pytest.raises(OutputError, match=named):
            write_campaign(other, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_temperature_and_a_direction_of_no_device_read_back_as_they_are(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    slews = []
    for slew in campaign.slews:
        warm = InputStream(slew.time, 293.0 + slew.time, "line")
        sun = InputStream(slew.time[:1], np.array([[0.6, 0.0, 0.8]]))
        slews.append(replace(slew, inputs={"temperature": warm, "sun": sun}))
    told = replace(campaign, slews=slews)
    again = read_campaign(write_campaign(told, tmp_path / "out"))
    devices = {row["name"]: row["is"] for row in campaign_json(again)["devices"]}
    assert devices["temperature"] == "input, 1 number"
    assert devices["sun"] == "input, 3 numbers"
    alone = [replace(slew, inputs=None) for slew in again.slews]
    assert_same(replace(again, slews=alone), campaign)
    for slew, other in zip(again.slews, told.slews, strict=True):
        assert slew.inputs.keys() == other.inputs.keys()
        for name, stream in slew.inputs.items():
            np.testing.assert_array_equal(stream.values, other.inputs[name].values)
            assert stream.between == other.inputs[name].between


def test_inputs_that_a_folder_would_lose_are_refused(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    first = campaign.slews[0]
    wide = InputStream(first.time, np.ones((len(first.time), 3)))
    named = [
        replace(s, inputs={"rate sensor": InputStream(s.time, s.time)}) for s in campaign.slews
    ]
    second = replace(first, name="again", start=first.start + 1e4)
    widths = [
        replace(first, inputs={"T": wide}),
        replace(second, inputs={"T": InputStream(first.time, first.time)}),
    ]
    for slews, message in ((named, "name of a sensor"), (widths, "1 or 3 numbers")):
        with pytest.raises(OutputError, match=message):
            write_campaign(replace(campaign, slews=slews), tmp_path / "out")


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('name = "temperature"', 'name = "panel temperature"', "no single word"),
        ('name = "rate sensor"', 'name = "temperature"', "that of a device"),
        ('["temperature_1"]', '["temperature_9"]', "temperature_9"),
    ],
)
def test_an_input_of_the_environment_is_checked(tmp_path, right, wrong, message):
    campaign = read_campaign(make(tmp_path / "in"))
    slews = [
        replace(s, inputs={"temperature": InputStream(s.time, s.time)}) for s in campaign.slews
    ]
    folder = write_campaign(replace(campaign, slews=slews), tmp_path / "out")
    text = (folder / "campaign.toml").read_text()
    assert right in text
    (folder / "campaign.toml").write_text(text.replace(right, wrong))
    with pytest.raises(CampaignError, match=message):
        read_campaign(folder)


def test_lost_commands_that_could_not_be_told_again_are_refused(tmp_path):
    """Between rows at no regular step an empty cell is a command that holds."""
    campaign = read_campaign(make(tmp_path / "in"))
    slew = campaign.slews[0]
    lost = np.array([0, 1, 0, 0])
    slew = replace(slew, lost_command=lost, lost_command_sd=np.ones_like(slew.wheel_torque))
    with pytest.raises(OutputError, match="would be taken as held"):
        write_campaign(replace(campaign, slews=(slew,)), tmp_path / "out")


NUMBER = st.floats(-1e6, 1e6, allow_subnormal=True)
# Seconds within the hour: a stamp farther away than that is a wrong one.
TIME = st.floats(-1e3, 1e3)


POSITIVE = st.floats(1e-9, 1e3)


def arrays(draw, rows: int, columns: int, gaps: bool):
    element = st.one_of(NUMBER, st.just(float("nan"))) if gaps else NUMBER
    return np.array(
        draw(
            st.lists(
                st.lists(element, min_size=columns, max_size=columns), min_size=rows, max_size=rows
            )
        )
    )


def with_gaps(draw, values):
    """Some rows after the first are empty."""
    empty = np.array([False, *(draw(st.booleans()) for _ in values[1:])])
    return np.where(empty[:, None], np.nan, values)


@st.composite
def campaigns(draw) -> Campaign:
    wheels = tuple(
        Wheel(
            name,
            unit(draw, 3),
            draw(POSITIVE),
            momentum_sigma=draw(st.none() | POSITIVE),
            max_torque=draw(st.none() | POSITIVE),
        )
        for name in draw(st.lists(st.text(max_size=5), max_size=3, unique=True))
    )
    tracker = draw(st.none() | st.builds(StarTracker, st.just(unit(draw, 3)), POSITIVE, POSITIVE))
    torque, momentum, field = (draw(st.booleans()) for _ in range(3))
    slews = []
    for name in draw(st.lists(st.text(max_size=5), min_size=1, max_size=3, unique=True)):
        time = np.array(sorted(draw(st.lists(TIME, min_size=2, max_size=5, unique=True))))
        rows = len(time)
        rate = arrays(draw, rows, 3, gaps=True) * 9e-4
        rate[0] = 9e-4 * draw(NUMBER)
        fixes = np.array(
            [unit(draw, 4) if draw(st.booleans()) else (np.nan,) * 4 for _ in range(rows)]
        )
        slews.append(
            Slew(
                name,
                draw(NUMBER),
                time,
                rate=rate,
                attitude=fixes if tracker and draw(st.booleans()) else None,
                wheel_torque=arrays(draw, rows, len(wheels), gaps=False)
                if torque and wheels and draw(st.booleans())
                else None,
                wheel_momentum=with_gaps(draw, arrays(draw, rows, len(wheels), gaps=False))
                if momentum and wheels and draw(st.booleans())
                else None,
                magnetic_field_N=with_gaps(draw, arrays(draw, rows, 3, gaps=False))
                if field and draw(st.booleans())
                else None,
                axis_B=draw(st.none() | st.just(unit(draw, 3))),
                angle=draw(st.none() | NUMBER),
            )
        )
    prior = InertiaPrior(
        np.diag([3.0, 2.0, 2.0]) * draw(POSITIVE),
        draw(POSITIVE),
        draw(POSITIVE),
        draw(st.booleans()),
    )
    sensor = RateSensor(
        sigma=draw(POSITIVE),
        range=draw(st.none() | POSITIVE),
        bias=tuple(draw(st.tuples(NUMBER, NUMBER, NUMBER))),
    )
    return Campaign(draw(st.text(max_size=20)), prior, wheels, sensor, tracker, tuple(slews))


@pytest.mark.slow
@given(campaign=campaigns())
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_any_campaign_survives_writing(tmp_path, campaign):
    folder = tmp_path / "round_trip"
    shutil.rmtree(folder, ignore_errors=True)
    path = write_campaign(campaign, folder)
    again = read_unmasked(path)
    assert_same(campaign, again)
    write_campaign(again, folder)  # identical to the last byte, or it would refuse
    # Random numbers may look like faults, which are masked and recorded: reading refuses none.
    read_campaign(path)


def test_the_shortest_step_that_numbers_hold_is_read(tmp_path):
    """Nothing that is divided by the length of a slew overflows."""
    slew = Slew("a", 0.0, np.array([0.0, 2.3e-309]), rate=np.zeros((2, 3)))
    prior, sensor = InertiaPrior(np.diag([3.0, 2.0, 2.0]), 1.0, 1.0), RateSensor(sigma=1.0)
    tracker = StarTracker((0.0, 0.0, 1.0), 40.0, 1.0)
    campaign = Campaign("", prior, (), sensor, tracker, (slew,))
    again = read_campaign(write_campaign(campaign, tmp_path / "short"))
    assert again.slews[0].time.tolist() == slew.time.tolist()


def test_tables_in_memory_are_the_campaign_that_the_folder_is(tmp_path):
    """Nothing is lost or rounded between the tables that are handed on and those on the disk."""
    campaign = read_campaign(Path(bayes_inertia.__file__).parent / "example")
    description, tables = content_of(campaign)
    folder = write_campaign(campaign, tmp_path / "written")
    handed_on = campaign_of(description, str(folder / "campaign.toml"), tables)
    assert_same(handed_on, read_campaign(folder))
    assert handed_on == read_campaign(folder)
