"""Effects without a fixed shape over time, as the posterior draws them."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
from jax import Array

from bayes_inertia.inference.each_slew import of_slew
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.predicted_telemetry import drawn_nuisances, thinned_draws
from bayes_inertia.inference.sampler import Chains
from bayes_inertia.physics.prediction import Structure
from bayes_inertia.physics.random_inputs import with_coefficients
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# Instants of each slew at which a signal is kept.
_INSTANTS = 101


def drawable(estimate: Estimate) -> tuple[StochasticEffect, ...]:
    """Effects of a fit whose signal over time can be drawn.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    tuple of StochasticEffect
        In the model's order.
    """
    effects = estimate.model.effects
    return tuple(e for e in effects if isinstance(e, StochasticEffect) and e.signal_components)


def signal_times(estimate: Estimate) -> np.ndarray:
    """Instants at which signals are kept.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    (slews, instants) array
        From each slew's own zero [s].
    """
    slews = estimate.model.campaign.slews
    return np.stack([np.linspace(s.time[0], s.time[-1], _INSTANTS) for s in slews])


def stochastic_signals(
    estimate: Estimate, chains: Chains, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Draws of each signal over time, from thinned draws with their nuisances.

    Parameters
    ----------
    estimate : Estimate
    chains : Chains
        Samples around it.
    rng : numpy.random.Generator
        Source of draws and nuisances.

    Returns
    -------
    dict of (ensembles, draws, slews, instants, components) arrays
        By effect, in its `signal_unit`; empty without such effects.
    """
    effects = drawable(estimate)
    if not effects:
        return {}
    model, point_of = estimate.model, drawn_nuisances(estimate)
    thetas = thinned_draws(chains, rng)
    numbers = estimate.point.bias.size + estimate.point.local.size
    each = [of_slew(k, (model.data.contexts, signal_times(estimate))) for k in range(model.n_slews)]
    names = tuple(effect.name for effect in effects)
    drawn = []
    for theta in thetas:
        local = point_of(theta, rng.standard_normal(numbers)).local
        parts = [
            _signals(model.structure, names, theta, of_slew(k, np.asarray(local)), *inputs)
            for k, inputs in enumerate(each)
        ]
        drawn.append([np.concatenate(signal) for signal in zip(*parts, strict=True)])
    shape = (len(chains.samples), -1)
    return {
        name: np.stack([signals[k] for signals in drawn]).reshape(*shape, *drawn[0][k].shape)
        for k, name in enumerate(names)
    }


@partial(jax.jit, static_argnums=(0, 1))
def _signals(
    structure: Structure,
    names: tuple[str, ...],
    theta: Array,
    local: Array,
    contexts: SlewContext,
    times: Array,
) -> tuple[Array, ...]:
    """Signals (slews, instants, components) of these effects at one draw."""
    active = structure.active_effects(theta)

    def one(slew: SlewContext, local: Array, t: Array) -> tuple[Array, ...]:
        acting = with_coefficients(active, structure.nuisances(local).coefficients, slew)
        return tuple(e.signal(p, slew, t) for e, p in acting if e.name in names)  # type: ignore[attr-defined]

    return jax.vmap(one)(contexts, local, times)
