"""The Laplace approximation: calibration, misfit, what the slews support."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.residual_tests import dispersion, whiteness
from bayes_inertia.physics.forward_model import Model

CAMPAIGNS = 40


@pytest.fixture(scope="module")
def perfect(flying):
    """Fits of perfectly specified campaigns whose truths are draws of the prior."""
    return [
        (estimate(Model(f.campaign), starts=1), f.truth)
        for f in map(flying, range(1000, 1000 + CAMPAIGNS))
    ]


@pytest.mark.long
@pytest.mark.slow
def test_errors_are_as_large_as_the_posterior_says(perfect):
    """z = (estimate - truth) / sd over campaigns and parameters: mean 0, variance 1; all nine
    together in Mahalanobis distance.
    """
    z = np.array([(e.theta - t.theta) / e.sd for e, t in perfect])
    n, d = z.shape
    assert np.abs(z.mean(0)).max() * np.sqrt(n) < stats.norm.ppf(1.0 - 1e-3 / (2 * d))
    tails = stats.chi2.cdf(np.sum(z**2, axis=0), n)
    assert np.minimum(tails, 1.0 - tails).min() > 1e-3 / (2 * d)
    distance = np.array(
        [(e.theta - t.theta) @ np.linalg.solve(e.covariance, e.theta - t.theta) for e, t in perfect]
    )
    assert stats.kstest(distance, stats.chi2(d).cdf).pvalue > 1e-3
    total = stats.chi2.cdf(distance.sum(), n * d)
    assert 1e-3 < total < 1.0 - 1e-3
    # Power of this test: sds wrong by 20 % would have failed it.
    assert not 1e-3 < stats.chi2.cdf(distance.sum() / 0.8**2, n * d) < 1.0 - 1e-3


@pytest.mark.slow
def test_reduced_chi2_counts_the_parameters_each_channel_pays_for(perfect):
    chi2 = np.sum([e.information.chi2.sum(0) for e, _ in perfect], axis=0)
    dof = np.sum([e.information.n_data.sum(0) - e.effective_parameters for e, _ in perfect], axis=0)
    tails = stats.chi2.cdf(chi2, dof)
    assert np.all((tails > 1e-3) & (tails < 1.0 - 1e-3)), chi2 / dof
    # Not counting them would have been seen: parameters are a third of the attitude numbers' worth.
    n_data = np.sum([e.information.n_data.sum(0) for e, _ in perfect], axis=0)
    assert stats.chi2.cdf(chi2[1], n_data[1]) < 1e-3


@pytest.mark.slow
def test_clean_data_are_hardly_ever_discounted(perfect):
    alarms = sum(e.discounted for e, _ in perfect)
    # Stated: about 6 in 1000 campaigns; what a rate of 1 % would exceed once in 1000 times.
    assert alarms <= stats.binom.isf(1e-3, len(perfect), 0.01)


def coloured(campaign, size, seed):
    """The campaign with slow wander (5 rows of correlation) of `size` sigmas added to its rates."""
    rng = np.random.default_rng(seed)

    def wander(n):
        x = np.zeros((n, 3))
        for k in range(1, n):
            x[k] = np.exp(-1.0 / 5.0) * x[k - 1] + np.sqrt(1.0 - np.exp(-2.0 / 5.0)) * rng.normal(
                size=3
            )
        return size * np.array(campaign.rate_sensor.sigma) * x

    return replace(
        campaign, slews=tuple(replace(s, rate=s.rate + wander(len(s.time))) for s in campaign.slews)
    )


@pytest.mark.long
@pytest.mark.slow
def test_coloured_misfit_is_discounted_and_the_sd_says_so(flying):
    """Wander that the stated noise ignores: without the discount errors are several sds, with it
    they are about one.
    """
    plain, honest = [], []
    for seed in range(12):
        flown = flying(2000 + seed)
        model = Model(coloured(flown.campaign, 4.0, seed))
        overruled, discounted = estimate(model, starts=1, discount=False), estimate(model, starts=1)
        assert not overruled.discounted
        assert discounted.discounted
        assert discounted.tests["rate"].too_large
        assert np.all(discounted.discount[:, 0] < 0.2)
        assert np.all(discounted.sd > overruled.sd)
        plain.append(np.mean(((overruled.theta - flown.truth.theta) / overruled.sd) ** 2))
        honest.append(np.mean(((discounted.theta - flown.truth.theta) / discounted.sd) ** 2))
    assert np.mean(plain) > 5.0
    assert np.mean(honest) < 0.3 * np.mean(plain)
    assert 0.2 < np.mean(honest) < 3.0


def test_too_small_residuals_discount_nothing(flown):
    """A sensor better than stated is no misfit."""
    sensor = replace(flown.campaign.rate_sensor, sigma=1e-4)
    result = estimate(Model(replace(flown.campaign, rate_sensor=sensor)), starts=1)
    assert result.tests["rate"].rejected
    assert not result.tests["rate"].too_large
    assert not result.discounted


def test_dispersion_is_the_variance_of_a_mean_over_that_of_white_noise():
    """AR(1) of variance v and correlation r: v (1 + r)/(1 - r)."""
    rng, r, v = np.random.default_rng(43), 0.7, 3.0
    x = np.zeros((20000, 2))
    for k in range(1, len(x)):
        x[k] = r * x[k - 1] + np.sqrt(v * (1.0 - r**2)) * rng.normal(size=2)
    assert dispersion(x) == pytest.approx(v * (1.0 + r) / (1.0 - r), rel=0.15)
    assert dispersion(rng.normal(size=(2000, 3))) < 1.2
    assert dispersion(0.1 * rng.normal(size=(2000, 3))) == 1.0


def test_the_whiteness_test_has_its_stated_false_alarm_rate():
    rng = np.random.default_rng(44)
    p = np.array([whiteness([rng.normal(size=(150, 3)) for _ in range(3)]) for _ in range(300)])
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    assert whiteness([rng.normal(size=(150, 3)).cumsum(0)]) < 1e-6
    assert whiteness([rng.normal(size=(20, 3))]) is None


@pytest.mark.long
@pytest.mark.slow
def test_leaving_a_slew_out_to_first_order_is_nearly_refitting_without_it(fitted, flown):
    for s in range(3):
        others = [i for i in range(3) if i != s]
        refit = estimate(Model(flown.campaign.subset(others)), starts=1, discount=False)
        moved, first_order = refit.theta - fitted.theta, fitted.without_slew(s) - fitted.theta
        assert np.abs(moved / fitted.sd).max() > 0.3
        np.testing.assert_allclose(first_order / refit.sd, moved / refit.sd, atol=0.1)


def test_the_shares_of_slews_are_the_joint_fit_with_nuisances_eliminated(fitted):
    fit, shared = fitted.linearised(), fitted.linearised().n_shared
    for left_out in range(3):
        weights = np.where(np.arange(3) == left_out, 0.0, np.ones((3, 3))).T
        hessian, gradient = fit.normal_equations(weights)
        covariance = np.linalg.inv(hessian)
        step, matrix = fit.shares.without(left_out)
        sd = np.sqrt(np.diag(covariance)[:shared])
        np.testing.assert_allclose(
            np.linalg.inv(matrix) / np.outer(sd, sd),
            covariance[:shared, :shared] / np.outer(sd, sd),
            atol=1e-6,
        )
        direct = -(covariance @ gradient)[:shared]
        np.testing.assert_allclose(step / sd, direct / sd, atol=1e-6)


@pytest.mark.slow
def test_robust_sd_is_never_below_the_models(perfect, fitted, flown):
    for result, _ in perfect:
        assert np.all(result.robust_sd >= result.sd * (1.0 - 1e-12))
        assert (
            np.linalg.eigvalsh(
                result.robust_covariance / np.outer(result.robust_sd, result.robust_sd)
            ).min()
            > -1e-10
        )
    assert (
        replace(fitted, model=Model(flown.campaign.subset([0]))).robust_sd is None
    )  # one slew has no other to disagree with


def test_robust_sd_grows_where_slews_disagree(flown):
    """Each slew's torques a per cent stronger or weaker: no noise that residuals within a slew
    show, but the slews disagree.
    """
    gains = (1.01, 0.99, 1.0)

    def change(slew, gain):
        first = slew.wheel_momentum[:1]
        return replace(
            slew,
            wheel_torque=gain * slew.wheel_torque,
            wheel_momentum=first + gain * (slew.wheel_momentum - first),
        )

    campaign = replace(
        flown.campaign,
        slews=tuple(change(s, g) for s, g in zip(flown.campaign.slews, gains, strict=True)),
    )
    result = estimate(Model(campaign), starts=1, discount=False)
    # Slew 1 is about x, slew 2 about y: their moments are a per cent in doubt, which the noise
    # alone does not say.
    doubt = result.robust_sd[:2] / result.theta[:2]
    assert np.all((doubt > 0.003) & (doubt < 0.03))
    assert np.all(result.sd[:2] / result.theta[:2] < 0.001)
