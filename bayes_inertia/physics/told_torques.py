"""Torques on the body as effects tell them along the measured motion, before any fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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
from bayes_inertia.physics.packing import bridged, pack
from bayes_inertia.physics.parameters import ParameterSpace
from bayes_inertia.physics.slew_context import State
from bayes_inertia.physics.slew_input import SlewInput


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
    slews = arrays.slews
    times, steps = np.asarray(slews.context.time), np.asarray(slews.context.step)
    measured = [_measured_motion(campaign, k, time) for k, time in enumerate(times)]
    motions = [np.stack(part) for part in zip(*measured, strict=True)]
    one = partial(_motion_of, acting, space, campaign)

    def every(flat: Array) -> tuple[Array, Array]:
        return jax.vmap(partial(one, flat))(slews, *motions)

    told = {}
    parts = zip(campaign.slews, times, steps, *_at_prior(every, space), strict=True)
    for slew, time, step, mean, doubt, carried, carried_doubt in parts:
        doubt = _integral(doubt[:, None], step)[:, 0] + carried_doubt
        told[slew.name] = (slew.time[0] + time, _integral(mean, step), doubt, carried)
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
    rows, seen, _ = attitudes_seen(original, original.slews[slew])
    if not len(rows):
        first = first_attitude_by_rates(original, original.slews[slew])
        rows = np.zeros(1, dtype=int)
        seen = np.array([[0.0, 0.0, 0.0, 1.0] if first is None else first])
    at = np.searchsorted(grid, time[rows])
    # What each seen attitude says of the first moment; the nearest one counts, for a bias drifts.
    nearest = np.searchsorted(0.5 * (grid[at][1:] + grid[at][:-1]), grid)
    return rate_B, np.asarray(_attitudes(turns, seen, at, nearest))


@jax.jit
def _attitudes(turns: Array, seen: Array, at: Array, nearest: Array) -> Array:
    """Attitudes (n, 4) by small rotations (n - 1, 3) [rad] from one of those seen (m, 4).

    `at`: the moments (m,) that they are of; `nearest`: which one counts for each moment (n,).
    """

    def turned(attitude: Array, turn: Array) -> tuple[Array, Array]:
        after = quaternion.turned(attitude, turn)
        return after, after

    start = jnp.array([0.0, 0.0, 0.0, 1.0])
    path = jnp.concatenate([start[None], jax.lax.scan(turned, start, turns)[1]])
    begun = quaternion.multiply(seen, quaternion.conjugate(path[at]))
    return quaternion.multiply(begun[nearest], path)


def _motion_of(
    acting: Sequence[Effect],
    space: ParameterSpace,
    campaign: Campaign,
    flat: Array,
    slew: SlewInput,
    rate_B: Array,
    attitude: Array,
) -> tuple[Array, Array]:
    """Torque (n, 3) of all effects [N m], and momentum (n, 3) that devices carry [N m s]."""
    values, context, prior = space.split(flat), slew.context, campaign.inertia
    active = ActiveEffects(tuple(acting), {e.name: values.get(e.name, {}) for e in acting})
    inputs = with_delivered_inputs(slew, active)
    axes, spin = campaign.wheel_axes_B, campaign.spin_inertias
    J = prior.tensor if prior.includes_wheel_spin else prior.tensor + (axes * spin) @ axes.T
    delivered = inputs.inputs or {}
    torque = carried = jnp.zeros((len(rate_B), 3))
    for effect, p in active:
        states = effect.initial_state(p, context, rate_B[0])

        def torque_at(t, turned, rate, momentum, environment, devices, e=effect, p=p, s=states):
            state = State(turned, rate, momentum, s, jnp.asarray(J), *environment)
            return e.body_torque(p, context, t, state._replace(inputs=devices))

        motion = context.time, attitude, rate_B, inputs.momentum, inputs.environment
        held = {name: 0.5 * (x.first + x.last) for name, x in delivered.items()}
        torque += jax.vmap(torque_at)(*motion, held)
        if effect.acts("carried_momentum"):
            at_start = {name: x.first for name, x in delivered.items()}
            carries = partial(effect.carried_momentum, p, context)
            carried += jax.vmap(carries)(context.time, at_start)
    return torque, carried


def _at_prior(
    at_all: Callable[[Array], tuple[Array, ...]], space: ParameterSpace
) -> Iterator[np.ndarray]:
    """Vectors (S, n, 3) at the priors' means, and sizes (S, n) of what one sd of each changes.

    Parameters of one effect add up as independent ones do; effects by their sizes.
    """
    values, changed_by = jax.linearize(at_all, jnp.asarray(space.mean))
    slopes = jax.vmap(changed_by)(jnp.diag(jnp.asarray(space.sd)))
    owners = dict.fromkeys(owner for owner, _ in space.entries)
    for value, slope in zip(values, slopes, strict=True):
        square = np.sum(np.asarray(slope) ** 2, axis=-1)
        sizes = [np.sqrt(square[space.slice_of(owner)].sum(axis=0)) for owner in owners]
        yield np.asarray(value)
        yield np.sum([np.zeros(square.shape[1:]), *sizes], axis=0)
