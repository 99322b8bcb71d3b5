"""Campaigns built in Python of what is no number, no list or no hardware: a sentence, no trace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import bayes_inertia as bi
from bayes_inertia.campaign.reader import campaign_of
from bayes_inertia.campaign.writer import content_of
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.physics.small_campaign import small_campaign

TIME, RATE = np.arange(3.0), np.zeros((3, 3))
AXES, SPINS = np.eye(3), np.eye(3)[[1, 2, 0]]
MOMENTS = [3.3, 2.2, 1.6]
of_moments = bi.GaussianPrior.of_principal_moments


class Quantity(np.ndarray):
    """Numbers that carry a unit, as those of astropy and pint do."""

    unit = "deg/s"

    def to(self, unit):
        return self


DEGREES = RATE.view(Quantity)
DATES = np.datetime64("2026-01-01T00:00") + np.arange(3) * np.timedelta64(1, "s")
LOST = {"wheel_torque": RATE, "lost_command": [0, 1, 0]}


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: bi.Slew("a", 0.0, TIME, rate=DEGREES), "rate: it carries a unit; give plain"),
        (lambda: bi.Slew("a", TIME[:1].view(Quantity), TIME), "start: it carries a unit"),
        (lambda: bi.RateSensor([DEGREES[0, 0:1]] * 3), "sigma: it carries a unit"),
        (lambda: bi.Wheel("x", (1, 0, 0), DEGREES[0]), "spin_inertia: it carries a unit"),
        (lambda: bi.Slew("a", 0.0, np.ma.masked_equal(TIME, 1.0), rate=RATE), "a time is not a"),
        (lambda: bi.Slew("a", [1.0, 2.0], TIME, rate=RATE), "start: these are 2 moments"),
        (lambda: bi.Slew("a", 0.0, TIME[:, None], rate=RATE), r"shape \(3, 1\) is not \(rows,\)"),
        (lambda: bi.Slew("a", 0.0, TIME, rate=RATE * 1j), "rate: .*of complex numbers"),
        (lambda: bi.Slew(None, 0.0, TIME, rate=RATE), "slews.name: None is no name"),
        (lambda: bi.Wheel(["x"], (1, 0, 0), 1e-3), r"wheels.name: \['x'\] is no name"),
        (lambda: bi.Slew("a", 0.0, TIME, lost_command_sd=-SPINS, **LOST), "an sd is below 0"),
        (lambda: bi.RateSensor("2e-5"), "sigma: no array of numbers, but of texts"),
        (lambda: bi.Slew("a", 0.0, TIME, rate=RATE, angle="30"), "angle: no array of numbers"),
        (lambda: bi.GaussianPrior(["K1"], np.array(["1"], object), [[1]]), "mean: .*of texts"),
        (lambda: bi.GaussianPrior("Jxx", [1.0], [[1.0]]), "prior.names: a str is no list"),
        (lambda: bi.GaussianPrior(["Jqq"], [1.0], [[1.0]]), "'Jqq'.* is no element of J"),
        (lambda: bi.GaussianPrior(["Jxx"], [1.0], [[1.0]], logarithmic=True), "a bool is no list"),
        (
            lambda: bi.GaussianPrior(["Jxy"], [1.0], [[1.0]], logarithmic=["Jxy"]),
            "prior.logarithmic: a product may be negative; name moments",
        ),
        (lambda: bi.Model("campaign"), "campaign: a str is no Campaign; give what `read_campaign`"),
        (lambda: bi.GaussianPrior(["Jxx"], None, [[1.0]]), "prior: 1 names do not fit"),
        (lambda: bi.GaussianPrior(["Jxx"], [1.0], None), "prior: 1 names do not fit"),
        (lambda: bi.Wheel("x", (1, 0, 0), 1e-3, state=np.ones(2)), "wheels.x.state: .* is unknown"),
        (lambda: bi.DirectionSensor(1e-3, unit=np.ones(2)), "unit: .* is no unit of a direction"),
        (lambda: bi.KnownTorque("t", frame=np.ones(2)), "actuators.t.frame: .* is unknown"),
        (lambda: bi.Change("c", 1.0, part=np.ones(2)), "changes.c.part: .* is unknown"),
        (lambda: bi.InputStream(TIME, RATE, np.ones(2)), "between: .* is unknown"),
        (lambda: bi.PlannedSlew((1, 0, 0), 0.5, profile=np.ones(2)), "profile: .* is unknown"),
        (lambda: replace(small_campaign(), reference=["gyro"]), "reference: no sensor is called"),
        (lambda: bi.Slew("a", None, TIME, rate=RATE), "slews.a.start: None is not finite"),
        (lambda: bi.Slew("a", "noon", TIME, rate=RATE), "slews.a.start: .*seconds or datetimes"),
        (
            lambda: bi.Slew("a", np.datetime64("2026-01-01T02:00"), DATES, rate=RATE),
            "slews.a.start: the first row is of 7200 s earlier; give the date of the first row",
        ),
        (lambda: bi.Slew("a", pd.NaT, TIME, rate=RATE), "slews.a.start: NaT is not finite"),
        (lambda: bi.Slew("a", 0.0, ["0", "1", "x"], rate=RATE), "time: no array of numbers"),
        (lambda: bi.Slew("a", 0.0, TIME, rate=[[0, 0], [0], [0]]), "rate: no array of numbers"),
        (lambda: bi.Slew("a", 0.0, TIME, rate=RATE, axis_B="x"), "axis: no array of numbers"),
        (lambda: bi.Slew("a", 0.0, TIME, rate=RATE, angle="half"), "angle: no array of numbers"),
        (lambda: bi.Slew("a", 0.0, TIME, more=[("g", RATE)]), "more: a list .*give a dictionary"),
        (lambda: bi.Slew("a", 0.0, TIME, inputs=[()]), "inputs: a list .*give a dictionary"),
        (lambda: bi.InputStream(TIME, ["on", "off", "on"]), "values: no array of numbers"),
        (lambda: bi.InputStream(TIME, [[0], [0, 1], [0]]), "values: no array of numbers"),
        (lambda: bi.Change("fuel", "noon"), "changes.fuel.time: .*seconds or datetimes"),
        (lambda: bi.Wheel("x", "x", 1e-3), "wheels.x.axis: no array of numbers"),
        (lambda: bi.Wheel("x", (1, 0, 0), "1e-3"), "'1e-3' is not positive"),
        (lambda: bi.RateSensor("quiet"), "sigma: no array of numbers"),
        (lambda: bi.RateSensor(1e-5, correlated_noise=(0.5, 1.0)), "a tuple is no CorrelatedNoise"),
        (
            lambda: bi.RateSensor(1e-5, correlated_noise=bi.CorrelatedNoise([0.1, 0.2], 1.0)),
            "not one number, nor one for each of 3 axes",
        ),
        (lambda: bi.StarTracker((0, 0, 1), "x", 1e-4), "sigma_cross: 'x' is not positive"),
        (lambda: bi.Thruster("j", [["a", 0, 0]]), "actuators.j.torque: no array of numbers"),
        (lambda: bi.GimballedRotors("c", [1.0, 2.0], AXES, SPINS), "nor one for each of 3"),
        (lambda: bi.KnownTorque("j", "0.1"), "gain_sigma: '0.1' is no sd"),
        (lambda: bi.Thruster("j", AXES, each_gain_sigma=[0.1, 0.1]), "each_gain_sigma: .* is no"),
        (lambda: bi.DirectionSensor(0.01, (0, 0, 1), offset_sigma=None), "offset_sigma: None is"),
        (lambda: bi.Wheel("x", (1, 0, 0), [1e-3]), r"spin_inertia: \[0.001\] is not positive"),
        (lambda: bi.InertiaPrior(AXES, [0.1, 0.2], 0.1), "relative_sigma: .*is not positive"),
        (lambda: of_moments(MOMENTS, 0.1, [2.0, 3.0]), "axes_sd_deg: .*not one number"),
        (lambda: bi.GaussianPrior(("K1",), [1.0], [[1e-4]]).inflated("x"), "'x' is no sd"),
        (lambda: bi.Slew("a", 0.0, TIME, rate=RATE, angle=[0.1, 0.2]), "angle: .*not one number"),
        (
            lambda: bi.Slew("a", 0, TIME, wheel_torque=RATE, lost_command=["a"] * 3),
            "lost_command: no array of numbers",
        ),
        (lambda: bi.read_campaign(None), "campaign: None is no path"),
        (lambda: bi.write_campaign(small_campaign(), None), "folder: None is no path"),
        (lambda: bi.with_orbit(small_campaign(), None, "2023-09-04"), "tle: None is no path"),
        (lambda: bi.InertiaPrior([[1, 2], [3]], 0.1, 0.1), "inertia.tensor: no array of numbers"),
        (lambda: of_moments(MOMENTS, [0.1, 0.1], 2.0), "relative_sd: .*nor one for each of 3"),
        (lambda: of_moments(MOMENTS[:2], 0.1, 2.0), r"principal_moments: shape \(2,\) is not"),
        (
            lambda: of_moments(MOMENTS, 0.1, 2.0, scale_factors=[1, 1], scale_factors_sd=[1] * 3),
            "scale_factors_sd: .*nor one for each of 2",
        ),
    ],
)
def test_what_is_no_number_is_said_with_its_key(make, says):
    with pytest.raises(bi.CampaignError, match=says):
        make()


def test_what_is_masked_is_not_measured():
    masked = np.ma.masked_array(np.ones((3, 3)), mask=np.eye(3))
    for given in (masked, masked.astype(int), list(masked)):
        rate = bi.Slew("a", 0.0, TIME, rate=given).rate
        np.testing.assert_array_equal(rate, np.where(np.eye(3), np.nan, 1.0))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"slews": bi.Slew("a", 0.0, TIME, rate=RATE)}, "slews: a Slew is no list"),
        ({"slews": [TIME]}, "slews: an ndarray is no Slew; give a Slew"),
        ({"name": None}, "name: a NoneType is no str"),
        ({"wheels": None}, "wheels: a NoneType is no list"),
        ({"inertia": np.eye(3)}, "inertia: an ndarray is no InertiaPrior"),
        ({"rate_sensor": [bi.RateSensor(1e-5)]}, "rate_sensor: a list is no RateSensor"),
        ({"prior": "last_run"}, "prior: a str is no GaussianPrior"),
        ({"actuators": [5]}, "actuators: an int .*give a KnownTorque or Magnetorquer or"),
        ({"more_sensors": [bi.RateSensor(1e-5)]}, "more_sensors: a RateSensor is no pair of"),
        ({"more_sensors": [(5, bi.RateSensor(1e-5))]}, "more_sensors: a tuple is no pair of"),
        ({"mission": ["name"]}, "mission: a str is no pair"),
        ({"names": ("gyro",)}, "names: .* are not two"),
    ],
)
def test_what_is_no_part_of_a_campaign_is_said_with_its_key(changes, says):
    with pytest.raises(bi.CampaignError, match=says):
        replace(small_campaign(), **changes)


def test_sensors_and_mission_may_be_given_as_dictionaries():
    campaign, gyro = small_campaign(), bi.RateSensor(1e-5)
    given = replace(campaign, more_sensors={"gyro_2": gyro}, mission={"name": "MOST"})
    assert given.more_sensors == (("gyro_2", gyro),)
    assert given.mission == (("name", "MOST"),)


@pytest.mark.parametrize("axes", [1, 2, 4])
def test_correlated_noise_of_one_number_counts_for_each_axis_of_any_sensor(axes):
    noise = bi.CorrelatedNoise(0.5, 2.0)
    directions = np.concatenate([np.eye(3), np.full((1, 3), 3**-0.5)])[:axes]
    sensor = bi.RateSensor(1e-5, directions, correlated_noise=noise)
    assert sensor.correlated_noise.share == (0.5,) * axes
    assert sensor.correlated_noise.time == (2.0,) * axes


@pytest.mark.parametrize("indices", [5, [7], [0.0], [True, False, True], np.array([True, False])])
def test_slews_are_chosen_by_their_numbers(indices):
    """A mask would be taken for the numbers 0 and 1."""
    with pytest.raises(bi.CampaignError, match="indices: "):
        small_campaign().subset(indices)
    assert [s.name for s in small_campaign().subset(np.array([2, 0])).slews] == ["slew 3", "slew 1"]


@pytest.mark.parametrize("name", ["rate", "attitude", "momentum", "noise"])
def test_no_further_sensor_has_the_name_of_a_channel(name):
    """Its readings and the channel's would have been one in every result."""
    campaign = replace(small_campaign(), more_sensors=[(name, bi.RateSensor(1e-5))])
    with pytest.raises(bi.CampaignError, match=f"sensors.{name}.name: results know something else"):
        bi.Model(campaign)


