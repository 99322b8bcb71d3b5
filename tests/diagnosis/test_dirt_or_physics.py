"""Dirt is seen for what it is before physics is tried, and no effect is swallowed by it."""

from __future__ import annotations

from dataclasses import replace
from time import process_time
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.diagnosis import clean_start as dirt
from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.diagnosis.clean_start import (
    CleanStart,
    at_measured_level,
    clean_start,
    holds_correlated_noise,
    measured_again,
    with_correlated_noise,
    with_louder_noise,
)
from bayes_inertia.diagnosis.limits import Rules
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.noise_colour import Colour
from bayes_inertia.inference.treatment import DirtTreatment
from bayes_inertia.physics.effects import (
    LIBRARY,
    ConstantTorque,
    RateBiasInstability,
    RateSensorDelay,
    WheelCommandLag,
)
from bayes_inertia.physics.forward_model import Model

RIGID = tuple(e for e in LIBRARY if e.name != "flexible_mode")
# What is added first where the bias wanders, and gives way again.
TEMPTING = tuple(e for e in LIBRARY if e.name in ("inertia_change", "rate_sensor_nonlinearity"))
WEAK = 1e-7 * np.array([1.0, -1.0, 1.0])  # [N m], clear to an ideal test, and slow
HIDDEN = {
    "constant_torque": ((ConstantTorque(),), {"constant_torque": {"torque": WEAK}}),
    "strong_torque": ((ConstantTorque(),), {"constant_torque": {"torque": 30.0 * WEAK}}),
    "lag": ((WheelCommandLag(),), {"wheel_command_lag": {"tau": np.array(0.02)}}),
    "delay": ((RateSensorDelay(),), {"rate_sensor_delay": {"tau": np.array(0.02)}}),
}


def changed(campaign, change):
    return replace(campaign, slews=tuple(change(s) for s in campaign.slews))


def coloured(campaign, phi, seed=5):
    """The campaign with Gauss-Markov noise of one sigma in the rates."""
    rng, sigma = np.random.default_rng(seed), np.array(campaign.rate_sensor.sigma)

    def change(slew):
        white = rng.normal(size=(len(slew.time) + 1000, 3))
        noise = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white, axis=0)[1000:]
        return replace(slew, rate=slew.rate + sigma * noise)

    return changed(campaign, change)


def spiked(campaign, seed=6):
    """The campaign with 0.5 % outliers of the rates, and how many rows they hit."""
    rng, hit = np.random.default_rng(seed), []

    def change(slew):
        where = rng.random(slew.rate.shape) < 0.005
        hit.append(int(where.any(axis=1).sum()))
        return replace(slew, rate=slew.rate + where * rng.choice([-1.0, 1.0]) * 1e-3)

    return changed(campaign, change), hit


def rounded(campaign, sigmas):
    step = sigmas * campaign.rate_sensor.sigma[0]
    return changed(campaign, lambda s: replace(s, rate=np.round(s.rate / step) * step))


def begun(campaign, library=RIGID, **options):
    return clean_start(Model(campaign, candidate_effects(campaign, library).linear), **options)


def kinds(diagnosis):
    return {(d.kind, d.channel, d.treated) for d in diagnosis.dirt}


def test_a_fit_that_stopped_early_is_brought_to_its_end(flown):
    """Also where its noise is at the right level already."""
    settled = optimizer.estimate(Model(flown.campaign), discount=False)
    beside = settled.theta + 30.0 * settled.sd
    early = optimizer.re_estimate(settled, beside, settled.free, tolerance=1e8)
    stated = dict.fromkeys(CHANNELS, 1.0)
    start = CleanStart(settled.model, settled, stated, DirtTreatment())
    _, final = at_measured_level(start, early)
    assert early.objective - settled.objective > 1e-4
    assert final.objective - settled.objective < 1e-6


