"""Gates: stuck ensembles fail, good ones pass."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.chains import SHORT

from bayes_inertia.inference.gates import (
    autocorrelation_time,
    check_gates,
    diagnose_chains,
    prior_gate,
)
from bayes_inertia.inference.sampler import sample
from bayes_inertia.inference.settings import FitContext
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def _diagnosed(samples: np.ndarray):
    return diagnose_chains(
        samples, tau=1.0, evaluations=samples[..., 0].size, seconds=1.0, acceptance=1.0, discarded=0
    )


def test_a_walker_that_never_moved_counts_as_one_draw():
    chain = np.random.default_rng(3).normal(size=(300, 8, 2))
    assert autocorrelation_time(chain) < 2.0
    chain[:, 3] = chain[:1, 3]
    assert autocorrelation_time(chain) == 300.0


def test_gates_fail_for_stuck_ensembles_and_pass_for_good_ones():
    good = np.random.default_rng(0).normal(size=(4, 32, 40, 3))
    assert _diagnosed(good).converged
    stuck = good.copy()
    stuck[0, ..., 1] += 6.0  # one ensemble has found another mode than the rest
    found = _diagnosed(stuck)
    assert not found.converged
    assert found.nested_rhat_max > 1.2
    # Walkers that never move agree between ensembles, and are still no sample.
    frozen = np.broadcast_to(good[:, :, :1], good.shape).copy()
    assert not _diagnosed(frozen + 1e-9 * good).converged
    short = good[:, :, :10]
    assert not _diagnosed(short).converged


def test_two_modes_between_the_ensembles_fail_the_gate():
    """Two modes, 12 sigma apart, that no walker leaves: each ensemble looks perfect, together they
    do not.
    """
    rng = np.random.default_rng(1)
    modes = np.array([-6.0, 6.0, 6.0, -6.0])[:, None, None, None]
    within = _diagnosed(rng.normal(size=(4, 32, 60, 2)))
    between = _diagnosed(rng.normal(size=(4, 32, 60, 2)) + modes)
    assert within.converged
    assert not between.converged


@pytest.mark.slow
def test_gates_say_which_noise_was_taken_and_fail_where_something_unknown_remains(small_at):
    chains = sample(small_at, SHORT)
    stated, louder, unknown = (
        check_gates(small_at, chains.diagnostics, context)
        for context in (
            None,
            FitContext(measured_noise={"rate": 2.25, "attitude": 1.0}),
            FitContext(verdict="unknown"),
        )
    )
    assert "the stated noise predict" in stated[1]["says"]
    assert "rate 2.25" in louder[1]["says"]
    assert "attitude" not in louder[1]["says"]
    assert [g["name"] for g in stated] == ["converged", "explained", "prior"]
    assert stated[2]["passed"]
    assert unknown[-1]["name"] == "diagnosed"
    assert not unknown[-1]["passed"]


def test_what_is_blamed_for_a_contradiction_is_in_campaigns_of_files_and_of_python():
    model = Model(small_campaign())
    for factor in (1.0 / 0.7, 57.29578):
        theta = np.array(model.space.mean)
        theta[6:9] *= factor
        gate = prior_gate(SimpleNamespace(model=model, theta=theta))
        assert not gate["passed"]
        assert "in the campaign" in gate["says"]
