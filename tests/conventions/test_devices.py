"""The check of what devices beside wheels were told: a wrong key is named, a right one is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.app.told_torques import torques_of
from bayes_inertia.campaign.actuators import GimballedRotors, KnownTorque, Magnetorquer
from bayes_inertia.campaign.hardware import DirectionSensor, body_rates
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.conventions.candidates import mistakes, signed
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.conventions.laws import CONSERVATION, Misfits
from bayes_inertia.conventions.motion import sampled
from bayes_inertia.conventions.reading import (
    FIELD,
    ToldTorque,
    ToldTorques,
    stated_by,
    stated_reading,
    untold,
)


@pytest.fixture(scope="module")
def example():
    import bayes_inertia

    return read_campaign(f"{next(iter(bayes_inertia.__path__))}/example")


def with_device(campaign, device, values_of):
    """The campaign without wheels, turned by a device whose input `values_of` a slew tells."""
    slews = [
        replace(
            slew,
            wheel_torque=None,
            wheel_momentum=None,
            inputs={device.name: InputStream(slew.time, values_of(slew), "line")},
        )
        for slew in campaign.slews
    ]
    return replace(campaign, wheels=(), actuators=(device,), slews=tuple(slews))


def test_an_only_column_is_not_called_all_columns():
    (alone,) = signed(["m1"], "torquer")
    assert alone.words == "m1 of torquer has the other sign"
    assert next(signed(["m1", "m2"], "torquers")).words.startswith("all columns of torquers have")


@pytest.fixture(scope="module")
def by_torque(example, tmp_path_factory):
    """Folder: the example's wheels, as a torque that telemetry tells."""

    def torque(slew):
        h_B = slew.wheel_momentum @ example.wheel_axes_B.T
        sensor = example.gyro
        rate_B = body_rates(sensor, slew.rate, sensor.scale_factor)
        return -np.gradient(h_B, slew.time, axis=0) - np.cross(rate_B, h_B)

    campaign = with_device(example, KnownTorque("jets", gain_sigma=0.02), torque)
    return write_campaign(campaign, tmp_path_factory.mktemp("jets") / "campaign")


def told_in_body_axes(campaign):
    """What a torque along body axes does, integrated by trapezoids."""
    told = {}
    for slew in campaign.slews:
        (stream,) = slew.inputs.values()
        steps = 0.5 * (stream.values[1:] + stream.values[:-1]) * np.diff(stream.time)[:, None]
        impulse = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        told[slew.name] = ToldTorque(
            stream.time, impulse, np.zeros(len(impulse)), np.zeros_like(impulse)
        )
    return told


def checked(folder, old="", new="", told=told_in_body_axes):
    """The check of the folder with other text in its description."""
    text = (folder / "campaign.toml").read_text()
    assert old in text
    (folder / "other.toml").write_text(text.replace(old, new))
    return check_conventions(folder / "other.toml", told, quick=True)


NAMES = '["jets_1", "jets_2", "jets_3"]'
WRONG = [
    ('unit = "N m"', 'unit = "mN m"', "unit", "N m"),
    (NAMES, '["jets_2", "jets_1", "jets_3"]', "names", ["jets_1", "jets_2", "jets_3"]),
    (NAMES, '["-jets_1", "-jets_2", "-jets_3"]', "names", ["jets_1", "jets_2", "jets_3"]),
    (NAMES, '["jets_1", "-jets_2", "jets_3"]', "names", ["jets_1", "jets_2", "jets_3"]),
    (NAMES, '["-jets_2", "jets_1", "jets_3"]', "names", ["jets_1", "jets_2", "jets_3"]),
]


def test_a_right_torque_is_not_accused(by_torque):
    assert checked(by_torque).changes == ()
    assert checked(by_torque).verdict == "consistent"


@pytest.mark.parametrize(("old", "new", "key", "mended"), WRONG)
def test_a_wrong_key_of_a_told_torque_is_named(by_torque, old, new, key, mended):
    check = checked(by_torque, old, new)
    assert check.verdict == "wrong"
    assert check.changes[0].key == f"actuators.jets.torque.{key}"
    assert check.changes[0].mended == mended


@pytest.mark.slow
def test_without_the_torque_no_key_of_it_is_named(by_torque):
    """The negative control: conservation of momentum is what the test above rests on."""
    check = checked(by_torque, told=untold)
    assert not any("jets" in change.key for change in check.changes)


@pytest.mark.long
@pytest.mark.slow
def test_a_torque_along_inertial_axes_is_named(by_torque):
    check = checked(by_torque, 'frame = "body"', 'frame = "inertial"', torques_of)
    assert (check.changes[0].key, check.changes[0].mended) == (
        "actuators.jets.torque.frame",
        "body",
    )


