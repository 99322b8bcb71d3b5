"""Effects without a fixed shape as candidates: what they do to residuals, and who wins."""

import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.special import logsumexp
from support.other_spacecraft import by_rotors, by_thrusters, gyroless, two_axes_and_vectors

from bayes_inertia.diagnosis.hypothesis_table import log_evidence_of_random
from bayes_inertia.diagnosis.limits import LIMITS, Rules
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.random_signals import (
    STOCHASTIC_CANDIDATES,
    random_members,
    roots_at,
    usable,
)
from bayes_inertia.diagnosis.score_test import random_candidates, with_p_values
from bayes_inertia.diagnosis.table_search import with_stochastic
from bayes_inertia.diagnosis.torque_response import coefficient_columns, torque_response
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.likelihood import Point, padded_sensitivities
from bayes_inertia.inference.marginal_posterior import prior_roots
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.maths.kept_programs import IN_MEMORY
from bayes_inertia.physics.effects import STOCHASTIC, ConstantTorque
from bayes_inertia.physics.effects.rate_bias import RateBiasSlewDrift
from bayes_inertia.physics.effects.rate_noise import RateBiasInstability, RateRandomWalk
from bayes_inertia.physics.forward_model import Model


@pytest.fixture(scope="module")
def plain(clean):
    return optimizer.estimate(Model(clean), discount=False)


def evidence_of_each(fit, effects):
    """Log evidence of effects without a fixed shape at a fit, by name."""
    linear = linear_model(fit, (), fit.objective)
    members = random_members(linear, torque_response(fit), effects, nameless=False)
    return {m.name: float(logsumexp(log_evidence_of_random(m))) for m in members}


def of_the_model(estimate, effect):
    """Derivatives of the residuals towards an effect's whitened coefficients, by its own model."""
    model = Model(estimate.model.campaign, (effect,))
    theta = model.space.mean
    theta[:9] = estimate.theta
    count = effect.coefficient_count(model.campaign)
    local = np.concatenate([estimate.point.local, np.zeros((model.n_slews, count))], 1)
    point = Point(theta, estimate.point.bias, local)
    white = whitening(model, theta)
    first = model.n_bias + model.structure.n_start
    jacobian = padded_sensitivities(model, point, white, np.arange(0)).jacobian
    columns = np.concatenate([np.asarray(j)[..., first : first + count] for j in jacobian], 1)
    (blocks,) = prior_roots(model.structure, theta, model.data.arrays.slews.context)
    return columns, np.asarray(blocks)


@pytest.mark.long
@pytest.mark.slow
def test_columns_are_those_of_the_effects_own_model(plain):
    """To the second order of the integration: the model steps from reading to reading. A motor acts
    on body, wheel and, through the wheel's momentum, on the body again.
    """
    (effect,) = (e for e in STOCHASTIC_CANDIDATES if e.name == "wheel_torque_noise")
    model, blocks = of_the_model(plain, effect)
    columns = coefficient_columns(torque_response(plain), effect)
    slews, _, k = columns.shape
    shaped = columns.reshape(slews, -1, blocks.shape[1], blocks.shape[2])
    whitened = np.einsum("snbi,sbij->snbj", shaped, blocks).reshape(slews, -1, k)
    assert np.abs(model).max() > 0.5
    assert np.abs(whitened - model).max() < 0.02 * np.abs(model).max()


def test_the_usual_candidates_are_the_named_ones():
    names = {e.name for e in STOCHASTIC_CANDIDATES}
    free = {f"{place}_remainder" for place in ("torque", "rate", "wheel_torque", "tachometer")}
    assert names == {e.name for e in STOCHASTIC} - free


@pytest.mark.long
@pytest.mark.slow
def test_of_a_clean_campaign_nothing_random_is_significant(plain):
    weighed = evidence_of_each(plain, STOCHASTIC_CANDIDATES)
    assert weighed.keys() == {e.name for e in STOCHASTIC_CANDIDATES}
    assert max(weighed.values()) < 5.0


