"""A process keeps few compiled programs, whatever shapes come."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.inference.compiled_programs import forget_surplus
from bayes_inertia.inference.likelihood import PROGRAMS
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths.kept_programs import KeptProgram
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


def test_large_programs_are_bounded_by_their_bytes_and_the_oldest_goes_first():
    program = KeptProgram(lambda power, x: x**power)
    for power in (2, 3, 4):
        program(power, np.ones(4))
    program(2, np.ones(4))
    sizes = [size for _, size, _ in program.sizes()]
    assert min(sizes) > 0
    forget_surplus((program,), most_bytes=sum(sizes))
    assert program._cache_size() == 3
    forget_surplus((program,), most_bytes=sum(sizes) - 1)
    assert sorted(form[0] for *_, form in program.sizes()) == [2, 4]
    assert program(3, np.full(4, 2.0)).tolist() == [8.0] * 4


def test_every_estimate_looks_after_the_programs(flown, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "bayes_inertia.inference.optimizer.forget_surplus",
        lambda: seen.append(sum(size for p in PROGRAMS[:2] for _, size, _ in p.sizes())),
    )
    estimate(Model(flown.campaign), starts=1)
    assert len(seen) == 1
    # What was compiled since the last estimate is not yet counted.
    assert seen[0] <= 2 * LIMITS.most_bytes
