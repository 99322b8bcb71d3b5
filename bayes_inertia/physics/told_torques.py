"""Torques on the body as effects tell them along the measured motion, before any fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.body_rates import attitudes_seen, first_attitude_by_rates
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import body_rates
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.channels import channels_of
from bayes_inertia.physics.effect import ActiveEffects, Effect
from bayes_inertia.physics.equations_of_motion import with_delivered_inputs
from bayes_inertia.physics.packing import Arrays, bridged, pack
from bayes_inertia.physics.parameters import ParameterSpace
from bayes_inertia.physics.slew_context import State


def told_torques(
    campaign: Campaign, effects: Sequence[Effect]
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Each slew's external torque of some effects, integrated, by the name of the slew.

    Returns: time (n,) on the slew's own clock [s]; impulse (n, 3) at the priors' means, body axes
    [N m s]; the integrated size (n,) of what one prior sd of each parameter changes; momentum
    (n, 3) that devices carry at those means.
    """
    hooks = ("body_torque", "carried_momentum")
    if not any(effect.acts(hook) for effect in effects for hook in hooks):
        return {}
    acting = [e for e in effects if any(e.acts(hook) for hook in (*hooks, "delivered_inputs"))]
    space = ParameterSpace(tuple((e.name, p) for e in acting for p in e.parameters(campaign)))
    asked = sorted({name for effect in acting for name in effect.inputs})
    arrays = pack(campaign, channels_of(campaign, "commanded"), inputs=asked)
    told = {}
    for k, slew in enumerate(campaign.slews):
        one: Arrays = jax.tree.map(lambda rows, k=k: rows[k], arrays)
        rate_B, attitude = _measured_motion(campaign, k, np.asarray(one.slews.context.time))
        motion = partial(_motion_of, acting, space, campaign, one, rate_B, attitude)
        (mean, doubt), (carried, carried_doubt) = _at_prior(motion, space)
        step = np.asarray(one.slews.context.step)
        time = slew.time[0] + np.asarray(one.slews.context.time)
        doubt = _integral(doubt[:, None], step)[:, 0] + carried_doubt
        told[slew.name] = (time, _integral(mean, step), doubt, carried)
    return told


def _integral(held: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Running integral (n, k) of values (n, k) that are held over each step (n,) [s]."""
    summed = np.cumsum(held * step[:, None], axis=0)
    return np.concatenate([np.zeros_like(summed[:1]), summed[:-1]])


def _measured_motion(
    campaign: Campaign, slew: int, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Body rate (n, 3) and attitude (n, 4) on the grid (n,) that the readings tell."""
    original, campaign = campaign, campaign.with_body_rates
    of, sensor = campaign.slews[slew], campaign.gyro
    time = of.time - of.time[0]
    readings = np.where(campaign.valid_readings(of), np.asarray(of.rate), np.nan)
    read = np.stack([bridged(grid, time, column) for column in readings.T], axis=-1)
    rate_B = body_rates(sensor, read, sensor.scale_factor)
    turns = 0.5 * (rate_B[1:] + rate_B[:-1]) * np.diff(grid)[:, None]
    path = np.asarray(_accumulated(jnp.asarray(turns)))
    rows, seen, _ = attitudes_seen(original, original.slews[slew])
    if not len(rows):
        first = first_attitude_by_rates(original, original.slews[slew])
        rows, seen = np.zeros(1, dtype=int), np.array([path[0] if first is None else first])
    at = np.searchsorted(grid, time[rows])
    # What each seen attitude says of the first moment; the nearest one counts, for a bias drifts.
    begun = quaternion.multiply(jnp.asarray(seen), quaternion.conjugate(jnp.asarray(path[at])))
    nearest = np.searchsorted(0.5 * (grid[at][1:] + grid[at][:-1]), grid)
    return rate_B, np.asarray(quaternion.multiply(begun[nearest], jnp.asarray(path)))


@jax.jit
def _accumulated(turns: Array) -> Array:
    """Attitudes (n, 4) relative to the first, by n - 1 small rotations (n - 1, 3) [rad]."""

    def turned(attitude: Array, turn: Array) -> tuple[Array, Array]:
        after = quaternion.turned(attitude, turn)
        return after, after

    start = jnp.array([0.0, 0.0, 0.0, 1.0])
    return jnp.concatenate([start[None], jax.lax.scan(turned, start, turns)[1]])


def _motion_of(
    acting: Sequence[Effect],
    space: ParameterSpace,
    campaign: Campaign,
    one: Arrays,
    rate_B: np.ndarray,
    attitude: np.ndarray,
    flat: Array,
) -> tuple[Array, Array]:
    """Torque (n, 3) of all effects [N m], and momentum (n, 3) that devices carry [N m s]."""
    values, context, prior = space.split(flat), one.slews.context, campaign.inertia
    active = ActiveEffects(tuple(acting), {e.name: values.get(e.name, {}) for e in acting})
    inputs = with_delivered_inputs(one.slews, active)
    axes, spin = campaign.wheel_axes_B, campaign.spin_inertias
    J = prior.tensor if prior.includes_wheel_spin else prior.tensor + (axes * spin) @ axes.T
    delivered = inputs.inputs or {}
    torque = carried = jnp.zeros((len(rate_B), 3))
    for effect, p in active:
        states = effect.initial_state(p, context, jnp.asarray(rate_B[0]))

        def torque_at(t, turned, rate, momentum, environment, devices, e=effect, p=p, s=states):
            state = State(turned, rate, momentum, s, jnp.asarray(J), *environment)
            return e.body_torque(p, context, t, state._replace(inputs=devices))

        torque += jax.vmap(torque_at)(
            context.time,
            jnp.asarray(attitude),
            jnp.asarray(rate_B),
            inputs.momentum,
            inputs.environment,
            {name: 0.5 * (x.first + x.last) for name, x in delivered.items()},
        )
        if effect.acts("carried_momentum"):
            at_start = {name: x.first for name, x in delivered.items()}
            carried += jax.vmap(partial(effect.carried_momentum, p, context))(
                context.time, at_start
            )
    return torque, carried


def _at_prior(
    at_all: Callable[[Array], tuple[Array, ...]], space: ParameterSpace
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vectors (n, 3) at the priors' means, and the size (n,) of what one sd of each changes.

    Parameters of one effect add up as independent ones do; effects by their sizes.
    """
    mean, sd = jnp.asarray(space.mean), jnp.asarray(space.sd)
    owners = dict.fromkeys(owner for owner, _ in space.entries)
    found = []
    for value, slopes in zip(at_all(mean), jax.jacfwd(at_all)(mean), strict=True):
        square = np.asarray(slopes * sd) ** 2
        sizes = [np.sqrt(np.sum(square[..., space.slice_of(o)], axis=(1, 2))) for o in owners]
        found.append((np.asarray(value), np.sum([np.zeros(len(square)), *sizes], axis=0)))
    return found
