"""The optimizer, the calibration of what it reports, and what misfit does to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.inference.likelihood import information_blocks
from bayes_inertia.inference.optimizer import distinct_ends, estimate
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.residual_tests import dispersion, whiteness
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.least_squares import levenberg_marquardt
from bayes_inertia.physics.forward_model import Model

BASILISK = Path(__file__).parents[2] / "shared" / "data" / "basilisk"
CAMPAIGNS = 40


@pytest.fixture(scope="module")
def fitted(flown):
    """The fit of the shared campaign."""
    return estimate(Model(flown.campaign), starts=1)


@pytest.fixture(scope="module")
def perfect(flying):
    """Fits of perfectly specified campaigns whose truths are draws of the prior."""
    return [
        (estimate(Model(f.campaign), starts=1), f.truth)
        for f in map(flying, range(1000, 1000 + CAMPAIGNS))
    ]


# --- the optimum --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("drive", ["commanded", "measured"])
def test_starts_thirty_percent_wrong_end_at_the_same_optimum(flown, drive):
    model = Model(flown.campaign, drive=drive)
    best = estimate(model, starts=1)
    rng = np.random.default_rng(41)
    for _ in range(5):
        start = best.theta.copy()
        while (
            True
        ):  # 30 % of the largest moment in a random direction of the six elements, and of each K
            direction = rng.normal(size=6)
            start[:6] = best.theta[:6] + 0.3 * best.theta[0] * direction / np.linalg.norm(direction)
            if bool(inertia_tensor.is_physical(jnp.asarray(start[:6]))):
                break
        start[6:9] = best.theta[6:9] * (1.0 + 0.3 * rng.choice([-1.0, 1.0], 3))
        again = estimate(model, start=start)
        np.testing.assert_allclose(again.theta, best.theta, rtol=0, atol=1e-2 * best.sd.min())
        assert abs(again.objective - best.objective) < 1e-4


def test_optima_are_told_apart_by_their_place_not_by_an_objective_in_which_the_data_hardly_count(
    fitted,
):
    model, here = fitted.model, fitted.point
    there = replace(here, local=here.local + 1.0)
    kept = distinct_ends(
        model,
        [(2.0, here), (2.3, there), (2.0001, here), (9.0, replace(here, local=here.local - 1.0))],
    )
    assert [count for _, count in kept] == [2, 1]
    assert kept[1][0] is there


def test_at_the_optimum_no_direction_goes_down(fitted):
    """The reported objective is a minimum of the sum of squares itself, checked without any derivative."""
    from bayes_inertia.inference.likelihood import residuals

    model, point = fitted.model, fitted.point

    def objective(theta, bias, local):
        r = residuals(model.structure, Point(theta, bias, local), model.data, fitted.white)
        prior = np.sum(((theta - model.space.mean) / model.space.sd) ** 2)
        return 0.5 * (
            sum(float(jnp.sum(x**2)) for x in r) + prior + np.sum(bias**2) + np.sum(local**2)
        )

    best = objective(point.theta, point.bias, point.local)
    assert abs(best - fitted.objective) < 1e-6
    rng, root = np.random.default_rng(42), np.linalg.cholesky(fitted.joint_covariance)
    d = len(point.theta)
    for _ in range(20):
        z = rng.normal(size=len(root))
        step = 0.5 * root @ (z / np.linalg.norm(z))
        moved = objective(
            point.theta + step[:d],
            point.bias + step[d : d + 3],
            point.local + step[d + 3 :].reshape(point.local.shape),
        )
        assert abs(moved - best - 0.125) < 0.01  # half of 0.5 squared: the Hessian is right as well


def test_a_prior_on_the_locked_tensor_gives_the_same_physics(flying, setup_type):
    """J or J_locked: what the file calls its tensor is what comes out, wheels heavy enough to tell."""
    for includes in (False, True):
        flown = flying(51, setup_type(spin_inertia=0.02, includes_wheel_spin=includes))
        result = estimate(Model(flown.campaign), starts=1)
        z = (result.theta - flown.truth.theta) / result.sd
        assert np.abs(z).max() < 4.5
    # Taking one for the other would have been seen.
    wrong = replace(
        flown.campaign, inertia=replace(flown.campaign.inertia, includes_wheel_spin=False)
    )
    z = (estimate(Model(wrong), starts=1).theta - flown.truth.theta) / result.sd
    assert np.abs(z[:3]).min() > 4.5


@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_levenberg_finds_rosenbrocks_minimum_at_any_scaling(scale):
    def rows(x):
        y = x / np.array([1.0, scale])
        jacobian = np.array([[-1.0, 0.0], [-20.0 * y[0], 10.0]]) / np.array([1.0, scale])
        return np.array([1.0 - y[0], 10.0 * (y[1] - y[0] ** 2)]), jacobian

    def equations(x):
        r, j = rows(x)
        return j.T @ j, j.T @ r

    x, objective = levenberg_marquardt(
        lambda x: 0.5 * np.sum(rows(x)[0] ** 2),
        equations,
        lambda x, s: x + s,
        np.array([-1.2, 1.0 * scale]),
        tolerance=1e-14,
    )
    np.testing.assert_allclose(x, [1.0, scale], rtol=1e-6)
    assert objective < 1e-12


@pytest.mark.parametrize("stiffness", [1e3, 1e5])
def test_levenberg_reaches_the_end_of_a_narrow_curved_valley(stiffness):
    """A valley as steep as that of a wheel momentum that nothing measures; damping alone stops half way."""

    def rows(x):
        return np.array([stiffness * (x[1] - np.sin(x[0])), x[0] - 3.0]), np.array(
            [[-stiffness * np.cos(x[0]), stiffness], [1.0, 0.0]]
        )

    def equations(x):
        r, j = rows(x)
        return j.T @ j, j.T @ r

    x, objective = levenberg_marquardt(
        lambda x: 0.5 * np.sum(rows(x)[0] ** 2),
        equations,
        lambda x, s: x + s,
        np.array([-3.0, 0.5]),
    )
    np.testing.assert_allclose(x, [3.0, np.sin(3.0)], atol=1e-4)
    assert objective < 1e-7


def test_levenberg_survives_points_without_derivatives():
    """Where the objective is finite but its derivatives are not, a step or correction is given up, not the descent."""

    def equations(x):
        hole = np.nan if 1.0 < x[0] < 2.5 else 1.0
        return hole * np.array([[1.0 + 12.0 * x[0] ** 2]]), hole * np.array(
            [x[0] - 3.0 + 4.0 * (x[0] - 3.0) ** 3]
        )

    for start in (-4.0, 0.5, 6.0):
        x, objective = levenberg_marquardt(
            lambda x: 0.5 * (x[0] - 3.0) ** 2 + (x[0] - 3.0) ** 4,
            equations,
            lambda x, s: x + s,
            np.array([start]),
        )
        assert np.isfinite(objective)
        assert objective <= 0.5 * (start - 3.0) ** 2 + (start - 3.0) ** 4
    x, _ = levenberg_marquardt(
        lambda x: 0.5 * (x[0] - 3.0) ** 2,
        lambda x: (np.full((1, 1), np.nan), np.full(1, np.nan)),
        lambda x, s: x + s,
        np.array([5.0]),
    )
    assert x[0] == 5.0
    # Nor does a start without an objective, whose derivatives are finite.
    x, objective = levenberg_marquardt(
        lambda x: np.inf, lambda x: (np.eye(1), x), lambda x, s: x + s, np.array([5.0])
    )
    assert (x[0], objective) == (5.0, np.inf)


def test_an_optimizer_that_stopped_short_leaves_the_linearised_residuals_alone(fitted):
    """Linearised residuals are those of the optimum, although the estimate is a few sds beside it."""
    point = fitted.point
    # One sd of everything fitted, along the posterior's own covariance.
    step = np.linalg.cholesky(fitted.joint_covariance) @ np.random.default_rng(4).standard_normal(
        len(fitted.hessian)
    )
    f = len(fitted.free)
    theta, bias, local = (
        point.theta.copy(),
        point.bias + step[f : f + 3],
        point.local + step[f + 3 :].reshape(point.local.shape),
    )
    theta[fitted.free] += step[:f]
    beside = replace(point, theta=theta, bias=bias, local=local)
    short = replace(
        fitted,
        point=beside,
        information=information_blocks(fitted.model, beside, fitted.white, fitted.free),
    )
    chi2 = [float(np.sum(at.linearised().settled_residual ** 2)) for at in (fitted, short)]
    uncorrected = float(short.information.chi2.sum())
    assert uncorrected - chi2[0] > 10.0
    assert abs(chi2[1] - chi2[0]) < 0.02 * (uncorrected - chi2[0])


# --- calibration ---------------------------------------------------------------------------------------------
def test_errors_are_as_large_as_the_posterior_says(perfect):
    """z = (estimate - truth) / sd over campaigns and parameters: mean 0, variance 1; all nine together in Mahalanobis distance."""
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


def test_reduced_chi2_counts_the_parameters_each_channel_pays_for(perfect):
    chi2 = np.sum([e.information.chi2.sum(0) for e, _ in perfect], axis=0)
    dof = np.sum([e.information.n_data.sum(0) - e.effective_parameters for e, _ in perfect], axis=0)
    tails = stats.chi2.cdf(chi2, dof)
    assert np.all((tails > 1e-3) & (tails < 1.0 - 1e-3)), chi2 / dof
    # Not counting them would have been seen: parameters are a third of the attitude numbers' worth.
    n_data = np.sum([e.information.n_data.sum(0) for e, _ in perfect], axis=0)
    assert stats.chi2.cdf(chi2[1], n_data[1]) < 1e-3


def test_clean_data_are_hardly_ever_discounted(perfect):
    alarms = sum(e.discounted for e, _ in perfect)
    # Stated: about 6 in 1000 campaigns; what a rate of 1 % would exceed once in 1000 times.
    assert alarms <= stats.binom.isf(1e-3, len(perfect), 0.01)


# --- misfit --------------------------------------------------------------------------------------------------
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


def test_coloured_misfit_is_discounted_and_the_sd_says_so(flying):
    """Wander that the stated noise ignores: without the discount errors are several sds, with it they are about one."""
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


# --- what the slews themselves support -------------------------------------------------------------------------
def test_leaving_a_slew_out_to_first_order_is_nearly_refitting_without_it(fitted, flown):
    for s in range(3):
        others = [i for i in range(3) if i != s]
        refit = estimate(Model(flown.campaign.subset(others)), starts=1, discount=False)
        moved, first_order = refit.theta - fitted.theta, fitted.without_slew(s) - fitted.theta
        assert np.abs(moved / fitted.sd).max() > 0.3
        np.testing.assert_allclose(first_order / refit.sd, moved / refit.sd, atol=0.1)


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
    """Each slew's torques a per cent stronger or weaker: no noise that residuals within a slew show, but the slews disagree."""
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
    # Slew 1 is about x, slew 2 about y: their moments are a per cent in doubt, which the noise alone does not say.
    doubt = result.robust_sd[:2] / result.theta[:2]
    assert np.all((doubt > 0.003) & (doubt < 0.03))
    assert np.all(result.sd[:2] / result.theta[:2] < 0.001)


@pytest.mark.slow
@pytest.mark.skipif(
    not (BASILISK / "clean").exists(),
    reason="the independent simulator's campaigns are not beside this project",
)
def test_telemetry_of_an_independent_simulator_is_explained():
    result = estimate(Model(read_campaign(BASILISK / "clean")), starts=1)
    assert not result.discounted
    assert not result.tests["total"].rejected