@pytest.mark.parametrize(("change", "again"), [(1.01, False), (0.99, False), (1.05, True)])
def test_a_level_that_hardly_changes_asks_for_no_further_round(flown, monkeypatch, change, again):
    settled = optimizer.estimate(Model(flown.campaign), discount=False)
    stated = dict.fromkeys(CHANNELS, 1.5)
    start = CleanStart(settled.model, settled, stated, DirtTreatment())
    named = replace(settled)
    monkeypatch.setattr(dirt, "_noise", lambda *_: {**stated, "rate": 1.5 * change})
    assert (measured_again(start, named) is not None) == again


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("hidden", HIDDEN)
def test_no_effect_is_taken_for_dirt(flight, hidden):
    campaign = flight(*HIDDEN[hidden])
    start = begun(campaign)
    assert not start.treatment.masked
    assert not start.treatment.rounded
    assert set(start.noise.values()) == {1.0}
    assert not diagnose(campaign, library=RIGID).dirt


@pytest.mark.long
@pytest.mark.slow
def test_dirt_alone_is_consistent_and_takes_no_longer_than_a_clean_campaign(clean):
    diagnose(clean, library=RIGID)  # Compiles.
    began = process_time()
    assert diagnose(clean, library=RIGID).verdict == "consistent"
    unit = process_time() - began
    outlying, hit = spiked(clean)
    for campaign, expected in (
        (outlying, ("outliers", "rate", "masked")),
        (coloured(clean, 0.9), ("coloured", "rate", "modelled")),
        (rounded(clean, 6.0), ("quantised", "rate", "modelled")),
    ):
        began = process_time()
        diagnosis = diagnose(campaign, library=RIGID)
        # Small functions are compiled once for other shapes of noise.
        assert process_time() - began < 4.0 * unit + 5.0
        assert (diagnosis.verdict, diagnosis.steps) == ("consistent", ())
        assert kinds(diagnosis) == {expected}
    assert sum(len(d.rows) for d in diagnose(outlying, library=RIGID).dirt) == sum(hit)


@pytest.mark.long
@pytest.mark.slow
def test_a_lag_beside_correlated_noise_is_named_and_the_noise_listed(flight):
    campaign = coloured(flight(*HIDDEN["lag"]), 0.7)
    diagnosis = diagnose(campaign, library=RIGID)
    assert (diagnosis.verdict, diagnosis.named) == ("named", ("wheel_command_lag",))
    assert kinds(diagnosis) == {("coloured", "rate", "modelled")}
    # Taken as white, the noise is not explained.
    begin = begun(campaign)
    assert not begin.treatment.colour
    assert begin.base.tests["rate"].p_white < 1e-6


@pytest.mark.long
@pytest.mark.slow
def test_a_torque_beside_outliers_is_named_and_the_outliers_listed(planted, few_candidates):
    campaign, hit = spiked(planted(steady=30.0 * WEAK))
    diagnosis = diagnose(campaign, library=few_candidates)
    assert "constant_torque" in diagnosis.named
    assert kinds(diagnosis) == {("outliers", "rate", "masked")}
    assert sum(len(d.rows) for d in diagnosis.dirt) == sum(hit)


@pytest.mark.long
@pytest.mark.slow
def test_nothing_is_measured_again_where_nothing_was_named(clean, few_candidates):
    start = begun(clean, few_candidates)
    assert measured_again(start, start.base) is None


def wandering(campaign, sd, seed):
    """The campaign with a Gauss-Markov bias of the rates, of 20 s, in each slew anew."""
    rng = np.random.default_rng(seed)

    def change(slew):
        kept = float(np.exp(-np.median(np.diff(slew.time)) / 20.0))
        fresh = np.sqrt(1.0 - kept**2) * rng.normal(size=slew.rate.shape)
        fresh[0] = rng.normal(size=3)
        return replace(slew, rate=slew.rate + sd * lfilter([1.0], [1.0, -kept], fresh, axis=0))

    return changed(campaign, change)


