"""Coefficients of effects without a fixed shape: how many, their prior, and how they reach hooks.

The nuisances of a slew end with the whitened coefficients z of its stochastic effects, all with
prior sd 1. A hook gets c = B(p) z; the root B depends on the effect's parameters.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import N_BASE
from bayes_inertia.physics.slew_context import SlewContext
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
        if not isinstance(count, int | np.integer) or count < 0:
            raise EffectError(
                f"coefficient_count(campaign) is {count!r}",
                where=effect.name,
                advice="return a whole number, 0 or more",
            )
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
    if (
        blocks.ndim != 3
        or blocks.shape[1] != blocks.shape[2]
        or blocks.shape[0] * blocks.shape[1] != count
    ):
        raise EffectError(
            f"coefficient_root has the shape {root.shape} for {count} coefficients",
            where=effect.name,
            advice="return one row and one column a coefficient, or the blocks of a diagonal",
        )
    return blocks


def hyperparameters(
    effects: tuple[Effect, ...],
    layout: tuple[tuple[str, str, int | None], ...],
    n_base: int = N_BASE,
) -> tuple[int, ...]:
    """Where the parameters of stochastic effects stand in the flat vector.

    `layout`: owner, name and number of components (None: a scalar) of each parameter after the
    `n_base` of J and K.

    Examples
    --------
    >>> hyperparameters((), (("rate_bias", "bias", 3),))
    ()
    """
    stochastic = {e.name for e in effects if isinstance(e, StochasticEffect)}
    indices: list[int] = []
    start = n_base
    for owner, _, size in layout:
        stop = start + (1 if size is None else size)
        indices += range(start, stop) if owner in stochastic else ()
        start = stop
    return tuple(indices)