@pytest.mark.slow
def test_p_values_of_a_fit_are_of_the_whole_family_and_below_the_bound(plain):
    """Each is of the largest of all Bayes factors: it falls with the evidence, and lies at a small
    share of Markov's bound where that is small. A campaign of too many slews keeps the bound.
    """
    response, linear = torque_response(plain), linear_model(plain)
    some = [e for e in STOCHASTIC_CANDIDATES if e.name in ("rate_random_walk", "torque_noise")]
    members = random_members(linear, response, some, nameless=False)
    one = [m for m in members if m.name == some[0].name]
    asked = []
    for level in (-2.0, 0.0, 2.0, 4.0, 6.0):
        asked += random_candidates(one, {frozenset([some[0].name]): level})
    assert [c.p_value for c in asked[:3]] == pytest.approx([1.0, 1.0, np.exp(-2.0)])
    p, bound = (
        np.array([c.p_value for c in candidates])
        for candidates in (
            with_p_values(asked, members, np.random.default_rng(1)),
            asked,
        )
    )
    assert np.all(np.diff(p) < 0.0)
    assert p[0] > 0.5
    assert np.all(p[2:] < 0.5 * bound[2:])
    assert np.all(p > 0.0)
    alone = with_p_values(asked, one, np.random.default_rng(1))
    assert alone[2].p_value < p[2]
    with pytest.MonkeyPatch.context() as patched:
        module = sys.modules[random_members.__module__]
        patched.setattr(module, "LIMITS", replace(LIMITS, largest_matrices=1.0))
        many = random_members(linear, response, some, nameless=False)
    assert with_p_values(asked, many, None) == tuple(asked)


@dataclass(frozen=True)
class WalkOfEachSlew(RateRandomWalk):
    """A random walk that begins anew in every slew."""

    name = "walk_of_each_slew"

    def covariance_across_slews(self, p, slews):
        return None


def walking(campaign, density, seed):
    """The campaign with a rate bias that walks, in each slew and between them."""
    rng = np.random.default_rng(seed)
    time = np.concatenate([s.start + s.time for s in campaign.slews])
    step = np.sqrt(np.diff(time, prepend=time[0]))[:, None] * rng.normal(size=(len(time), 3))
    walk = density * step.cumsum(0)
    walk -= walk[np.abs(time - np.mean(campaign.span)).argmin()]
    parts = iter(np.split(walk, np.cumsum([len(s.time) for s in campaign.slews])[:-1]))
    slews = tuple(replace(s, rate=s.rate + next(parts)) for s in campaign.slews)
    return replace(campaign, slews=slews)


@pytest.mark.slow
def test_a_walk_is_weighed_as_one_process_over_the_campaign(clean):
    """Its values in several slews belong together: that tells it from other shapes."""
    gains = []
    for seed in range(4):
        campaign = walking(clean, 0.03 * clean.rate_sensor.sigma[0], seed)
        fit = optimizer.estimate(Model(campaign), starts=1, discount=False)
        (one,), (apart,) = (
            evidence_of_each(fit, [effect]).values()
            for effect in (RateRandomWalk(), WalkOfEachSlew())
        )
        gains.append(one - apart)
    assert np.mean(gains) > 2.0 * np.std(gains) / np.sqrt(len(gains))


def stationary(campaign, sd, time, seed):
    """The campaign with a rate bias that wanders about its mean, in each slew and between them."""
    rng = np.random.default_rng(seed)
    at = np.concatenate([s.start + s.time for s in campaign.slews])
    kept = np.exp(-np.diff(at, prepend=-np.inf) / time)
    bias = np.zeros((len(at), 3))
    for i, (share, fresh) in enumerate(zip(kept, rng.normal(size=bias.shape), strict=True)):
        bias[i] = share * bias[i - 1] + np.sqrt(1.0 - share**2) * fresh
    parts = np.split(sd * bias, np.cumsum([len(s.time) for s in campaign.slews])[:-1])
    pairs = zip(campaign.slews, parts, strict=True)
    return replace(campaign, slews=tuple(replace(s, rate=s.rate + part) for s, part in pairs))


def restarting(campaign, density, seed):
    """The campaign with a rate bias that walks off from zero in each slew."""
    walks, slews = walking(campaign, density, seed), []
    for old, slew in zip(campaign.slews, walks.slews, strict=True):
        slews.append(replace(slew, rate=slew.rate - (slew.rate - old.rate)[:1]))
    return replace(campaign, slews=tuple(slews))


# Kind, how it is made, its size in sds of a reading, and its time in slews.
WANDERING = [
    pytest.param("walk", walking, 0.1, None, marks=pytest.mark.long),
    ("walk that restarts", restarting, 0.1, None),
    pytest.param("lasting", stationary, 1.0, 3.0, marks=pytest.mark.long),
    pytest.param("short", stationary, 1.0, 0.05, marks=pytest.mark.long),
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "made", "size", "time"), WANDERING)
def test_a_walk_and_its_stationary_neighbour_are_told_apart_only_where_the_data_do(
    clean, kind, made, size, time
):
    """The true one is never ruled out; what ends within a slew is no walk."""
    sizes, leads = [size * clean.rate_sensor.sigma[0]], []
    if time is not None:
        sizes.append(time * clean.slews[0].duration)
    for seed in range(3):
        fit = optimizer.estimate(Model(made(clean, *sizes, seed)), starts=1, discount=False)
        value = evidence_of_each(fit, [RateRandomWalk(), RateBiasInstability()])
        assert max(value.values()) > 20.0
        leads.append(value["rate_random_walk"] - value["rate_bias_instability"])
    true = 1.0 if kind.startswith("walk") else -1.0
    assert min(true * lead for lead in leads) > -Rules().log_evidence_margin
    if kind == "short":
        assert max(leads) < -Rules().log_evidence_margin


