"""What is wrong with one device of many: named by kind and device, and of that device alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.other_spacecraft import by_thrusters

from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.campaign.actuators import KnownTorque, Magnetorquer, Thruster
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor, StarTracker
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.physics.effects import LIBRARY, EachSlew, RateSensorDelay, by_name
from bayes_inertia.physics.effects.of_device import KINDS, candidates_in, errors_of
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.physics.packing import longest_step
from bayes_inertia.physics.small_campaign import small_campaign

TORQUES = 2e-4 * np.vstack([np.eye(3), -np.eye(3)])
AXES = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0]])
SUN_N = (0.5, 0.7, 0.51)


@pytest.fixture(scope="module")
def equipped():
    """A small campaign with two gyros, two trackers, Sun sensor, magnetometer and three devices."""
    plain, rng = small_campaign(), np.random.default_rng(1)
    inputs = {
        name: InputStream(np.arange(0.5, 63.0, 4.0), size * rng.uniform(0, 1, (16, n)), "hold")
        for name, size, n in (("torquers", 3.0, 3), ("jets", 1.0, 6), ("push", 1e-4, 3))
    }
    slews = [
        replace(
            s,
            inputs=inputs,
            more={
                "mems": s.rate @ AXES.T,
                "tracker 2": s.attitude,
                "sun": np.ones((len(s.time), 3)),
                "magnetometer": 3e-5 * np.ones((len(s.time), 3)),
            },
        )
        for s in plain.slews
    ]
    return replace(
        plain,
        slews=tuple(slews),
        actuators=(Magnetorquer("torquers"), Thruster("jets", TORQUES), KnownTorque("push")),
        more_sensors=(
            ("mems", RateSensor(1e-4, AXES)),
            ("tracker 2", StarTracker((1.0, 0.0, 0.0), 2e-5, 1e-4)),
            ("sun", DirectionSensor(0.01, SUN_N)),
            ("magnetometer", DirectionSensor(1e-7, unit="T")),
        ),
        names=("fog", "tracker 1"),
    )


def names_of(effects):
    return [effect.name for effect in effects]


def test_every_kind_is_tried_for_every_device(equipped):
    effects = candidate_effects(equipped, LIBRARY)
    names = names_of(effects.linear)
    of_gyro = [e.kind for e in KINDS[RateSensor]]
    assert {f"{kind}[{gyro}]" for kind in of_gyro for gyro in ("fog", "mems")} <= set(names)
    assert {"offset[magnetometer]", "scale[magnetometer]", "delay[sun]"} <= set(names)
    assert {"gain[torquers]", "direction[jets]", "gain[push]", "shift[tracker 2]"} <= set(names)
    assert {"delay[torquers]", "delay[jets]", "each_gain[jets]"} <= set(names)
    # A direction has no size, an old name stands for the first of several only.
    assert not {"offset[sun]", "rate_sensor_delay", "star_tracker_shift"} & set(names)
    assert len(set(names)) == len(names)
    assert names_of(candidates_in(small_campaign(), LIBRARY)) == names_of(LIBRARY)
    few = (RateSensorDelay(),)
    assert names_of(candidates_in(equipped, few)) == ["delay[fog]"]


def test_the_axes_of_the_reference_are_the_bodys(equipped):
    def turned(campaign):
        found = names_of(candidates_in(campaign, LIBRARY))
        return {name for name in found if name.startswith("misalignment[")}

    assert equipped.frame_reference == "tracker 1"
    assert "misalignment[tracker 1]" not in turned(equipped)
    assert "misalignment[mems]" not in turned(replace(equipped, reference="mems"))
    assert "misalignment[tracker 1]" in turned(replace(equipped, reference="mems"))
    alone = replace(small_campaign(), reference="star tracker")
    assert "star_tracker_misalignment" not in names_of(candidates_in(alone, LIBRARY))
    assert "rate_sensor_misalignment" in names_of(candidates_in(alone, LIBRARY))
    with pytest.raises(CampaignError, match="no sensor is called 'gyro'"):
        replace(equipped, reference="gyro")


@pytest.mark.long
@pytest.mark.slow
def test_an_error_of_a_sensor_shows_in_its_readings_alone(equipped):
    devices = ("fog", "mems", "tracker 2", "sun", "magnetometer", "torquers", "jets", "push")
    model = Model(equipped, [e for device in devices for e in errors_of(device, equipped)])
    before = model.predict(model.space.nulls)
    for effect in model.effects:
        theta = np.array(model.space.nulls)
        part = model.space.slice_of(effect.name)
        theta[part] += model.space.sd[part]
        after = model.predict(theta)
        moved = {k for k in before if not np.allclose(before[k], after[k], rtol=1e-9, atol=1e-14)}
        channel = {"fog": "rate"}.get(effect.device, effect.device)
        expected = {channel} if effect.device in equipped.sensors else set(before)
        assert moved == expected, effect.name


@pytest.mark.long
@pytest.mark.slow
def test_the_gain_of_a_device_is_that_of_its_record(equipped):
    (gain,) = by_name(["gain[torquers]"])
    doubtful = (replace(equipped.actuators[0], gain_sigma=0.02), *equipped.actuators[1:])
    by_record, by_effect = Model(replace(equipped, actuators=doubtful)), Model(equipped, (gain,))
    predicted = []
    for model, name in ((by_record, "torquers.gain"), (by_effect, "gain[torquers].gain")):
        theta = np.array(model.space.nulls)
        theta[model.space.names.index(name)] = 1.1
        predicted.append(model.predict(theta))
    for channel, values in predicted[0].items():
        np.testing.assert_allclose(predicted[1][channel], values, rtol=1e-9, atol=1e-13)


def test_a_device_of_one_number_has_one_gain(equipped):
    """Its gain and its gain of each would be the same column twice."""
    slews = tuple(
        replace(s, inputs={"jet": replace(told, values=told.values[:, :1])})
        for s in equipped.slews
        for told in [s.inputs["jets"]]
    )
    one = replace(equipped, actuators=(Thruster("jet", TORQUES[:1]),), slews=slews)
    assert [e.kind for e in errors_of("jet", one)] == ["gain", "direction", "delay"]


@pytest.mark.long
@pytest.mark.slow
def test_gains_of_each_are_those_of_the_record(equipped):
    doubtful = replace(equipped.actuators[1], each_gain_sigma=0.02)
    actuators = (equipped.actuators[0], doubtful, equipped.actuators[2])
    by_record = Model(replace(equipped, actuators=actuators))
    by_effect = Model(equipped, by_name(["each_gain[jets]"]))
    gains = np.linspace(0.9, 1.1, 6)
    predicted = []
    for model, name in (
        (by_record, "jets.each_gain_1"),
        (by_effect, "each_gain[jets].each_gain_1"),
    ):
        theta, first = np.array(model.space.nulls), model.space.names.index(name)
        theta[first : first + 6] = gains
        predicted.append(model.predict(theta))
    for channel, values in predicted[0].items():
        np.testing.assert_allclose(predicted[1][channel], values, rtol=1e-9, atol=1e-13)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("between", ["hold", "line"])
@pytest.mark.parametrize("tau", [0.0, 0.3, 1.7])
def test_a_delayed_device_does_what_one_does_that_is_told_later(equipped, between, tau):
    def told(late):
        def moved(x):
            return InputStream(x.time + late, x.values, between)

        inputs = [{k: moved(x) for k, x in s.inputs.items()} for s in equipped.slews]
        slews = (replace(s, inputs=x) for s, x in zip(equipped.slews, inputs, strict=True))
        return replace(equipped, slews=tuple(slews))

    devices = ("torquers", "jets", "push")
    model = Model(told(0.0), by_name([f"delay[{name}]" for name in devices]))
    theta = np.array(model.space.nulls)
    theta[-3:] = tau
    later = Model(told(tau))
    found, expected = model.predict(theta), later.predict(later.space.nulls)
    plain = model.predict(model.space.nulls)
    for channel in ("rate", "attitude", "momentum"):
        moved = np.abs(expected[channel] - plain[channel]).max()
        # A step's mean torque stands for its torque: a jump of 2e-4 N m on 2 kg m^2 within a step
        # of 1 s turns the body by 1e-5 rad at most, a hundredth of what the delays do here.
        np.testing.assert_allclose(found[channel], expected[channel], atol=0.01 * moved + 1e-13)


def test_effects_of_absent_parts_are_no_candidates():
    plain = small_campaign()
    slews = [replace(s, attitude=None, wheel_torque=None, wheel_momentum=None) for s in plain.slews]
    bare = replace(plain, star_tracker=None, wheels=(), slews=tuple(slews))
    found = candidate_effects(bare, LIBRARY)
    assert not [n for n in names_of(found.linear) if n.startswith(("star_tracker", "wheel_"))]
    skipped = dict(found.skipped)
    assert skipped["star_tracker_shift"] == "needs a star tracker"
    assert skipped["wheel_friction"] == "needs wheels"
    assert skipped["magnetic_dipole"] == "needs a star tracker or directions in every slew"
    assert "rate_bias" in names_of(found.linear)


@pytest.mark.long
@pytest.mark.slow
def test_a_direction_turns_the_torques_of_thrusters(equipped):
    turned = replace(equipped.actuators[1], torque_B=TORQUES + np.cross([0.0, 0.0, 1e-3], TORQUES))
    other = replace(equipped, actuators=(equipped.actuators[0], turned, equipped.actuators[2]))
    model = Model(equipped, by_name(["direction[jets]"]))
    theta = np.array(model.space.nulls)
    theta[-1] = 1e-3
    plain = Model(other)
    expected = plain.predict(plain.space.nulls)
    np.testing.assert_allclose(model.predict(theta)["rate"], expected["rate"], atol=1e-13)


def test_errors_of_sensors_and_devices_come_before_every_effect(equipped):
    doubtful = (replace(equipped.actuators[0], gain_sigma=0.02), *equipped.actuators[1:])
    campaign = replace(equipped, actuators=doubtful)
    model = Model(campaign, by_name(["delay[mems]", "constant_torque"]))
    known = model.space.names[: model.n_known]
    assert known == Model(campaign).space.names
    assert known[9:] == ("mems.K1", "mems.K2", "mems.bias1", "mems.bias2", "torquers.gain")


@pytest.mark.long
@pytest.mark.slow
def test_an_effect_of_a_device_may_differ_from_slew_to_slew(equipped):
    (delay,) = by_name(["delay[mems]"])
    model = Model(equipped, (EachSlew.of(delay, equipped),))
    theta = np.array(model.space.nulls)
    theta[model.space.slice_of("delay[mems]")] = [0.0, 0.5, 0.0]
    before, after = model.predict(model.space.nulls), model.predict(theta)
    changed = np.abs(after["mems"] - before["mems"])[0].max(axis=(1, 2))
    assert changed[1] > 1e-6 > 1e-12 > max(changed[0], changed[2])


def test_names_take_settings_and_survive_a_stored_diagnosis(equipped):
    (delay,) = effects_named(["delay[mems]:sigma=0.2"])
    assert delay.name == "delay[mems]"
    assert delay.in_campaign(equipped).sigma == 0.2
    content = {"verdict": "named", "noise": {}, "drive": "commanded"}
    content["fitted"] = [{"effect": "delay[mems]", "settings": {"device": "mems", "sigma": 0.3}}]
    (stored,) = next_fit_from(content).effects
    wanted = RateSensorDelay(sigma=0.3, device="mems").in_campaign(equipped)
    assert stored.in_campaign(equipped) == wanted


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("delay[gps]", "no device of this campaign is called 'gps'; devices here: fog, tracker 1"),
        ("gain[mems]", "mems has no error of this kind; effects of it: bias[mems]"),
        ("dilay[mems]", "no kind of effect is called 'dilay'; perhaps delay"),
        ("delay[mems]:tau=3", "no setting 'tau'; perhaps"),
    ],
)
def test_bad_names_teach(equipped, name, said):
    with pytest.raises(EffectError) as refused:
        Model(equipped, effects_named([name]))
    assert said in str(refused.value)


def test_a_late_gyro_beside_thrusters_sees_a_grid_that_straight_lines_follow():
    """Slow telemetry of a fast motion: between its rows alone a line misses more than the noise."""
    campaign = by_thrusters()
    rates = [0.3 * np.sin(s.time[:, None] / [2.0, 3.0, 4.0]) for s in campaign.slews]
    slews = [replace(s, rate=rate) for s, rate in zip(campaign.slews, rates, strict=True)]
    fast = replace(campaign, slews=tuple(slews))
    step = np.asarray(Model(fast, (RateSensorDelay(),)).data.arrays.slews.context.step)
    assert step.max() <= longest_step(fast) < 1.0
