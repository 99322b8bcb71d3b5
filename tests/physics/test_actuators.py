"""Devices beside wheels: their torque and momentum, exact where an input jumps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.campaign.actuators import GimballedRotors, KnownTorque, Magnetorquer, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.diagnosis.random_signals import roots_at
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.actuators import effects_of
from bayes_inertia.physics.actuators.gimballed_rotors import momentum_noise
from bayes_inertia.physics.channels import channels_of
from bayes_inertia.physics.check_effect import check_effect
from bayes_inertia.physics.effect import ActiveEffects, Effect
from bayes_inertia.physics.effects import RateRandomWalk, TorqueNoise
from bayes_inertia.physics.effects.magnetic_dipole import MagneticDipole
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.integration_plan import shapes_of_input_noise
from bayes_inertia.physics.packing import pack
from bayes_inertia.physics.parameters import Normal, scalar
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start
from bayes_inertia.physics.small_campaign import small_campaign

START = Start(
    jnp.array([0.05, -0.08, 0.11]), quaternion.exp(jnp.array([0.3, -0.2, 0.1])), jnp.zeros(3)
)


def campaign_with(device, stream: InputStream) -> Campaign:
    campaign = small_campaign()
    slews = tuple(replace(s, inputs={device.name: stream}) for s in campaign.slews)
    return replace(campaign, slews=slews, actuators=(device,))


def flown(campaign: Campaign, effects, step: float, values=None):
    """Trajectory of the first slew, and where its rows stand in the grid."""
    asked = sorted({name for effect in effects for name in effect.inputs})
    channels = channels_of(campaign, "commanded")
    arrays = pack(campaign, channels, max_step=step, inputs=asked)
    first = type(arrays.slews)(*(_first(x) for x in arrays.slews))
    active = ActiveEffects(tuple(effects), values or {})
    path, _ = simulate_slew(first, START, jnp.asarray(campaign.inertia.tensor), active)
    return path, np.asarray(arrays.telemetry.sample[0])


def _first(x):
    if x is None or hasattr(x, "shape"):
        return None if x is None else x[0]
    if isinstance(x, dict):
        return {key: _first(value) for key, value in x.items()}
    return type(x)(*(_first(value) for value in x))


def predicted(campaign: Campaign, effects=(), theta=None) -> list[np.ndarray]:
    model = Model(campaign, effects)
    theta = model.space.mean if theta is None else theta
    local = jnp.zeros((model.n_slews, model.structure.n_local))
    return [
        np.asarray(x)
        for x in predict_all(model.structure, jnp.asarray(theta), local, jnp.zeros(3), model.data)
    ]


@dataclass(frozen=True)
class LooksUp(Effect):
    """A torque that is looked up by time, as nobody should."""

    name = "looks_up"
    times: tuple[float, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()

    def body_torque(self, p, slew, t, state):
        row = jnp.searchsorted(jnp.array(self.times), slew.start + t, side="right") - 1
        return jnp.array(self.values)[row]


def jumping_torque(between: str) -> InputStream:
    """Large torques whose jumps lie nowhere near a row."""
    rng = np.random.default_rng(5)
    time = np.append(0.0, np.cumsum(rng.uniform(0.3, 2.3, 48)))
    return InputStream(time, 0.05 * rng.normal(size=(len(time), 3)), between)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("between", ["hold", pytest.param("line", marks=pytest.mark.long)])
def test_inputs_that_jump_off_the_grid_keep_the_order_of_the_method(between):
    stream = jumping_torque(between)
    campaign = campaign_with(KnownTorque("jets"), stream)
    rows = slice(None, None, 8)  # every step of 8 s that the coarsest grid has
    slews = tuple(
        replace(s, **{k: getattr(s, k)[rows] for k in ("time", "rate", "attitude")} | others(s))
        for s in campaign.slews
    )
    campaign = replace(campaign, slews=slews)

    def end(step, effects):
        path, sample = flown(campaign, effects, step)
        return np.concatenate([path.attitude[sample[:8]], path.rate_B[sample[:8]]], axis=1)

    exact = end(0.05, effects_of(campaign))
    errors = [np.abs(end(h, effects_of(campaign)) - exact).max() for h in (2.0, 1.0, 0.5)]
    assert errors[0] / errors[1] > 2.0**4.5
    assert errors[1] / errors[2] > 2.0**4.5
    if between == "hold":
        looked_up = LooksUp(tuple(stream.time), tuple(map(tuple, stream.values)))
        poor = [np.abs(end(h, (looked_up,)) - exact).max() for h in (2.0, 1.0, 0.5)]
        assert poor[2] > 1e3 * errors[2]
        assert poor[0] / poor[2] < 2.0**4.5


def others(slew) -> dict:
    kept = ("wheel_torque", "wheel_momentum", "magnetic_field_N", "position_N")
    return {k: 0.0 * getattr(slew, k)[::8] for k in kept}


@pytest.mark.slow
def test_thrusters_by_on_times_are_the_torque_that_they_make():
    torque_B = np.array([[0.02, 1e-3, 0.0], [-0.02, 0.0, 1e-3]])
    on = InputStream(np.arange(0.0, 60.0, 3.0), np.tile([[0.37, 0.0], [0.0, 1.21]], (10, 1)))
    on = replace(on, between="on_time")
    edges, level, _ = on.pieces()
    told = InputStream(np.append(-1.0, edges), level @ torque_B, "hold")
    first = predicted(campaign_with(Thruster("jets", torque_B), on))
    second = predicted(campaign_with(KnownTorque("jets"), told))
    for ours, theirs in zip(first, second, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-13)


@pytest.mark.long
@pytest.mark.slow
def test_thrusters_that_are_turned_and_stronger_are_told_as_such():
    torque_B = 0.01 * np.eye(3)[:2]
    held = InputStream([0.0], [[0.3, 0.7]])
    doubted = campaign_with(Thruster("jets", torque_B, 0.0, 0.05, 0.02), held)
    model = Model(doubted)
    assert model.space.names[9:] == (
        *(f"jets.each_gain_{k}" for k in (1, 2)),
        *(f"jets.direction_{k}" for k in "xyz"),
    )
    theta = np.append(model.space.mean[:9], [1.1, 0.9, 0.0, 0.0, 0.02])
    told = np.array([0.3 * 1.1, 0.7 * 0.9]) @ torque_B
    told = told + np.cross([0.0, 0.0, 0.02], told)
    same = campaign_with(KnownTorque("jets"), InputStream([0.0], [told]))
    for ours, theirs in zip(predicted(doubted, (), theta), predicted(same), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-13)


@pytest.mark.slow
def test_a_held_dipole_is_the_residual_dipole():
    dipole = np.array([0.3, -0.2, 0.5])
    axes = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    held = InputStream([0.0], [axes @ dipole])
    torquers = campaign_with(Magnetorquer("torquers", axes), held)
    bare = small_campaign()
    theta = np.append(Model(bare, (MagneticDipole(),)).space.mean[:9], dipole)
    for ours, theirs in zip(
        predicted(torquers), predicted(bare, (MagneticDipole(),), theta), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_a_torque_in_inertial_axes_keeps_its_direction():
    held = InputStream([0.0], [[2e-3, -1e-3, 3e-3]])
    campaign = campaign_with(KnownTorque("wind", frame="inertial"), held)
    path, sample = flown(campaign, effects_of(campaign), 0.5)
    J, G = campaign.inertia.tensor, campaign.wheel_axes_B
    locked = J + (G * campaign.spin_inertias) @ G.T
    momentum_B = path.rate_B @ locked.T + path.wheel_momentum @ G.T
    momentum_N = np.asarray(quaternion.to_inertial(path.attitude, momentum_B))
    gained = momentum_N[sample[40]] - momentum_N[0]
    np.testing.assert_allclose(gained, 40.0 * held.values[0], rtol=1e-7)


@pytest.mark.slow
def test_rotors_exchange_momentum_and_lose_none():
    rng = np.random.default_rng(4)
    gimbal = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    spin = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    device = GimballedRotors("cluster", [0.5, 0.4, 0.6], gimbal, spin)
    time = np.arange(0.0, 64.0, 0.7)
    angles = InputStream(time, np.cumsum(0.1 * rng.normal(size=(len(time), 3)), axis=0), "line")
    campaign = campaign_with(device, angles)
    path, _ = flown(campaign, effects_of(campaign), 0.25)
    J, G = campaign.inertia.tensor, campaign.wheel_axes_B
    locked = J + (G * campaign.spin_inertias) @ G.T
    a = np.stack([np.interp(path.time, time, x) for x in angles.values.T], -1)[..., None]
    across = np.cross(gimbal, spin)
    carried = np.einsum("k,nki->ni", device.momentum, np.cos(a) * spin + np.sin(a) * across)
    momentum_B = path.rate_B @ locked.T + path.wheel_momentum @ G.T + carried
    momentum_N = np.asarray(quaternion.to_inertial(path.attitude, momentum_B))
    assert np.abs(path.rate_B).max() > 0.1
    np.testing.assert_allclose(momentum_N, np.tile(momentum_N[0], (len(a), 1)), atol=1e-13)


def test_noise_of_gimbal_angles_is_noise_of_an_input():
    axes = np.eye(3)
    device = GimballedRotors("one", 0.5, axes[:1], axes[1:2], angle_sigma=1e-4)
    campaign = campaign_with(device, InputStream(np.arange(64.0), np.zeros((64, 1)), "line"))
    # At angle 0 the momentum along y turns towards z.
    wanted = np.diag([0.0, 0.0, 0.5e-4**2])
    np.testing.assert_allclose(momentum_noise(campaign, "commanded"), wanted, atol=1e-20)
    noisy = Model(campaign)
    exact = Model(replace(campaign, actuators=(replace(device, angle_sigma=0.0),)))
    shapes = shapes_of_input_noise(campaign).shape[1]
    assert noisy.structure.n_local == exact.structure.n_local + shapes
    channel = noisy.channels[0]
    more = channel.noise(campaign, noisy.space.mean, "commanded") - channel.noise(
        exact.campaign, noisy.space.mean, "commanded"
    )
    shaken = np.linalg.inv(campaign.inertia.tensor + 1e-3 * np.eye(3))[:, 2] * 0.5e-4
    np.testing.assert_allclose(more, np.outer(shaken, shaken), rtol=1e-9)


def test_gains_are_parameters_where_they_are_in_doubt():
    stream = InputStream([0.0], [[1e-3, 0.0, 0.0]])
    known = Model(campaign_with(KnownTorque("jets"), stream))
    doubted = Model(campaign_with(KnownTorque("jets", 0.02), stream))
    each = Model(campaign_with(Thruster("jets", np.eye(3), 0.0, 0.1), stream))
    assert known.space.names == Model(small_campaign()).space.names
    assert doubted.space.names[9:] == ("jets.gain",)
    assert each.space.names[9:] == tuple(f"jets.each_gain_{k}" for k in (1, 2, 3))
    assert doubted.effects == ()
    assert doubted.space.mean[9] == 1.0
    assert doubted.space.sd[9] == 0.02


def test_random_effects_stand_beside_devices_and_the_noise_of_their_inputs():
    angles = InputStream(np.arange(64.0), np.zeros((64, 1)), "line")
    rotor = GimballedRotors("one", 0.5, np.eye(3)[:1], np.eye(3)[1:2], angle_sigma=1e-4)
    both = (RateRandomWalk(), TorqueNoise())
    alone = roots_at(Model(small_campaign(), both), 0.0)
    beside = roots_at(Model(campaign_with(rotor, angles), both), 0.0)
    for first, second in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(first.blocks, second.blocks)


@pytest.mark.slow
def test_an_effect_of_your_own_looks_up_an_input_by_name():
    @dataclass(frozen=True)
    class Own(Effect):
        name = "own"
        inputs = ("valve",)

        def body_torque(self, p, slew, t, state):
            return state.input("valve")[0] * jnp.array([1e-3, 0.0, 0.0])

    @dataclass(frozen=True)
    class Forgot(Own):
        inputs = ()

    stream = InputStream([0.0, 7.3], [[0.0], [1.0]])
    bare = small_campaign()
    campaign = replace(bare, slews=tuple(replace(s, inputs={"valve": stream}) for s in bare.slews))
    torque = InputStream([0.0, 7.3], [[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0]])
    ours = predicted(campaign, (Own(),))
    theirs = predicted(campaign_with(KnownTorque("valve"), torque))
    for first, second in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-14)
    with pytest.raises(EffectError, match=r"inputs = \(\"valve\",\)"):
        predicted(campaign, (Forgot(),))
    with pytest.raises(CampaignError, match="which the slew does not have"):
        predicted(bare, (Own(),))


@pytest.mark.long
@pytest.mark.slow
def test_a_torque_that_is_looked_up_by_time_is_warned_of():
    @dataclass(frozen=True)
    class Pulse(Effect):
        name = "pulse"

        def parameters(self, campaign):
            return (scalar("size", unit="N m", prior=Normal(0.0, 1e-4)),)

        def body_torque(self, p, slew, t, state):
            on = jnp.where((t > 12.3) & (t < 14.0), 1.0, 0.0)
            return p["size"] * on * jnp.array([1.0, 0.0, 0.0])

    @dataclass(frozen=True)
    class Steep(Pulse):
        name = "steep"

        def body_torque(self, p, slew, t, state):
            return p["size"] * jnp.sin(1.5 * t) * jnp.array([1.0, 0.0, 0.0])

    bare = small_campaign()
    commanded = replace(bare, slews=tuple(replace(s, wheel_momentum=None) for s in bare.slews))
    (warning,) = check_effect(Pulse(), commanded).warnings
    assert "body_torque jumps" in warning
    assert "begins at 12 s" in warning
    assert check_effect(Steep(), commanded).warnings == ()
