"""Formulas: what acts, in proportion to what."""

import itertools
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.check_effect import check_effect
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.effects.formula import DRIVERS, FORMS, PLACES, Formula, driver_of
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_context import State
from bayes_inertia.physics.small_campaign import small_campaign

CAMPAIGN = small_campaign()


@pytest.mark.parametrize("place", PLACES)
def test_a_formula_is_found_by_its_name(place):
    told = ("input_temperature", "rate_with_temperature", "vector_plume_full", "inertial_sun")
    for driver, form in itertools.product((*DRIVERS, *told), FORMS):
        wheel = 1 if driver_of(driver).of_one_wheel else 0
        row, column = {"entry": (2, 1), "column": (0, 1)}.get(form, (0, 0))
        formula = Formula(place, driver, form, row, column, wheel)
        assert formula.name.isidentifier()
        assert Formula.of_name(formula.name) == formula
        assert by_name([formula.name]) == (formula,)


def test_no_other_name_is_a_formula():
    for name in ("rate_bias", "formula", "formula_body_torque_rate_best", "formula_here_rate_full"):
        with pytest.raises(KeyError):
            Formula.of_name(name)
    with pytest.raises(EffectError, match="no effect of this name"):
        by_name(["formula_body_torque_rate_best"])


@pytest.mark.parametrize("end", ["entry", "entry_1", "column", "column_1_2", "full_1"])
def test_a_formula_without_its_entry_or_column_is_no_name(end):
    with pytest.raises(EffectError, match="no effect of this name"):
        by_name([f"formula_body_torque_rate_{end}"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"place": "here"}, "no place 'here'"),
        ({"driver": "luck"}, "no driver 'luck'"),
        ({"form": "round"}, "no form 'round'"),
        ({"form": "entry", "row": 3}, "there is no row 3"),
        ({"form": "column", "column": -1}, "there is no column -1"),
        ({"driver": "momentum_times_rate", "wheel": 3}, "there is no wheel 3"),
        ({"place": "rate_error", "driver": "field"}, "do not follow 'field'"),
        ({"driver": "constant", "form": "diagonal"}, "have no form 'diagonal'"),
    ],
)
def test_a_formula_that_cannot_be_is_refused(settings, message):
    with pytest.raises(EffectError, match=message):
        Formula(**settings).parameters(CAMPAIGN)


@pytest.mark.parametrize(
    ("form", "coefficients", "matrix"),
    [
        ("full", np.arange(9.0), np.arange(9.0).reshape(3, 3)),
        ("diagonal", np.array([1.0, 2.0, 3.0]), np.diag([1.0, 2.0, 3.0])),
        ("scalar", np.array([2.0]), 2.0 * np.eye(3)),
        ("column", np.array([1.0, 2.0, 3.0]), np.outer([1.0, 2.0, 3.0], [0.0, 1.0, 0.0])),
        ("cross", np.array([1.0, 2.0, 3.0]), [[0, -3, 2], [3, 0, -1], [-2, 1, 0]]),
    ],
)
def test_what_acts_is_the_matrix_of_coefficients_times_the_driver(form, coefficients, matrix):
    driver = np.array([0.3, -0.7, 1.1])
    formula = Formula("body_torque", "rate", form, column=1)
    labels = formula.parameters(CAMPAIGN)[0].names
    assert len(labels) == len(coefficients)
    state = State(*[None] * 7)._replace(rate_B=jnp.asarray(driver))
    acting = formula.body_torque({"c": jnp.asarray(coefficients)}, None, 0.0, state)
    np.testing.assert_allclose(acting, np.asarray(matrix) @ driver)


@pytest.mark.parametrize(
    ("formula", "unit"),
    [
        (Formula("body_torque", "constant", "full"), "N m"),
        (Formula("body_torque", "rate_times_speed", "diagonal"), "N m s^2"),
        (Formula("body_torque", "momentum", "full"), "1/s"),
        (Formula("wheel_torque", "wheel_squares", "diagonal"), "1/(N m s^2)"),
        (Formula("rate_error", "rate", "cross"), "rad"),
        (Formula("attitude_error", "time_in_slew", "full"), "rad/s"),
        (Formula("tachometer_error", "wheel_momenta", "scalar"), ""),
        (Formula("body_torque", "eddy", "scalar"), "N m s/T^2"),
    ],
)
def test_coefficients_have_the_unit_of_what_acts_over_that_of_the_driver(formula, unit):
    assert formula.parameters(CAMPAIGN)[0].unit == unit


def test_a_formula_given_by_name_counts_a_temperature_from_its_mean_in_the_campaign():
    """As a diagnosis does: K would hold at zero degrees otherwise."""
    slews = tuple(
        replace(s, inputs={"temperature": InputStream(s.time, np.full(len(s.time), 290.0 + k))})
        for k, s in enumerate(CAMPAIGN.slews)
    )
    campaign = replace(CAMPAIGN, slews=slews)
    for driver in ("input_temperature", "rate_with_temperature"):
        (formula,) = by_name([f"formula_rate_error_{driver}_full"])
        readings = np.concatenate([s.inputs["temperature"].values for s in slews])
        assert formula.in_campaign(campaign).middle == pytest.approx(readings.mean(), rel=1e-5)
        stated = replace(formula, middle=5.0)
        assert stated.in_campaign(campaign) is stated
    (model_s,) = Model(campaign, (formula,)).effects
    assert model_s.middle == formula.in_campaign(campaign).middle
    assert Formula("body_torque", "speed").in_campaign(campaign).middle is None


def test_a_scale_factor_that_follows_a_temperature_counts_it_from_its_middle():
    formula = Formula("rate_error", "rate_with_temperature", "diagonal", middle=293.0)
    assert formula.text == "rate error = diag(c) (temperature − 293) ω"
    # A name tells no number, but from where it counts.
    assert Formula.of_name(formula.name).text == "rate error = diag(c) (temperature − mean) ω"
    assert formula.K_holds == "the mean of temperature"
    assert Formula("rate_error", "rate_times_time").K_holds == "the middle of the campaign"
    assert Formula("body_torque", "rate_times_time").K_holds == ""
    for form in ("hollow", "cross"):
        assert Formula("rate_error", "rate_times_time", form).K_holds == ""
    assert formula.parameters(CAMPAIGN)[0].unit == "rad/temperature"
    state = State(*[None] * 7, inputs={"temperature": jnp.asarray([295.0])})
    state = state._replace(rate_B=jnp.asarray([0.1, 0.2, -0.3]))
    acting = formula._value({"c": jnp.asarray([1.0, 10.0, 100.0])}, None, 0.0, state)
    np.testing.assert_allclose(acting, [0.2, 4.0, -60.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "formula",
    [
        Formula("body_torque", "gyroscopic", "cross"),
        pytest.param(Formula("wheel_torque", "wheel_efforts", "diagonal"), marks=pytest.mark.long),
        pytest.param(
            Formula("rate_error", "momentum_times_rate", "scalar", wheel=2), marks=pytest.mark.long
        ),
    ],
)
def test_formulas_keep_the_contract_of_effects(formula):
    assert check_effect(formula).name == formula.name