@pytest.mark.long
@pytest.mark.slow
def test_a_wrong_sign_of_a_gimbal_angle_is_named(example, tmp_path):
    """The example's wheels, as pairs of rotors whose gimbals tilt against each other."""
    momentum = 10.0 * max(np.abs(slew.wheel_momentum).max() for slew in example.slews)
    across = example.wheel_axes_B.T
    spin = np.roll(across, 1, axis=0)
    gimbals = np.cross(spin, across)
    # cos a s + sin a g x s: of a pair the part along s cancels, the part across is the wheel's.
    rotors = GimballedRotors(
        "cmg", 0.5 * momentum, np.concatenate([gimbals, -gimbals]), np.concatenate([spin, -spin])
    )
    campaign = with_device(
        example, rotors, lambda slew: np.tile(np.arcsin(slew.wheel_momentum / momentum), 2)
    )
    folder = write_campaign(campaign, tmp_path / "campaign")
    assert checked(folder, told=torques_of).verdict == "consistent"
    first = checked(folder, '"cmg_2"', '"-cmg_2"', torques_of).changes[0]
    assert first.key == "actuators.cmg.gimbal_angle.names"
    assert first.mended == [f"cmg_{i + 1}" for i in range(6)]


def told_fields(campaign):
    """A teller that tells the magnetic field of each slew."""
    return {slew.name: slew.magnetic_field_N[0].tolist() for slew in campaign.slews}


def of_the_field(tried):
    return [m for m in tried if m.changes[0].key.startswith("environment")]


def test_another_unit_or_order_of_the_field_is_one_for_torquers_and_magnetometer(example):
    off = {"torquers": InputStream(np.zeros(1), np.zeros((1, 3)))}
    slews = [
        replace(slew, magnetic_field_N=np.full((len(slew.time), 3), 2e-5), inputs=off)
        for slew in example.slews
    ]
    campaign = replace(
        example,
        actuators=(Magnetorquer("torquers"),),
        more_sensors=(("field", DirectionSensor(2e-7, unit="T")),),
        slews=tuple(slews),
    )
    stated, torques = stated_reading(campaign), ToldTorques(campaign, told_fields)
    tried = of_the_field(mistakes(campaign, stated_by(campaign), 3, True))
    (unit,) = (m for m in tried if m.changes[0].mended == "nT")
    (order,) = (m for m in tried if m.changes[0].mended == ["By_N_T", "Bx_N_T", "Bz_N_T"])
    for mistake, matrix in ((unit, 1e-9 * np.eye(3)), (order, np.eye(3)[[1, 0, 2]])):
        mended = mistake.mend(stated)
        assert set(mended.matrices) - set(stated.matrices) == {FIELD}
        np.testing.assert_allclose(mended.matrices[FIELD], matrix)
        (fields,) = {tuple(field) for field in torques.under(mended).values()}
        np.testing.assert_allclose(fields, matrix @ np.full(3, 2e-5))


def test_the_field_of_an_orbit_is_in_no_column(example, by_torque):
    campaign = replace(
        example,
        actuators=(Magnetorquer("torquers"),),
        slews=[
            replace(
                slew,
                magnetic_field_N=np.full((len(slew.time), 3), 2e-5),
                inputs={"torquers": InputStream(np.zeros(1), np.zeros((1, 3)))},
            )
            for slew in example.slews
        ],
    )
    said = parse_description((by_torque / "campaign.toml").read_text(), "campaign.toml")
    entries = [entry for entry in said.entries if not entry.path.startswith("environment")]
    of_orbit = replace(said, entries=tuple(entries))
    for description, some in ((None, True), (said, True), (of_orbit, False)):
        tried = mistakes(campaign, stated_by(campaign, description), 0, True)
        assert bool(of_the_field(tried)) == some


@pytest.mark.parametrize(("factor", "doubted"), [(1.0, False), (1e-4, True)])
def test_a_field_of_a_size_that_the_earth_has_in_no_orbit_is_doubted(example, factor, doubted):
    slews = [
        replace(slew, magnetic_field_N=np.full((len(slew.time), 3), 2e-5 * factor))
        for slew in example.slews
    ]
    check = check_conventions(replace(example, slews=slews))
    said = [doubt for doubt in check.doubts if "look at its unit" in doubt]
    assert (check.verdict == "doubtful", bool(said)) == (doubted, doubted)


def test_the_noise_of_gimbal_angles_is_noise_of_the_momentum(example):
    momentum, sd = 4.0, 1e-3
    rotors = GimballedRotors("cmg", momentum, np.eye(3), np.eye(3)[[1, 2, 0]], angle_sigma=sd)
    quiet = replace(rotors, angle_sigma=0.0)
    noises = []
    for device in (quiet, rotors):
        campaign = with_device(example, device, lambda slew: np.zeros((len(slew.time), 3)))
        reading = stated_reading(campaign)
        noises.append(Misfits(campaign, sampled(campaign)).law(CONSERVATION, reading).noise)
    assert noises[1] ** 2 - noises[0] ** 2 == pytest.approx(3.0 * (momentum * sd) ** 2)
