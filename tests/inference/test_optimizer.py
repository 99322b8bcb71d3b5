"""The optimizer finds the maximum."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate, Starts
from bayes_inertia.inference.likelihood import Information, Point, information_blocks
from bayes_inertia.inference.noise_model import discounted, whitening
from bayes_inertia.inference.optimizer import (
    distinct_optima,
    estimate,
    move_to,
    re_estimate,
    resumed,
)
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.effects import TorqueNoise, by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["commanded", pytest.param("measured", marks=pytest.mark.long)])
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
    kept = distinct_optima(
        model,
        [(2.0, here), (2.3, there), (2.0001, here), (9.0, replace(here, local=here.local - 1.0))],
    )
    assert [count for _, count in kept] == [2, 1]
    assert kept[1][0] is there


def test_a_fit_that_begins_where_no_telemetry_is_finite_is_brought_back(fitted):
    theta = fitted.theta.copy()
    theta[:6] = [1.0, 1.0, 9.0, 0.0, 0.0, 0.0]  # of no body
    again = re_estimate(fitted, theta, fitted.free)
    assert np.isfinite(again.hessian).all()
    assert again.objective == pytest.approx(fitted.objective, abs=1e-3)


def test_sizes_of_stochastic_effects_are_never_brought_back_to_none(fitted, monkeypatch):
    """None has no logarithm: the evidence would have no number there."""
    begin = move_to(fitted, Model(fitted.model.campaign, (TorqueNoise(),)))
    sizes, theta = begin.model.space.slice_of("torque_noise"), begin.theta.copy()
    theta[sizes] = [3e-6, 20.0]
    theta[0] *= 1.5
    monkeypatch.setattr(optimizer, "negative_log_posterior", lambda *_: np.nan)
    back = optimizer._with_finite_telemetry(begin, theta)
    assert begin.theta[sizes][0] == 0.0
    np.testing.assert_array_equal(back.theta[sizes], theta[sizes])
    np.testing.assert_allclose(back.theta[:6], begin.theta[:6], rtol=1e-12)


def test_at_the_optimum_no_direction_goes_down(fitted):
    """The reported objective is a minimum of the sum of squares itself, checked without any
    derivative.
    """
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


@pytest.mark.long
@pytest.mark.slow
def test_a_prior_on_the_locked_tensor_gives_the_same_physics(flying, setup_type):
    """J or J_locked: what the file calls its tensor comes out, wheels heavy enough to tell."""
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


def test_an_optimizer_that_stopped_short_leaves_the_linearised_residuals_alone(fitted):
    """Linearised residuals are those of the optimum, though the estimate is a few sds off."""
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


@pytest.mark.slow
def test_telemetry_of_an_independent_simulator_is_explained():
    result = estimate(Model(read_campaign(EXAMPLE)), starts=1)
    assert not result.discounted
    assert not result.tests["total"].rejected


def test_a_point_moves_to_a_model_whose_rows_are_padded_otherwise():
    campaign = read_campaign(EXAMPLE)
    small, large = Model(campaign), Model(campaign, by_name(("flexible_mode",)))
    rows = [model.data.arrays.telemetry.sample.shape for model in (small, large)]
    assert rows[0] != rows[1]
    theta, discount = np.array(small.space.mean), np.full((small.n_slews, 3), 0.25)
    stated = whitening(small, theta)
    empty = np.zeros((small.n_slews, 3))
    information = Information(empty, empty, empty, empty, np.arange(9))
    point = Point(theta, np.zeros(3), np.zeros((small.n_slews, small.structure.n_local)))
    parts = (discounted(stated, discount), discount, information, np.eye(9), 0.0, Starts(1, 1))
    moved = move_to(Estimate(small, point, stated, *parts), large)
    now, before, used = (w[0].factors for w in (moved.stated, stated, moved.white))
    assert now.shape[:2] == used.shape[:2] == rows[1]
    length = min(rows[0][1], rows[1][1])
    np.testing.assert_array_equal(now[:, :length], before[:, :length])
    np.testing.assert_allclose(used, 0.5 * np.asarray(now), rtol=1e-15)
    np.testing.assert_array_equal(moved.theta[:9], theta)


@pytest.mark.slow
def test_without_a_single_reading_the_estimate_is_the_prior():
    """Nothing was measured: no misfit, and nothing to divide it by."""
    campaign = small_campaign()
    slews = tuple(
        replace(slew, rate=np.full_like(slew.rate, np.nan), attitude=None, wheel_momentum=None)
        for slew in campaign.slews
    )
    silent = estimate(Model(replace(campaign, slews=slews)))
    inertia = campaign.inertia.tensor
    of_prior = [inertia[i][k] for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    np.testing.assert_allclose(silent.theta[:6], of_prior, atol=1e-9)
    assert silent.objective == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_a_fit_goes_on_from_where_it_stood_to_where_a_new_one_ends(small_flown):
    """Outliers were left out; slews that misfit discounts stay discounted, others are not."""

    def rippled(size, left_out=0):
        slews = []
        for slew in small_flown.campaign.slews:
            ripple = np.sin(2.0 * np.pi * slew.time / 7.0)[:, None] * np.array([1.0, -0.5, 0.3])
            rate = slew.rate + size * ripple
            rate[5 : 5 + left_out] = np.nan
            slews.append(replace(slew, rate=rate))
        campaign = replace(small_flown.campaign, slews=tuple(slews))
        return Model(campaign, (TorqueNoise(pieces=4),))

    sigma = float(np.max(small_flown.campaign.rate_sensor.sigma))
    before = estimate(rippled(3.0 * sigma), starts=1)
    assert before.discounted
    for model in (rippled(3.0 * sigma, left_out=3), rippled(0.0)):
        best, again = estimate(model, starts=1), resumed(before, model)
        assert again.discounted == best.discounted
        np.testing.assert_allclose(again.discount, best.discount, rtol=0.1)
        apart = (again.theta - best.theta) / best.sd
        assert np.max(np.abs(apart)) < 0.1
    assert not best.discounted
    # The control: without a descent it is not there.
    assert np.max(np.abs((before.theta - best.theta) / best.sd)) > 0.1
