"""How far an effect too weak to be found could have moved J and K."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.refits import fitted_with

from bayes_inertia.campaign.hardware import InertiaPrior
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.diagnosis.hypothesis_table import log_evidence_of, nothing
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.quoted_parameters import (
    largest_shifts,
    noncentrality_at_even_odds,
    quoted_parameters,
    undetected_alternatives,
    undetected_effects,
)
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import ParameterSpace
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.fit_sections import diagnosis_sections
from bayes_inertia.report.verdict import diagnosis_verdict


@pytest.mark.long
@pytest.mark.slow
def test_what_could_hide_moves_the_fit_as_far_as_it_says(
    flight, clean, clean_diagnosis, content_of, check_contract, rigid_library
):
    """The effect is flown, with the noise of the clean campaign, and left out of the fit."""
    found = clean_diagnosis
    rows = {row.parameter: row for row in undetected_effects(found)}
    assert tuple(rows) == found.base.model.space.names[:9]
    for name in ("Jxy", "K2"):
        row, i = rows[name], found.base.model.space.names.index(name)
        assert row.shift > 2.0 * row.sd
        (effect,) = (e for e in rigid_library if e.name == row.effect)
        space = ParameterSpace(tuple((effect.name, p) for p in effect.parameters(clean)))
        theta = np.array([row.values[n.split(".", 1)[1]] for n in space.names])
        values = {k: np.asarray(v) for k, v in space.split(theta)[effect.name].items()}
        moved = estimate(Model(flight((effect,), {effect.name: values})), starts=1, discount=False)
        # Half a per cent of it is of second order in the effect.
        assert (moved.theta[i] - found.base.theta[i]) / row.shift == pytest.approx(1.0, abs=0.02)
        # What moves one furthest moves the others no further than what moves those furthest.
        assert all(
            abs(moved.theta[j] - found.base.theta[j]) < 1.02 * other.shift
            for j, other in enumerate(rows.values())
        )
    content = content_of(found, blind_spots=tuple(rows.values()))
    check_contract(content)
    assert "too weak to be found, " in diagnosis_verdict(content).sentences[-1]
    assert "too weak" not in diagnosis_verdict(content).title
    assert "What could still hide" in [section.title for section in diagnosis_sections(content)]


@pytest.mark.long
@pytest.mark.slow
def test_what_is_fitted_hides_nothing_and_of_the_unknown_nothing_is_said(lagging, pumped):
    assert "wheel_command_lag" not in {row.effect for row in undetected_effects(lagging)}
    assert undetected_effects(pumped) == ()


@pytest.mark.long
@pytest.mark.slow
def test_J_and_K_with_an_undetected_effect_are_those_of_a_fit_with_it(clean_diagnosis):
    rows = {row.effect: row for row in undetected_alternatives(clean_diagnosis.final)}
    assert 0.0 < sum(row.probability for row in rows.values()) < 0.5
    for name in ("constant_torque", "rate_sensor_misalignment"):
        direct, row = fitted_with(clean_diagnosis.base.model, name), rows[name]
        # To first order in the effect: 5 % of what the fit moves or widens.
        before = clean_diagnosis.final
        moved = np.abs(direct.theta - before.theta)[:9] / direct.sd[:9]
        assert np.all(np.abs(row.mean - direct.theta[:9]) / direct.sd[:9] < 0.02 + 0.05 * moved)
        np.testing.assert_allclose(row.sd, direct.sd[:9], rtol=0.03)
        assert np.any(row.sd > 1.2 * before.sd[:9])


@pytest.mark.slow
def test_odds_beyond_the_largest_float_are_probabilities():
    small = small_campaign()
    shift = np.array([0.0, 3e-3, 0.0])
    turned = [replace(slew, rate=slew.rate + shift) for slew in small.slews]
    campaign, library = replace(small, slews=tuple(turned)), by_name(["rate_bias"])
    fitted = estimate(Model(campaign), starts=1, discount=False)
    linear = linear_model(move_to(fitted, Model(campaign, library)))
    evidence = log_evidence_of(nothing(linear.system), linear.members)
    assert evidence > np.log(np.finfo(float).max)
    (row,) = undetected_alternatives(fitted, library)
    assert row.probability == pytest.approx(1.0)


@pytest.mark.long
@pytest.mark.slow
def test_what_a_former_result_quotes_beyond_its_model_is_quoted_again():
    """As `fit` does in its summary."""
    campaign, beyond = small_campaign(), np.array([5e-2, 0.0])
    known = GaussianPrior(("Jxx", "K1"), [3.2, 1.0], np.diag([1e-8, 1e-8]))
    fitted = estimate(Model(replace(campaign, prior=known)), starts=1, discount=False)
    plain = quoted_parameters(fitted)
    wider = Model(replace(campaign, prior=replace(known, beyond_sd=beyond)))
    added = quoted_parameters(replace(fitted, model=wider)).sd ** 2 - plain.sd**2
    # The prior tells Jxx nearly alone.
    assert math.sqrt(added[0]) == pytest.approx(beyond[0], rel=0.3)
    assert np.all(added >= 0.0)


def test_even_odds_are_even_and_the_furthest_amplitude_is_the_furthest():
    rng, n = np.random.default_rng(4), 40_000
    size, limit = (
        noncentrality_at_even_odds(3, 1e-3),
        16.266,
    )  # chi^2 with three degrees of freedom exceeds it once in a thousand times
    error = math.sqrt(0.25 / n)

    def found(size):
        return np.mean(np.sum(rng.normal([math.sqrt(size), 0.0, 0.0], 1.0, (n, 3)) ** 2, 1) > limit)

    assert abs(found(size) - 0.5) < 4.0 * error
    assert abs(found(1.1 * size) - 0.5) > 4.0 * error
    shift_per_amplitude, root = rng.normal(size=(2, 4)), rng.normal(size=(4, 4))
    data = 9.0 * root @ root.T
    shift, amplitude = largest_shifts(shift_per_amplitude, data)
    shape = data + 0.25 * np.eye(4)
    np.testing.assert_allclose(np.einsum("pi,ij,pj->p", amplitude, shape, amplitude), 1.0)
    np.testing.assert_allclose(np.sum(shift_per_amplitude * amplitude, 1), shift)
    others = rng.normal(size=(5000, 4))
    others /= np.sqrt(np.einsum("ni,ij,nj->n", others, shape, others))[:, None]
    assert np.all(np.abs(others @ shift_per_amplitude.T) <= shift * (1.0 + 1e-12))


@pytest.mark.slow
def test_a_gain_that_scales_J_alone_is_seen_by_no_data_and_widens_nothing():
    """Where the prior of J was narrow it saw the gain, and J was quoted a hundred times wider."""
    small, library = small_campaign(), by_name(["wheel_torque_gain"])
    blind = tuple(replace(wheel, momentum_sigma=None) for wheel in small.wheels)
    slews = tuple(replace(slew, wheel_momentum=None) for slew in small.slews)
    powers = {}
    for narrow in (True, False):
        prior = InertiaPrior(small.inertia.tensor, *((0.01, 0.03) if narrow else (100.0, 100.0)))
        campaign = replace(small, wheels=blind, slews=slews, inertia=prior)
        fitted = estimate(Model(campaign), starts=1, discount=False)
        linear = linear_model(move_to(fitted, Model(campaign, library)))
        (member,) = linear.members
        each = (linear.system.matrix, linear.told_by_data)
        block = np.ix_(member.index, member.index)
        powers[narrow] = [np.linalg.eigvalsh(matrix[block]) for matrix in each]
        if narrow:
            (row,) = undetected_alternatives(fitted, library)
            # Gains that differ widen it 3 times; with what all share it was 50 times and more.
            assert np.all(row.sd < 5.0 * fitted.sd[:9])
    (by_prior, told), (_, again) = powers[True], powers[False]
    assert by_prior[0] > 1.0 > 1e3 * told[0]
    np.testing.assert_allclose(told[1:], again[1:], rtol=1e-3)
