"""Student-t noise and noise of sampled scale, against quadrature, brute force and simulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special, stats
from support.noisy_campaigns import importance_moments, spiked, with_student_t_rates

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError, SettingsError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import clean_fit, with_modelled_outliers
from bayes_inertia.inference.density_marginal import (
    density_marginal,
    log_density_with_densities,
    nuisance_optimum,
)
from bayes_inertia.inference.laplace import marginal
from bayes_inertia.inference.likelihood import Point, residuals
from bayes_inertia.inference.marginal_posterior import (
    SlewEquations,
    eliminated,
    log_density_of,
    steps_given,
)
from bayes_inertia.inference.noise_model import densities_of
from bayes_inertia.inference.predicted_telemetry import losses
from bayes_inertia.physics.channel_noise import (
    ChannelNoise,
    NoiseModel,
    noise_model_from_json,
    noise_model_from_text,
)
from bayes_inertia.physics.densities import FAMILIES
from bayes_inertia.physics.forward_model import Model

STUDENT_T = FAMILIES["student_t"]
HEAVY = NoiseModel(rate=ChannelNoise("student_t"))
SAMPLED = NoiseModel(rate=ChannelNoise(scale_sampled=True))
ALL = NoiseModel(
    rate=ChannelNoise("student_t", None, scale_sampled=True),
    attitude=ChannelNoise(scale_sampled=True),
)
DATA = Path(__file__).parents[1] / "data"


def fitted(campaign, noise=None, **options):
    return optimizer.estimate(Model(campaign, noise=noise or NoiseModel()), starts=1, **options)


def too_large(estimate):
    return [name for name, test in estimate.tests.items() if test.too_large]


@pytest.mark.parametrize("degrees", [pytest.param(1.0, marks=pytest.mark.slow), 2.5, 30.0])
def test_the_formulas_of_student_t_noise(degrees):
    """Against Lange, Little and Taylor (1989), appendix B, and scipy."""
    y, nu = jnp.linspace(-6.0, 6.0, 25), degrees
    log_density = -STUDENT_T.loss(y, nu) - 0.5 * np.log(2.0 * np.pi)
    assert np.allclose(log_density, stats.t(nu).logpdf(y), atol=1e-12)
    assert np.allclose(STUDENT_T.slope(y, nu), (nu + 1.0) * y / (nu + y**2), atol=1e-12)
    curvature = (nu + 1.0) * (nu - y**2) / (nu + y**2) ** 2
    assert np.allclose(STUDENT_T.curvature(y, nu), curvature, atol=1e-12)
    moments = STUDENT_T.moments(nu)
    trigamma = special.polygamma(1, 0.5 * nu) - special.polygamma(1, 0.5 * (nu + 1.0))
    of_degrees = 0.25 * trigamma - 0.5 * (nu + 5.0) / (nu * (nu + 1.0) * (nu + 3.0))
    across = -2.0 / ((nu + 1.0) * (nu + 3.0))
    information = [[2.0 * nu / (nu + 3.0), across], [across, of_degrees]]
    assert np.allclose(moments.information, information, rtol=1e-7, atol=1e-9)
    assert float(moments.location) == pytest.approx((nu + 1.0) / (nu + 3.0), rel=1e-9)
    assert float(moments.worth) == pytest.approx((nu + 3.0) / nu, rel=1e-9)
    assert float(moments.per_parameter) == pytest.approx((nu + 2.0) / (nu + 5.0), rel=1e-9)


def test_gaussian_noise_is_the_trivial_density():
    gaussian, y = FAMILIES["gaussian"], jnp.linspace(-6.0, 6.0, 25)
    assert np.array_equal(gaussian.slope(y, 0.0), y)
    assert np.array_equal(gaussian.curvature(y, 0.0), np.ones(25))
    moments = gaussian.moments(0.0)
    assert np.allclose(moments.information, [[2.0, 0.0], [0.0, 0.0]], atol=1e-9)
    assert np.allclose(moments[1:], 1.0, rtol=1e-9)


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
def test_a_density_is_one_whole(family):
    """What every family promises: a density, its tail and its draws belong together."""
    shape = 3.0
    edges = np.linspace(-8.0, 8.0, 161)
    density = np.exp(-np.asarray(family.loss(edges, shape))) / np.sqrt(2.0 * np.pi)
    inside = integrate.simpson(density, x=edges)
    assert inside == pytest.approx(1.0 - 2.0 * family.upper_tail(np.array(8.0), shape), abs=1e-6)
    draws = family.draw(np.random.default_rng(1), shape, (4000,))
    scores = family.normal_scores(draws, shape)
    assert stats.kstest(scores, "norm").pvalue > 1e-3
    assert family.heavy == (stats.kurtosis(draws) > 1.0)
    # Of a density with a kink, such as |y|, the curvature misses the kink: no fit can use it.
    curvature = np.asarray(family.curvature(jnp.asarray(edges), shape))
    mean = integrate.simpson(density * curvature, x=edges)
    assert mean == pytest.approx(float(family.moments(shape).location), abs=1e-3)


def test_normal_scores_are_normal():
    numbers = np.random.default_rng(1).standard_t(3.0, 4000)
    assert stats.kstest(STUDENT_T.normal_scores(numbers, 3.0), "norm").pvalue > 1e-3
    assert stats.kstest(STUDENT_T.normal_scores(numbers, 30.0), "norm").pvalue < 1e-6


@pytest.mark.slow
def test_nuisances_eliminated_slew_by_slew_are_those_of_the_whole_matrix():
    rng, shared, own, slews = np.random.default_rng(2), 2, 3, 4
    roots = rng.normal(size=(slews, 9, shared + own))
    blocks = np.einsum("sni,snj->sij", roots, roots)
    slope, size = rng.normal(size=(slews, shared + own)), shared + slews * own
    whole, right = np.eye(size), np.zeros(size)
    for s, block in enumerate(blocks):
        index = [*range(shared), *range(shared + s * own, shared + (s + 1) * own)]
        whole[np.ix_(index, index)] += block
        right[index] += slope[s]
    zeros = np.zeros(shared), np.zeros((slews, own))
    equations = SlewEquations(0.0, blocks, slope, np.eye(shared), zeros[0], 0.0, zeros[1])
    parts = eliminated((), jax.tree.map(jnp.asarray, equations))
    found = np.concatenate([np.ravel(x) for x in steps_given(parts)])
    assert np.allclose(found, -np.linalg.solve(whole, right))
    drawn = [
        np.concatenate([np.ravel(x) for x in steps_given(parts, z)]) - found for z in np.eye(size)
    ]
    assert np.allclose(np.transpose(drawn) @ drawn, np.linalg.inv(whole))


@pytest.mark.long
@pytest.mark.slow
def test_gaussian_noise_of_scale_one_has_the_plain_marginal(flown):
    plain, scaled = (fitted(flown.campaign, noise) for noise in (None, SAMPLED))
    rng = np.random.default_rng(3)
    thetas = plain.theta + rng.normal(size=(8, 9)) @ np.linalg.cholesky(plain.covariance).T
    ours = log_density_with_densities(scaled, batch=8)(np.column_stack([thetas, np.ones(8)]))
    theirs = np.asarray(
        log_density_of(plain.model.structure, marginal(plain), batch=32)(jnp.asarray(thetas))
    )
    assert np.ptp(theirs) > 1.0
    assert np.ptp(ours - theirs) < 1e-3


def exact_marginals(estimate, thetas, rng, n=4000):
    """log of the integrals over the nuisances by importance sampling, and their standard errors."""
    model, frozen = estimate.model, density_marginal(estimate)
    densities = densities_of(model)
    size = 3 + estimate.point.local.size
    dof = 30.0
    settled_at = jax.jit(lambda theta: nuisance_optimum(model.structure, densities, frozen, theta))

    def joint(theta, at, z):
        bias, local = steps_given(at.parts, z)
        point = Point(theta, at.point.bias + bias, local)
        r = residuals(model.structure, point, model.data, estimate.stated)
        return r, -0.5 * (jnp.sum(point.bias**2) + jnp.sum(point.local**2))

    joints = jax.jit(jax.vmap(joint, (None, None, 0)))
    results = []
    for theta in thetas:
        at = settled_at(jnp.asarray(theta))
        spread = np.sqrt(dof / rng.chisquare(dof, size=n))
        z = rng.normal(size=(n, size)) * spread[:, None]
        log_weight = []
        for part in np.split(z, n // 500):
            r, prior = joints(jnp.asarray(theta), at, jnp.asarray(part))
            numbers = zip(densities, r, frozen.valid, strict=True)
            loss = sum(
                losses(density, theta, np.asarray(values), np.asarray(ok)).sum(-1)
                for density, values, ok in numbers
            )
            proposal = -0.5 * (dof + size) * np.log1p(np.sum(part**2, axis=1) / dof)
            log_weight.append(np.asarray(prior) - loss - proposal)
        roots = (np.diagonal(x, axis1=-2, axis2=-1) for x in (at.parts.root, at.parts.shared_root))
        log_weight = np.concatenate(log_weight) - sum(np.log(x).sum() for x in roots)
        weight = np.exp(log_weight - log_weight.max())
        error = weight.std() / weight.mean() / np.sqrt(n)
        results.append((float(np.log(weight.mean()) + log_weight.max()), float(error)))
    return np.array(results).T


@pytest.mark.long
@pytest.mark.slow
def test_nuisances_under_student_t_noise_are_integrated_as_by_brute_force(small_flown):
    rng = np.random.default_rng(4)
    estimate = fitted(spiked(small_flown.campaign, 0.02)[0], ALL)
    root = np.linalg.cholesky(estimate.covariance)
    thetas = (
        estimate.theta
        + np.concatenate([np.zeros((1, 12)), 1.5 * rng.normal(size=(3, 12))]) @ root.T
    )
    prior_free = log_density_with_densities(estimate, batch=4)(thetas) - np.array(
        [log_prior_of(estimate, theta) for theta in thetas]
    )
    exact, errors = exact_marginals(estimate, thetas, rng)
    gap = (prior_free - prior_free[0]) - (exact - exact[0])
    assert np.ptp(exact) > 2.0
    # Laplace's own error beside that of the sampling: a fiftieth of a unit of log density.
    assert np.all(np.abs(gap) < 4.0 * np.hypot(errors, errors[0]) + 0.02), (gap, errors)
    # The same integral as of Gaussian noise is another one.
    gaussian = fitted(estimate.model.campaign, discount=False)
    plain = log_density_of(gaussian.model.structure, marginal(gaussian), batch=32)(
        jnp.asarray(thetas[:, :9])
    )
    assert np.max(np.abs(np.asarray(plain - plain[0]) - (exact - exact[0]))) > 1.0


def log_prior_of(estimate, theta):
    from bayes_inertia.physics.parameters import log_prior

    return float(log_prior(estimate.model.space.constants(), jnp.asarray(theta)))


@pytest.mark.long
@pytest.mark.slow
def test_a_sampled_scale_has_its_analytic_posterior(flown):
    """Inverse gamma times log-normal prior, of the squares that a plain fit leaves."""
    plain, estimate = fitted(flown.campaign), fitted(flown.campaign, SAMPLED)
    place = estimate.model.space.names.index("noise.rate_scale")
    squares = plain.information.chi2[:, 0].sum()
    dof = plain.information.n_data[:, 0].sum() - plain.effective_parameters[0]
    log_scale = np.linspace(-0.3, 0.3, 2001)
    density = -dof * log_scale - 0.5 * squares * np.exp(-2.0 * log_scale)
    density = density - 0.5 * (log_scale / 0.5) ** 2
    weight = np.exp(density - density.max())
    weight /= weight.sum()
    mean = weight @ log_scale
    sd = np.sqrt(weight @ (log_scale - mean) ** 2)
    moments = importance_moments(estimate, np.random.default_rng(5), 6000, logarithm_of=(place,))
    error = np.sqrt(1.0 / moments.effective)
    # The squares of the fit at another scale differ by a share of the effective parameters.
    assert abs(moments.mean[place] - mean) < (4.0 * error + 0.1) * sd
    assert abs(np.log(moments.sd[place] / sd)) < 4.0 * np.sqrt(0.5) * error + 0.02
    assert abs(np.log(estimate.theta[place]) - mean) < 0.2 * sd
    assert estimate.sd[place] / estimate.theta[place] == pytest.approx(sd, rel=0.05)


@pytest.mark.long
@pytest.mark.slow
def test_an_unknown_scale_widens_j_where_rows_are_few(flying, setup_type):
    """Against a mixture of plain fits, each of another noise, weighted by its evidence."""
    few = setup_type(turns=((0.6, 0.1, 0.0), (0.1, 0.5, 0.5)), rows=8, dt=12.0, fix_rows=(0, -1))
    campaign = flying(6, few).campaign
    plain, estimate = fitted(campaign, discount=False), fitted(campaign, SAMPLED)
    n = plain.information.n_data[:, 0].sum()
    log_scale = np.linspace(-0.9, 1.1, 17)
    means, covariances, evidence = [], [], []
    for x in log_scale:
        one = optimizer.with_noise(
            plain, {"rate": float(np.exp(x)), "attitude": 1.0, "momentum": 1.0}
        )
        means.append(one.theta)
        covariances.append(one.covariance)
        half = 0.5 * np.linalg.slogdet(one.hessian)[1]
        evidence.append(-one.objective - half - n * x - 0.5 * (x / 0.5) ** 2)
    weight = np.exp(np.array(evidence) - max(evidence))
    weight /= weight.sum()
    mean = weight @ np.array(means)
    variance = weight @ np.array(
        [np.diag(c) + (m - mean) ** 2 for c, m in zip(covariances, means, strict=True)]
    )
    moments = importance_moments(estimate, np.random.default_rng(7), 20_000)
    error = np.sqrt(1.0 / moments.effective)
    ratio = np.log(moments.sd[:9] / np.sqrt(variance))
    assert np.all(np.abs(ratio) < 5.0 * error + 0.02), ratio
    assert np.all(np.abs(moments.mean[:9] - mean) < (5.0 * error + 0.05) * np.sqrt(variance))
    known = fitted(replace_sigma(campaign, float(np.exp(weight @ log_scale))), discount=False)
    assert np.max(np.sqrt(variance) / known.sd) > 1.01


def replace_sigma(campaign, factor):
    sensor = campaign.rate_sensor
    return replace(
        campaign, rate_sensor=replace(sensor, sigma=tuple(factor * s for s in sensor.sigma))
    )


@pytest.mark.slow
def test_outliers_cost_student_t_noise_little(flown):
    clean = fitted(flown.campaign)
    for share in (0.005, 0.05):
        campaign, _ = spiked(flown.campaign, share)
        estimate = fitted(campaign, HEAVY)
        assert not too_large(estimate)
        assert np.max(np.abs(estimate.theta - clean.theta)[:9] / estimate.sd[:9]) < 1.0
        # Nor are they taken for an effect: at the maximum nothing pulls.
        fit = estimate.linearised()
        pull = fit.covariance @ fit.normal_equations()[1]
        np.testing.assert_allclose(fit.inverse_root.T @ fit.whitened_gradient, pull, atol=1e-6)
        # Plain noise, as stated: the same readings overrule everything.
        plain = fitted(campaign, discount=False)
        assert too_large(plain)
        assert np.max(np.abs(plain.theta - clean.theta)[:9] / plain.sd[:9]) > 3.0


@pytest.mark.slow
def test_outliers_in_student_t_noise_are_recorded_and_kept(flown):
    campaign, rows = spiked(flown.campaign, 0.01)
    estimate = fitted(campaign, HEAVY)
    result = clean_fit(estimate)
    assert result.estimate is estimate
    records = with_modelled_outliers(estimate).model.campaign.dirt
    assert {(d.kind, d.channel, d.treated) for d in records} == {("outliers", "rate", "modelled")}
    assert {d.slew: set(d.rows) for d in records} == rows
    untouched = fitted(flown.campaign, HEAVY)
    assert with_modelled_outliers(untouched) is untouched


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", ["hidden_lag", "hidden_dipole"])
def test_heavy_noise_of_unknown_scale_hides_no_missing_effect(name):
    assert too_large(fitted(read_campaign(DATA / name), ALL))


@pytest.mark.long
@pytest.mark.slow
def test_fits_to_student_t_noise_are_calibrated(flying):
    """z-scores of 16 campaigns whose truth is a draw of the prior, the noise's scale among it."""
    rng, campaigns = np.random.default_rng(8), 16
    noise = NoiseModel(rate=ChannelNoise("student_t", 4.0, scale_sampled=True))
    squares, of_scale, plain_squares, of_level = [], [], [], []
    for seed in range(100, 100 + campaigns):
        scale = float(np.exp(0.5 * rng.normal()))
        campaign, truth = with_student_t_rates(flying, seed, 4.0, scale)
        estimate = fitted(campaign, noise)
        gap = np.append(truth.theta, scale) - estimate.theta
        squares.append(gap[:9] @ np.linalg.solve(estimate.covariance[:9, :9], gap[:9]))
        of_scale.append(np.log(scale / estimate.theta[9]) * estimate.theta[9] / estimate.sd[9])
        known = replace_sigma(campaign, scale)
        plain = fitted(known, discount=False)
        gap = truth.theta - plain.theta
        plain_squares.append(gap @ np.linalg.solve(plain.covariance, gap))
        of_level.append(fitted(known, HEAVY).tests["rate"])
    together = stats.chi2(9 * campaigns)
    assert 1e-3 < together.cdf(np.sum(squares)) < 0.999
    assert stats.kstest(squares, stats.chi2(9).cdf).pvalue > 1e-3
    assert 1e-3 < stats.chi2(campaigns).cdf(np.sum(np.square(of_scale))) < 0.999
    # Gaussian noise of the same scale believes too much.
    assert together.sf(np.sum(plain_squares)) < 1e-6
    # The level of Student-t residuals is judged by their own distribution.
    assert stats.kstest([test.p_chi2 for test in of_level], "uniform").pvalue > 1e-3


