"""Dirt in residuals is seen for what it is, and a missing effect is not taken for dirt."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from support.other_spacecraft import by_thrusters

from bayes_inertia.campaign.hardware import CorrelatedNoise, DirectionSensor, RateSensor
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import EstimateError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import (
    away_from_switches,
    clean_fit,
    colours_seen,
    outlying_fixes,
    outlying_readings,
)
from bayes_inertia.inference.gates import _explained, prior_gate
from bayes_inertia.inference.likelihood import Point
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_colour import (
    Colour,
    ColourOfAxis,
    colour_of,
    factor_of_shared_errors,
    is_alike_everywhere,
)
from bayes_inertia.inference.settings import FitContext
from bayes_inertia.inference.treatment import DirtTreatment, treated, treatment_from
from bayes_inertia.maths.linear_algebra import inverse_root
from bayes_inertia.maths.quaternion import to_body
from bayes_inertia.physics.channel_noise import ChannelNoise, NoiseModel
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign

DATA = Path(__file__).parents[1] / "data"


def fitted(campaign):
    return optimizer.estimate(Model(campaign))


def too_large(estimate):
    return [name for name, test in estimate.tests.items() if test.too_large]


def shift(estimate, clean):
    """Change of J and K in sd of the clean fit."""
    return np.abs(estimate.theta - clean.theta)[:9] / clean.sd[:9]


def changed(campaign, change):
    return replace(campaign, slews=tuple(change(i, s) for i, s in enumerate(campaign.slews)))


@pytest.fixture(scope="module")
def clean_at(flown):
    return fitted(flown.campaign)


def spiked(campaign, share=0.005, seed=3):
    """The campaign with outliers of the rate sensor, and their rows by slew."""
    rng, rows = np.random.default_rng(seed), {}

    def change(i, slew):
        hit = rng.random(slew.rate.shape) < share
        size = rng.choice([-1.0, 1.0], hit.shape) * rng.uniform(10.0, 60.0, hit.shape) * 2e-5
        rows[slew.name] = set(np.flatnonzero(hit.any(axis=1)).tolist())
        return replace(slew, rate=np.where(hit, slew.rate + size, slew.rate))

    return changed(campaign, change), rows


def test_a_clean_campaign_is_left_alone_to_the_bit(clean_at):
    result = clean_fit(clean_at)
    assert result.estimate is clean_at
    assert result.treatment.is_nothing
    assert treated(clean_at.model.campaign, result.treatment, "commanded") is (
        clean_at.model.campaign
    )


def test_outliers_are_masked_and_move_nothing(flown, clean_at):
    campaign, rows = spiked(flown.campaign)
    dirty = fitted(campaign)
    assert too_large(dirty)
    result = clean_fit(dirty)
    assert {d.slew: set(d.rows) for d in result.treatment.masked} == {
        name: hit for name, hit in rows.items() if hit
    }
    assert not too_large(result.estimate)
    assert shift(result.estimate, clean_at).max() < 1.0
    assert {d.kind for d in result.estimate.model.campaign.dirt} == {"outliers"}


def test_a_wrong_fix_is_masked(flown, clean_at):
    def change(i, slew):
        attitude = np.array(slew.attitude)
        if i == 1:
            attitude[2, 0] += 3e-3
            attitude[2] /= np.linalg.norm(attitude[2])
        return replace(slew, attitude=attitude)

    result = clean_fit(fitted(changed(flown.campaign, change)))
    (record,) = result.treatment.masked
    assert (record.channel, record.slew, record.rows) == ("attitude", "slew 2", (2,))
    assert shift(result.estimate, clean_at).max() < 1.0


def test_noise_stated_too_small_is_measured(flown, clean_at):
    sensor = flown.campaign.rate_sensor
    stated = tuple(s / 3.0 for s in sensor.sigma)
    dirty = fitted(replace(flown.campaign, rate_sensor=replace(sensor, sigma=stated)))
    result = clean_fit(dirty)
    n = 3 * sum(len(s.time) for s in flown.campaign.slews)
    # Power from second differences scatters by sqrt(3.9 / number).
    assert abs(result.treatment.level["rate"] - 3.0) < 5.0 * 3.0 * 0.5 * np.sqrt(3.9 / n)
    assert [d.kind for d in result.treatment.dirt] == ["noise_level"]
    assert not too_large(result.estimate)
    assert shift(result.estimate, clean_at).max() < 1.0


@pytest.mark.slow
def test_rounding_of_readings_is_modelled_as_such(flown):
    step = 3.0 * 2e-5
    rounded = changed(flown.campaign, lambda i, s: replace(s, rate=np.round(s.rate / step) * step))
    result = clean_fit(fitted(rounded))
    assert [(d.kind, d.channel) for d in result.treatment.dirt] == [("quantised", "rate")]
    assert not too_large(result.estimate)


@pytest.mark.slow
@pytest.mark.parametrize("sigmas", [6.0, 20.0])
def test_coarse_rounding_is_counted_once(flown, sigmas):
    """Readings share errors: the noise is louder than the rounding, and no test calls it wrong."""
    step = sigmas * 2e-5
    rounded = changed(flown.campaign, lambda i, s: replace(s, rate=np.round(s.rate / step) * step))
    result = clean_fit(fitted(rounded))
    assert [(d.kind, d.channel) for d in result.treatment.dirt] == [("quantised", "rate")]
    assert result.estimate.model.campaign.shared_errors == ("rate",)
    assert not any(test.rejected for test in result.estimate.tests.values())
    assert result.treatment.level["rate"] > np.hypot(1.0, sigmas / 12.0**0.5)


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["momentum", "magnetometer"])
def test_coarse_rounding_is_counted_in_every_sensor(channel):
    rng, small = np.random.default_rng(21), small_campaign()
    sensor = DirectionSensor(2e-7, unit="T")

    def change(i, slew):
        h = slew.wheel_momentum + 5e-6 * rng.normal(size=slew.wheel_momentum.shape)
        field = np.asarray(to_body(slew.attitude, slew.magnetic_field_N))
        field = field + 2e-7 * rng.normal(size=field.shape)
        rate = slew.rate + 2e-5 * rng.normal(size=slew.rate.shape)
        if channel == "momentum":
            h = np.round(h / 5e-5) * 5e-5
        else:
            field = np.round(field / 2e-6) * 2e-6
        return replace(slew, wheel_momentum=h, rate=rate, more={"magnetometer": field})

    seen = replace(small, more_sensors=(("magnetometer", sensor),))
    result = clean_fit(fitted(changed(seen, change)))
    assert result.treatment.rounded == (channel,)
    assert result.estimate.model.campaign.shared_errors == (channel,)
    assert not too_large(result.estimate)


@pytest.mark.parametrize("profile", ["smooth", "plateau", "noisy"])
def test_shared_errors_of_rounding_blur_a_motion_as_often_as_foretold(profile):
    """Of 1,000 phases; independent errors would blur what is smooth or rests at its top less."""
    rng, fraction = np.random.default_rng(3), np.linspace(0.0, 1.0, 1200)
    turning = np.clip(4.0 * np.minimum(fraction, 1.0 - fraction), 0.0, 1.0)
    path = 10.3 * (turning if profile == "plateau" else np.sin(np.pi * fraction) ** 2)
    noise = 0.5 if profile == "noisy" else 0.05
    true = path + rng.uniform(size=(1000, 1)) + noise * rng.normal(size=(1000, 1200))
    motion = path - path.mean()
    blur = (np.round(true) - true) @ motion / np.sqrt(motion @ motion / 12.0)
    seen, foretold = np.sqrt(np.mean(blur**2)), factor_of_shared_errors([path], [motion], [noise])
    # The mean square of 1,000 numbers: 1.2 for flat ones, 2 / 1,000 for normal ones.
    margin = 4.0 * 0.5 * np.sqrt(2.0 / 1000.0)
    assert seen == pytest.approx(foretold, rel=margin)
    assert (seen < 1.0 + margin) == (profile == "noisy")


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", ["hidden_lag", "hidden_dipole"])
def test_a_missing_effect_is_neither_masked_nor_taken_for_noise(name):
    result = clean_fit(fitted(read_campaign(DATA / name)))
    assert too_large(result.estimate)
    assert not result.treatment.masked
    assert not result.treatment.colour


def motion(rows=400, at_rest=90):
    """A slew that rests, turns, and rests."""
    speed = np.zeros((rows, 3))
    speed[at_rest:-at_rest, 0] = np.sin(np.linspace(0.0, np.pi, rows - 2 * at_rest)) ** 2
    return Slew("a", 0.0, 0.25 * np.arange(rows), rate=0.01 * speed)


def gauss_markov(rng, rows=400, phi=0.8):
    white = rng.normal(size=(rows + 100, 3))
    return lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white, axis=0)[100:]


def named(slew, n=4):
    return [replace(slew, name=str(i)) for i in range(n)]


def test_correlated_noise_is_seen_where_it_is_alike_everywhere():
    rng, slews = np.random.default_rng(1), named(motion())
    colour = colour_of(slews, [gauss_markov(rng) for _ in slews])
    assert colour is not None
    # 4 x 400 readings: a correlation of 0.8 is known to sqrt((1 - 0.64) / 1600) = 0.015.
    assert all(abs(a.share * a.correlation - 0.8) < 0.1 for a in colour.axes)
    assert all(abs(a.sd - 1.0) < 0.2 for a in colour.axes)


@pytest.mark.slow
def test_white_noise_has_no_colour_and_what_is_tied_to_the_motion_neither():
    rng, slews = np.random.default_rng(2), named(motion())
    white = [rng.normal(size=(400, 3)) for _ in slews]
    assert colour_of(slews, white) is None
    moving = (np.abs(motion().rate[:, :1]) > 5e-4).astype(float)
    tied = [x + 2.0 * moving * gauss_markov(rng) for x in white]
    assert colour_of(slews, tied) is None
    assert not is_alike_everywhere(slews, tied)
    of_one = [x + 2.0 * (i == 0) * gauss_markov(rng) for i, x in enumerate(white)]
    assert colour_of(slews, of_one) is None


@pytest.mark.parametrize(
    "misfit",
    [
        lambda t: 30.0 * (t > 200),  # a step
        lambda t: 0.2 * t,  # a drift
        lambda t: 20.0 * np.sin(0.5 * t),  # a ringing
        lambda t: 40.0 * ((t > 100) & (t < 140)),  # a lag while torque acts
        lambda t: np.where(t > 200, 30.0 * np.exp(-(t - 200) / 40) * np.sin(0.9 * (t - 200)), 0.0),
        lambda t: np.where(t > 200, 30.0 * np.exp(-(t - 200) / 15) * np.sin(2.4 * (t - 200)), 0.0),
        lambda t: 3.0 * np.maximum(0.0, t - 200.0),  # friction that changes its sign
    ],
)
def test_no_shape_of_a_missing_effect_is_an_outlier(misfit):
    noise = np.random.default_rng(4).normal(size=(400, 3))
    series = noise + misfit(np.arange(400.0))[:, None]
    assert not outlying_readings([series])[0].any()
    series[[60, 300]] += 400.0
    assert set(np.flatnonzero(outlying_readings([series])[0].any(axis=1))) == {60, 300}


@pytest.mark.parametrize("end", [0, 1, 2, -3, -2, -1])
def test_the_turn_of_a_missing_torque_is_no_outlier_at_the_ends_and_a_spike_is(end):
    """The star tracker of a gyroless spacecraft sees hundreds of sigmas of smooth misfit."""
    rng, x = np.random.default_rng(12), np.linspace(-1.0, 1.0, 160)
    turned = np.stack([400.0 * x**2 - 50.0 * x, -300.0 * x**2 + 200.0 * x, 100.0 * x**3], -1)
    fixes = turned + rng.normal(size=turned.shape)
    every = [np.arange(len(x))]
    assert not outlying_fixes([fixes], [every])[0].any()
    assert not outlying_readings([fixes])[0].any()
    fixes -= 0.9 * turned
    fixes[end, 1] += 30.0
    assert np.flatnonzero(outlying_fixes([fixes], [every])[0]).tolist() == [end % len(x)]
    assert np.argwhere(outlying_readings([fixes])[0]).tolist() == [[end % len(x), 1]]


def test_a_step_of_rounded_readings_is_no_outlier_and_three_are():
    # Noise of a sixth of the step: a reading leaps by a whole step now and then.
    truth = 0.9 + 0.3 * np.sin(0.7 * np.arange(400.0))[:, None]
    noisy = truth + np.random.default_rng(9).normal(size=(400, 3))
    rounded, steps = 6.0 * np.round(noisy / 6.0) - truth, np.full(3, 6.0)
    assert outlying_readings([rounded])[0].any()
    assert not outlying_readings([rounded], steps)[0].any()
    rounded[200, 1] += 18.0
    assert np.argwhere(outlying_readings([rounded], steps)[0]).tolist() == [[200, 1]]


def test_too_many_outliers_are_the_noise():
    rng = np.random.default_rng(5)
    heavy = rng.standard_t(1.0, size=(2000, 3))
    assert outlying_readings([heavy])[0].mean() > LIMITS.most_outliers


@pytest.mark.slow
def test_more_outliers_than_can_be_left_out_are_told_with_what_models_them(flown):
    rng = np.random.default_rng(8)

    def change(i, slew):
        hit = rng.random(slew.rate.shape) < 0.06
        return replace(slew, rate=slew.rate + 6e-4 * hit * rng.choice([-1.0, 1.0], hit.shape))

    dirty = changed(flown.campaign, change)
    result = clean_fit(fitted(dirty))
    (record,) = result.treatment.masked
    assert (record.channel, record.slew, record.rows) == ("rate", "", ())
    assert "%" in record.note
    explained = _explained(result.estimate, FitContext())
    assert "--noise rate=student_t" in explained["says"]
    modelled = NoiseModel(rate=ChannelNoise("student_t"))
    assert not clean_fit(optimizer.estimate(Model(dirty, noise=modelled))).treatment.masked


def test_readings_that_do_not_change_for_long_are_judged_without_a_warning():
    # Warnings are errors here: a window of equal readings has no spread of its own.
    series = np.random.default_rng(5).normal(size=(400, 3))
    series[100:200] = 0.0
    assert not outlying_readings([series])[0][110:190].any()


def test_outliers_that_gather_where_torque_changes_are_no_dirt():
    torque = np.zeros((400, 1))
    torque[[100, 101, 250, 251]] = 1.0
    slew = Slew("a", 0.0, np.arange(400.0), rate=np.zeros((400, 3)), wheel_torque=torque)
    flag = np.zeros((400, 3), bool)
    flag[[101, 102, 251, 252], 0] = True
    assert not away_from_switches((slew,), [flag])[0].any()
    scattered = np.zeros((400, 3), bool)
    scattered[[10, 101, 180, 320, 390], 1] = True
    assert np.array_equal(away_from_switches((slew,), [scattered])[0], scattered)


def test_a_burst_of_two_fixes_has_no_outlier():
    rng = np.random.default_rng(6)
    slews = [rng.normal(size=(4, 3)) for _ in range(4)]
    slews[0][0] += 50.0
    pairs = [[np.array([0, 1]), np.array([2, 3])]] * 4
    together = [[np.arange(4)]] * 4
    assert not any(flag.any() for flag in outlying_fixes(slews, pairs))
    assert np.flatnonzero(outlying_fixes(slews, together)[0]).tolist() == [0]


TRIPLES = [[np.arange(3), np.arange(3, 6)]] * 4


def drifting_fixes(seed=8):
    """Bursts of three fixes while a missing torque turns the body: turns and residuals."""
    rng, t = np.random.default_rng(seed), np.tile(np.arange(3.0), 2)[:, None]
    turns = [t**2 * rng.normal(0.0, 5.0, 3) + t * rng.normal(0.0, 20.0, 3) for _ in TRIPLES]
    return turns, [turn + rng.normal(size=(6, 3)) for turn in turns]


def test_what_a_missing_torque_does_to_three_fixes_is_no_outlier():
    turns, slews = drifting_fixes()
    assert not any(f.any() for f in outlying_fixes(slews, TRIPLES, turns=turns))
    # Nor is what an error of the rate sensor lets expect: the fixes themselves do not drift.
    calm = [np.random.default_rng(k).normal(size=(6, 3)) for k in range(4)]
    wrong = [30.0 * np.tile(np.arange(3.0), 2)[:, None] * np.ones(3)] * 4
    assert not any(f.any() for f in outlying_fixes(calm, TRIPLES, turns=wrong))


@pytest.mark.parametrize("row", [0, 1, 2, 4])
def test_one_wrong_fix_of_three_is_known(row):
    turns, slews = drifting_fixes()
    slews[2][row, 1] += 40.0
    flags = outlying_fixes(slews, TRIPLES, turns=turns)
    assert [np.flatnonzero(f).tolist() for f in flags] == [[], [], [row], []]


@pytest.mark.slow
@pytest.mark.parametrize("louder", [1.0, 1.5, 3.0])
def test_fixes_louder_than_stated_are_no_outliers(louder):
    halves = [[np.arange(12), np.arange(12, 24)]] * 5
    for seed in range(20):
        rng = np.random.default_rng(seed)
        slews = [louder * rng.normal(size=(24, 3)) for _ in halves]
        assert not any(f.any() for f in outlying_fixes(slews, halves))
        slews[2][7, 0] += 20.0 * louder
        assert np.flatnonzero(outlying_fixes(slews, halves)[2]).tolist() == [7]


def test_two_wrong_fixes_of_three_are_left_alone():
    turns, slews = drifting_fixes()
    slews[2][0, 1] += 40.0
    slews[2][1, 1] -= 60.0
    assert not any(f.any() for f in outlying_fixes(slews, TRIPLES, turns=turns))


def coloured(campaign, share, time):
    sensor = replace(campaign.rate_sensor, correlated_noise=CorrelatedNoise(share, time))
    return replace(campaign, rate_sensor=sensor)


def test_readings_of_correlated_noise_tell_less(flown, clean_at):
    correlated = fitted(coloured(flown.campaign, 0.9, 3.0))
    assert np.all(correlated.sd[:9] > 0.99 * clean_at.sd[:9])
    assert np.max(correlated.sd[:9] / clean_at.sd[:9]) > 1.3


@pytest.mark.parametrize("axes", [np.eye(3)[:2], np.vstack([np.eye(3), np.ones(3) / 3**0.5])])
def test_correlated_noise_is_that_of_each_axis_of_the_gyro(flown, axes):
    slews = tuple(replace(slew, rate=slew.rate @ axes.T) for slew in flown.campaign.slews)
    campaign = replace(flown.campaign, rate_sensor=RateSensor(2e-5, axes), slews=slews)
    shares = np.linspace(0.2, 0.8, len(axes))
    colour = Colour(tuple(ColourOfAxis(1.5, share, 0.5, 50.0) for share in shares), 1.0)
    sensor = treated(campaign, DirtTreatment(colour={"rate": colour}), "commanded").gyro
    np.testing.assert_allclose(sensor.sigma, 3e-5)
    np.testing.assert_allclose(sensor.correlated_noise.share, shares)


@pytest.mark.long
@pytest.mark.slow
def test_correlated_noise_of_a_further_gyro_is_its_own(flown, clean_at):
    rng, slews, sigma = np.random.default_rng(3), [], 1e-4
    for slew, residual in zip(flown.campaign.slews, clean_at.residual_series["rate"], strict=True):
        n = len(slew.time)
        exact = slew.rate - residual[:n] * flown.campaign.gyro.sigma
        slews.append(replace(slew, more={"mems": exact + sigma * gauss_markov(rng, n)}))
    sensors = (("mems", RateSensor(sigma)),)
    fit = fitted(replace(flown.campaign, slews=tuple(slews), more_sensors=sensors))
    colour = colours_seen(fit)
    assert list(colour) == ["mems"]
    assert np.mean([axis.correlation for axis in colour["mems"].axes]) == pytest.approx(
        0.8, abs=0.1
    )
    treatment = DirtTreatment(colour=colour)
    seen = treated(fit.model.campaign, treatment, "commanded")
    assert "noise of the mems is correlated in time" in treatment.dirt[0].note
    assert seen.gyro == flown.campaign.gyro
    again = optimizer.estimate(Model(seen), start=fit.theta, starts=1)
    assert again.tests["mems"].p_white > 1e-3 > fit.tests["mems"].p_white
    wider = again.sd[9:12] / fit.sd[9:12]
    assert wider.min() > 1.0
    assert wider.max() > 1.3


@pytest.mark.slow
def test_a_treatment_survives_its_json(flown):
    campaign, _ = spiked(flown.campaign)
    rng, slews = np.random.default_rng(1), named(motion())
    colour = colour_of(slews, [gauss_markov(rng) for _ in slews])
    result = clean_fit(fitted(campaign))
    treatment = replace(result.treatment, colour={"rate": colour}, rounded=("rate",))
    assert treatment_from(treatment.json()) == treatment
    of_the_first_gyro = treatment.json()["colour"]["rate"]
    assert treatment_from(treatment.json() | {"colour": of_the_first_gyro}) == treatment
    assert treatment_from(DirtTreatment().json()).is_nothing


def test_scale_factors_far_from_their_prior_are_never_trusted(clean_at, flown):
    """Rates in deg/s read as rad/s: K = 0.01745, tens of prior sd away, whatever chi^2 says."""
    assert prior_gate(clean_at)["passed"]
    theta = clean_at.theta.copy()
    theta[6:9] *= np.pi / 180.0
    point = Point(theta, clean_at.point.bias, clean_at.point.local)
    gate = prior_gate(replace(clean_at, point=point))
    assert not gate["passed"]
    assert "deg/s read as rad/s" in gate["says"]
    # Nine that are each 4 sd away are as impossible together.
    moved = clean_at.model.space.mean + 4.0 * clean_at.model.space.sd
    together = prior_gate(replace(clean_at, point=replace(point, theta=moved)))
    assert not together["passed"]
    assert "together" in together["says"]


def test_a_huge_objective_is_no_reason_to_lose_the_only_optimum(clean_at):
    descents = [(1e60, clean_at.point)]
    assert len(optimizer.distinct_optima(clean_at.model, descents)) == 1


def test_normal_equations_that_are_singular_end_in_a_message():
    with pytest.raises(EstimateError, match="units and signs"):
        inverse_root(np.array([[1.0, 2.0], [2.0, 1.0]]))


def test_a_device_that_contradicts_what_is_stated_of_it_is_never_trusted():
    model = Model(by_thrusters())
    theta = np.array(model.space.mean)
    gain = model.space.names.index("jets.gain")
    theta[gain] = 1.01
    gate = prior_gate(SimpleNamespace(model=model, theta=theta))
    assert gate["passed"]
    # What is farthest is not of J and K.
    assert "jets.gain = 1.01" in gate["says"]
    assert "J and K" not in gate["says"]
    theta[gain] = -1.0
    gate = prior_gate(SimpleNamespace(model=model, theta=theta))
    assert not gate["passed"]
    assert "jets.gain = -1 lies 100.0 prior sd" in gate["says"]
    assert "what jets was told" in gate["says"]


def test_a_further_gyro_that_contradicts_what_is_stated_of_it_is_never_trusted():
    """Its unit was wrong, and J and K trusted; no bias of a gyro is judged."""
    small = small_campaign()
    slews = tuple(replace(slew, more={"mems": slew.rate}) for slew in small.slews)
    model = Model(replace(small, slews=slews, more_sensors=(("mems", small.rate_sensor),)))
    theta, names = np.array(model.space.mean), model.space.names
    theta[names.index("mems.bias1")] += 10.0 * model.space.sd[names.index("mems.bias1")]
    assert prior_gate(SimpleNamespace(model=model, theta=theta))["passed"]
    theta[names.index("mems.K1")] = np.pi / 180.0
    gate = prior_gate(SimpleNamespace(model=model, theta=theta))
    assert not gate["passed"]
    assert "what mems reads" in gate["says"]


def test_without_a_gyro_nothing_is_said_of_the_unit_of_rates():
    small = small_campaign()
    slews = tuple(replace(slew, rate=None) for slew in small.slews)
    model = Model(replace(small, rate_sensor=None, slews=slews))
    theta = model.space.mean + 8.0 * model.space.sd
    gate = prior_gate(SimpleNamespace(model=model, theta=theta))
    assert not gate["passed"]
    assert "rad/s" not in gate["says"]
