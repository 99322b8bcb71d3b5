"""Where data say nothing the posterior is the prior."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.chains import D

from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.sampler import sample
from bayes_inertia.inference.settings import Settings
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.forward_model import Model


def _independent(chains, n: int, seed: int) -> np.ndarray:
    """n draws (n, d), each of another walker or long after it."""
    draws = chains.samples[:, :, :: max(1, int(np.ceil(8 * chains.diagnostics.tau_max)))].reshape(
        -1, chains.samples.shape[-1]
    )
    assert len(draws) >= n
    return np.random.default_rng(seed).permutation(draws)[:n]


def _p_values(draws: np.ndarray, reference: np.ndarray) -> np.ndarray:
    return np.array(
        [stats.ks_2samp(a, b).pvalue for a, b in zip(draws.T, reference.T, strict=True)]
    )


@pytest.mark.long
@pytest.mark.slow
def test_without_motion_the_posterior_is_the_prior_physical_edge_included(flying, setup_type):
    """A quarter of this prior's tensors break the triangle inequality: its edge is sampled, not
    only its middle.
    """
    setup = setup_type(
        turns=((0.0, 0.0, 0.0),),
        rows=64,
        relative_sigma=0.25,
        product_sigma=0.3,
        start_rate=(0.0, 0.0, 0.0),
        start_momentum=0.0,
    )
    model = Model(flying(3, setup).campaign)
    rng = np.random.default_rng(0)
    assert np.mean(np.asarray(inertia_tensor.is_physical(model.space.draw(rng, 2000)[:, :6]))) < 0.9
    at = estimate(model)
    chains = sample(at, Settings(steps=144, max_steps=144))
    assert chains.diagnostics.converged
    assert np.all(np.asarray(inertia_tensor.is_physical(chains.samples[..., :6])))
    draws, prior = _independent(chains, 1000, 1), model.draw_prior(rng, 20_000)
    assert _p_values(draws, prior).min() > 1e-3 / D
    # The smallest distance from the triangle inequality's edge, as the prior has it.
    edge = [
        0.5 * m.sum(-1) - m[..., -1]
        for m in (inertia_tensor.principal_moments(x[:, :6]) for x in (draws, prior))
    ]
    assert stats.ks_2samp(*edge).pvalue > 1e-3
    # The same test notices a prior without the constraint.
    assert _p_values(draws, model.space.draw(rng, 20_000)).min() < 1e-4


@pytest.mark.long
@pytest.mark.slow
def test_what_one_slew_cannot_see_stays_as_the_prior_has_it(flying, setup_type):
    setup = setup_type(
        turns=((0.8, 0.0, 0.0),), rows=64, start_rate=(0.0, 0.0, 0.0), start_momentum=0.0
    )
    at = estimate(Model(flying(3, setup).campaign))
    contraction = 1.0 - (at.sd / at.model.space.sd) ** 2
    unseen = np.flatnonzero(contraction < 0.01)
    assert {"Jyy", "Jzz", "Jyz"} <= {at.model.space.names[i] for i in unseen}
    assert contraction[0] > 0.99
    chains = sample(at, Settings())
    assert chains.diagnostics.converged
    assert np.all(np.asarray(inertia_tensor.is_physical(chains.samples[..., :6])))
    draws, prior = (
        _independent(chains, 700, 2),
        at.model.draw_prior(np.random.default_rng(1), 20_000),
    )
    assert _p_values(draws[:, unseen], prior[:, unseen]).min() > 1e-3 / len(unseen)
    assert _p_values(draws[:, :1], prior[:, :1]).max() < 1e-6
