"""Programs of a model with an effect without a fixed shape are there when they are asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.inference import descent, hyperparameters, likelihood
from bayes_inertia.inference.likelihood import Point
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.maths.kept_programs import IN_MEMORY
from bayes_inertia.physics.effects import RateRandomWalk
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def begin(effects):
    """A model and its prior mean."""
    model = Model(small_campaign(), effects)
    local = np.zeros((model.n_slews, model.structure.n_local))
    return model, Point(model.space.mean, np.zeros(3), local)


def programs():
    return set(IN_MEMORY.held())


@pytest.mark.long
@pytest.mark.slow
def test_what_a_fit_evaluates_is_compiled_beside_the_body():
    model, point = begin((RateRandomWalk(),))
    before = programs()
    with descent.compiled_meanwhile(model, point):
        pass
    compiled = programs()
    assert compiled != before
    white, everything = whitening(model, point.theta), np.arange(model.space.size)
    likelihood.residuals(model.structure, point, model.data, white)
    # Also where fewer parameters may move.
    for free in (everything, np.setdiff1d(everything, [7])):
        evidence = hyperparameters.Evidence(model, point, white, free, whole=True)
        sizes = evidence.standardised(point.theta)
        evidence.negative_log(sizes)
        replace(evidence, whole=False).given(sizes[None])
    assert programs() == compiled


def test_a_plain_model_is_not_evaluated_and_failures_wait_for_the_fit(monkeypatch):
    seen = []

    def evaluate(model, point):
        seen.append(model)
        raise ArithmeticError

    monkeypatch.setattr(descent, "_evaluate", evaluate)
    with descent.compiled_meanwhile(*begin(())):
        pass
    assert seen == []
    walking, point = begin((RateRandomWalk(),))
    with descent.compiled_meanwhile(walking, point):
        pass
    assert seen == [walking]
