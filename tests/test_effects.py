"""The effect library: every effect keeps the contract, and its physics agrees with a formula that is not the code's own."""

from __future__ import annotations

import importlib.util
import itertools
import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor
from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import EffectError
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.check_effect import check_effect
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    LIBRARY,
    ConstantTorque,
    EachSlew,
    WheelCommandLag,
    by_name,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import Normal, scalar, vector
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.simulator import simulate
from bayes_inertia.physics.slew_context import State, Trajectory
from bayes_inertia.physics.slew_input import Start, idle_slew
from bayes_inertia.physics.small_campaign import small_campaign

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
J = np.array([[3.2, -0.02, 0.01], [-0.02, 2.2, 0.03], [0.01, 0.03, 1.9]])
CANONICAL = [
    "rate_bias",
    "rate_bias_drift",
    "rate_sensor_misalignment",
    "rate_sensor_delay",
    "rate_sensor_nonlinearity",
    "star_tracker_misalignment",
    "star_tracker_shift",
    "star_tracker_time_offset",
    "wheel_torque_gain",
    "wheel_misalignment",
    "wheel_friction",
    "wheel_command_lag",
    "constant_torque",
    "magnetic_dipole",
    "gravity_gradient",
    "viscous_torque",
    "flexible_mode",
    "inertia_change",
]


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return small_campaign()


def effect_of(name: str) -> Effect:
    return by_name([name])[0]


def path_of(rates, step=0.5, attitude=None) -> tuple:
    """A context and trajectory with given rates (n, 3), the attitude integrated by scipy, without commanded torque."""
    rates = np.asarray(rates, float)
    n = len(rates)
    slew = idle_slew(step * np.arange(n), 3, np.eye(3), np.full(3, 1e-3))
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)) if attitude is None else attitude
    empty = jnp.zeros((n, 0))
    return slew.context, Trajectory(
        slew.context.time, jnp.asarray(quaternions), jnp.asarray(rates), jnp.zeros((n, 3)), empty
    )


def state_of(
    rate=(0.0, 0.0, 0.0),
    wheel=(0.0, 0.0, 0.0),
    q=(0.0, 0.0, 0.0, 1.0),
    field=(0.0, 0.0, 0.0),
    position=(7e6, 0.0, 0.0),
) -> State:
    arrays = [jnp.asarray(x, dtype=float) for x in (q, rate, wheel)]
    return State(
        *arrays,
        jnp.zeros(0),
        jnp.asarray(J),
        jnp.asarray(field, dtype=float),
        jnp.asarray(position, dtype=float),
    )


def flown(effect: Effect, p: dict, slew, start: Start) -> tuple:
    return simulate(
        slew,
        start,
        jnp.asarray(J),
        ActiveEffects((effect,), {effect.name: {k: jnp.asarray(v) for k, v in p.items()}}),
    )


REST = Start(jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3))

# --- the library and its contract --------------------------------------------------------------------


def test_the_library_has_the_canonical_names():
    assert [effect.name for effect in LIBRARY] == CANONICAL


def test_unknown_names_are_refused_with_the_nearest_ones():
    with pytest.raises(EffectError, match=r"'wheel_gain'.*wheel_torque_gain"):
        by_name(["wheel_gain"])
    with pytest.raises(EffectError, match="twice"):
        by_name(["rate_bias", "rate_bias"])


@pytest.mark.parametrize("effect", LIBRARY, ids=lambda e: e.name)
def test_every_library_effect_keeps_the_contract(effect, campaign):
    fingerprint = check_effect(effect, campaign).fingerprint
    assert set(fingerprint) == {"commanded", "measured"}
    # What acts on commands, or between wheels and body, cannot show where tachometers drive the model.
    on_commands = effect.name in ("wheel_torque_gain", "wheel_friction", "wheel_command_lag")
    assert (max(fingerprint["measured"].values()) == 0.0) == on_commands


def thrown_body() -> Campaign:
    time = np.linspace(0.0, 0.5, 101)
    rate = np.stack([10.0 * np.cos(3.0 * time), 10.0 * np.sin(3.0 * time), np.full(101, 2.0)], -1)
    prior = InertiaPrior(1e-3 * np.diag([1.3, 1.1, 0.9]), 0.3, 1e-4)
    slews = tuple(Slew(f"throw {i}", 60.0 * i, time, rate=rate) for i in range(2))
    return Campaign("thrown", prior, (), RateSensor(sigma=0.01, bias_sigma=0.01), None, slews)


