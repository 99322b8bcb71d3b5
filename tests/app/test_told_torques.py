"""Effects that are named count when conventions are held against physics."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.app import many_folder, run_folder
from bayes_inertia.app.result_folder import write_json
from bayes_inertia.app.told_torques import refuse_impossible, torques_of
from bayes_inertia.campaign.actuators import GimballedRotors, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.errors import CampaignError
from bayes_inertia.maths.quaternion import exp, to_body
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.sealing import sealed

THRUSTERS = """from dataclasses import dataclass
import jax.numpy as jnp
from bayes_inertia import Effect, Normal, scalar

@dataclass(frozen=True)
class Thrusters(Effect):
    name = "thrusters"
    strength: float = {strength}

    def parameters(self, campaign):
        return (scalar("gain", unit="", prior=Normal(1.0, 0.02), null=0.0),)

    def body_torque(self, p, slew, t, state):
        push = jnp.where(t < 30.0, 1.0, 0.0) - jnp.where(t >= 70.0, 1.0, 0.0)
        axis = jnp.eye(3)[slew.index]
        return p["gain"] * self.strength * push * axis
"""


def pushed(strength: float) -> Campaign:
    """A body without wheels that thrusters turn up and stop again, about one axis a slew."""
    small = small_campaign()
    moments, time = np.diag(small.inertia.tensor), np.arange(101.0)
    speed = strength * np.clip(np.minimum(time, 100.0 - time), 0.0, 30.0)
    slews = []
    for k in range(3):
        axis = np.eye(3)[k]
        rate = speed[:, None] / moments[k] * axis
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) / moments[k]
        attitude = np.array([np.asarray(exp(a * axis)) for a in angle])
        slews.append(Slew(f"slew {k + 1}", 300.0 * k, time, rate=rate, attitude=attitude))
    inertia = replace(small.inertia, tensor=np.diag(moments))
    return replace(small, inertia=inertia, wheels=(), slews=tuple(slews))


@pytest.fixture
def thrown(tmp_path):
    campaign = tmp_path / "campaign"
    write_campaign(pushed(0.02), campaign)
    return campaign


def thrusters(folder, strength: float) -> list[str]:
    file = folder.parent / "thrusters.py"
    file.write_text(THRUSTERS.format(strength=strength))
    return [f"{file}:Thrusters"]


@pytest.mark.slow
def test_a_torque_that_a_named_effect_tells_is_no_broken_law(thrown):
    before = check_conventions(thrown)
    assert before.verdict != "consistent"
    assert before.misfits["conservation"] > 3.0
    check = refuse_impossible(thrown, thrusters(thrown, 0.02))
    assert check.verdict == "consistent"
    assert max(check.misfits.values()) < 0.2


@pytest.mark.slow
def test_a_torque_of_the_wrong_sign_is_found(thrown):
    check = check_conventions(thrown, partial(torques_of, effects=thrusters(thrown, -0.02)))
    assert check.verdict != "consistent"
    assert check.misfits["conservation"] > 3.0


def test_effects_of_the_library_load_no_physics(thrown):
    assert torques_of(read_campaign(thrown), ["magnetic_dipole", "constant_torque"]) == {}


@pytest.mark.slow
def test_the_told_torque_follows_the_measured_attitude(tmp_path):
    """A torque that is fixed in inertial axes turns with the body, from the tracker's attitude."""
    write_campaign(pushed(0.02), tmp_path / "campaign")
    file = tmp_path / "wind.py"
    file.write_text(
        THRUSTERS.split("@dataclass")[0]
        + "from bayes_inertia import to_body\n"
        + "@dataclass(frozen=True)\nclass Wind(Effect):\n    name = 'wind'\n"
        + "    def body_torque(self, p, slew, t, state):\n"
        + "        return to_body(state.attitude, jnp.array([1e-3, 0.0, 0.0]))\n"
    )
    told = torques_of(read_campaign(tmp_path / "campaign"), [f"{file}:Wind"])["slew 3"]
    slew = pushed(0.02).slews[2]
    force = np.tile([1e-3, 0.0, 0.0], (len(slew.time), 1))
    torque = np.asarray(to_body(slew.attitude, force))
    expected = np.trapezoid(torque, slew.time, axis=0)
    at_end = told.at(slew.time[-1:])[0]
    # Torques are held over steps of a few hundredths of a radian.
    np.testing.assert_allclose(at_end[:3], expected, atol=0.02 * np.abs(expected).max())
    assert at_end[3] == 0.0


