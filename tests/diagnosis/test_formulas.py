"""Formulas for what has no name: their columns, their prior, their rate of false alarms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp

from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.campaign.actuators import Change
from bayes_inertia.campaign.hardware import RateSensor
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.diagnosis import formulas
from bayes_inertia.diagnosis.formulas import blocks, drivers, projected, search_formulas, weighed
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.result import FormulaSearch, FormulaTerm
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.physics.effects.formula import Formula
from bayes_inertia.physics.effects.viscous_torque import ViscousTorque
from bayes_inertia.physics.effects.wheel_friction import WheelFriction
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.verdict import headline

# One of each place.
FORMULAS = (
    Formula("body_torque", "rate_times_speed", "full"),
    Formula("inertial_torque", "constant", "full"),
    Formula("wheel_torque", "wheel_signed_squares", "full"),
    Formula("rate_error", "wheel_speeds", "full"),
    Formula("rate_error", "rate_times_time", "full"),
    Formula("attitude_error", "time_in_slew", "full"),
    Formula("tachometer_error", "wheel_rates", "full"),
    Formula("body_torque", "inertial_sun", "full"),
    Formula("rate_error", "input_temperature", "full"),
    Formula("rate_error", "rate_with_temperature", "full"),
    Formula("attitude_error", "vector_sun", "full"),
)


def heated(slew):
    """The slew with a temperature and the direction of the Sun beside it."""
    k = int(slew.start) % 7
    degrees = 293.0 + 3.0 * np.sin(0.1 * slew.time + k) + k
    sun = np.roll([[0.8, -0.5, 0.33]], k, axis=1)
    inputs = {"temperature": InputStream(slew.time, degrees, "line")}
    inputs["stuck"] = InputStream(slew.time[:1], np.array([[293.1234567]]))
    return replace(slew, inputs=inputs | {"sun": InputStream(slew.time[:1], sun)})


@pytest.fixture(scope="module")
def fit():
    campaign = small_campaign()
    return estimate(Model(replace(campaign, slews=tuple(map(heated, campaign.slews)))), starts=1)


def test_a_stuck_input_is_followed_by_nothing(fit):
    keys = [followed.key for followed in drivers(torque_response(fit))]
    assert {"rate_with_temperature", "vector_sun", "inertial_sun"} <= set(keys)
    assert not [key for key in keys if "stuck" in key]


@pytest.fixture(scope="module")
def search(fit):
    return search_formulas(torque_response(fit), linear_model(fit))


@pytest.mark.long
@pytest.mark.slow
def test_columns_are_the_derivatives_of_the_model(fit):
    """The linear response against sensitivities of a model that holds the formulas."""
    found = {block.formula.name: block for block in blocks(torque_response(fit))}
    formulas = tuple(found[formula.name].formula for formula in FORMULAS)
    held = move_to(fit, Model(fit.model.campaign, formulas))
    sensitivities, space = held.linearised().parameters, held.model.space
    for formula in formulas:
        part = space.slice_of(formula.name)
        exact = sensitivities[..., part] * space.sd[part]
        columns = found[formula.name].columns
        # As far as the fit's start states cannot do the same.
        assert np.linalg.norm(columns - exact) < 0.02 * np.linalg.norm(exact), formula.name


@pytest.mark.slow
def test_prior_probabilities_of_all_terms_add_up_to_one(search):
    assert logsumexp([term.log_prior for term in search.terms]) == pytest.approx(0.0, abs=1e-9)
    assert len({term.formula.name for term in search.terms}) == len(search.terms) > 500


@pytest.mark.slow
def test_an_error_in_proportion_to_the_rate_leaves_the_scale_factors_to_K(search):
    """Its diagonal is K: free once more, K would not be known at all."""
    held = [
        t.formula for t in search.terms if t.formula.name.startswith("formula_rate_error_rate_")
    ]
    held = [f for f in held if f.driver == "rate"]
    assert {f.form for f in held} == {"hollow", "entry", "cross"}
    assert all(f.row != f.column for f in held if f.form == "entry")
    assert not any(
        (t.formula.place, t.formula.driver) == ("rate_error", "wheel_rates") for t in search.terms
    )


def test_all_but_the_diagonal_multiplies_the_driver():
    formula = Formula("rate_error", "rate", "hollow")
    assert Formula.of_name(formula.name) == formula
    assert formula.text == "rate error = C ω with no diagonal in C"
    (parameter,) = formula.parameters(small_campaign())
    assert parameter.components == ("xy", "xz", "yx", "yz", "zx", "zy")
    acting = formula._of_driver(np.arange(1.0, 7.0), np.array([1.0, 10.0, 100.0]))
    np.testing.assert_allclose(acting, [210.0, 403.0, 65.0])


def test_labels_of_no_diagonal_go_by_place_and_not_by_name():
    campaign = small_campaign()
    wheels = tuple(replace(w, name=f"rw{k}") for k, w in enumerate(campaign.wheels))
    formula = Formula("body_torque", "wheel_commands", "hollow")
    (parameter,) = formula.parameters(replace(campaign, wheels=wheels))
    assert parameter.components[:2] == ("x_rw1", "x_rw2")
    assert formula._of_driver(np.ones(len(parameter.components)), np.ones(3)).tolist() == [2.0] * 3


@pytest.mark.parametrize(
    ("axes", "known"),
    [
        (np.diag([1.0, -1.0, 1.0]), True),
        (np.eye(3) + 1e-12, True),
        (np.eye(3)[[1, 2, 0]], False),
        (np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, -0.8, 0.6]]), False),
        (np.eye(3)[:2], False),
    ],
)
def test_an_error_of_the_rate_is_weighed_only_where_K_is_its_diagonal(axes, known):
    campaign = SimpleNamespace(rate_sensor=SimpleNamespace(axes=axes))
    model = SimpleNamespace(campaign=campaign)
    assert bool(formulas._allowed("rate_error", "rate", model)) is known
    assert formulas._allowed("rate_error", "rate_squares", model)
    assert not formulas._allowed("rate_error", "wheel_rates", model)


def test_a_headline_with_several_answers_names_no_formula_alone():
    name = "formula_rate_error_wheel_commands_full"
    content = {"verdict": "formula", "named": [name], "ambiguous_with": []}
    assert headline(content).endswith("Its formula: rate error = C u_w.")
    several = headline(content | {"ambiguous_with": [[name, "nameless_rate_error"]]})
    assert several.startswith("Something is missing: either rate error = C u_w or ")
    assert several.endswith("This campaign cannot tell.")


@pytest.mark.long
@pytest.mark.slow
def test_a_law_that_an_effect_can_make_is_no_formula(fit, search):
    """Friction alike on all wheels is friction; drag in the square of the rate is another law."""
    effects = WheelFriction(), ViscousTorque()
    linear = linear_model(move_to(fit, Model(fit.model.campaign, effects)))
    names = [effect.name for effect in effects]
    left = {t.formula.name for t in search_formulas(torque_response(fit), linear, names).terms}
    same = {
        f"formula_{law}_{form}"
        for law in ("wheel_torque_wheel_signs", "body_torque_rate")
        for form in ("scalar", "diagonal", "entry_0_0")
    }
    assert same <= {term.formula.name for term in search.terms}
    assert not same & left
    assert "formula_body_torque_rate_times_speed_scalar" in left
    assert "formula_body_torque_rate_full" in left


def test_terms_stand_in_the_order_of_their_odds():
    terms = [FormulaTerm(Formula(column=k, form="column"), 5.0 - k, -2.0 * k) for k in range(3)]
    search = FormulaSearch(tuple(terms))
    assert search.equals(3.5) == tuple(terms[:2])
    assert search.log_evidence == pytest.approx(logsumexp([5.0, 2.0, -1.0]))


@pytest.mark.long
@pytest.mark.slow
def test_noise_alone_gives_false_alarms_as_rarely_as_stated(fit):
    """Markov: odds of 50 in at most one campaign of 50; a torque beside the noise gives them."""
    rng, linear, draws = np.random.default_rng(3), fit.linearised(), 40
    own = [projected(block, linear_model(fit)) for block in blocks(torque_response(fit))]
    noise = linear.replicates(rng, draws, np.ones_like(linear.residual))
    found = np.array([_searched(own, noise[..., k]) for k in range(draws)])
    assert np.mean(found > np.log(50.0)) <= 0.02 + 2.0 * np.sqrt(0.02 / draws)
    drag = next(o.block for o in own if o.block.formula.driver == "rate_times_speed")
    column = linear.unfitted(drag.columns[..., 0])
    loud = noise[..., 0] + 12.0 * column / np.linalg.norm(column)
    assert _searched(own, loud) > np.log(50.0)


def _searched(own, residual):
    """Log evidence of any formula for residuals that a fit left."""
    of_block = [p._replace(gradient=np.einsum("snk,sn->k", p.block.columns, residual)) for p in own]
    return weighed(of_block).log_evidence


@pytest.mark.long
@pytest.mark.slow
def test_a_bias_that_follows_the_users_own_temperature_is_named(clean, rigid_library):
    """The column is counted from its mean: a bias is fitted anyway."""
    slews = []
    for slew in map(heated, clean.slews):
        warmer = slew.inputs["temperature"].values - 293.0
        error = 0.5 * clean.rate_sensor.sigma[0] * warmer * np.array([1.0, -0.4, 0.2])
        slews.append(replace(slew, rate=slew.rate + error))
    found = diagnose(replace(clean, slews=tuple(slews)), library=rigid_library)
    assert found.verdict == "formula"
    (name,) = found.named
    assert name.startswith("formula_rate_error_input_temperature")
    (formula,) = found.effects_added
    assert 285.0 < formula.middle < 305.0


@pytest.mark.long
@pytest.mark.slow
def test_a_scale_factor_that_follows_the_users_own_temperature_is_named(clean, rigid_library):
    slews = []
    for slew in map(heated, clean.slews):
        warmer = slew.inputs["temperature"].values - 293.0
        slews.append(replace(slew, rate=slew.rate * (1.0 + 1e-3 * warmer)))
    found = diagnose(replace(clean, slews=tuple(slews)), library=rigid_library)
    assert found.verdict == "formula"
    (name,) = found.named
    assert name.startswith("formula_rate_error_rate_with_temperature")


@pytest.mark.long
@pytest.mark.slow
def test_a_law_outside_the_library_is_named_by_its_formula(
    planted, few_candidates, content_of, check_contract
):
    law = Formula("body_torque", "speed_squared", "full")
    truth = np.array([0.03, 0.0, 0.015])
    found = diagnose(planted(square=truth), library=few_candidates)
    assert (found.verdict, found.named) == ("formula", (law.name,))
    space, final = found.final.model.space, found.final
    part = space.slice_of(law.name)
    z = (final.theta[part] - truth) / final.sd[part]
    assert np.abs(z).max() < 4.0
    content = content_of(found)
    check_contract(content, few_candidates)
    assert content["formulas"]["terms"][0]["formula"] == "body torque = c |ω|²"
    assert content["formulas"]["false_alarm_at_most"] < 1e-6
    assert next_fit_from(content).effects == found.effects_added
    assert headline(content) == (
        "Something is missing that no effect of the library is. Its formula: body torque = c |ω|²."
    )


@pytest.mark.long
@pytest.mark.slow
def test_columns_are_those_of_the_gyro_at_hand_and_of_J_after_its_changes(fit):
    """Four skewed axes, and a panel that opens before the second slew."""
    slews, axes = fit.model.campaign.slews, np.vstack([np.eye(3), np.full(3, 3.0**-0.5)])
    campaign = replace(
        fit.model.campaign,
        rate_sensor=RateSensor((2e-5,) * 4, axes=axes, bias_sigma=(2e-6,) * 4),
        slews=tuple(replace(slew, rate=slew.rate @ axes.T) for slew in slews),
        changes=(Change("panel", slews[1].start, 0.3),),
    )
    plain = estimate(Model(campaign), starts=1)
    theta = plain.theta.copy()
    theta[plain.model.space.slice_of("panel")] = [1.5, 0.3, 1.2, 0.1, 0.0, -0.1]
    opened = replace(plain, point=replace(plain.point, theta=theta))
    found = {block.formula.name: block for block in blocks(torque_response(opened))}
    formulas = tuple(found[f.name].formula for f in (FORMULAS[0], FORMULAS[3]))
    assert {formula.place for formula in formulas} == {"body_torque", "rate_error"}
    held = move_to(opened, Model(campaign, formulas))
    linear, space = held.linearised(), held.model.space
    # The attitudes are far from those measured, where their residuals are no straight lines.
    rates = linear.channels["rate"].shaped
    for formula in formulas:
        part = space.slice_of(formula.name)
        exact = rates(linear.parameters[..., part] * space.sd[part])
        columns = rates(found[formula.name].columns)
        for s in range(len(slews)):
            gap = np.linalg.norm(columns[s] - exact[s])
            assert gap < 0.02 * np.linalg.norm(exact[s]), (formula.name, s)