@pytest.mark.parametrize("effect", LIBRARY, ids=lambda e: e.name)
def test_default_priors_scale_with_the_body(effect, campaign):
    """What a prior sd does to a satellite in a minute and to a gram-scale body in half a second is alike in the body's own scales."""
    rate, duration, mass = campaign.scale_of_motion()
    rate_t, duration_t, mass_t = thrown_body().scale_of_motion()
    factors = {
        "N m": mass * rate / duration / (mass_t * rate_t / duration_t),
        "N m s": mass / duration / (mass_t / duration_t),
        "kg m^2": mass / mass_t,
        "kg^0.5 m": (mass / mass_t) ** 0.5,
        "s": duration / duration_t,
    }
    small = {p.name: p for p in effect.parameters(thrown_body())}
    for parameter in effect.parameters(campaign):
        assert all(np.isfinite(prior.sd) and prior.sd > 0.0 for prior in parameter.priors)
        if parameter.unit in factors and parameter.name in small:
            assert parameter.priors[0].sd == pytest.approx(
                small[parameter.name].priors[0].sd * factors[parameter.unit]
            )


def test_effects_on_wheels_do_nothing_where_there_are_none():
    for effect in LIBRARY:
        if effect.name.startswith("wheel") and effect.name != "wheel_command_lag":
            assert effect.parameters(thrown_body()) == ()


# --- effects that break the contract -------------------------------------------------------------------


