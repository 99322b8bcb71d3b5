"""Fits with one effect without a fixed shape more, and with fewer effects beside it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.diagnosis.evidence import COMPARISON_TOLERANCE
from bayes_inertia.inference.descent import compiled_meanwhile
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.stochastic_effect import StochasticEffect


def instances[E: Effect](effects: Sequence[E]) -> Mapping[str, E]:
    """Effects by their names.

    Examples
    --------
    >>> from bayes_inertia.physics.effects import TorqueNoise
    >>> list(instances([TorqueNoise()]))
    ['torque_noise']
    """
    return {effect.name: effect for effect in effects}


def with_stochastic(before: Estimate, effect: StochasticEffect, start: Sequence[float]) -> Estimate:
    """Fit one effect without a fixed shape more; effects that were not fitted are left out.

    Returns: of a model that holds what is fitted and nothing else.
    """
    old = before.model
    model = Model(old.campaign, (*before.effects_fitted, effect), old.structure.drive)
    begin = move_to(before, model)
    part = model.space.slice_of(effect.name)
    theta = begin.theta.copy()
    theta[part] = start
    begin = replace(begin, point=replace(begin.point, theta=theta))
    free = np.concatenate([begin.free, np.arange(part.start, part.stop)])
    with compiled_meanwhile(model, begin.point):
        return re_estimate(begin, theta, free, tolerance=COMPARISON_TOLERANCE)


def without_effects(
    fitted: Estimate, names: Collection[str], before: Estimate, start: Mapping[str, Sequence[float]]
) -> Estimate:
    """Fit again with some effects held at their null, in the same model.

    Nothing is compiled anew for it. Campaign and noise stay those of the fit with all effects.

    `start`: by the names of effects that `before` does not know, their parameters to begin from.
    """
    space, theta = fitted.model.space, move_to(before, fitted.model).theta.copy()
    for name, values in start.items():
        theta[space.slice_of(name)] = values
    free = np.array([i for i in fitted.free if space.names[i].split(".")[0] not in names])
    return re_estimate(fitted, theta, free, tolerance=COMPARISON_TOLERANCE)