def test_noise_is_asked_for_in_words(flown):
    noise = noise_model_from_text(
        ["rate=student_t:sampled", "momentum=gaussian"], ["rate", "attitude"]
    )
    assert noise == ALL
    assert noise.names == ("noise.rate_scale", "noise.rate_degrees", "noise.attitude_scale")
    assert noise_model_from_json(noise.json()) == noise
    assert Model(flown.campaign, noise=noise).space.names[9:] == noise.names
    for texts, sampled, words in (
        (["rate=cauchy"], [], "no distribution is called 'cauchy'"),
        (["rate"], [], "'rate' has no distribution; write rate=student_t"),
        (["rate=student_t:few"], [], "'few' degrees of freedom"),
        (["rate=student_t:0.5"], [], "0.5 degrees of freedom"),
        (["rate=student_t:inf"], [], "inf degrees of freedom"),
        (["rate=gaussian:4"], [], "gaussian has no degrees of freedom"),
        (["rate=gaussian", "rate=student_t"], [], "rate is given twice"),
    ):
        with pytest.raises(SettingsError, match=words):
            noise_model_from_text(texts, sampled)


def test_noise_of_a_further_sensor_is_asked_for_by_its_name(flown):
    noise = noise_model_from_text(["gyro=student_t"], ["gyro"])
    with pytest.raises(CampaignError, match="no channel is called 'gyro'; write rate, attitude"):
        Model(flown.campaign, noise=noise)
    slews = tuple(replace(slew, more={"gyro": slew.rate}) for slew in flown.campaign.slews)
    further = {"more_sensors": {"gyro": flown.campaign.rate_sensor}, "slews": slews}
    model = Model(replace(flown.campaign, **further), noise=noise)
    assert model.space.names[-1] == "noise.gyro_scale"


def test_noise_of_a_channel_without_readings_is_refused(flown):
    momentum = NoiseModel(momentum=ChannelNoise("student_t"))
    with pytest.raises(CampaignError, match="no readings of the channel momentum"):
        Model(flown.campaign, drive="measured", noise=momentum)
    slews = tuple(replace(slew, attitude=None) for slew in flown.campaign.slews)
    blind = replace(flown.campaign, slews=slews, star_tracker=None)
    with pytest.raises(CampaignError, match="no readings of the channel attitude"):
        Model(blind, noise=NoiseModel(attitude=ChannelNoise(scale_sampled=True)))
