"""Fits with one effect without a fixed shape more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.diagnosis.evidence import COMPARISON_TOLERANCE
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.stochastic_effect import StochasticEffect


def instances[E: Effect](effects: Sequence[E]) -> Mapping[str, E]:
    """Effects by their names.

    Parameters
    ----------
    effects : sequence of Effect
        No two of one name.

    Returns
    -------
    mapping of Effect

    Examples
    --------
    >>> from bayes_inertia.physics.effects import TorqueNoise
    >>> list(instances([TorqueNoise()]))
    ['torque_noise']
    """
    return {effect.name: effect for effect in effects}


def with_stochastic(before: Estimate, effect: StochasticEffect, start: Sequence[float]) -> Estimate:
    """Fit one effect without a fixed shape more; effects that were not fitted are left out.

    Parameters
    ----------
    before : Estimate
        The fit without it.
    effect : StochasticEffect
        What to add.
    start : sequence of float
        Its parameters to begin from.

    Returns
    -------
    Estimate
        Of a model that holds what is fitted and nothing else.
    """
    old = before.model
    model = Model(old.campaign, (*before.effects_fitted, effect), old.structure.drive)
    begin = move_to(before, model)
    part = model.space.slice_of(effect.name)
    theta = begin.theta.copy()
    theta[part] = start
    begin = replace(begin, point=replace(begin.point, theta=theta))
    free = np.concatenate([begin.free, np.arange(part.start, part.stop)])
    return re_estimate(begin, theta, free, tolerance=COMPARISON_TOLERANCE)