@dataclass(frozen=True)
class Torque(Effect):
    """A good effect that the broken ones spoil in one way each."""

    name = "torque"

    def parameters(self, campaign):
        return (vector("torque", "xyz", unit="N m", prior=Normal(0.0, 1e-5)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"]


@dataclass(frozen=True)
class NotANoOp(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] + 1e-9


@dataclass(frozen=True)
class Impure(Torque):
    calls = itertools.count()

    def body_torque(self, p, slew, t, state):
        return p["torque"] * (1.0 + 1e-3 * next(self.calls))


@dataclass(frozen=True)
class NotFinite(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.sqrt(p["torque"][0])


@dataclass(frozen=True)
class DerivativeNotFinite(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.linalg.norm(p["torque"])


@dataclass(frozen=True)
class DoubledName(Torque):
    def parameters(self, campaign):
        return (
            *super().parameters(campaign),
            scalar("torque_x", unit="N m", prior=Normal(0.0, 1.0)),
        )


@dataclass(frozen=True)
class Degrees(Torque):
    def parameters(self, campaign):
        return (vector("torque", "xyz", unit="deg/s", prior=Normal(0.0, 1e-5)),)


@dataclass(frozen=True)
class NoUnit(Torque):
    def parameters(self, campaign):
        return (vector("torque", "xyz", unit=None, prior=Normal(0.0, 1e-5)),)


@dataclass(frozen=True)
class NoFingerprint(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.array([1.0, 1.0, 0.0])


@dataclass(frozen=True)
class WrongDerivative(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * (1.0 + 1e5 * jax.lax.stop_gradient(p["torque"][0]))


@dataclass(frozen=True)
class BranchOnValue(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] if p["torque"][0] > 0.0 else 0.0 * p["torque"]


@dataclass(frozen=True)
class Unhashable(Torque):
    direction: object = None


class NotADataclass(Torque):
    pass


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (NotANoOp(), "at its null values it changes"),
        (Impure(), "pure"),
        (NotFinite(), "telemetry is not finite"),
        (DerivativeNotFinite(), "a derivative is not finite at its null"),
        (DoubledName(), "'torque_x'.*used twice"),
        (Degrees(), "not in SI units"),
        (NoUnit(), "no unit"),
        (NoFingerprint(), "torque_z changes nothing"),
        (WrongDerivative(), "finite difference"),
        (BranchOnValue(), "TracerBoolConversionError"),
        (Unhashable(direction=[1.0]), "cannot be hashed"),
        (NotADataclass(), "not a frozen dataclass"),
        (Torque, "not an instance"),
    ],
    ids=lambda x: getattr(x, "__name__", type(x).__name__) if not isinstance(x, str) else "",
)
def test_broken_effects_are_rejected(effect, words, campaign):
    with pytest.raises(EffectError, match=words):
        check_effect(effect, campaign)


def test_the_good_effect_that_the_broken_ones_derive_from_passes(campaign):
    assert min(check_effect(Torque(), campaign).fingerprint["commanded"].values()) > 1.0


# --- sensors -----------------------------------------------------------------------------------------


def test_rate_bias_and_drift_add_a_constant_and_a_line_through_the_campaign_s_middle():
    context, path = path_of(np.full((5, 3), 0.01))
    bias = effect_of("rate_bias").rate_output(
        {"bias": jnp.array([1e-5, 0.0, -2e-5])}, context, path, path.rate_B
    )
    np.testing.assert_allclose(bias - path.rate_B, np.tile([1e-5, 0.0, -2e-5], (5, 1)), atol=1e-17)
    later = context._replace(start=jnp.asarray(100.0), middle=jnp.asarray(40.0))
    drift = effect_of("rate_bias_drift").rate_output(
        {"drift": jnp.array([1e-6, 0.0, 0.0])}, later, path, path.rate_B
    )
    np.testing.assert_allclose(
        (drift - path.rate_B)[:, 0], 1e-6 * (60.0 + 0.5 * np.arange(5)), rtol=1e-9
    )


def test_the_campaign_s_middle_is_where_the_drift_is_zero(campaign):
    context = Model(campaign, by_name(["rate_bias_drift"])).data.arrays.slews.context
    assert campaign.span == (0.0, 663.0)
    np.testing.assert_allclose(context.middle, 331.5)
    np.testing.assert_array_equal(context.slews, 3)


def test_rate_sensor_misalignment_turns_the_rows_of_c_rate():
    angle, axes = (
        np.array([0.02, -0.01, 0.03]),
        np.array([[0.8, 0.6, 0.0], [0.0, 1.0, 0.0], [0.0, 0.6, 0.8]]),
    )
    context, path = path_of([[0.01, 0.02, -0.03], [0.0, 0.1, 0.0]])
    context = context._replace(rate_axes=jnp.asarray(axes))
    rows = Rotation.from_rotvec(angle).apply(axes)
    nominal = path.rate_B @ axes.T + 1e-4  # and a bias, which does not turn
    seen = effect_of("rate_sensor_misalignment").rate_output(
        {"angle": jnp.asarray(angle)}, context, path, nominal
    )
    np.testing.assert_allclose(seen, path.rate_B @ rows.T + 1e-4, atol=1e-15)


@pytest.mark.parametrize("tau", [0.02, 0.3, 2.3])
def test_rate_sensor_delay_shifts_a_sine(tau):
    time = 0.05 * np.arange(400)
    context, path = path_of(np.stack([np.sin(time), np.cos(time), 0.5 * time], -1), step=0.05)
    seen = effect_of("rate_sensor_delay").rate_output(
        {"tau": jnp.asarray(tau)}, context, path, path.rate_B
    )
    inside = (time - tau > 0.0) & (time - tau < time[-1])
    expected = np.stack([np.sin(time - tau), np.cos(time - tau), 0.5 * (time - tau)], -1)
    # Linear interpolation is off by at most step^2 / 8.
    np.testing.assert_allclose(seen[inside], expected[inside], atol=0.05**2 / 8 * 1.1)


def test_rate_sensor_delay_is_differentiable_at_zero_and_nothing_there():
    rates = np.abs(np.arange(11.0) - 5.0)[:, None] * np.ones(3)  # a corner at row 5
    context, path = path_of(rates, step=1.0)

    def out(tau):
        effect = effect_of("rate_sensor_delay")
        return effect.rate_output({"tau": tau}, context, path, path.rate_B)

    np.testing.assert_array_equal(out(jnp.asarray(0.0)), path.rate_B)
    slope = np.array(jax.jacfwd(out)(jnp.asarray(0.0)))[:, 0]
    # At the corner it is the slope before it: what follows a reading may answer the reading's noise.
    np.testing.assert_allclose(slope, np.where(np.arange(11) <= 5, 1.0, -1.0), atol=1e-12)
    np.testing.assert_allclose(
        slope, out(jnp.asarray(1e-3))[:, 0] / 1e-3 - path.rate_B[:, 0] / 1e-3, atol=1e-9
    )


def test_rate_sensor_delay_holds_a_commanded_start_and_ignores_padding():
    context, path = path_of(np.arange(6.0)[:, None] * np.ones(3), step=1.0)
    padded = context._replace(
        time=jnp.array([0.0, 1.0, 2.0, 3.0, 3.0, 3.0]),
        step=jnp.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
    )
    pushed = padded._replace(torque=padded.torque.at[0, 0].set(1e-3))
    for slew, first in ((padded, -0.5), (pushed, 0.0)):
        seen = effect_of("rate_sensor_delay").rate_output(
            {"tau": jnp.asarray(0.5)}, slew, path, path.rate_B
        )
        np.testing.assert_allclose(seen[:4, 0], [first, 0.5, 1.5, 2.5], atol=0.02)


def test_rate_sensor_nonlinearity_is_a_polynomial():
    context, path = path_of([[0.1, -0.2, 0.3]] * 2)
    p = {"quadratic": jnp.array([0.1, 0.2, 0.0]), "cubic": jnp.array([0.0, 1.0, 2.0])}
    seen = effect_of("rate_sensor_nonlinearity").rate_output(p, context, path, path.rate_B)
    np.testing.assert_allclose(
        seen[0], [0.1 + 0.1 * 0.01, -0.2 + 0.2 * 0.04 - 0.008, 0.3 + 2.0 * 0.027], rtol=1e-12
    )


def test_star_tracker_misalignment_shows_across_the_slew_s_axis():
    """Relative to its first fix, the tracker sees the slew about a turned axis: 2 sin(angle / 2) |n x a|, nothing along n."""
    angle, axis = 0.8, np.array([0.0, 0.0, 1.0])
    context, path = path_of(
        np.zeros((2, 3)),
        attitude=np.array([[0.0, 0.0, 0.0, 1.0], [*(axis * np.sin(angle / 2)), np.cos(angle / 2)]]),
    )
    for tilt, size in (
        (np.array([1e-4, 0.0, 0.0]), 2e-4 * np.sin(angle / 2)),
        (np.array([0.0, 0.0, 1e-4]), 0.0),
    ):
        seen = effect_of("star_tracker_misalignment").attitude_output(
            {"angle": jnp.asarray(tilt)}, context, path, path.attitude
        )
        turned = Rotation.from_quat(seen[0]).inv() * Rotation.from_quat(seen[1])
        change = (Rotation.from_rotvec(angle * axis).inv() * turned).as_rotvec()
        assert np.linalg.norm(change) == pytest.approx(size, abs=1e-11)


def test_star_tracker_shift_turns_the_fixes_after_the_slew_only():
    context, path = path_of(
        np.zeros((6, 3)), attitude=np.tile(Rotation.from_rotvec([0.3, 0.1, -0.2]).as_quat(), (6, 1))
    )
    shift = np.array([1e-4, -2e-4, 3e-4])
    seen = effect_of("star_tracker_shift").attitude_output(
        {"shift": jnp.asarray(shift)}, context, path, path.attitude
    )
    errors = np.array(quaternion.error(path.attitude, seen))
    np.testing.assert_allclose(errors[:3], 0.0, atol=1e-15)
    np.testing.assert_allclose(errors[3:], np.tile(shift, (3, 1)), atol=1e-15)


@pytest.mark.parametrize("tau", [0.37, -0.37, 1.9])
def test_star_tracker_time_offset_shows_the_attitude_of_another_moment(tau):
    time, axis = 0.5 * np.arange(20), np.array([0.6, 0.0, 0.8])

    def angle(t):
        return 0.01 * t**2

    attitude = Rotation.from_rotvec(angle(time)[:, None] * axis).as_quat()
    context, path = path_of(0.02 * time[:, None] * axis, attitude=attitude)
    seen = effect_of("star_tracker_time_offset").attitude_output(
        {"tau": jnp.asarray(tau)}, context, path, path.attitude
    )
    inside = (time >= tau) & (time - tau <= time[-1])
    expected = Rotation.from_rotvec(angle(time[inside] - tau)[:, None] * axis).as_quat()
    np.testing.assert_allclose(
        quaternion.error(jnp.asarray(expected), seen[inside]), 0.0, atol=1e-12
    )


# --- wheels ------------------------------------------------------------------------------------------


def test_wheel_torque_gain_scales_the_momentum_change():
    torque = np.tile([2e-3, -1e-3, 5e-4], (41, 1))
    slew = idle_slew(
        0.5 * np.arange(41), wheel_axes_B=np.eye(3), spin_inertia=np.full(3, 1e-3), torque=torque
    )
    path, _ = flown(effect_of("wheel_torque_gain"), {"gain": [1.1, 0.9, 1.0]}, slew, REST)
    absolute = path.wheel_momentum[-1] + 1e-3 * path.rate_B[-1]  # H' = u
    np.testing.assert_allclose(absolute, np.array([1.1, 0.9, 1.0]) * torque[0] * 20.0, rtol=1e-12)


@pytest.mark.parametrize("tau", [0.12, 0.9, 1e-6])
def test_wheel_command_lag_is_the_exponential_response(tau):
    """Momentum at the samples against a direct integration of tau y' = u - y; uneven rows and padding."""
    time = np.array([0.0, 0.25, 0.5, 0.8, 1.0, 1.7, 2.0])
    commands = np.array([0.0, 3e-3, 3e-3, -2e-3, 0.0, 1e-3, 0.0])
    slew = idle_slew(
        np.append(time, 2.0),
        wheel_axes_B=np.eye(3)[:, :1],
        torque=np.append(commands, 0.0)[:, None],
    ).context
    mean = effect_of("wheel_command_lag").delivered_torque(
        {"tau": jnp.asarray(tau)}, slew, slew.torque
    )[:, 0]
    y, total, momentum = commands[0], 0.0, []
    for u, h in zip(commands[:-1], np.diff(time), strict=True):
        momentum.append(total := total + u * h + (y - u) * tau * (1.0 - np.exp(-h / tau)))
        y = u + (y - u) * np.exp(-h / tau)
    np.testing.assert_allclose(np.cumsum(mean * slew.step)[:-2], momentum, atol=1e-15)
    assert np.isfinite(mean).all()


def test_wheel_command_lag_has_its_limit_and_derivative_at_zero():
    torque = jnp.array([[0.0], [3e-3], [3e-3], [-2e-3], [0.0]])
    slew = idle_slew(0.25 * np.arange(5), wheel_axes_B=np.eye(3)[:, :1], torque=torque).context

    def out(tau):
        effect = effect_of("wheel_command_lag")
        return effect.delivered_torque({"tau": tau}, slew, torque)[:4, 0]

    np.testing.assert_array_equal(out(jnp.asarray(0.0)), torque[:4, 0])
    slope = jax.jacfwd(out)(jnp.asarray(0.0))
    np.testing.assert_allclose(slope, np.array([0.0, -3e-3, 0.0, 5e-3]) / 0.25, atol=1e-15)
    np.testing.assert_allclose(
        slope, (out(jnp.asarray(1e-5)) - out(jnp.asarray(0.0))) / 1e-5, atol=1e-10
    )


def test_wheel_misalignment_tilts_to_unit_axes_by_the_angles_given():
    axes = np.array([[1.0, 0.0, 0.6], [0.0, 1.0, 0.64], [0.0, 0.0, 0.48]])
    slew = idle_slew([0.0, 1.0], wheel_axes_B=axes, spin_inertia=np.full(3, 1e-3)).context
    p = {"tilt_1": jnp.array([3e-3, 0.0, -2e-3]), "tilt_2": jnp.array([4e-3, 1e-3, 0.0])}
    tilted = np.array(effect_of("wheel_misalignment").wheel_axes(p, slew, jnp.asarray(axes)))
    np.testing.assert_allclose(np.linalg.norm(tilted, axis=0), 1.0, atol=1e-15)
    angles = np.linalg.norm(np.cross(axes, tilted, axis=0), axis=0)
    np.testing.assert_allclose(np.arcsin(angles), np.arctan([5e-3, 1e-3, 2e-3]), rtol=1e-9)
    # The two directions are perpendicular: derivatives of the axes.
    one = jax.jacfwd(
        lambda a, b: effect_of("wheel_misalignment").wheel_axes(
            {"tilt_1": a, "tilt_2": b}, slew, jnp.asarray(axes)
        ),
        argnums=(0, 1),
    )
    first, second = (np.einsum("iww->iw", d) for d in one(jnp.zeros(3), jnp.zeros(3)))
    np.testing.assert_allclose(np.sum(first * second, axis=0), 0.0, atol=1e-15)


def test_wheel_friction_slows_the_wheel_and_keeps_total_momentum():
    slew = idle_slew(0.5 * np.arange(81), wheel_axes_B=np.eye(3), spin_inertia=np.full(3, 1e-3))
    effect = effect_of("wheel_friction")
    start = REST._replace(wheel_momentum=jnp.array([0.05, -0.05, 0.05]))
    path, _ = flown(
        effect, {"coulomb": [1e-5, 1e-5, 0.0], "viscous": [0.0, 0.0, 2e-6]}, slew, start
    )
    absolute = np.array(path.wheel_momentum[-1] + 1e-3 * path.rate_B[-1])
    np.testing.assert_allclose(absolute[:2], [0.05 - 40e-5, -0.05 + 40e-5], atol=1e-12)
    assert absolute[2] == pytest.approx(
        0.05 * np.exp(-2e-6 / 1e-3 * 40.0), rel=2e-5
    )  # but for the body's own small rate
    total = quaternion.to_inertial(
        path.attitude, path.rate_B @ (J + 1e-3 * np.eye(3)) + path.wheel_momentum
    )
    np.testing.assert_allclose(total - total[0], 0.0, atol=1e-14)
    crossing = effect.wheel_torque(
        {"coulomb": jnp.ones(3), "viscous": jnp.zeros(3)},
        slew.context,
        0.0,
        state_of(wheel=(0.0, 1e-2, -1e-2)),
    )
    np.testing.assert_allclose(crossing, [0.0, -1.0, 1.0], atol=1e-8)


# --- torques on the body -------------------------------------------------------------------------------


def test_constant_torque_spins_up_an_axis():
    slew = idle_slew(np.arange(21.0), 3, np.eye(3), np.zeros(3))
    effect = effect_of("constant_torque")
    path, _ = simulate(
        slew,
        REST,
        jnp.diag(jnp.array([3.0, 2.0, 1.0])),
        ActiveEffects((effect,), {effect.name: {"torque": jnp.array([0.0, 0.0, 1e-5])}}),
    )
    np.testing.assert_allclose(path.rate_B[:, 2], 1e-5 * np.arange(21.0), rtol=1e-10, atol=1e-20)


def test_magnetic_dipole_is_the_cross_product_in_body_axes():
    q, field_N, dipole = (
        Rotation.from_rotvec([0.4, -1.0, 0.7]),
        np.array([2e-5, -1e-5, 3e-5]),
        np.array([0.05, -0.02, 0.1]),
    )
    torque = effect_of("magnetic_dipole").body_torque(
        {"dipole": jnp.asarray(dipole)}, None, 0.0, state_of(q=q.as_quat(), field=field_N)
    )
    np.testing.assert_allclose(torque, np.cross(dipole, q.inv().apply(field_N)), atol=1e-20)


def test_gravity_gradient_is_the_differential_gravity_of_point_masses():
    """Against Newton's law on six point masses that have the tensor J: exact up to (body / orbit)^2 of the torque."""
    mu, position_N = 3.986004418e14, np.array([4e6, -5e6, 2.5e6])
    q = Rotation.from_rotvec([0.4, -1.0, 0.7])
    moments, axes = np.linalg.eigh(np.array(inertia_tensor.second_moments(jnp.asarray(J))))
    arms = (
        np.concatenate([axes.T * np.sqrt(moments)[:, None], -axes.T * np.sqrt(moments)[:, None]])
        * 1e3
    )  # masses of 0.5e-6 kg, km apart
    r = q.inv().apply(position_N) + arms
    force = -mu * 0.5e-6 * r / np.linalg.norm(r, axis=1)[:, None] ** 3
    torque = effect_of("gravity_gradient").body_torque(
        {"factor": jnp.asarray(1.0)}, None, 0.0, state_of(q=q.as_quat(), position=position_N)
    )
    np.testing.assert_allclose(torque, np.cross(arms, force).sum(0), rtol=1e-5, atol=1e-11)


def test_viscous_torque_decays_the_rate_exponentially():
    slew = idle_slew(np.arange(41.0), 0)
    effect = effect_of("viscous_torque")
    start = Start(jnp.array([0.0, 0.0, 0.1]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    path, _ = simulate(
        slew,
        start,
        jnp.diag(jnp.array([3.0, 2.0, 1.0])),
        ActiveEffects((effect,), {effect.name: {"drag": jnp.array([0.0, 0.0, 0.02])}}),
    )
    np.testing.assert_allclose(path.rate_B[:, 2], 0.1 * np.exp(-0.02 * np.arange(41.0)), rtol=1e-8)


def test_inertia_change_begins_with_its_slew():
    effect = type(effect_of("inertia_change"))(from_slew=2)
    context = idle_slew([0.0, 1.0]).context
    change = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    for chosen, index, slews, active in (
        (effect, 1, 5, False),
        (effect, 2, 5, True),
        (LIBRARY[-1], 2, 5, False),
        (LIBRARY[-1], 3, 5, True),
    ):
        at = context._replace(index=jnp.asarray(index), slews=jnp.asarray(slews))
        changed = chosen.inertia({"change": jnp.asarray(change)}, at, jnp.asarray(J))
        np.testing.assert_allclose(
            inertia_tensor.elements(changed - J), change * active, atol=1e-15
        )


# --- the flexible mode -----------------------------------------------------------------------------------

DELTA, FREQUENCY, DAMPING = np.array([0.5, 0.0, 0.0]), 0.3, 0.01


def test_flexible_mode_keeps_total_momentum_and_rings_like_the_free_body():
    """A push about x, then free ringing: period and decay against the two coupled linear equations solved by hand."""
    tensor, time = np.diag([3.0, 2.0, 2.0]), np.arange(0.0, 40.0, 0.02)
    torque = np.where(time < 1.0, 2e-3, 0.0)[:, None]
    slew = idle_slew(time, wheel_axes_B=np.eye(3)[:, :1], spin_inertia=np.zeros(1), torque=torque)
    effect = effect_of("flexible_mode")
    p = {
        "coupling": jnp.asarray(DELTA),
        "frequency": jnp.asarray(FREQUENCY),
        "damping": jnp.asarray(DAMPING),
    }
    path, (own,) = simulate(
        slew,
        REST._replace(wheel_momentum=jnp.zeros(1)),
        jnp.asarray(tensor),
        ActiveEffects((effect,), {effect.name: p}),
    )
    eta_rate = own[:, 1] - path.rate_B @ DELTA
    total = path.rate_B[:, 0] * 3.0 + path.wheel_momentum[:, 0] + DELTA[0] * eta_rate
    np.testing.assert_allclose(total, 0.0, atol=1e-16)
    W, shrink = 2.0 * np.pi * FREQUENCY, 1.0 - DELTA[0] ** 2 / 3.0

    def motion(t, x):  # w, eta, eta' with w' = (-u - delta eta'') / J eliminated
        push = -(2e-3 if t < 1.0 else 0.0) / 3.0
        acceleration = (-2.0 * DAMPING * W * x[2] - W**2 * x[1] - DELTA[0] * push) / shrink
        return [push - DELTA[0] * acceleration / 3.0, x[2], acceleration]

    solved = solve_ivp(
        motion, (0.0, time[-1]), np.zeros(3), t_eval=time, rtol=1e-10, atol=1e-14, max_step=0.02
    )
    np.testing.assert_allclose(path.rate_B[:, 0], solved.y[0], atol=2e-9)
    free = np.array(own[:, 0])[time > 1.0]
    crossings = time[time > 1.0][1:][np.diff(np.sign(free)) > 0]
    ringing = (len(crossings) - 1) / (crossings[-1] - crossings[0])
    assert ringing == pytest.approx(FREQUENCY / np.sqrt(shrink), rel=2e-3)


def test_flexible_mode_begins_undeformed_on_a_turning_body():
    slew = idle_slew(0.05 * np.arange(101), 0)
    effect = effect_of("flexible_mode")
    start = Start(jnp.array([0.1, 0.0, 0.0]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    p = {
        "coupling": jnp.asarray(DELTA),
        "frequency": jnp.asarray(FREQUENCY),
        "damping": jnp.asarray(DAMPING),
    }
    path, _ = simulate(
        slew,
        start,
        jnp.diag(jnp.array([3.0, 2.0, 2.0])),
        ActiveEffects((effect,), {effect.name: p}),
    )
    np.testing.assert_allclose(path.rate_B, np.tile([0.1, 0.0, 0.0], (101, 1)), atol=1e-14)


def test_flexible_mode_is_integrated_finely_enough(campaign):
    """Twice as many steps change a mode at the prior's upper end by less than a tenth of its damping would in the slew."""
    effect = effect_of("flexible_mode")
    step, highest = (
        effect.max_step(campaign),
        effect.parameters(campaign)[1].priors[0].distribution.ppf(0.977),
    )
    p = {
        "coupling": jnp.asarray(DELTA),
        "frequency": jnp.asarray(highest),
        "damping": jnp.asarray(DAMPING),
    }
    ends = []
    for split in (1, 2, 8):
        time = np.arange(0.0, 20.0 + 1e-9, step / split)
        slew = idle_slew(
            time,
            wheel_axes_B=np.eye(3)[:, :1],
            spin_inertia=np.zeros(1),
            torque=np.where(time < 2.0 - 1e-9, 2e-3, 0.0)[:, None],
        )
        path, _ = simulate(
            slew,
            REST._replace(wheel_momentum=jnp.zeros(1)),
            jnp.asarray(np.diag([3.0, 2.0, 2.0])),
            ActiveEffects((effect,), {effect.name: p}),
        )
        ends.append(np.array(path.rate_B[:: 1 * split, 0]))
    n = min(map(len, ends))
    errors = [np.abs(e[:n] - ends[2][:n]).max() for e in ends[:2]]
    assert (
        errors[0] / errors[1] > 4.0
    )  # converges (the push ends on no grid point of the coarse grid)
    assert errors[0] < 2e-5


# --- independent simulator's telemetry -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folder", "name"), [("hidden_lag", "wheel_command_lag"), ("hidden_dipole", "magnetic_dipole")]
)
def test_hidden_effects_of_another_simulator_are_found_at_their_true_size(folder, name):
    path = SHARED / "basilisk" / folder
    if not path.exists():
        pytest.skip(f"{folder}: the independent simulator's telemetry is not at hand")
    truth = json.loads((path / "truth.json").read_text())
    (hidden,) = truth["effects"].values()
    amplitude = hidden["amp"] * np.array(hidden.get("dir", [1.0]))
    expected = np.concatenate(
        [np.array(inertia_tensor.elements(np.array(truth["J_kgm2"]))), truth["K"], amplitude]
    )
    fitted = estimate(Model(read_campaign(path), by_name([name])), starts=1)
    assert np.abs((fitted.theta - expected) / fitted.sd).max() < 3.5
    assert (
        np.abs(amplitude).max() > 10.0 * fitted.sd[9:].max()
    )  # the effect is seen, not merely allowed
    assert not fitted.discounted
    for channel, test in fitted.tests.items():
        low, high = test.interval
        assert low < test.reduced_chi2 < high, channel


def test_an_outsider_s_effect_needs_one_file(capsys):
    path = Path(__file__).resolve().parents[1] / "analyses" / "outside_effect.py"
    spec = importlib.util.spec_from_file_location("outside_effect", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["outside_effect"] = module
    spec.loader.exec_module(module)
    fitted, truth = module.main()
    assert re.search("the contract holds", capsys.readouterr().out)
    assert np.abs((fitted.theta - truth) / fitted.sd).max() < 3.5
    assert (fitted.sd[9:] < 0.5 * fitted.model.space.sd[9:]).all()


@pytest.mark.parametrize("inner", [ConstantTorque(), WheelCommandLag()], ids=lambda e: e.name)
def test_an_effect_of_its_own_in_each_slew_is_the_effect_where_all_slews_agree(campaign, inner):
    apart = EachSlew.of(inner, campaign)
    check_effect(apart, campaign)
    one, many = Model(campaign, (inner,)), Model(campaign, (apart,))
    value = 0.5 * one.space.sd[9:]
    same = predict_all(one.structure, jnp.asarray([*one.space.mean[:9], *value]), *nothing(one))
    each = np.tile(value, len(campaign.slews))
    repeated = predict_all(
        many.structure, jnp.asarray([*one.space.mean[:9], *each]), *nothing(many)
    )
    np.testing.assert_allclose(repeated.rate, same.rate, rtol=0, atol=1e-14)
    each[: len(value)] = 0.0
    first_without = predict_all(
        many.structure, jnp.asarray([*one.space.mean[:9], *each]), *nothing(many)
    )
    assert np.abs(first_without.rate[0] - same.rate[0]).max() > 1e-9
    np.testing.assert_allclose(first_without.rate[1:], same.rate[1:], rtol=0, atol=1e-14)


def test_of_a_slew_to_come_an_effect_of_each_slew_claims_nothing(campaign):
    """It did as in the last slew, silently; and a change that stays was not there afterwards."""
    apart = EachSlew.of(ConstantTorque(), campaign)
    p = {"torque": jnp.arange(1.0, 1.0 + 3 * len(campaign.slews))}
    context = idle_slew([0.0, 1.0]).context
    last, next_one = (context._replace(index=jnp.asarray(len(campaign.slews) - k)) for k in (1, 0))
    np.testing.assert_array_equal(apart.body_torque(p, last, 0.0, None), p["torque"][-3:])
    np.testing.assert_array_equal(apart.body_torque(p, next_one, 0.0, None), np.zeros(3))
    assert apart.afterwards() == ConstantTorque()
    change = by_name(["inertia_change"])[0]
    assert EachSlew.of(change, campaign).afterwards() == change.afterwards() != change


def nothing(model: Model) -> tuple:
    return jnp.zeros((model.n_slews, model.structure.n_local)), jnp.zeros(3), model.data
