"""Effects on rate sensor and star tracker, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.effects import effect_of

from bayes_inertia.campaign.actuators import Magnetorquer
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effects import (
    by_name,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import idle_slew
from bayes_inertia.physics.small_campaign import small_campaign


def path_of(rates, step=0.5, attitude=None) -> tuple:
    """A context and trajectory with given rates (n, 3), the attitude integrated by scipy, without
    commanded torque.
    """
    rates = np.asarray(rates, float)
    n = len(rates)
    slew = idle_slew(step * np.arange(n), 3, np.eye(3), np.full(3, 1e-3))
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)) if attitude is None else attitude
    empty = jnp.zeros((n, 0))
    return slew.context, Trajectory(
        slew.context.time, jnp.asarray(quaternions), jnp.asarray(rates), jnp.zeros((n, 3)), empty
    )


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


@pytest.mark.slow
def test_rate_sensor_delay_follows_the_bend_of_a_free_motion():
    time = 0.05 * np.arange(200)
    context, path = path_of(np.stack([np.sin(4.0 * time)] * 3, -1), step=0.05)

    def largest_error(context, tau):
        effect, p = effect_of("rate_sensor_delay"), {"tau": jnp.asarray(tau)}
        seen = effect.rate_output(p, context, path, path.rate_B)[2:, 0]
        return np.abs(seen - np.sin(4.0 * (time - tau))[2:]).max()

    driven = context._replace(torque=jnp.ones((200, 1)))
    for tau in (0.01, 0.025, 0.12):
        assert largest_error(context, tau) < 0.15 * largest_error(driven, tau)


@pytest.mark.slow
def test_rate_sensor_delay_keeps_the_corners_that_a_told_device_makes():
    time = np.arange(11.0)
    context, path = path_of(np.abs(time - 5.0)[:, None] * np.ones(3), step=1.0)
    p, alone = {"tau": jnp.asarray(0.3)}, effect_of("rate_sensor_delay")
    device = Magnetorquer("torquers")
    inputs = {device.name: InputStream([0.0], [[0.0, 0.0, 0.0]])}
    slews = tuple(replace(x, inputs=inputs) for x in small_campaign().slews)
    told = alone.in_campaign(replace(small_campaign(), slews=slews, actuators=(device,)))
    seen = [e.rate_output(p, context, path, path.rate_B)[1:, 0] for e in (told, alone)]
    expected = np.abs(time[1:] - 0.3 - 5.0)
    np.testing.assert_allclose(seen[0], expected, atol=1e-12)
    assert np.abs(seen[1] - expected).max() > 0.1


@pytest.mark.slow
def test_rate_sensor_delay_is_differentiable_at_zero_and_nothing_there():
    rates = np.abs(np.arange(11.0) - 5.0)[:, None] * np.ones(3)  # a corner at row 5
    context, path = path_of(rates, step=1.0)
    context = context._replace(torque=jnp.ones((11, 1)).at[0].set(0.0))

    def out(tau):
        effect = effect_of("rate_sensor_delay")
        return effect.rate_output({"tau": tau}, context, path, path.rate_B)

    np.testing.assert_array_equal(out(jnp.asarray(0.0)), path.rate_B)
    slope = np.array(jax.jacfwd(out)(jnp.asarray(0.0)))[:, 0]
    # At the corner it is the slope before it: what follows a reading may answer the reading's
    # noise.
    np.testing.assert_allclose(slope, np.where(np.arange(11) <= 5, 1.0, -1.0), atol=1e-12)
    np.testing.assert_allclose(
        slope, out(jnp.asarray(1e-3))[:, 0] / 1e-3 - path.rate_B[:, 0] / 1e-3, atol=1e-9
    )


@pytest.mark.slow
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
    """Relative to its first fix, the tracker sees the slew about a turned axis: 2 sin(angle / 2) |n
    x a|, nothing along n.
    """
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "tau", [0.37, *(pytest.param(tau, marks=pytest.mark.long) for tau in (-0.37, 1.9))]
)
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
