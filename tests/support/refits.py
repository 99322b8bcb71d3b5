"""Rounds of a search, refits with one effect more, and fits with given effects, all in a model that
holds the whole library: they share its compiled code.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.diagnosis.candidates import ranked_candidates, score_candidates
from bayes_inertia.diagnosis.refitting import ScoredRound, refit
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.inference.optimizer import estimate


def fitted_with(model, *effects: str):
    """The fit of J, K and some effects of a model, begun where none acts; the others do nothing."""
    space = model.space
    parts = [np.arange(space.size)[space.slice_of(effect)] for effect in effects]
    start = np.concatenate([space.mean[:9], space.nulls[9:]])
    free = np.concatenate([np.arange(9), *parts])
    return estimate(model, start=start, free=free, discount=False)


def scored(at) -> ScoredRound:
    """All candidates at an estimate; none is significant or not."""
    tests = score_candidates(at)
    return ScoredRound(at, tests, ranked_candidates(tests), 1.0, None)


def refitted(at, effect: str):
    """The fit with one effect more."""
    begun = scored(at)
    (candidate,) = (c for c in begun.candidates if c.effect == effect)
    return refit(begun, candidate, Rules())
