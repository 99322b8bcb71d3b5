"""Predicted telemetry, compiled: parameters and nuisances of a model -> what the sensors report.

`Structure` is the hashable part of a model, so that all campaigns of one shape share compiled
code; `Data` holds its arrays. The nuisances of a slew end with the whitened coefficients z of its
effects without a fixed shape, all with prior sd 1. A hook gets c = B(p) z; the root B depends on
the effect's parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.effect import (
    BODY_HOOKS,
    LOOKING_BACK,
    MOVING_HOOKS,
    ActiveEffects,
    Effect,
    require_rule,
)
from bayes_inertia.physics.packing import Data, Nuisances, NuisanceScale, Telemetry
from bayes_inertia.physics.parameters import N_BASE
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.slew_input import (
    Drive,
    SlewInput,
    Start,
    without_tachometer_error,
)
from bayes_inertia.physics.stochastic_effect import StochasticEffect


def coefficient_counts(campaign: Campaign, effects: tuple[Effect, ...]) -> tuple[int, ...]:
    """How many coefficients each effect has in one slew.

    Returns: one an effect, 0 for effects of a fixed shape; empty if all are.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> coefficient_counts(small_campaign(), ())
    ()
    """
    counts = []
    for effect in effects:
        count = effect.coefficient_count(campaign) if isinstance(effect, StochasticEffect) else 0
        whole = isinstance(count, int | np.integer) and count >= 0
        require_rule(whole, effect, "whole_count", count=count)
        counts.append(int(count))
    return tuple(counts) if any(counts) else ()


def each_effects_coefficients(counts: tuple[int, ...], whitened: Array) -> tuple[Array, ...]:
    """The coefficients of one slew, cut into those of each effect.

    `whitened` (n_random,). Returns (k,).

    Examples
    --------
    >>> [z.tolist() for z in each_effects_coefficients((1, 0, 2), jnp.array([5.0, 6.0, 7.0]))]
    [[5.0], [], [6.0, 7.0]]
    """
    # What follows the last effect is empty.
    return tuple(jnp.split(whitened, np.cumsum(counts, dtype=int))[:-1])


def with_coefficients(
    active: ActiveEffects, whitened: tuple[Array, ...], slew: SlewContext
) -> ActiveEffects:
    """Effects with the coefficients of one slew in place of the parameters that fix their prior.

    `whitened` (k,): z of this slew, one an effect, see `each_effects_coefficients`.
    """
    values = dict(active.values)
    for (effect, p), z in zip(active, whitened, strict=True):
        if isinstance(effect, StochasticEffect):
            blocks = _blocks(effect, p, slew, len(z))
            shaped = z.reshape(*blocks.shape[:2], 1)
            values[effect.name] = {"coefficients": (blocks @ shaped).reshape(len(z))}
    return ActiveEffects(active.effects, values)


def prior_blocks(
    active: ActiveEffects, counts: tuple[int, ...], slew: SlewContext
) -> tuple[Array, ...]:
    """The root B of the prior covariance of all coefficients of one slew, as diagonal blocks.

    Returns (b, m, m): one an effect with coefficients; its b blocks follow each other on the
    diagonal of B.
    """
    return tuple(
        _blocks(effect, p, slew, count)
        for (effect, p), count in zip(active, counts, strict=True)
        if isinstance(effect, StochasticEffect) and count
    )


def _blocks(
    effect: StochasticEffect, p: Mapping[str, Array], slew: SlewContext, count: int
) -> Array:
    """An effect's root (b, m, m), b m being its number of coefficients."""
    root = jnp.asarray(effect.coefficient_root(p, slew, count))
    blocks = root if root.ndim == 3 else root[None]
    square = blocks.ndim == 3 and blocks.shape[1] == blocks.shape[2]
    whole = square and len(blocks) * blocks.shape[1] == count
    require_rule(whole, effect, "root_shape", shape=root.shape, count=count)
    return blocks


