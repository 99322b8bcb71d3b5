"""First-order processes that a model's effects add to readings, and the nuisances for them."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.reading_noise import ReadingNoise
from bayes_inertia.physics.stochastic_effect import StochasticEffect


class EffectNoise(NamedTuple):
    """What one effect adds to readings.

    Parameters
    ----------
    effect : str
        Its name.
    noise : ReadingNoise
        The process.
    coefficients : slice
        Which of a slew's own nuisances stand for it.
    """

    effect: str
    noise: ReadingNoise
    coefficients: slice


def noise_of_effects(model: Model, theta: np.ndarray) -> tuple[EffectNoise, ...]:
    """What a model's effects add to readings that are compared.

    `theta` (d,).

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> model = Model(small_campaign())
    >>> noise_of_effects(model, model.space.mean)
    ()
    """
    structure, start, found = model.structure, model.structure.n_start, []
    if not any(structure.coefficients):
        return ()
    active = structure.active_effects(jnp.asarray(theta))
    for (effect, p), count in zip(active, structure.coefficients, strict=False):
        noise = effect.reading_noise(p) if isinstance(effect, StochasticEffect) else None
        if count and noise is not None and _is_read(model, noise):
            plain = noise._replace(size=float(noise.size), time=float(noise.time))
            found.append(EffectNoise(effect.name, plain, slice(start, start + count)))
        start += count
    return tuple(found)


def effects_between_knots(model: Model, theta: np.ndarray) -> tuple[EffectNoise, ...]:
    """Those of `noise_of_effects` whose coefficients are values of the rates' errors on knots.

    `theta` (d,). Returns: what they do between knots is filtered out of the readings.
    """
    every = noise_of_effects(model, theta)
    return tuple(each for each in every if each.noise.channel == "rate" and each.noise.knots)


def _is_read(model: Model, noise: ReadingNoise) -> bool:
    """Whether readings with this noise are compared, and the noise is there at all."""
    compared = noise.channel == "rate" or model.structure.drive == "commanded"
    return compared and float(noise.size) > 0.0