def test_levels_of_thrusters_are_shares_of_full_thrust():
    def flown(level):
        inputs = {"jets": bi.InputStream([0.0, 1.0], [[level], [0.0]])}
        slew = bi.Slew("a", 0.0, TIME, rate=RATE, inputs=inputs)
        prior, jets = bi.InertiaPrior(AXES, 0.1, 0.1), bi.Thruster("jets", [[0.1, 0.0, 0.0]])
        return bi.Campaign("c", prior, (), bi.RateSensor(1e-5), None, (slew,), actuators=(jets,))

    assert flown(1.02).actuators
    with pytest.raises(bi.CampaignError, match=r"inputs\.jets: a level of 50 times full thrust"):
        flown(50.0)


def test_a_wheel_that_spins_freely_has_no_commands():
    """They would have turned it, whatever its state says."""
    small = small_campaign()
    free = replace(small, wheels=(replace(small.wheels[0], state="free"), *small.wheels[1:]))
    with pytest.raises(bi.CampaignError, match="slew 1: x spins freely, and is commanded"):
        campaign_of(content_of(free)[0], "campaign.toml", content_of(free)[1])
    slews = [replace(s, wheel_torque=s.wheel_torque * [0.0, 1.0, 1.0]) for s in small.slews]
    description, tables = content_of(replace(free, slews=slews))
    assert campaign_of(description, "campaign.toml", tables).wheels == free.wheels


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda: bi.plot_telemetry(small_campaign().slews[0], "rates"),
            "channel: slew 1 has no rates; choose one of rate, attitude",
        ),
        (
            lambda: bi.simulate(bi.paper_like_plan(), most_like_mission(), "s", 0, hidden="x"),
            "hidden: a str is no list; give a tuple",
        ),
    ],
)
def test_a_wrong_name_is_told_with_the_right_ones(make, says):
    with pytest.raises(bi.BayesInertiaError, match=says):
        make()


def test_progress_that_is_no_callback_is_refused():
    says = "progress: 'yes' is no callback; give True, None or a callback"
    with pytest.raises(bi.SettingsError, match=says):
        bi.estimate(small_campaign(), progress="yes")