@dataclass(frozen=True)
class Structure:
    """What decides the compiled code of a model.

    Parameters
    ----------
    effects : tuple of Effect
        What acts beside J and K.
    drive : "commanded" or "measured"
        What drives the model.
    layout : tuple of (str, str, int or None)
        Owner (an effect or a further sensor), name and number of components (None: a scalar) of
        each parameter after J and K.
    includes_wheel_spin : bool
        Whether the first six parameters are J_locked.
    wheels : int
        Number of wheels.
    shapes : int
        Number of shapes of tachometer noise a wheel (measured drive), and free momenta.
    refined : bool
        Whether the integration grid is finer than the telemetry's rows.
    coefficients : tuple of int, optional
        How many coefficients each effect has in one slew; empty if all effects have a fixed shape.
    rows_per_step : int
        Grid points that one integration step spans.
    channels : tuple of Channel
        What is compared with measurements.
    free_momenta : int
        How many of the shapes are free momenta between readings of slow tachometers.
    """

    effects: tuple[Effect, ...]
    drive: Drive
    layout: tuple[tuple[str, str, int | None], ...]
    includes_wheel_spin: bool
    wheels: int
    shapes: int
    refined: bool
    coefficients: tuple[int, ...] = ()
    rows_per_step: int = 1
    channels: tuple[Channel, ...] = ()
    free_momenta: int = 0

    def place(self, channel: str) -> int:
        """Where a channel stands among those of the model."""
        return [each.name for each in self.channels].index(channel)

    @property
    def n_base(self) -> int:
        """Number of parameters of J and K."""
        ends = (c.parameters[1] for c in self.channels if c.stream == RATE)
        return next(ends, N_BASE)

    @property
    def n_start(self) -> int:
        """Number of one slew's nuisances without coefficients.

        Start rate and attitude, then start momentum (commanded) or tachometer shapes (measured).
        """
        return 6 + self.wheels * (self.shapes if self.drive == "measured" else 1)

    @property
    def n_local(self) -> int:
        """Number of one slew's nuisances: `n_start`, then the effects' whitened coefficients."""
        return self.n_start + sum(self.coefficients)

    def nuisances(self, local: Array) -> Nuisances:
        """The nuisances of one slew, each effect's coefficients apart.

        `local` (n_local,).
        """
        coefficients = each_effects_coefficients(self.coefficients, local[self.n_start :])
        return Nuisances(local[: self.n_start], coefficients)

    @property
    def only_sensed(self) -> tuple[bool, ...]:
        """Of each effect: whether it has coefficients, and these do not move the body."""
        pairs = zip(self.effects, self.coefficients, strict=False)
        return tuple(n > 0 and not any(e.acts(h) for h in BODY_HOOKS) for e, n in pairs)

    @property
    def has_sparse_output(self) -> bool:
        """Whether only the attitude changes in a slew, and no sensor looks at more than a row.

        The motion is then worked out only where it is compared.
        """
        hooks = (*MOVING_HOOKS, *LOOKING_BACK)
        if any(channel.sees_attitude for channel in self.channels):
            return False
        return self.rows_per_step > 1 and not any(e.acts(h) for e in self.effects for h in hooks)

    @property
    def hyperparameters(self) -> tuple[int, ...]:
        """Which parameters only fix the prior of coefficients; empty without stochastic effects."""
        if not self.coefficients:
            return ()
        stochastic = {e.name for e in self.effects if isinstance(e, StochasticEffect)}
        owners = [owner for owner, _, size in self.layout for _ in range(size or 1)]
        return tuple(self.n_base + i for i, owner in enumerate(owners) if owner in stochastic)

    def active_effects(self, theta: Array) -> ActiveEffects:
        """The effects with the parameters that a flat vector gives them.

        `theta` (d,).
        """
        values: dict[str, dict[str, Array]] = {effect.name: {} for effect in self.effects}
        start = self.n_base
        for owner, name, size in self.layout:
            stop = start + (1 if size is None else size)
            values.setdefault(owner, {})[name] = theta[start] if size is None else theta[start:stop]
            start = stop
        return ActiveEffects(self.effects, values)


