"""A joint prior in a fit: an update is the joint fit, and old priors stay what they were."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood_summary import product, summary_of, with_prior
from bayes_inertia.inference.objective import normal_prior, prior_equations
from bayes_inertia.physics.parameters import log_prior, prior_residual
from bayes_inertia.physics.small_campaign import small_campaign

J_AND_K = slice(0, 9)
EXAMPLE = Path(bi.__file__).parent / "example"


def as_prior(estimate):
    """What an estimate tells the next campaign."""
    space, covariance = estimate.model.space, estimate.covariance[J_AND_K, J_AND_K]
    return bi.GaussianPrior(space.names[J_AND_K], estimate.theta[J_AND_K], covariance)


def own_prior(campaign):
    """The campaign's own prior, said as a joint one."""
    space = bi.Model(campaign).space
    covariance = np.diag(space.sd[J_AND_K] ** 2)
    return bi.GaussianPrior(space.names[J_AND_K], space.mean[J_AND_K], covariance)


@dataclass(frozen=True)
class BiasOfEachPart(bi.Effect):
    """The rate bias of two campaigns that are fitted as one: each has its own."""

    first: int = 3
    sigma: float = 2e-6
    name = "bias_of_each_part"

    def parameters(self, campaign):
        components = tuple(f"{part}{axis}" for part in "ab" for axis in "xyz")
        prior = bi.Normal(0.0, self.sigma)
        return (bi.vector("bias", components, unit="rad/s", prior=prior),)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + jnp.where(slew.index < self.first, p["bias"][:3], p["bias"][3:])


@pytest.fixture(scope="module")
def example():
    return bi.read_campaign(EXAMPLE)


def joint(campaign, first):
    """Both parts fitted at once: J and K are shared, the bias of the gyro is not."""
    sensor = replace(campaign.rate_sensor, bias_sigma=(1e-12,) * 3)
    effect = BiasOfEachPart(first, campaign.rate_sensor.bias_sigma[0])
    return bi.estimate(bi.Model(replace(campaign, rate_sensor=sensor), (effect,)))


@pytest.mark.long
@pytest.mark.slow
def test_an_update_equals_the_joint_fit(example):
    together = joint(example, 3)
    former = bi.estimate(example.subset(range(3)))
    updated = bi.estimate(replace(example.subset(range(3, 5)), prior=as_prior(former)))
    sd = together.sd[J_AND_K]
    off = (updated.theta[J_AND_K] - together.theta[J_AND_K]) / sd
    assert np.abs(off).max() < 0.01
    assert np.abs(updated.sd[J_AND_K] / sd - 1.0).max() < 0.01
    # Not because either part says all: each alone lies further off, and knows less.
    alone = bi.estimate(example.subset(range(3, 5)))
    for part in (former, alone):
        assert np.abs((part.theta - together.theta[J_AND_K])[:9] / sd).max() > 0.1
        assert (part.sd[J_AND_K] / sd).max() > 1.2


@pytest.mark.slow
def test_a_prior_without_correlations_is_the_stated_one_to_the_bit():
    campaign = small_campaign()
    stated = bi.estimate(campaign)
    said = bi.estimate(replace(campaign, prior=own_prior(campaign)))
    np.testing.assert_array_equal(stated.theta, said.theta)
    np.testing.assert_array_equal(stated.covariance, said.covariance)


def scaled(prior):
    """With the correlation between Jxx and Jyy in units of their sds."""
    matrix = np.eye(9)
    matrix[0, 1] = matrix[1, 0] = 0.9
    return replace(prior, covariance=np.outer(prior.sd, prior.sd) * matrix)


@pytest.fixture(scope="module")
def campaign():
    small = small_campaign()
    return replace(small, prior=scaled(own_prior(small)))


def test_the_density_is_that_of_the_joint_normal(campaign):
    space, prior = bi.Model(campaign).space, campaign.prior
    theta = space.draw(np.random.default_rng(1), 4)
    distance = theta - prior.mean
    wanted = -0.5 * np.einsum("ni,ij,nj->n", distance, np.linalg.inv(prior.covariance), distance)
    np.testing.assert_allclose(log_prior(space.constants(), theta), wanted, rtol=1e-9)
    residual = np.asarray(prior_residual(space.constants(), theta))
    np.testing.assert_allclose(-0.5 * np.sum(residual**2, -1), wanted, rtol=1e-9)


def test_draws_have_the_covariance_and_single_sds_stay(campaign):
    space = bi.Model(campaign).space
    draws = space.draw(np.random.default_rng(2), 20_000)
    correlation = np.corrcoef(draws.T)
    assert correlation[0, 1] == pytest.approx(0.9, abs=0.01)
    assert abs(correlation[0, 2]) < 0.03
    np.testing.assert_allclose(draws.std(0), space.sd, rtol=0.03)
    np.testing.assert_array_equal(space.sd, bi.Model(small_campaign()).space.sd)
    middle = space.from_unit(np.full(9, 0.5))
    np.testing.assert_allclose(middle, space.mean)


