"""What a slew keeps: momentum, energy, and what no frame or sign changes."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.slews import (
    ATTITUDE,
    EXTERNAL,
    RATE,
    SKEWED,
    WHEEL_SETS,
    J,
    run,
    start_with,
    torques,
)

from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.slew_input import Start


def total_momentum_N(trajectory, inertia_B, wheel_axes_B, spin_inertia):
    """J w + G H (n, 3) [N m s] in inertial axes: constant where no external torque acts."""
    locked = inertia_B + inertia_tensor.wheel_spin_tensor(wheel_axes_B, spin_inertia)
    momentum_B = trajectory.rate_B @ locked + trajectory.wheel_momentum @ wheel_axes_B.T
    return quaternion.to_inertial(trajectory.attitude, momentum_B)


@pytest.mark.parametrize("axes", WHEEL_SETS.values(), ids=WHEEL_SETS)
def test_momentum_is_conserved_to_rounding_with_wheels_torqued(slew_of, axes):
    wheels = axes.shape[1]
    time = np.arange(0.0, 400.0, 1.0)
    spin = np.full(wheels, 0.02)
    path = run(slew_of(time, torques(len(time), wheels), axes, spin), start_with(wheels))
    total = np.asarray(total_momentum_N(path, jnp.asarray(J), jnp.asarray(axes), jnp.asarray(spin)))
    assert np.abs(np.asarray(path.rate_B)).max() > 0.2  # it tumbles
    np.testing.assert_allclose(
        total, np.broadcast_to(total[0], total.shape), atol=1e-13 * np.linalg.norm(total[0])
    )
    # Independently of `total_momentum_N`: J w + G H with H = h + Js g.w, turned by scipy.
    H = np.asarray(path.wheel_momentum) + spin * (np.asarray(path.rate_B) @ axes)
    other = Rotation.from_quat(np.asarray(path.attitude)).apply(
        np.asarray(path.rate_B) @ J + H @ axes.T
    )
    np.testing.assert_allclose(other, total, atol=1e-12)


def test_an_external_torque_changes_momentum_by_its_integral(slew_of, test_torque):
    time = np.arange(0.0, 30.0, 0.05)
    values = {"test_torque": {"constant": jnp.array([0.02, -0.03, 0.01]), "damping": jnp.zeros(3)}}
    path = run(
        slew_of(time, torques(len(time), 4), SKEWED, np.full(4, 0.02)),
        start_with(4),
        effects=(test_torque,),
        values=values,
    )
    total = np.asarray(
        total_momentum_N(path, jnp.asarray(J), jnp.asarray(SKEWED), jnp.full(4, 0.02))
    )
    torque_N = Rotation.from_quat(np.asarray(path.attitude)).apply([0.02, -0.03, 0.01])
    gained = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(0.5 * (torque_N[1:] + torque_N[:-1]) * 0.05, axis=0)]
    )  # trapezium: (w dt)^2 / 12
    np.testing.assert_allclose(total - total[0], gained, atol=2e-4 * np.abs(gained).max())
    assert np.abs(gained).max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("axes", WHEEL_SETS.values(), ids=WHEEL_SETS)
def test_energy_is_conserved_without_torque_and_grows_by_the_motors_work(slew_of, axes):
    wheels, dt = axes.shape[1], 0.02
    time = np.arange(0.0, 40.0, dt)
    spin = np.full(wheels, 0.02)

    def energy(path):
        rate, H = (
            np.asarray(path.rate_B),
            np.asarray(path.wheel_momentum) + spin * (np.asarray(path.rate_B) @ axes),
        )
        return 0.5 * np.sum(rate @ J * rate, 1) + 0.5 * np.sum(H**2 / spin, 1)

    free = energy(run(slew_of(time, np.zeros((len(time), wheels)), axes, spin), start_with(wheels)))
    assert np.abs(free / free[0] - 1.0).max() < 1e-10
    # The motor's power is u times the wheel's speed RELATIVE to the body.
    steady = np.broadcast_to(0.02 * np.sin(np.arange(wheels) + 1.0), (len(time), wheels))
    path = run(slew_of(time, steady, axes, spin), start_with(wheels))
    power = np.sum(steady * np.asarray(path.wheel_momentum) / spin, axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * dt)])
    gained = energy(path) - energy(path)[0]
    assert np.abs(gained).max() > 0.1
    np.testing.assert_allclose(gained, work, atol=1e-5 * np.abs(gained).max())


@pytest.mark.slow
def test_locked_wheels_move_with_the_body_as_one_rigid_body_of_inertia_J_locked(slew_of):
    """Motor torques that keep the wheels still relative to the body: the motion is that of J_locked
    without wheels.
    """
    time, spin = np.arange(0.0, 30.0, 0.02), np.full(4, 0.2)
    still = Start(jnp.asarray(RATE), jnp.asarray(ATTITUDE), jnp.zeros(4))
    locked = J + SKEWED @ np.diag(spin) @ SKEWED.T
    rigid = run(
        slew_of(time, np.zeros((len(time), 0)), np.zeros((3, 0)), np.zeros(0)),
        still._replace(wheel_momentum=jnp.zeros(0)),
        locked,
    )
    held = run(slew_of(time, None, SKEWED, spin, np.zeros((len(time), 4))), still, drive="measured")
    np.testing.assert_allclose(held.rate_B, rigid.rate_B, atol=1e-13)
    # Commanded: u = Js g.w' keeps the relative momentum at zero, up to holding it over a step.
    change = np.diff(np.asarray(rigid.rate_B), axis=0, append=np.asarray(rigid.rate_B)[-1:])
    driven = run(slew_of(time, (change @ SKEWED) * spin / 0.02, SKEWED, spin), still)
    np.testing.assert_allclose(
        driven.wheel_momentum, np.zeros_like(driven.wheel_momentum), atol=1e-6
    )
    np.testing.assert_allclose(driven.rate_B, rigid.rate_B, atol=1e-6)
    # ... and confusing the two tensors would have shown.
    confused = run(
        slew_of(time, np.zeros((len(time), 0)), np.zeros((3, 0)), np.zeros(0)),
        still._replace(wheel_momentum=jnp.zeros(0)),
        J,
    )
    assert np.abs(np.asarray(confused.rate_B - rigid.rate_B)).max() > 1e-3


@pytest.mark.slow
def test_the_sign_of_the_quaternion_does_not_matter(slew_of, test_torque):
    time = np.arange(0.0, 20.0, 0.5)
    slew = slew_of(time, torques(len(time), 4), SKEWED, np.full(4, 0.02))
    one, other = (
        run(slew, start_with(4, attitude=sign * ATTITUDE), effects=(test_torque,), values=EXTERNAL)
        for sign in (1.0, -1.0)
    )
    np.testing.assert_array_equal(one.rate_B, other.rate_B)
    np.testing.assert_array_equal(one.attitude, -other.attitude)
    np.testing.assert_array_equal(
        quaternion.error(one.attitude, other.attitude), np.zeros((len(time), 3))
    )


@pytest.mark.parametrize(
    ("drive", "gain"),
    [("commanded", 2.0), ("measured", 2.0), ("commanded", 1.7), ("measured", 0.3)],
)
def test_a_common_gain_of_inertia_and_wheels_changes_no_rate(slew_of, drive, gain):
    """(J, Js, h, u) -> gain (J, Js, h, u): with wheels only, J and a common wheel gain are exactly
    degenerate.
    """
    time, spin = np.arange(0.0, 50.0, 0.5), np.full(4, 0.02)
    torque, momentum, start = (
        torques(len(time), 4),
        0.1 * torques(len(time), 4, 2, 1.0),
        start_with(4),
    )
    plain = run(slew_of(time, torque, SKEWED, spin, momentum), start, drive=drive)
    scaled_start = start._replace(wheel_momentum=gain * start.wheel_momentum)
    scaled = run(
        slew_of(time, gain * torque, SKEWED, gain * spin, gain * momentum),
        scaled_start,
        gain * J,
        drive=drive,
    )
    same = (
        np.testing.assert_array_equal
        if gain == 2.0
        else lambda a, b: np.testing.assert_allclose(a, b, atol=1e-12)
    )  # powers of two: to the last bit
    same(scaled.rate_B, plain.rate_B)
    same(scaled.attitude, plain.attitude)
    # Leaving one of them out is not an invariance.
    half = run(slew_of(time, torque, SKEWED, spin, momentum), start, gain * J, drive=drive)
    assert np.abs(np.asarray(half.rate_B - plain.rate_B)).max() > 1e-2


def test_another_inertial_frame_changes_no_body_quantity(slew_of):
    time = np.arange(0.0, 20.0, 0.5)
    slew = slew_of(time, torques(len(time), 4), SKEWED, np.full(4, 0.02))
    turn = quaternion.exp(jnp.array([0.4, -1.0, 0.3]))
    plain = run(slew, start_with(4))
    turned = run(slew, start_with(4, attitude=quaternion.multiply(turn, jnp.asarray(ATTITUDE))))
    np.testing.assert_allclose(turned.rate_B, plain.rate_B, atol=1e-13)
    np.testing.assert_allclose(
        turned.attitude, quaternion.multiply(turn, plain.attitude), atol=1e-13
    )


@pytest.mark.slow
def test_an_effect_that_does_nothing_changes_nothing(slew_of, test_torque):
    """The path that integrates all states against the one that integrates only the attitude,
    padding included.
    """
    time = np.concatenate([np.cumsum(np.random.default_rng(3).uniform(0.1, 0.5, 40)), np.zeros(8)])
    time[40:] = time[39]
    slew = slew_of(
        time, torques(len(time), 4), SKEWED, np.full(4, 0.02), 0.1 * torques(len(time), 4, 2, 1.0)
    )
    nothing = {"test_torque": {"constant": jnp.zeros(3), "damping": jnp.zeros(3)}}
    for drive in ("commanded", "measured"):
        plain = run(slew, start_with(4), drive=drive)
        full = run(slew, start_with(4), effects=(test_torque,), values=nothing, drive=drive)
        assert plain.inputs is full.inputs is None
        for a, b in zip(plain[:-1], full[:-1], strict=True):
            np.testing.assert_allclose(a, b, atol=1e-13)
    commanded = run(slew, start_with(4))
    still = np.asarray(commanded.rate_B[39:] - commanded.rate_B[39])
    # Time stands still in the padding, to the rounding of the machine's multiply-and-add.
    assert np.abs(still).max() < 8 * np.finfo(float).eps
    assert np.abs(np.asarray(commanded.rate_B[39] - commanded.rate_B[38])).max() > 1e-4


def test_locked_tensor_is_what_total_momentum_uses():
    spin = jnp.full(4, 0.02)
    locked = J + np.asarray(inertia_tensor.wheel_spin_tensor(jnp.asarray(SKEWED), spin))
    np.testing.assert_allclose(locked - J, 0.02 * SKEWED @ SKEWED.T, atol=1e-15)