def start_of(structure: Structure, scale: NuisanceScale, reference: Start, local: Array) -> Start:
    """Start state of one slew from its nuisances.

    `local` (n_start,).
    """
    physical = local * scale.local
    attitude = quaternion.turned(reference.attitude, physical[3:6])
    momentum = reference.wheel_momentum + (physical[6:] if structure.drive == "commanded" else 0.0)
    return Start(reference.rate_B + physical[:3], attitude, momentum)


def inertia_in(structure: Structure, theta: Array, slew: SlewContext) -> Array:
    """The inertia tensor of everything except the wheels' spin.

    `theta` (d,). Returns (3, 3) [kg m^2].
    """
    J = inertia_tensor.tensor(theta[:6])
    if not structure.includes_wheel_spin:
        return J
    return inertia_tensor.without_wheel_spin(J, slew.wheel_axes_B, slew.spin_inertia)


def acting_in(
    structure: Structure, theta: Array, coefficients: tuple[Array, ...], slew: SlewContext
) -> ActiveEffects:
    """What acts in one slew.

    `theta` (d,); `coefficients` (k,). Returns: with the coefficients of effects that have no fixed
    shape.
    """
    active = structure.active_effects(theta)
    if not structure.coefficients:
        return active
    return with_coefficients(active, coefficients, slew)


def predict(
    structure: Structure,
    theta: Array,
    nuisances: Nuisances,
    bias: Array,
    slew: SlewInput,
    telemetry: Telemetry,
    reference: Start,
    data: Data,
) -> tuple[Array, ...]:
    """Predicted telemetry of one slew.

    `theta` (d,); `bias` (axes,). `slew`: one slew of `data.arrays`, as are `telemetry` and
    `reference`. `telemetry`: says where rows and fixes stand on the grid.
    """
    local, coefficients = nuisances
    active = acting_in(structure, theta, coefficients, slew.context)
    J = inertia_in(structure, theta, slew.context)
    if structure.drive == "measured" and structure.wheels:
        noise = (local[6:] * data.scale.local[6:]).reshape(structure.wheels, structure.shapes)
        slew = without_tachometer_error(slew, telemetry.tachometer_shapes, noise)
    rows, fixes = _places_on_grid(structure, telemetry)
    if structure.has_sparse_output:
        slew = slew._replace(fixes=jnp.concatenate(fixes))
    start = start_of(structure, data.scale, reference, local)
    trajectory, effect_states = simulate_slew(
        slew, start, J, active, structure.drive, structure.rows_per_step
    )
    predicted = []
    for channel, constants, at in zip(structure.channels, data.sensors, rows, strict=True):
        value = channel.seen(theta, constants, bias * data.scale.bias, slew, trajectory)
        for (effect, p), states in zip(active, effect_states, strict=True):
            path = trajectory._replace(effect_states=states)
            value = channel.with_effect(effect, p, constants, slew.context, path, value)
        predicted.append(channel.read(theta[slice(*channel.parameters)], value)[at])
    return tuple(predicted)


def _places_on_grid(structure: Structure, telemetry: Telemetry) -> tuple[list[Any], list[Array]]:
    """Where each channel's readings stand in what is simulated, and all fixes on the grid."""
    rows: list[Any] = []
    fixes: list[Array] = []
    for channel, readings in zip(structure.channels, telemetry.readings, strict=True):
        if channel.stream.is_series:
            rows.append(telemetry.sample if structure.refined else slice(None))
            continue
        first = sum(map(len, fixes))
        fixes.append(telemetry.sample[readings.row] if structure.refined else readings.row)
        # Where only fixes are simulated they follow each other.
        sparse = slice(first, first + len(readings.row))
        rows.append(sparse if structure.has_sparse_output else fixes[-1])
    return rows, fixes


def predict_all(
    structure: Structure, theta: Array, local: Array, bias: Array, data: Data
) -> tuple[Array, ...]:
    """Predicted telemetry of all slews.

    `theta` (d,); `local` (slews, n_local); `bias` (axes,).
    """
    one = jax.vmap(
        lambda x, slew, telemetry, reference: predict(
            structure, theta, structure.nuisances(x), bias, slew, telemetry, reference, data
        )
    )
    return one(local, *data.arrays)