@pytest.mark.long
@pytest.mark.slow
def test_a_strong_process_of_the_bias_is_named_alone(clean):
    """Names and noise are of one search: nothing of an earlier one stands beside it.

    Walks as strong are diagnosed by `analyses/naming/table_study.py`.
    """
    size = 10.0 * clean.rate_sensor.sigma[0]
    diagnosis = diagnose(wandering(clean, size, 1), library=TEMPTING, rules=Rules(max_effects=1))
    name = "rate_bias_instability"
    assert (diagnosis.verdict, diagnosis.named) == ("named", (name,))
    assert [e.name for e in diagnosis.final.effects_fitted] == [name]
    assert "coloured" not in {dirt.kind for dirt in diagnosis.dirt}
    # Its sd is known to a few percent; that the fit is not of another size.
    first = diagnosis.final.model.space.slice_of(name).start
    assert diagnosis.final.theta[first] == pytest.approx(size, rel=0.3)


def heavy_tailed(campaign, seed=6):
    """The campaign with Student-t noise of 2.5 degrees of freedom beside the noise of its rates."""
    rng, sigma = np.random.default_rng(seed), np.array(campaign.rate_sensor.sigma)

    def change(slew):
        return replace(slew, rate=slew.rate + 0.7 * sigma * rng.standard_t(2.5, slew.rate.shape))

    return changed(campaign, change)


@pytest.mark.long
def test_heavy_tails_are_louder_noise_and_nothing_is_named_for_them(clean):
    diagnosis = diagnose(heavy_tailed(clean), library=TEMPTING, stochastic=())
    assert (diagnosis.verdict, diagnosis.named) == ("consistent", ())
    assert diagnosis.noise_probabilities["louder"] > 0.95
    assert diagnosis.treatment.by_residuals == ("rate",)
    # As large as the residuals are, tails and all.
    assert diagnosis.tests["rate"].reduced_chi2 == pytest.approx(1.0, abs=0.02)
    (told,) = (d.note for d in diagnosis.dirt if d.kind == "noise_level")
    assert "heavy tails" in told


def test_residuals_with_structure_or_as_large_as_predicted_are_no_louder_noise(flown):
    campaigns = (flown.campaign, coloured(flown.campaign, 0.9), heavy_tailed(flown.campaign))
    for campaign, expected in zip(campaigns, (False, False, True), strict=True):
        fit = optimizer.estimate(Model(campaign), starts=1, discount=False)
        begin = CleanStart(fit.model, fit, dict.fromkeys(CHANNELS, 1.0), DirtTreatment())
        louder = with_louder_noise(begin, fit, Rules())
        assert (louder is not None) is expected
    assert louder.noise["rate"] > 1.2
    assert louder.noise["attitude"] == 1.0
    assert with_louder_noise(replace(begin, as_stated=True), fit, Rules()) is None


@pytest.mark.parametrize(("readings", "noise"), [(10.0, True), (40.0, False)])
def test_a_process_of_the_rates_that_lasts_for_few_readings_is_noise(flown, readings, noise):
    effects = (RateBiasInstability(), ConstantTorque())
    model = Model(flown.campaign, effects)
    theta = model.space.mean
    time = model.space.slice_of("rate_bias_instability").start + 1
    theta[time] = readings * np.median(np.diff(flown.campaign.slews[0].time))
    fit = SimpleNamespace(model=model, theta=theta, effects_fitted=effects)
    assert holds_correlated_noise(fit) is noise
    assert not holds_correlated_noise(
        SimpleNamespace(model=model, theta=theta, effects_fitted=effects[1:])
    )


def test_noise_whose_colour_is_known_has_one_table(flown):
    """Coarse rounding is no guess, and telemetry taken as stated has white noise."""
    fit = optimizer.estimate(Model(coloured(flown.campaign, 0.9)), starts=1, discount=False)
    noise = dict.fromkeys(CHANNELS, 1.0)
    rounded = DirtTreatment((), {}, {"rate": Colour((), 0.1)}, ("rate",))
    white = CleanStart(fit.model, fit, noise, DirtTreatment())
    assert with_correlated_noise(white, fit).treatment.colour
    assert with_correlated_noise(replace(white, treatment=rounded), fit) is None
    assert with_correlated_noise(replace(white, as_stated=True), fit) is None