def test_what_a_former_result_may_be_off_goes_together_as_its_parameters_do(campaign):
    """A size of J known to 2 %, and ratios known a hundred times better, moved K by three sds."""
    beyond = 0.3 * campaign.prior.sd
    model = bi.Model(replace(campaign, prior=replace(campaign.prior, beyond_sd=beyond)))
    # A campaign that tells nothing new.
    told = SimpleNamespace(
        model=model, theta=model.space.mean, covariance=campaign.prior.covariance
    )
    shifts = Estimate.prior_beyond_shifts.func(told)
    np.testing.assert_allclose(shifts.T @ shifts, 0.09 * campaign.prior.covariance, atol=1e-15)


@pytest.mark.slow
def test_what_is_known_adds_up(campaign):
    seen = bi.observe(bi.estimate(campaign))
    for p in seen.parameters:
        total = p.share.sum() + p.share_own_prior + p.share_other_priors
        assert total == pytest.approx(1.0, abs=1e-6)
    assert all(0.0 <= d.contraction <= 1.0 for d in seen.directions)


@pytest.mark.slow
def test_jax_samples_the_joint_prior_too(campaign):
    density = bi.log_density(campaign)
    theta = density.mean + 0.1 * np.sqrt(np.diag(density.covariance))
    assert density(theta) == pytest.approx(float(density(jnp.asarray(theta))), abs=1e-7)


@pytest.mark.slow
def test_bounds_and_logarithms_reach_the_fit():
    small = small_campaign()
    prior = bi.GaussianPrior(
        ("Jxx", "K1"),
        [np.log(3.2), 1.0],
        np.diag([0.05**2, 1e-4]),
        upper=[np.inf, 0.9999],
        logarithmic=("Jxx",),
    )
    space = bi.Model(replace(small, prior=prior)).space
    assert isinstance(space.priors[0], bi.LogNormal)
    assert space.mean[0] == pytest.approx(3.2)
    fitted = bi.estimate(replace(small, prior=prior))
    assert fitted.theta[6] < 0.9999
    draws = space.draw(np.random.default_rng(3), 500)
    assert draws[:, 6].max() <= 0.9999


@pytest.mark.slow
def test_a_moment_of_inertia_stays_within_its_bounds():
    small = small_campaign()
    prior = bi.GaussianPrior(("Jxx",), [3.2], [[0.01]], lower=[3.2003], upper=[3.6])
    fitted = bi.estimate(replace(small, prior=prior), starts=1, discount=False)
    space = fitted.model.space
    assert 3.2003 <= fitted.theta[0] < 3.201
    assert np.isfinite(log_prior(space.constants(), fitted.theta))


def test_bounds_hold_for_draws_of_correlated_parameters():
    small = small_campaign()
    prior = scaled(own_prior(small))
    upper = np.full(9, np.inf)
    upper[0] = prior.mean[0]
    space = bi.Model(replace(small, prior=replace(prior, upper=upper))).space
    draws = space.draw(np.random.default_rng(4), 400)
    assert draws.shape == (400, 9)
    assert draws[:, 0].max() <= prior.mean[0]


def test_a_parameter_that_is_not_there_is_named():
    prior = bi.GaussianPrior(("Jxx", "K4"), [3.2, 1.0], np.eye(2))
    with pytest.raises(bi.CampaignError, match="'K4' is no element of J or scale factor"):
        bi.Model(replace(small_campaign(), prior=prior))


def test_the_likelihood_is_what_a_joint_prior_and_the_posterior_imply():
    rng = np.random.default_rng(5)
    root, data = rng.standard_normal((2, 9, 9))
    prior_covariance = root @ root.T + np.eye(9)
    sd = np.sqrt(np.diag(prior_covariance))
    correlation, at = prior_covariance / np.outer(sd, sd), rng.standard_normal(9)
    told = data @ data.T + 1e-3 * np.eye(9)
    mean = rng.standard_normal(9)
    covariance = np.linalg.inv(told + np.linalg.inv(prior_covariance))
    posterior = covariance @ (told @ mean + np.linalg.solve(prior_covariance, at))
    summary = summary_of("a", posterior, covariance, at, sd, correlation)
    np.testing.assert_allclose(summary.precision, told, atol=1e-6)
    np.testing.assert_allclose(told @ summary.mean, told @ mean, atol=1e-5)
    again = with_prior(product([summary]))
    np.testing.assert_allclose(again[0], posterior, atol=1e-6)
    np.testing.assert_allclose(again[1], covariance, atol=1e-6)


def test_a_logarithmic_prior_alone_tells_nothing():
    prior = bi.GaussianPrior.of_principal_moments([3.2, 2.2, 1.9], 0.2, 10.0)
    model = bi.Model(replace(small_campaign(), prior=prior))
    theta = model.space.mean * np.where(np.arange(9) < 3, [0.9] * 9, 1.0)
    precision, _ = prior_equations(model, theta, np.arange(9))
    mean, sd = normal_prior(model, theta)
    covariance = np.linalg.inv(precision)
    summary = summary_of("a", theta, covariance, mean, sd, model.space.correlation)
    np.testing.assert_allclose(summary.precision * np.outer(sd, sd), 0.0, atol=1e-6)
    # Where the prior was thought of as normal it told a tenth of itself.
    space = model.space
    other = summary_of("a", theta, covariance, space.mean, space.sd, space.correlation)
    assert np.max(other.precision * np.outer(sd, sd)) > 0.1
