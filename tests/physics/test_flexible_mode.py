"""The flexible mode, against an independent integration."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.effects import REST, effect_of

from bayes_inertia.physics.effect import ActiveEffects
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start, idle_slew

DELTA, FREQUENCY, DAMPING = np.array([0.5, 0.0, 0.0]), 0.3, 0.01


@pytest.mark.slow
def test_flexible_mode_keeps_total_momentum_and_rings_like_the_free_body():
    """A push about x, then free ringing: period and decay against the two coupled linear equations
    solved by hand.
    """
    tensor, time = np.diag([3.0, 2.0, 2.0]), np.arange(0.0, 40.0, 0.02)
    torque = np.where(time < 1.0, 2e-3, 0.0)[:, None]
    slew = idle_slew(time, wheel_axes_B=np.eye(3)[:, :1], spin_inertia=np.zeros(1), torque=torque)
    effect = effect_of("flexible_mode")
    p = {
        "coupling": jnp.asarray(DELTA),
        "frequency": jnp.asarray(FREQUENCY),
        "damping": jnp.asarray(DAMPING),
    }
    path, (own,) = simulate_slew(
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


@pytest.mark.slow
def test_flexible_mode_begins_undeformed_on_a_turning_body():
    slew = idle_slew(0.05 * np.arange(101), 0)
    effect = effect_of("flexible_mode")
    start = Start(jnp.array([0.1, 0.0, 0.0]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    p = {
        "coupling": jnp.asarray(DELTA),
        "frequency": jnp.asarray(FREQUENCY),
        "damping": jnp.asarray(DAMPING),
    }
    path, _ = simulate_slew(
        slew,
        start,
        jnp.diag(jnp.array([3.0, 2.0, 2.0])),
        ActiveEffects((effect,), {effect.name: p}),
    )
    np.testing.assert_allclose(path.rate_B, np.tile([0.1, 0.0, 0.0], (101, 1)), atol=1e-14)


@pytest.mark.long
@pytest.mark.slow
def test_flexible_mode_is_integrated_finely_enough(campaign):
    """Twice as many steps change a mode at the prior's upper end by less than a tenth of its
    damping would in the slew.
    """
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
        path, _ = simulate_slew(
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
