"""Nuisances integrated out, against sampling them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.inference.laplace import marginal
from bayes_inertia.inference.likelihood import Point, residuals, unpadded_sensitivities
from bayes_inertia.inference.marginal_posterior import conditional_point, log_density_of


def joint_log_density(fitted):
    """log p(theta, bias, local | data) of whole vectors (batch, all): residuals and priors, no
    approximation.
    """
    model, d = fitted.model, len(fitted.theta)
    prior_mean, prior_sd = jnp.asarray(model.space.mean), jnp.asarray(model.space.sd)
    shape, white, structure, data = (
        fitted.point.local.shape,
        fitted.white,
        model.structure,
        model.data,
    )

    def one(x, data, white):
        theta, bias, local = x[:d], x[d : d + 3], x[d + 3 :].reshape(shape)
        prediction = residuals(structure, Point(theta, bias, local), data, white)
        own = jnp.sum(((theta - prior_mean) / prior_sd) ** 2) + jnp.sum(x[d:] ** 2)
        return -0.5 * (sum(jnp.sum(r**2) for r in prediction) + own)

    compiled = jax.jit(jax.vmap(one, (0, None, None)))
    return lambda x: np.concatenate(
        [
            np.asarray(compiled(jnp.asarray(part), data, white))
            for part in np.split(x, len(x) // 1000)
        ]
    )


def importance(log_density, mean, covariance, rng, n):
    """Weighted draws from a slightly over-dispersed multivariate t: (draws, weights, effective
    sample size).
    """
    dof = 30.0
    scale = np.linalg.cholesky(covariance)
    z = rng.normal(size=(n, len(mean))) * np.sqrt(dof / rng.chisquare(dof, size=(n, 1)))
    draws = mean + z @ scale.T
    proposal = -0.5 * (dof + len(mean)) * np.log1p(np.sum(z**2, axis=1) / dof)
    log_weight = log_density(draws) - proposal
    weights = np.exp(log_weight - log_weight.max())
    weights /= weights.sum()
    return draws, weights, 1.0 / np.sum(weights**2)


def moments(draws, weights):
    mean = weights @ draws
    return mean, np.sqrt(weights @ (draws - mean) ** 2)


def compare(one, other):
    """Largest difference of means and of log sds in their Monte Carlo sigmas; each is (mean, sd,
    effective size).
    """
    (mean_a, sd_a, n_a), (mean_b, sd_b, n_b) = one, other
    of_mean = np.abs(mean_a - mean_b) / np.sqrt(sd_a**2 / n_a + sd_b**2 / n_b)
    of_sd = np.abs(np.log(sd_a / sd_b)) / np.sqrt(0.5 / n_a + 0.5 / n_b)
    return of_mean.max(), of_sd.max()


@pytest.mark.long
@pytest.mark.slow
def test_the_marginal_posterior_is_that_of_sampling_every_nuisance(small):
    rng, d, n = np.random.default_rng(31), len(small.theta), 3000
    model = small.model
    full = np.concatenate([small.theta, small.point.bias, small.point.local.ravel()])
    draws, weights, size = importance(
        joint_log_density(small), full, small.joint_covariance, rng, n
    )
    assert size > 0.2 * n
    joint = (*moments(draws[:, :d], weights), size)

    frozen = marginal(small)
    draws, weights, size = importance(
        lambda x: np.asarray(log_density_of(model.structure, frozen, batch=32)(jnp.asarray(x))),
        small.theta,
        small.covariance,
        rng,
        n,
    )
    assert size > 0.5 * n
    marginalised = (*moments(draws, weights), size)
    of_mean, of_sd = compare(joint, marginalised)
    # 18 comparisons: 4 sigma has a false alarm rate of 1e-3.
    assert of_mean < 4.0
    assert of_sd < 4.0

    # Negative control: nuisances held at their optimum instead of integrated out.
    ridge = frozen.ridge._replace(bias=0.0 * frozen.ridge.bias, local=0.0 * frozen.ridge.local)
    held = frozen._replace(ridge=ridge, root=0.0 * frozen.root)
    covariance = np.linalg.inv(small.hessian[:d, :d])
    draws, weights, size = importance(
        lambda x: np.asarray(log_density_of(model.structure, held, batch=32)(jnp.asarray(x))),
        small.theta,
        covariance,
        rng,
        n,
    )
    assert compare(joint, (*moments(draws, weights), size))[1] > 20.0


@pytest.mark.slow
def test_the_marginal_posterior_is_pointwise_that_of_integrating_at_each_theta(small):
    """At theta far out: Laplace's integral over the nuisances at THEIR optimum there, with its own
    determinant.
    """
    model, d, frozen = small.model, len(small.theta), marginal(small)
    rng = np.random.default_rng(32)
    thetas = (
        small.theta
        + 3.0 * (np.linalg.cholesky(small.covariance) @ rng.normal(size=(d, 12)) / np.sqrt(d)).T
    )
    thetas = np.concatenate([small.theta[None], thetas])
    ours = np.asarray(log_density_of(model.structure, frozen, batch=32)(jnp.asarray(thetas)))
    exact = np.array([integrated_over_nuisances(small, theta) for theta in thetas])
    gap = (ours - ours[0]) - (exact - exact[0])
    assert np.ptp(exact) > 2.0
    assert np.abs(gap).max() < 0.02, gap


def integrated_over_nuisances(fitted, theta):
    """log of the integral over bias and local nuisances at theta: Gauss-Newton to their optimum,
    then Laplace.
    """
    model, d = fitted.model, len(theta)
    m = model.structure.n_local
    nuisance = np.zeros(3 + model.n_slews * m)
    for _ in range(6):
        local = nuisance[3:].reshape(model.n_slews, m)
        point = Point(theta, nuisance[:3], local)
        at = unpadded_sensitivities(model, point, fitted.white, np.arange(d))
        H, g = np.eye(len(nuisance)), nuisance.copy()
        for r, jacobian in zip(at.residuals, at.jacobian, strict=True):
            for s in range(model.n_slews):
                columns = np.zeros((r.shape[1], len(nuisance)))
                columns[:, :3] = jacobian[s, :, d : d + 3]
                columns[:, 3 + s * m : 3 + (s + 1) * m] = jacobian[s, :, d + 3 :]
                H += columns.T @ columns
                g += columns.T @ np.asarray(r[s])
        chi2 = sum(float(np.sum(r**2)) for r in at.residuals) + nuisance @ nuisance
        nuisance = nuisance - np.linalg.solve(H, g)
    prior = np.sum(((theta - model.space.mean) / model.space.sd) ** 2)
    return -0.5 * (chi2 + prior) - 0.5 * np.linalg.slogdet(H)[1]


@pytest.mark.slow
def test_conditional_nuisances_have_the_joint_posteriors_moments(small):
    """theta from the marginal, nuisances given theta: together the joint Gaussian of the Laplace
    approximation.
    """
    model, d, n, rng = small.model, len(small.theta), 2000, np.random.default_rng(33)
    thetas = rng.multivariate_normal(small.theta, small.covariance, n, method="cholesky")
    size = 3 + small.point.local.size
    frozen = marginal(small)
    drawn = [
        conditional_point(model.structure, frozen, theta, rng.normal(size=size)) for theta in thetas
    ]
    draws = np.array([[*point.theta, *point.bias, *point.local.ravel()] for point in drawn])
    full = np.concatenate([small.theta, small.point.bias, small.point.local.ravel()])
    white = np.linalg.solve(np.linalg.cholesky(small.joint_covariance), (draws - full).T)
    # d + size whitened coordinates: each of unit variance, all uncorrelated.
    covariance = np.cov(white) - np.eye(d + size)
    assert np.abs(np.diag(covariance)).max() < 4.5 * np.sqrt(2.0 / n)
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 5.0 / np.sqrt(n)
    assert np.abs(white.mean(1)).max() < 4.5 / np.sqrt(n)


@pytest.mark.slow
def test_outside_the_physical_tensors_and_the_support_the_density_is_zero(small):
    theta = np.stack([small.theta] * 3)
    theta[1, 0] = theta[1, 1] + theta[1, 2] + 0.1
    theta[2, 7] = np.nan
    values = np.asarray(
        log_density_of(small.model.structure, marginal(small), batch=32)(jnp.asarray(theta))
    )
    assert np.isfinite(values[0])
    assert np.isneginf(values[1:]).all()
