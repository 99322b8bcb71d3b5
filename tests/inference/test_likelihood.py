"""Whitened residuals and their derivatives."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from bayes_inertia.errors import CampaignError
from bayes_inertia.inference import likelihood
from bayes_inertia.inference.likelihood import (
    Point,
    _plain_sensitivities,
    padded_sensitivities,
    residuals,
    unpadded_sensitivities,
)
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict_all


def residuals_at(model, theta, bias=None, local=None, white=None):
    bias = np.zeros(3) if bias is None else bias
    local = np.zeros((model.n_slews, model.structure.n_local)) if local is None else local
    white = white or whitening(model, theta)
    return residuals(model.structure, Point(theta, bias, local), model.data, white)


def with_slews(campaign, change):
    return replace(campaign, slews=tuple(change(s) for s in campaign.slews))


def test_residuals_at_the_truth_are_white_unit_noise(flying, setup_type):
    """Start states at their references (the first readings) would not do: fit them with theta held
    by a narrow prior.
    """
    flown = flying(21, setup_type())
    fitted = estimate(Model(flown.campaign), starts=1)
    for channel, series in fitted.residual_series.items():
        numbers = np.concatenate([s[np.isfinite(s)] for s in series])
        dof = (
            len(numbers)
            - fitted.effective_parameters[("rate", "attitude", "momentum").index(channel)]
        )
        p = stats.chi2.cdf(np.sum(numbers**2), dof)
        assert 1e-3 < p < 1.0 - 1e-3, channel


@pytest.mark.slow
def test_residuals_without_noise_are_what_the_definitions_say(flying, setup_type):
    """Independent arithmetic: (K^-1 (w + b) - measured) / sigma, the small rotation by scipy,
    tachometers in sigmas.
    """
    flown = flying(22, setup_type(start_rate=(0.0, 0.0, 0.0)), noise=0.0)
    model, theta = Model(flown.campaign), flown.truth.theta
    bias = flown.truth.bias / np.array(flown.campaign.rate_sensor.bias_sigma)
    exact = residuals_at(model, theta, bias)
    start_gap = np.abs(np.asarray(exact[2])).max()
    assert (
        start_gap < 0.5
    )  # starts are the first readings, which differ from the start by the bias only
    push = np.zeros((model.n_slews, model.structure.n_local))
    small = 1e-3
    push[:, 5] = small  # 1 mrad about the boresight, the nuisance's sd being 1 rad
    turned = residuals_at(model, theta, bias, push)
    place = model.structure.place("attitude")
    fixes = np.asarray(model.data.arrays.telemetry.readings[place].row)
    prediction = predict_all(
        model.structure, jnp.asarray(theta), jnp.asarray(push), jnp.asarray(bias), model.data
    )
    for s, slew in enumerate(flown.campaign.slews):
        gap = (
            Rotation.from_quat(np.asarray(prediction[1][s])).inv()
            * Rotation.from_quat(slew.attitude[fixes[s]])
        ).as_rotvec()
        expected = gap / np.array([2.5e-5, 2.5e-5, 1.5e-4])
        np.testing.assert_allclose(np.asarray(turned[1][s]).reshape(-1, 3), expected, atol=1e-6)
        rate = (slew.rate - np.asarray(prediction[0][s])[: len(slew.time)]) / flown.setup.rate_sigma
        np.testing.assert_allclose(
            np.asarray(turned[0][s]).reshape(-1, 3)[: len(slew.time)], rate, atol=1e-6
        )
    assert abs(abs(np.asarray(turned[1][0]).reshape(-1, 3)[0, 2]) - small / 1.5e-4) < 0.05


def test_the_signs_of_measured_quaternions_do_not_matter(flown):
    flips = np.where(np.arange(96) % 2, -1.0, 1.0)[:, None]
    model, other = (
        Model(flown.campaign),
        Model(with_slews(flown.campaign, lambda s: replace(s, attitude=flips * s.attitude))),
    )
    theta = flown.truth.theta
    np.testing.assert_array_equal(residuals_at(model, theta)[1], residuals_at(other, theta)[1])


def test_missing_and_saturated_readings_count_for_nothing(flown):
    """NaN, saturated and absurd-but-masked cells: no residual, no NaN, and every other residual
    unchanged.
    """
    gone = np.zeros((96, 3), bool)
    gone[5], gone[10:20, 1], gone[30, 0], gone[40, 2] = True, True, True, True

    def spoil(slew):
        rate = np.where(gone, np.nan, slew.rate)
        rate[30, 0], rate[40, 2] = 0.05, -0.05  # the sensor's range
        momentum = slew.wheel_momentum.copy()
        momentum[7:9, 0] = np.nan
        return replace(slew, rate=rate, wheel_momentum=momentum)

    theta = flown.truth.theta
    whole, holed = (
        Model(flown.campaign, drive="commanded"),
        Model(with_slews(flown.campaign, spoil), drive="commanded"),
    )
    a, b = residuals_at(whole, theta), residuals_at(holed, theta)
    rate_a, rate_b = (np.asarray(r[0]).reshape(3, -1, 3)[:, :96] for r in (a, b))
    assert np.all(rate_b[:, gone] == 0.0)
    np.testing.assert_allclose(rate_b[:, ~gone], rate_a[:, ~gone], rtol=1e-12, atol=1e-9)
    momentum = np.asarray(b[2]).reshape(3, -1, 3)
    assert np.all(momentum[:, 7:9, 0] == 0.0)
    assert np.all(np.isfinite(momentum))
    fitted = estimate(holed, starts=1)
    assert fitted.information.n_data[:, 0].tolist() == [3 * 96 - gone.sum()] * 3
    assert np.all(np.abs(fitted.theta - flown.truth.theta) < 6.0 * fitted.sd)


@pytest.mark.long
@pytest.mark.slow
def test_a_tachometer_with_gaps_can_drive_the_model(flown):
    """Gaps are bridged on a straight line: the fit moves by less than a fraction of its sd."""

    def spoil(slew):
        momentum = slew.wheel_momentum.copy()
        momentum[0, 0], momentum[50, 1], momentum[-1] = np.nan, np.nan, np.nan
        return replace(slew, wheel_momentum=momentum)

    whole = estimate(Model(flown.campaign, drive="measured"), starts=1)
    holed = estimate(Model(with_slews(flown.campaign, spoil), drive="measured"), starts=1)
    assert np.all(np.isfinite(holed.theta))
    assert np.all(np.abs(holed.theta - whole.theta) < 0.5 * whole.sd)
    assert not holed.discounted


def test_missing_commands_are_an_error_and_dead_tachometers_rule_out_the_measured_drive(
    flown,
):
    def without(key, cells):
        def change(slew):
            array = getattr(slew, key).copy()
            array[cells] = np.nan
            return replace(slew, **{key: array})

        return change

    with pytest.raises(CampaignError, match=r"wheel_torque.*not a number"):
        with_slews(flown.campaign, without("wheel_torque", (40, 1)))
    dead = with_slews(flown.campaign, without("wheel_momentum", (slice(None), 1)))
    with pytest.raises(CampaignError, match="measured drive needs"):
        Model(dead, drive="measured")
    r = residuals_at(Model(dead), flown.truth.theta)
    assert all(np.all(np.isfinite(channel)) for channel in r)
    momentum = np.asarray(r[2]).reshape(3, -1, 3)
    assert not np.any(momentum[..., 1])
    assert np.any(momentum[..., 0])


def test_a_slew_without_any_rate_reading_or_fix_is_simulated_but_weighs_nothing(flown):
    first = flown.campaign.slews[0]
    blind = replace(
        first, rate=np.full_like(first.rate, np.nan), attitude=np.full_like(first.attitude, np.nan)
    )
    model = Model(replace(flown.campaign, slews=(blind, *flown.campaign.slews[1:])))
    r = residuals_at(model, flown.truth.theta)
    assert not np.any(r[0][0])
    assert not np.any(r[1][0])
    assert all(np.all(np.isfinite(channel)) for channel in r)


@pytest.mark.long
@pytest.mark.slow
def test_without_a_star_tracker_there_are_no_attitude_residuals(flown):
    campaign = replace(
        with_slews(flown.campaign, lambda s: replace(s, attitude=None)), star_tracker=None
    )
    model = Model(campaign)
    r = residuals_at(model, flown.truth.theta)
    assert r[1].shape[-1] == 0
    fitted = estimate(model, starts=1)
    assert np.all(np.isfinite(fitted.sd))
    assert np.all(np.abs(fitted.theta - flown.truth.theta) < 6.0 * fitted.sd)
    # The fixes say how far the body turned; without them only the gyroscopic torque of the wheels
    # says how big a rad/s is.
    assert np.all(fitted.sd[6:9] > 2.0 * estimate(Model(flown.campaign), starts=1).sd[6:9])


def test_sensitivities_are_the_residuals_derivatives(small):
    model, point, white = small.model, small.point, small.white
    exact = unpadded_sensitivities(model, point, white, np.arange(len(point.theta)))
    d, sd = len(point.theta), np.sqrt(np.diag(small.joint_covariance))
    full = np.concatenate([point.theta, point.bias, point.local.ravel()])
    assert full.size == sd.size

    def at(x):
        here = Point(x[:d], x[d : d + 3], x[d + 3 :].reshape(point.local.shape))
        return np.concatenate(residuals(model.structure, here, model.data, white), -1)

    m = point.local.shape[1]
    # In residuals per sd.
    differences = np.array([at(full + x) - at(full - x) for x in np.diag(0.3 * sd)]) / 0.6
    ours = np.concatenate([np.asarray(j) for j in exact.jacobian], 1)
    for s in range(model.n_slews):
        index = np.concatenate([np.arange(d + 3), d + 3 + s * m + np.arange(m)])
        np.testing.assert_allclose(
            ours[s] * sd[index],
            differences[index, s].T,
            atol=2e-4 * max(1.0, np.abs(differences[index, s]).max()),
        )
        others = np.setdiff1d(np.arange(d + 3, full.size), index)
        assert not np.any(differences[others, s])  # a slew's own nuisances do not touch the others


@pytest.fixture(scope="module")
def attitude_chi2(flying, setup_type):
    """Sums over campaigns driven by noisy tachometers: chi^2 and degrees of freedom of rates and
    fixes
    (before, in the middle, after: the free start rate cannot take up both), with the package's
    treatment and with none."""
    setup = setup_type(momentum_sigma=2e-5, dt=2.0, fix_rows=(0, 1, 2, 47, 48, -3, -2, -1))
    totals = {"treated": np.zeros(4), "ignored": np.zeros(4)}
    for seed in range(4):
        campaign = flying(100 + seed, setup).campaign
        for name, stated in (("treated", 2e-5), ("ignored", 1e-9)):
            wheels = tuple(replace(w, momentum_sigma=stated) for w in campaign.wheels)
            fitted = estimate(
                Model(replace(campaign, wheels=wheels), drive="measured"), starts=1, discount=False
            )
            chi2 = fitted.information.chi2.sum(0)
            dof = fitted.information.n_data.sum(0) - fitted.effective_parameters
            totals[name] += np.array([chi2[0], dof[0], chi2[1], dof[1]])
    return totals


@pytest.mark.slow
@pytest.mark.parametrize("channel", [0, 1], ids=["rate", "attitude"])
def test_tachometer_noise_is_accounted_for_as_process_noise(attitude_chi2, channel):
    chi2, dof = attitude_chi2["treated"][2 * channel : 2 * channel + 2]
    assert abs(chi2 / dof - 1.0) < 4.0 * np.sqrt(2.0 / dof), chi2 / dof
    chi2, dof = attitude_chi2["ignored"][2 * channel : 2 * channel + 2]
    assert chi2 / dof - 1.0 > 4.0 * np.sqrt(2.0 / dof), chi2 / dof


@pytest.mark.long
@pytest.mark.slow
def test_coefficients_that_only_sensors_feel_need_no_motion_of_their_own(small_flown):
    """They stand before and after others, and their columns are those of all taken together."""
    names = ("rate_remainder", "torque_noise", "star_tracker_low_frequency")
    model = Model(small_flown.campaign, by_name(names))
    assert model.structure.only_sensed == (True, False, True)
    local = np.random.default_rng(4).normal(size=(model.n_slews, model.structure.n_local))
    theta = model.space.mean
    at = model.structure, Point(theta, np.zeros(3), 0.1 * local), model.data
    white = whitening(model, theta)
    ours = padded_sensitivities(model, at[1], white, np.arange(model.space.size)).jacobian
    columns = np.arange(model.space.size + 3 + model.structure.n_local)
    every = _plain_sensitivities(*at, white, columns).jacobian
    for channel, taken_together in zip(ours, every, strict=True):
        p, scale = taken_together.shape[-1], np.abs(taken_together).max(initial=1.0)
        assert np.asarray(channel)[..., :p] == pytest.approx(taken_together, abs=1e-9 * scale)


def test_sensitivities_on_a_fine_grid_are_taken_few_columns_at_a_time(fitted, monkeypatch):
    model, point, free = fitted.model, fitted.point, fitted.free
    whole = unpadded_sensitivities(model, point, fitted.white, free)
    points = model.data.contexts.time.shape[1]
    fewer = replace(likelihood.LIMITS, numbers_of_columns=5 * points)
    monkeypatch.setattr(likelihood, "LIMITS", fewer)
    parts = unpadded_sensitivities(model, point, fitted.white, free)
    for one, other in zip(whole.jacobian, parts.jacobian, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(one).max(initial=1.0))
