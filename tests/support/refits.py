"""Fits with given effects, all in a model that holds the whole library: they share its code."""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.optimizer import estimate


def fitted_with(model, *effects: str):
    """The fit of J, K and some effects of a model, begun where none acts; the others do nothing."""
    space = model.space
    parts = [np.arange(space.size)[space.slice_of(effect)] for effect in effects]
    start = np.concatenate([space.mean[:9], space.nulls[9:]])
    free = np.concatenate([np.arange(9), *parts])
    return estimate(model, start=start, free=free, discount=False)
