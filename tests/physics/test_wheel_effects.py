"""Effects on wheels, against closed forms."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.effects import REST, J, effect_of, state_of

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import ActiveEffects, Effect
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start, idle_slew


def flown(effect: Effect, p: dict, slew, start: Start) -> tuple:
    return simulate_slew(
        slew,
        start,
        jnp.asarray(J),
        ActiveEffects((effect,), {effect.name: {k: jnp.asarray(v) for k, v in p.items()}}),
    )


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
    """Momentum at the samples against a direct integration of tau y' = u - y; uneven rows and
    padding.
    """
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