def with_jets(sign: float) -> Campaign:
    """One slew by pulses of a pair of thrusters."""
    campaign = pushed(0.02)
    levels = InputStream([0.0, 30.0, 70.0], [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    torque_B = sign * 0.02 * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    slew = replace(campaign.slews[0], inputs={"jets": levels})
    return replace(campaign, slews=(slew,), actuators=(Thruster("jets", torque_B, 0.02),))


def test_devices_of_the_campaign_count():
    """Pulses of thrusters are no broken law, unless their torques point the other way."""
    right = bi.check_conventions(with_jets(1.0))
    assert right.verdict == "consistent"
    assert max(right.misfits.values()) < 0.2
    assert bi.check_conventions(with_jets(-1.0)).misfits["conservation"] > 3.0


@pytest.mark.slow
def test_rotors_count_in_the_total_momentum():
    """A body that turns because its rotor turns back."""
    campaign = pushed(0.02)
    moments = np.diag(campaign.inertia.tensor)
    slew = campaign.slews[0]
    size, spin, gimbal = 2.0, np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    # Its momentum along x is -size sin(angle), and two rotors cancel along y.
    angle = np.arcsin(0.5 * moments[0] * slew.rate[:, 0] / size)
    device = GimballedRotors("pair", size, np.repeat(gimbal, 2, 0), np.concatenate([spin, -spin]))
    stream = InputStream(slew.time, np.column_stack([angle, -angle]), "line")
    flown = replace(slew, inputs={"pair": stream})
    check = bi.check_conventions(replace(campaign, slews=(flown,), actuators=(device,)))
    assert check.verdict == "consistent"
    assert check.misfits["conservation"] < 0.2


@pytest.mark.parametrize(("sign", "says"), [(1.0, "0 of 1 campaigns"), (-1.0, "impossible")])
def test_a_history_refuses_what_fit_refuses(sign, says, tmp_path, monkeypatch):
    """Devices of a campaign count there too: thrusters that push the other way are no data."""
    write_campaign(with_jets(sign), tmp_path / "jets")

    def fitted(run, **_):
        run.mkdir(parents=True)
        unusable = {"campaign": "jets", "likelihood": None}
        write_json(run / "summary.json", sealed(unusable))

    monkeypatch.setattr(run_folder, "start", lambda *_, **__: None)
    monkeypatch.setattr(run_folder, "finish", fitted)
    with pytest.raises(CampaignError, match=says):
        many_folder.run_history([tmp_path / "jets"], tmp_path / "out")


@pytest.mark.slow
def test_what_a_named_effect_makes_of_commands_counts(tmp_path):
    """Thrusters whose commands an effect turns round push the other way."""
    file = tmp_path / "swapped.py"
    file.write_text(
        THRUSTERS.split("@dataclass")[0]
        + "@dataclass(frozen=True)\nclass Swapped(Effect):\n    name = 'swapped'\n"
        + "    def parameters(self, campaign):\n"
        + "        return (scalar('share', unit='', prior=Normal(-1.0, 0.5), null=1.0),)\n"
        + "    def delivered_inputs(self, p, slew, inputs):\n"
        + "        rows = inputs['jets']\n"
        + "        first, last = p['share'] * rows.first, p['share'] * rows.last\n"
        + "        return {**inputs, 'jets': rows._replace(first=first, last=last)}\n"
    )
    plain = torques_of(with_jets(-1.0))["slew 1"]
    told = torques_of(with_jets(-1.0), [f"{file}:Swapped"])["slew 1"]
    np.testing.assert_allclose(told.impulse_B, -plain.impulse_B, atol=1e-12)
    # Half of the torque is open, beside the 2 % of the device.
    size = np.abs(told.impulse_B).max()
    assert plain.doubt.max() == pytest.approx(0.02 * 2.0 * size, rel=0.05)
    assert told.doubt.max() == pytest.approx(0.52 * 2.0 * size, rel=0.05)
