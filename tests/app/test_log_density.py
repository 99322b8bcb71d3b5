"""The public density: what `fit` samples, for any sampler."""

from __future__ import annotations

import pickle

import emcee
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

import bayes_inertia as bi
from bayes_inertia.physics.small_campaign import small_campaign

SETTINGS = bi.Settings(seed=3, ensembles=2, walkers=32, steps=24, max_steps=24)
EFFECTS = (bi.LIBRARY[0],)


@pytest.fixture(scope="module")
def campaign():
    return small_campaign()


@pytest.fixture(scope="module")
def density(campaign):
    return bi.log_density(campaign, seed=3)


@pytest.fixture(scope="module")
def draws(density):
    rng = np.random.default_rng(0)
    return rng.multivariate_normal(density.mean, density.covariance, 6, method="cholesky")


@pytest.mark.slow
def test_names_and_units_are_those_of_the_fit(density):
    assert density.names == ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")
    assert density.units == ("kg m^2",) * 6 + ("",) * 3
    assert repr(density).startswith("LogDensity of small: Jxx, ")


@pytest.mark.slow
def test_it_is_the_density_that_fit_samples(campaign, density):
    posterior = bi.fit(campaign, settings=SETTINGS)
    lp = posterior.tree["sample_stats"]["lp"].values.ravel()
    np.testing.assert_allclose(density(posterior.samples), lp, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_numpy_and_jax_agree_and_shapes_are_kept(density, draws):
    of_numpy, of_jax = density(draws), density(jnp.asarray(draws))
    assert isinstance(of_numpy, np.ndarray)
    assert isinstance(of_jax, jax.Array)
    np.testing.assert_allclose(of_numpy, of_jax, rtol=0, atol=1e-7)
    assert density(draws[0]).shape == density(jnp.asarray(draws[0])).shape == ()
    assert density(draws[0]) == pytest.approx(of_numpy[0], abs=1e-9)


@pytest.mark.long
@pytest.mark.slow
def test_slopes_are_those_of_differences(density, draws):
    slope = np.asarray(jax.jit(jax.grad(density))(jnp.asarray(draws[1])))
    steps = 1e-2 * np.diag(np.sqrt(np.diag(density.covariance)))
    differences = np.array([density(draws[1] + h) - density(draws[1] - h) for h in steps]) / 2.0
    np.testing.assert_allclose(slope @ steps, differences, atol=1e-6)


@pytest.mark.slow
def test_it_is_zero_where_J_is_no_body(density):
    thin = density.mean.copy()
    thin[0] = thin[1] + thin[2] + 0.1
    assert density(thin) == -np.inf
    assert density(jnp.asarray(thin)) == -np.inf
    assert density.log_likelihood(thin) == -np.inf


@pytest.mark.slow
def test_prior_and_likelihood_make_the_density(density, draws):
    both = density.log_prior(draws) + density.log_likelihood(draws)
    np.testing.assert_allclose(both, density(draws), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_the_unit_cube_becomes_the_prior(density):
    space = density.estimate.model.space
    middle = density.prior_transform(np.full(9, 0.5))
    np.testing.assert_allclose(middle, space.mean)
    high = density.prior_transform(np.full((2, 9), stats.norm.cdf(1.0)))
    np.testing.assert_allclose(high - middle, np.tile(space.sd, (2, 1)))


def test_draws_by_name_hold_tensors(density, draws):
    named = density.to_parameters(draws)
    np.testing.assert_array_equal(named["K2"], draws[:, 7])
    assert named["J"].shape == (6, 3, 3)
    np.testing.assert_array_equal(named["J"][:, 0, 2], draws[:, 4])


@pytest.mark.long
@pytest.mark.slow
def test_effects_are_parameters_and_noise_may_be_sampled(campaign):
    density = bi.log_density(campaign, effects=EFFECTS)
    assert density.names[9].startswith(f"{EFFECTS[0].name}.")
    noise = bi.NoiseModel(rate=bi.ChannelNoise(scale_sampled=True))
    density = bi.log_density(campaign, noise=noise)
    theta = np.stack([density.mean] * 2)
    np.testing.assert_allclose(density(theta), density(jnp.asarray(theta)), atol=1e-7)


@pytest.mark.parametrize("theta", [np.zeros(8), np.zeros((2, 3, 9)), 1.0])
def test_a_wrong_shape_is_refused(density, theta):
    with pytest.raises(bi.SettingsError, match=r"give \(9,\) or \(n, 9\)"):
        density(theta)


def test_the_density_of_no_points_is_empty(density):
    assert density(np.zeros((0, 9))).shape == density(jnp.zeros((0, 9))).shape == (0,)


@pytest.mark.parametrize("number", [-0.1, 1.5, np.nan])
def test_what_is_outside_the_unit_cube_is_refused(density, number):
    with pytest.raises(bi.SettingsError, match="unit: a number is not between 0 and 1"):
        density.prior_transform(np.full(9, number))


def test_a_wrong_number_of_parameters_is_refused_everywhere(density):
    functions = (
        density.log_prior,
        density.prior_transform,
        density.to_parameters,
        density.estimate.model.predict,
    )
    for function in functions:
        with pytest.raises(bi.SettingsError, match=r"its shape is \(3,\); give \(9,\)"):
            function(np.ones(3))


@pytest.mark.slow
def test_it_goes_to_other_processes_after_its_first_call(density, draws):
    before = density(draws)
    again = pickle.loads(pickle.dumps(density))
    assert again == density
    np.testing.assert_array_equal(again(draws), before)


@pytest.mark.long
@pytest.mark.slow
def test_an_optimizer_of_scipy_finds_the_same_maximum(density):
    root = np.linalg.cholesky(density.covariance)
    slope = jax.jit(jax.value_and_grad(lambda z: -density(density.mean + root @ z)))
    begin = np.random.default_rng(1).standard_normal(9)
    found = optimize.minimize(lambda z: tuple(map(np.asarray, slope(z))), begin, jac=True)
    # The maximum of the density lies beside that of its Laplace approximation.
    assert np.abs(found.x).max() < 0.05


@pytest.mark.long
@pytest.mark.slow
def test_emcee_by_hand_gives_the_posterior_of_fit(campaign, density):
    posterior = bi.fit(campaign, settings=bi.Settings(seed=3, steps=60, target_ess=4000))
    sampler = emcee.EnsembleSampler(64, 9, density, vectorize=True, moves=emcee.moves.DEMove())
    rng = np.random.default_rng(5)
    starts = rng.multivariate_normal(density.mean, density.covariance, 64, method="cholesky")
    state = emcee.State(starts, random_state=np.random.RandomState(6).get_state())
    sampler.run_mcmc(state, 1500)
    tau = sampler.get_autocorr_time(quiet=True).max()
    draws = sampler.get_chain(discard=200, flat=True)
    error = np.sqrt(1.0 / (len(draws) / tau) + 1.0 / 4000)
    sd = posterior.samples.std(0)
    assert np.abs((draws.mean(0) - posterior.samples.mean(0)) / sd).max() < 4.0 * error
    assert np.abs(draws.std(0) / sd - 1.0).max() < 4.0 * error / np.sqrt(2.0)
    # Half the effective samples are wanted for the first to be worth anything.
    assert error < 0.1
