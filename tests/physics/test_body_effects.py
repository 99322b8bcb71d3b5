"""Torques on the body and changes of its inertia, against closed forms."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.effects import REST, J, effect_of, state_of

from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.effect import ActiveEffects
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start, idle_slew


def test_constant_torque_spins_up_an_axis():
    slew = idle_slew(np.arange(21.0), 3, np.eye(3), np.zeros(3))
    effect = effect_of("constant_torque")
    path, _ = simulate_slew(
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
    """Against Newton's law on six point masses that have the tensor J: exact up to (body / orbit)^2
    of the torque.
    """
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


@pytest.mark.slow
def test_viscous_torque_decays_the_rate_exponentially():
    slew = idle_slew(np.arange(41.0), 0)
    effect = effect_of("viscous_torque")
    start = Start(jnp.array([0.0, 0.0, 0.1]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    path, _ = simulate_slew(
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
    in_library = effect_of("inertia_change")
    for chosen, index, slews, active in (
        (effect, 1, 5, False),
        (effect, 2, 5, True),
        (in_library, 2, 5, False),
        (in_library, 3, 5, True),
    ):
        at = context._replace(index=jnp.asarray(index), slews=jnp.asarray(slews))
        changed = chosen.inertia({"change": jnp.asarray(change)}, at, jnp.asarray(J))
        np.testing.assert_allclose(
            inertia_tensor.elements(changed - J), change * active, atol=1e-15
        )
