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
from bayes_inertia.physics.effect import Effect
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
    acting = [effect for effect in effects if any(effect.acts(hook) for hook in hooks)]
    if not acting:
        return {}
    spaces = [_space(effect, campaign) for effect in acting]
    asked = sorted({name for effect in acting for name in effect.inputs})
    arrays = pack(campaign, channels_of(campaign, "commanded"), inputs=asked)
    told = {}
    for k, slew in enumerate(campaign.slews):
        one: Arrays = jax.tree.map(lambda rows, k=k: rows[k], arrays)
        rate_B, attitude = _measured_motion(campaign, k, np.asarray(one.slews.context.time))
        mean, doubt = np.zeros((len(rate_B), 3)), np.zeros(len(rate_B))
        carried, carried_doubt = np.zeros_like(mean), np.zeros_like(doubt)
        for effect, space in zip(acting, spaces, strict=True):
            torque, size = _torque(effect, space, campaign, one, rate_B, attitude)
            mean, doubt = mean + torque, doubt + size
            momentum, size = _carried(effect, space, one)
            carried, carried_doubt = carried + momentum, carried_doubt + size
        step = np.asarray(one.slews.context.step)
        time = slew.time[0] + np.asarray(one.slews.context.time)
        doubt = _integral(doubt[:, None], step)[:, 0] + carried_doubt
        told[slew.name] = (time, _integral(mean, step), doubt, carried)
    return told


def _carried(effect: Effect, space: ParameterSpace, one: Arrays) -> tuple[np.ndarray, np.ndarray]:
    """Momentum (n, 3) that a device carries [N m s], and what the priors leave open of it (n,)."""
    context = one.slews.context
    devices = {name: x.first for name, x in (one.slews.inputs or {}).items()}

    def at_all(flat: Array) -> Array:
        p = space.split(flat).get(effect.name, {})
        if not effect.acts("carried_momentum"):
            return jnp.zeros((len(context.time), 3))
        carried = partial(effect.carried_momentum, p, context)
        return jax.vmap(carried)(context.time, devices)

    return _at_prior(at_all, space)


def _integral(held: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Running integral (n, k) of values (n, k) that are held over each step (n,) [s]."""
    summed = np.cumsum(held * step[:, None], axis=0)
    return np.concatenate([np.zeros_like(summed[:1]), summed[:-1]])


def _space(effect: Effect, campaign: Campaign) -> ParameterSpace:
    return ParameterSpace(tuple((effect.name, p) for p in effect.parameters(campaign)))


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


def _torque(
    effect: Effect,
    space: ParameterSpace,
    campaign: Campaign,
    one: Arrays,
    rate_B: np.ndarray,
    attitude: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Torque (n, 3) at the priors' means [N m], and how far the priors leave it open (n,)."""
    inputs, context, prior = one.slews, one.slews.context, campaign.inertia
    axes, spin = campaign.wheel_axes_B, campaign.spin_inertias
    J = prior.tensor if prior.includes_wheel_spin else prior.tensor + (axes * spin) @ axes.T

    def at_all(flat: Array) -> Array:
        p = space.split(flat).get(effect.name, {})
        states = effect.initial_state(p, context, jnp.asarray(rate_B[0]))

        def at(t, turned, rate, momentum, environment, devices):
            state = State(turned, rate, momentum, states, jnp.asarray(J), *environment)
            state = state._replace(inputs=devices)
            return effect.body_torque(p, context, t, state)

        return jax.vmap(at)(
            context.time,
            jnp.asarray(attitude),
            jnp.asarray(rate_B),
            inputs.momentum,
            inputs.environment,
            {name: 0.5 * (x.first + x.last) for name, x in (inputs.inputs or {}).items()},
        )

    return _at_prior(at_all, space)


def _at_prior(
    at_all: Callable[[Array], Array], space: ParameterSpace
) -> tuple[np.ndarray, np.ndarray]:
    """A vector (n, 3) at the priors' means, and the size (n,) of what one sd of each changes."""
    mean = jnp.asarray(space.mean)
    columns = jax.jacfwd(at_all)(mean) * jnp.asarray(space.sd)
    return np.asarray(at_all(mean)), np.sqrt(np.asarray(jnp.sum(columns**2, axis=(1, 2))))
