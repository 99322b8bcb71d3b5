"""Effects without a fixed shape, integrated out: against dense Gaussians, and calibrated."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import linalg, stats

from bayes_inertia.inference.hyperparameters import Evidence
from bayes_inertia.inference.laplace import marginal
from bayes_inertia.inference.likelihood import information_blocks
from bayes_inertia.inference.marginal_posterior import (
    conditional_point,
    log_density_of,
    prior_roots,
)
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior_groups import stochastic_signals
from bayes_inertia.inference.proposal import EvidenceMove, IndependenceMove, explored_sizes
from bayes_inertia.physics.effects.rate_bias import RateBiasSlewDrift
from bayes_inertia.physics.effects.rate_noise import RateRandomWalk
from bayes_inertia.physics.effects.torque_noise import TorqueNoise
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import log_prior

DENSITY = 1e-5  # of the simulated walks [rad/s^1.5]


def wandering(campaign, seed: int, density: float = DENSITY):
    """The campaign with a random walk of the rate bias, drawn reading by reading."""
    rng = np.random.default_rng(seed)
    slews = []
    for slew in campaign.slews:
        steps = np.diff(slew.time, prepend=slew.time[0] - 1.0)
        walk = np.cumsum(density * np.sqrt(steps)[:, None] * rng.normal(size=slew.rate.shape), 0)
        slews.append(replace(slew, rate=slew.rate + walk))
    return replace(campaign, slews=tuple(slews))


@pytest.fixture(scope="module")
def wandered(small_flown):
    """Fit of a small campaign with a walk and a random torque, few coefficients each."""
    effects = (RateRandomWalk(knots=4), TorqueNoise(pieces=4))
    model = Model(wandering(small_flown.campaign, 5), effects)
    return estimate(model, starts=1, discount=False)


@pytest.mark.long
@pytest.mark.slow
def test_a_signal_is_where_it_is_whatever_the_slews_own_clock_says(wandered):
    old = wandered.model
    slews = tuple(replace(slew, time=slew.time + 5e5) for slew in old.campaign.slews)
    later = replace(wandered, model=Model(replace(old.campaign, slews=slews), old.effects))
    chains = SimpleNamespace(samples=np.tile(wandered.theta, (2, 2, 3, 1)))
    before, after = (
        stochastic_signals(fit, chains, np.random.default_rng(1)) for fit in (wandered, later)
    )
    for name, signal in before.items():
        np.testing.assert_allclose(after[name], signal, atol=1e-6 * np.abs(signal).max())


@pytest.mark.long
@pytest.mark.slow
def test_silent_coefficients_take_no_step_and_change_nothing_else(wandered):
    model, point = wandered.model, wandered.point
    full, silent = (
        information_blocks(model, point, wandered.white, wandered.free, silent=said)
        for said in (False, True)
    )
    shared = len(wandered.free) + len(point.bias)
    of_effects = np.arange(full.matrix.shape[-1]) >= shared + model.structure.n_start
    assert of_effects.any()
    kept = full.matrix * ~of_effects * ~of_effects[:, None]
    scale = np.sqrt(np.einsum("scpp->scp", full.matrix).max((0, 1)))
    np.testing.assert_allclose(
        silent.matrix, kept, atol=1e-10 * np.outer(scale, scale).max(), rtol=1e-9
    )
    assert np.abs(full.matrix[..., of_effects]).max() > 0.0
    assert not silent.matrix[..., of_effects].any()
    assert not silent.gradient[..., of_effects].any()


def dense_log_integral(fitted, theta) -> float:
    """log N(residuals; 0, 1 + A A^T), all nuisances of all slews in one matrix A.

    By one QR decomposition: the covariance itself has a condition of 1e14, as start states move
    residuals by 1e5 sigmas.
    """
    model, d = fitted.model, len(fitted.theta)
    structure, rows = model.structure, fitted.linearised().rows
    slews, numbers = rows.residual.shape
    contexts = model.data.arrays.slews.context
    before, after = (
        [
            linalg.block_diag(*(root for effect in effects for root in np.asarray(effect[s])))
            for s in range(slews)
        ]
        for effects in (
            prior_roots(structure, jnp.asarray(x), contexts) for x in (fitted.theta, theta)
        )
    )
    free = np.ones(structure.n_start)
    own_nuisances = rows.jacobian.shape[-1] - d - 3
    A = np.zeros((slews * numbers, 3 + slews * own_nuisances))
    A[:, :3] = rows.jacobian[..., d : d + 3].reshape(-1, 3)
    residual = np.zeros(slews * numbers)
    for s in range(slews):
        part = slice(s * numbers, (s + 1) * numbers)
        columns = slice(3 + s * own_nuisances, 3 + (s + 1) * own_nuisances)
        own = rows.jacobian[s][:, d + 3 :]
        all_zero = rows.residual[s] - rows.jacobian[s][:, d : d + 3] @ fitted.point.bias
        residual[part] = all_zero - own @ fitted.point.local[s]
        A[part, columns] = own @ linalg.block_diag(
            np.diag(free), np.linalg.solve(before[s], after[s])
        )
    orthogonal, root = np.linalg.qr(np.vstack([A, np.eye(A.shape[1])]))
    whole = np.concatenate([residual, np.zeros(A.shape[1])])
    unexplained = whole - orthogonal @ (orthogonal.T @ whole)
    return float(-0.5 * unexplained @ unexplained - np.sum(np.log(np.abs(np.diag(root)))))


@pytest.mark.long
@pytest.mark.slow
def test_the_integral_is_that_of_the_dense_gaussian(wandered):
    model, learnt = wandered.model, list(wandered.model.structure.hyperparameters)
    rng = np.random.default_rng(6)
    thetas = np.tile(wandered.theta, (9, 1))
    thetas[1:, learnt] *= np.exp(1.5 * rng.normal(size=(8, len(learnt))))
    ours = np.asarray(
        log_density_of(model.structure, marginal(wandered), batch=32)(jnp.asarray(thetas))
    )
    ours = ours - np.asarray(log_prior(model.space.constants(), jnp.asarray(thetas)))
    dense = np.array([dense_log_integral(wandered, theta) for theta in thetas])
    assert np.ptp(dense) > 10.0
    np.testing.assert_allclose(ours - ours[0], dense - dense[0], atol=1e-8 * np.abs(dense).max())


@pytest.mark.slow
def test_the_evidence_is_largest_at_the_fit(wandered):
    """Its gradient in the learnt parameters vanishes, and agrees with the sampled density's."""
    evidence = Evidence(
        wandered.model, wandered.point, wandered.white, np.arange(len(wandered.theta))
    )
    standardised = evidence.standardised(wandered.theta)
    for i, unit in enumerate(np.eye(len(standardised))):
        (up, slope), (here, _), (down, _) = (
            evidence.negative_log(standardised + step * unit) for step in (0.2, 0.0, -0.2)
        )
        assert min(up, down) > here - 5e-3
        # Slopes belong to values: over a small step to both sides.
        after, before = (
            evidence.negative_log(standardised + (0.2 + h) * unit)[0] for h in (1e-4, -1e-4)
        )
        assert slope[i] == pytest.approx((after - before) / 2e-4, rel=1e-4, abs=1e-5)


