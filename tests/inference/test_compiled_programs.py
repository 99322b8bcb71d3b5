"""A process keeps few compiled programs, whatever shapes come."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from bayes_inertia.inference.compiled_programs import MOST_PROGRAMS, forget_surplus
from bayes_inertia.inference.likelihood import PROGRAMS
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model


def called_with_shapes(n: int):
    function = jax.jit(lambda x: 2.0 * x)
    for size in range(n):
        function(jnp.zeros(size + 1))
    return function


def test_a_function_with_too_many_programs_forgets_them():
    few, many = called_with_shapes(3), called_with_shapes(4)
    forget_surplus((few, many), most=3)
    assert (few._cache_size(), many._cache_size()) == (3, 0)
    assert many(jnp.ones(1)).tolist() == [2.0]


def test_every_estimate_looks_after_the_programs(flown, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "bayes_inertia.inference.optimizer.forget_surplus",
        lambda: seen.append(PROGRAMS[0]._cache_size()),
    )
    estimate(Model(flown.campaign), starts=1)
    assert len(seen) == 1
    assert seen[0] <= MOST_PROGRAMS + 1
