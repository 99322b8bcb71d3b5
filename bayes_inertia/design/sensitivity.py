"""How the telemetry of a slew that is flown as planned would change with each unknown, to first order.

The planned motion is known (`motion`), so that only the linear equations of a small deviation are integrated. With the
deviation psi of the attitude as a rotation vector in inertial axes, m the total momentum in body axes, and C, J, G, H as in
`dynamics`,

    psi' = C^T J^-1 ([m]x C psi + s),   s = C dM_N - G dH - dG H - dJ w,   dw = J^-1 ([m]x C psi + s),

where dJ, dG, dM_N, dH are what an unknown does to inertia, wheel axes, total momentum and wheel momentum. All of that is
asked of the effects' own hooks by differentiating them along the planned motion; how a deviation of the state would change
an effect is left out (it vanishes at the effect's null). The same sensitivities out of the simulator take a minute to
compile once they are to be differentiated again; these take seconds, and agree (`tests/test_design.py`).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.errors import EffectError
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.effect import SlewContext, State, Trajectory
from bayes_inertia.physics.forward_model import NuisanceScale, Sensors, Structure

N_BIAS = 3


class Planned(NamedTuple):
    """The planned motion of one slew and its environment: `path` (its `own` is empty), `magnetic_field_N` (n, 3), `position_N` (n, 3)."""

    path: Trajectory
    magnetic_field_N: Array
    position_N: Array


class Response(NamedTuple):
    """Derivatives of the telemetry with respect to (theta, whitened bias, whitened start state), p in all: `rate` (n, 3, p) as read,
    `attitude` (n, 3, p) as a rotation vector in body axes, `momentum` (n, wheels, p)."""

    rate: Array
    attitude: Array
    momentum: Array


class _Parts(NamedTuple):
    """What the parameters decide along the planned motion."""

    inertia_B: Array
    axes_B: Array
    delivered: Array
    wheel_torque: Array
    body_torque: Array
    rate_S: Array
    attitude: Array
    momentum: Array
    scale_factor: Array


def response(
    structure: Structure,
    theta: Array,
    context: SlewContext,
    planned: Planned,
    sensors: Sensors,
    scale: NuisanceScale,
) -> Response:
    """First-order response of one slew's telemetry at theta (d,); the slew begins at rest.

    Raises `EffectError` for an effect with states of its own (a flexible mode, slosh).
    """
    for effect in structure.effects:
        if effect.acts("state_rate"):
            raise EffectError(
                "has states of its own, which plans are not designed for",
                where=effect.name,
                advice="leave it out of the design",
            )
    parts = partial(_parts, structure, context=context, planned=planned, sensors=sensors)
    at, by_theta = parts(theta), jax.jacfwd(parts)(theta)
    d, p = len(theta), len(theta) + N_BIAS + structure.n_local
    moved = jax.tree.map(
        lambda x: jnp.concatenate([x, jnp.zeros((*x.shape[:-1], p - d))], -1), by_theta
    )
    path, spin, G = planned.path, context.spin_inertia, at.axes_B
    total, d_total, d_wheel = _start(at, moved, path, context, scale, d)
    wheel = path.wheel_momentum + spin * (path.rate_B @ G)
    step = jnp.diff(path.time)[:, None, None]
    d_wheel = (
        d_wheel + _grown(step, moved.delivered[:-1]) + _grown(step, _middle(moved.wheel_torque))
    )
    d_total = d_total + _grown(step, _middle(_to_inertial(path.attitude, moved.body_torque)))
    momentum_B = quaternion.to_body(path.attitude, jnp.broadcast_to(total, path.rate_B.shape))
    source = _to_body(path.attitude, d_total) - jnp.einsum("iw,nwp->nip", G, d_wheel)
    source = (
        source
        - jnp.einsum("iwp,nw->nip", moved.axes_B, wheel)
        - jnp.einsum("ijp,nj->nip", moved.inertia_B, path.rate_B)
    )
    inverse = _inverse(at.inertia_B)
    turned, d_rate = _integrated(path, momentum_B, inverse, source, d + N_BIAS, scale)
    rate_S = jnp.einsum("ij,njp->nip", sensors.axes, d_rate) + moved.rate_S
    rate_S = rate_S + jnp.zeros((3, p)).at[jnp.arange(3), d + jnp.arange(N_BIAS)].set(scale.bias)
    read = (
        rate_S - (at.rate_S / at.scale_factor)[..., None] * moved.scale_factor
    ) / at.scale_factor[:, None]
    seen = (
        2.0
        * quaternion.multiply(
            quaternion.conjugate(at.attitude)[:, None], jnp.swapaxes(moved.attitude, 1, 2)
        )[..., :3]
    )
    h = d_wheel - spin[:, None] * (
        jnp.einsum("iwp,ni->nwp", moved.axes_B, path.rate_B) + jnp.einsum("iw,nip->nwp", G, d_rate)
    )
    return Response(read, turned + jnp.swapaxes(seen, 1, 2), h + moved.momentum)


def _parts(
    structure: Structure, theta: Array, context: SlewContext, planned: Planned, sensors: Sensors
) -> _Parts:
    """Inertia, wheels, torques and sensor signals that parameters theta (d,) give along the planned motion."""
    active, path = structure.active_effects(theta), planned.path
    J, axes, torque = inertia_tensor.tensor(theta[:6]), context.wheel_axes_B, context.torque
    if structure.includes_wheel_spin:
        J = J - inertia_tensor.wheel_spin_tensor(axes, context.spin_inertia)
    for effect, p in active:
        J, axes, torque = (
            effect.inertia(p, context, J),
            effect.wheel_axes(p, context, axes),
            effect.delivered_torque(p, context, torque),
        )
    locked = J + inertia_tensor.wheel_spin_tensor(axes, context.spin_inertia)
    friction, external = jnp.zeros_like(path.wheel_momentum), jnp.zeros_like(path.rate_B)
    rate_S, attitude, momentum = (
        path.rate_B @ sensors.axes.T + sensors.bias,
        path.attitude,
        path.wheel_momentum,
    )
    for effect, p in active:

        def instant(t, q, w, h, field, position, effect=effect, p=p):
            state = State(q, w, h, jnp.zeros(0), locked, field, position)
            wheel_torque = effect.wheel_torque(p, context, t, state)
            return wheel_torque, effect.body_torque(p, context, t, state)

        rows = (
            path.time,
            path.attitude,
            path.rate_B,
            path.wheel_momentum,
            planned.magnetic_field_N,
            planned.position_N,
        )
        on_wheels, on_body = jax.vmap(instant)(*rows)
        friction, external = friction + on_wheels, external + on_body
        rate_S = effect.rate_output(p, context, path, rate_S)
        attitude = effect.attitude_output(p, context, path, attitude)
        momentum = effect.momentum_output(p, context, path, momentum)
    return _Parts(J, axes, torque, friction, external, rate_S, attitude, momentum, theta[6:9])


def _start(
    at: _Parts, moved: _Parts, path: Trajectory, context: SlewContext, scale: NuisanceScale, d: int
) -> tuple[Array, Array, Array]:
    """Total momentum (3,) in inertial axes, and how it (3, p) and the wheels' momentum (wheels, p) change with the unknowns.

    The start state's columns are those of `model.start_of`: rate, attitude, wheel momentum; the planned rate is zero.
    """
    p = moved.scale_factor.shape[-1]
    first, G, wheels = d + N_BIAS, at.axes_B, at.axes_B.shape[1]
    locked = at.inertia_B + inertia_tensor.wheel_spin_tensor(G, context.spin_inertia)
    h, q = path.wheel_momentum[0], path.attitude[0]
    momentum_B = G @ h
    d_momentum = jnp.einsum("iwp,w->ip", moved.axes_B, h)
    d_momentum = d_momentum.at[:, first : first + 3].add(locked * scale.local[:3])
    d_momentum = d_momentum.at[:, first + 3 : first + 6].add(-_cross(momentum_B) * scale.local[3:6])
    d_momentum = d_momentum.at[:, first + 6 : first + 6 + wheels].add(G * scale.local[6:])
    d_wheel = (
        jnp.zeros((wheels, p))
        .at[:, first : first + 3]
        .set((context.spin_inertia * G).T * scale.local[:3])
    )
    d_wheel = d_wheel.at[:, first + 6 : first + 6 + wheels].set(jnp.diag(scale.local[6:]))
    return quaternion.to_inertial(q, momentum_B), _to_inertial(q, d_momentum), d_wheel


def _integrated(
    path: Trajectory,
    momentum_B: Array,
    inverse: Array,
    source: Array,
    first: int,
    scale: NuisanceScale,
) -> tuple[Array, Array]:
    """Deviations of attitude and rate (n, 3, p) in body axes, by the trapezoidal rule."""
    to_body = jax.vmap(lambda q: quaternion.to_body(q, jnp.eye(3)).T)(path.attitude)  # C
    gain = inverse @ jax.vmap(_cross)(momentum_B)
    A = jnp.swapaxes(to_body, 1, 2) @ gain @ to_body
    B = jnp.swapaxes(to_body, 1, 2) @ (inverse @ source)
    half = 0.5 * jnp.diff(path.time)[:, None, None]
    left = _inverse(jnp.eye(3) - half * A[1:])
    across, push = left @ (jnp.eye(3) + half * A[:-1]), left @ (half * (B[:-1] + B[1:]))
    begin = (
        jnp.zeros(source.shape[1:])
        .at[:, first + 3 : first + 6]
        .set(to_body[0].T * scale.local[3:6])
    )

    def step(psi: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        following = row[0] @ psi + row[1]
        return following, following

    _, psi = jax.lax.scan(step, begin, (across, push))
    turned = to_body @ jnp.concatenate([begin[None], psi])
    return turned, gain @ turned + inverse @ source


def _inverse(matrix: Array) -> Array:
    """Inverse of matrices (..., 3, 3) by cross products of their rows."""
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], -1)
    return adjugate / jnp.sum(a * adjugate[..., 0], -1)[..., None, None]


def _cross(v: Array) -> Array:
    zero = jnp.zeros(())
    return jnp.stack(
        [
            jnp.stack([zero, -v[2], v[1]]),
            jnp.stack([v[2], zero, -v[0]]),
            jnp.stack([-v[1], v[0], zero]),
        ]
    )


def _to_inertial(q: Array, columns_B: Array) -> Array:
    """Columns (..., 3, p) of body vectors in inertial axes."""
    return jnp.swapaxes(
        quaternion.to_inertial(q[..., None, :], jnp.swapaxes(columns_B, -1, -2)), -1, -2
    )


def _to_body(q: Array, columns_N: Array) -> Array:
    return jnp.swapaxes(
        quaternion.to_body(q[..., None, :], jnp.swapaxes(columns_N, -1, -2)), -1, -2
    )


def _middle(rows: Array) -> Array:
    return 0.5 * (rows[1:] + rows[:-1])


def _grown(step: Array, slope: Array) -> Array:
    """Integral (n, k, p) of what is given for each step (n - 1, k, p), zero at the first row."""
    # As a matrix product, which compiles ten times as fast as a cumulative sum.
    n = len(slope)
    return jnp.einsum("ij,jkp->ikp", jnp.tril(jnp.ones((n + 1, n)), -1), step * slope)