def acceptance(move, structure, frozen) -> float:
    """Of an independence sampler, from importance weights of its proposals."""
    draws = move.draw(np.random.RandomState(8), 256)
    density = np.asarray(log_density_of(structure, frozen, batch=32)(jnp.asarray(draws)))
    weights = density - move.log_density(draws)
    weights = np.exp(weights - weights.max())
    return float(np.minimum(weights[:, None], weights).sum() / (len(weights) * weights.sum()))


@pytest.mark.long
@pytest.mark.slow
def test_proposals_by_evidence_resemble_the_posterior(wandered):
    model, everything = wandered.model, np.arange(len(wandered.theta))
    evidence = Evidence(model, wandered.point, wandered.white, everything)
    ours = EvidenceMove(evidence, explored_sizes(evidence, np.random.RandomState(9)))
    logarithmic = np.array([p.logarithmic for p in model.space.priors])
    # One ellipsoid around everything, the negative control, resembles it less.
    ellipsoid = IndependenceMove(wandered.theta, wandered.covariance, logarithmic=logarithmic)
    frozen = marginal(wandered)
    assert acceptance(ours, model.structure, frozen) > 0.7
    assert acceptance(ellipsoid, model.structure, frozen) < 0.5


@pytest.mark.long
@pytest.mark.slow
def test_drawn_nuisances_have_their_conditional_mean_and_spread(wandered):
    frozen, structure = marginal(wandered), wandered.model.structure
    theta = wandered.theta.copy()
    learnt = list(structure.hyperparameters)
    size = 3 + wandered.point.local.size
    at_fit = conditional_point(structure, frozen, theta, np.zeros(size))
    np.testing.assert_allclose(at_fit.local, wandered.point.local, atol=0.05)
    # Coefficients with a vanishing prior keep their prior: standard normal draws.
    theta[learnt] *= 1e-9
    noise = np.random.default_rng(7).normal(size=size)
    drawn = conditional_point(structure, frozen, theta, noise)
    own = noise[3:].reshape(wandered.point.local.shape)[:, structure.n_start :]
    np.testing.assert_allclose(drawn.local[:, structure.n_start :], own, atol=1e-3)


def test_without_stochastic_effects_nothing_changes(fitted):
    assert marginal(fitted).coefficients is None
    assert fitted.point.n_local == fitted.model.structure.n_start


@pytest.mark.long
@pytest.mark.slow
def test_another_drift_in_each_slew_is_learnt(flown):
    rng = np.random.default_rng(8)
    slews = tuple(
        replace(s, rate=s.rate + s.time[:, None] * 3e-6 * rng.normal(size=3))
        for s in flown.campaign.slews
    )
    campaign = replace(flown.campaign, slews=slews)
    with_drift = estimate(Model(campaign, (RateBiasSlewDrift(),)), starts=1)
    sd, sd_sd = with_drift.theta[9], with_drift.sd[9]
    assert abs(np.log(sd / 3e-6)) < 4.0 * sd_sd / sd
    assert not with_drift.discounted
    assert estimate(Model(campaign), starts=1).discounted


@pytest.mark.long
@pytest.mark.slow
def test_z_scores_under_a_random_walk_are_calibrated(flying):
    """With the effect they are standard normal (0.1 % two-sided); without it far too wide."""
    scores, plain = [], []
    for seed in range(5):
        flown = flying(100 + seed)
        campaign = wandering(flown.campaign, seed)
        for effects, into in (((RateRandomWalk(knots=9),), scores), ((), plain)):
            fitted = estimate(Model(campaign, effects), starts=1, discount=False)
            gap = fitted.theta[:9] - flown.truth.theta
            covariance = fitted.covariance[:9, :9]
            into.append(gap @ np.linalg.solve(covariance, gap))
    # Sums of squares in the metric of the covariance: chi^2 with 9 degrees of freedom each.
    low, high = stats.chi2.interval(0.999, 9 * len(scores))
    assert low < np.sum(scores) < high
    assert np.sum(plain) > 2.0 * high