@pytest.mark.slow
@pytest.mark.parametrize("alike", [True, False])
def test_a_drift_that_restarts_alike_in_all_slews_is_told_from_one_of_each_slew(clean, alike):
    rng, drift = np.random.default_rng(3), 0.4 * clean.rate_sensor.sigma[0]
    slopes = rng.normal(size=(1 if alike else len(clean.slews), 3)) * np.ones((len(clean.slews), 1))
    slews = [
        replace(s, rate=s.rate + drift * (s.time - s.time[0])[:, None] / np.ptp(s.time) * slope)
        for s, slope in zip(clean.slews, slopes, strict=True)
    ]
    fit = optimizer.estimate(Model(replace(clean, slews=tuple(slews))), starts=1, discount=False)
    linear = linear_model(fit, (), fit.objective)
    (member,) = random_members(linear, torque_response(fit), [RateBiasSlewDrift()], nameless=False)
    of_each, of_all = (logsumexp(x) for x in np.split(log_evidence_of_random(member), 2))
    assert (of_all > of_each + 1.0) if alike else (of_each > of_all + 1.0)


@pytest.mark.long
@pytest.mark.slow
def test_a_fit_without_an_effect_is_that_of_a_model_without_it(plain):
    """In the model that holds it, so that nothing is compiled anew."""
    start, walk = (1e-7,), RateRandomWalk()
    begin = optimizer.move_to(plain, Model(plain.model.campaign, (ConstantTorque(), walk)))
    theta = begin.theta.copy()
    theta[begin.model.space.slice_of(walk.name)] = start
    both = optimizer.re_estimate(begin, theta, np.arange(len(theta)))
    expected = with_stochastic(plain, walk, start)
    compiled = set(IN_MEMORY.held())
    fitted = optimizer.without_effects(both, {"constant_torque"}, theta, tolerance=1e-5)
    assert set(IN_MEMORY.held()) == compiled
    assert fitted.model is both.model
    assert [e.name for e in fitted.effects_fitted] == [walk.name]
    assert fitted.objective == pytest.approx(expected.objective, abs=1e-3)
    assert fitted.theta[:9] == pytest.approx(expected.theta[:9], abs=1e-2 * expected.sd[:9].min())
    assert both.objective < expected.objective - 1e-3


@pytest.mark.slow
def test_noise_that_the_campaign_states_is_no_candidate(clean):
    sensor = replace(clean.rate_sensor, rate_random_walk=1e-7)
    stated = Model(replace(clean, rate_sensor=sensor))
    names = {e.name for e in STOCHASTIC_CANDIDATES}
    assert {e.name for e in usable(STOCHASTIC_CANDIDATES, Model(clean), 1000)} == names
    kept = usable(STOCHASTIC_CANDIDATES, stated, 1000)
    assert {e.name for e in kept} == names - {"rate_random_walk"}
    assert usable(STOCHASTIC_CANDIDATES, stated, 10**9) == ()


@pytest.mark.parametrize("kind", [by_thrusters, by_rotors, gyroless, two_axes_and_vectors])
def test_random_candidates_are_those_that_the_spacecraft_can_have(kind):
    """Without star tracker none of it: a diagnosis ended with the error that such a fit has."""
    model = Model(kind())
    found = usable(STOCHASTIC_CANDIDATES, model, 99)
    beside = Model(model.campaign, found, model.structure.drive)
    assert beside.effects == found
    # The noise of gimbal angles is random too, and no candidate.
    assert len(roots_at(beside, 0.0)) == len(found)
    of_gyro = {"rate_random_walk", "rate_bias_instability", "rate_bias_slew_drift"}
    of_tracker = {"star_tracker_low_frequency"} if kind is not two_axes_and_vectors else set()
    names = {effect.name for effect in found}
    assert names >= of_tracker | (set() if kind is gyroless else of_gyro)
    assert ("star_tracker_low_frequency" in names) == bool(of_tracker)
