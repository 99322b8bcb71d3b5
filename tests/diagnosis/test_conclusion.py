"""From the steps of a search to the verdict."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.diagnosis import nameless
from bayes_inertia.diagnosis.conclusion import (
    final_tests,
    is_explained,
    without_named_alternatives,
)
from bayes_inertia.diagnosis.nameless import (
    Rival,
    ambiguous_sets,
    nameless_leads,
    nameless_rival,
    nameless_shapes,
    names_may_imitate,
)
from bayes_inertia.diagnosis.prior_of_sets import cost_of_further
from bayes_inertia.diagnosis.result import AlternativeEffect, NamelessShape, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.residual_tests import chi2_test, whiteness
from bayes_inertia.physics.effects import StarTrackerLowFrequency, TorqueNoise
from bayes_inertia.physics.forward_model import Model

# Nothing without a name comes near.
FAR = Rival("body torque", -20.0, 0)


def rival_of(steps, candidates):
    return nameless_rival(steps, candidates, nameless_shapes(steps))


def test_what_was_named_too_is_no_alternative():
    """Both are needed."""
    fit = SimpleNamespace()
    delay = AlternativeEffect("rate_sensor_delay", fit, 9.0, 0.9)
    torque = AlternativeEffect("constant_torque", fit, 9.0, 0.9)
    steps = (
        Step("wheel_command_lag", fit, fit, 10.0, (delay, torque)),
        Step("constant_torque", fit, fit, 5.0),
    )
    kept = without_named_alternatives(steps)
    assert [a.effect for a in kept[0].alternatives] == ["rate_sensor_delay"]
    assert [s.added for s in kept] == ["wheel_command_lag", "constant_torque"]


def test_without_steps_nothing_is_claimed():
    assert rival_of((), 17).log_bayes_factor == -math.inf


def test_a_random_effect_that_a_shape_without_a_name_may_be_is_one_of_a_set():
    """With its hook; shapes that explain clearly less are none of the set, nor names of fixed
    shape, which have rivals of their own.
    """
    fit = SimpleNamespace()
    shapes = (NamelessShape("body torque", 19.0), NamelessShape("rate sensor", 12.0))
    step = Step("torque_noise", fit, fit, 20.0, stochastic=True, nameless=shapes)
    assert ambiguous_sets((step,), Rules(), FAR) == (("torque_noise", "nameless_body_torque"),)
    assert ambiguous_sets((step,), Rules(log_evidence_margin=0.5), FAR) == ()
    fixed = Step("constant_torque", fit, fit, 20.0, nameless=shapes)
    assert ambiguous_sets((fixed,), Rules(), FAR) == ()
    model = SimpleNamespace(model=SimpleNamespace(effects=(TorqueNoise(),)))
    beside = AlternativeEffect("torque_noise", model, 19.5, math.nan)
    both = Step("constant_torque", fit, fit, 20.0, (beside,), nameless=shapes)
    names = ("constant_torque", "torque_noise", "nameless_body_torque")
    assert ambiguous_sets((both,), Rules(), FAR) == (names,)


def test_a_name_that_something_without_a_name_equals_is_one_of_a_set():
    """And so is every later name, which may have taken a part of it."""
    fit = SimpleNamespace()
    steps = [Step(n, fit, fit, 20.0) for n in ("rate_bias", "wheel_torque_gain", "viscous_torque")]
    near = Rival("body torque that follows square of the body rate", -1.6, 1)
    assert ambiguous_sets(steps, Rules(), near) == (
        ("wheel_torque_gain", "nameless_body_torque"),
        ("viscous_torque", "nameless_body_torque"),
    )
    assert ambiguous_sets(steps, Rules(log_evidence_margin=1.0), near) == ()
    assert ambiguous_sets(steps, Rules(), FAR) == ()


def test_what_has_no_name_leads_each_step_by_its_own_evidence():
    """Not by that of the nearest over all steps, which may be none of the set."""
    fit = SimpleNamespace()
    shapes = (NamelessShape("body torque", 19.0), NamelessShape("rate sensor", 19.5))
    random = Step("torque_noise", fit, fit, 20.0, stochastic=True, nameless=shapes)
    steps = (random, Step("rate_bias", fit, fit, 30.0))
    torque, rate = "nameless_body_torque", "nameless_rate_error"
    assert nameless_leads(steps, Rules(), FAR) == ({torque: -1.0, rate: -0.5}, {})
    near = Rival("body torque that follows body rate", 1.5, 0)
    assert nameless_leads(steps, Rules(), near) == ({torque: 1.5, rate: -0.5}, {torque: 1.5})
    assert nameless_leads(steps, Rules(), near._replace(instead_of=1))[0][torque] == -1.0


def test_one_effect_in_place_of_several_is_in_all_their_sets():
    """And several in place of one are in its set together."""
    fit = SimpleNamespace(model=SimpleNamespace(effects=(StarTrackerLowFrequency(),)))
    name = "star_tracker_low_frequency"
    wheel = "wheel_friction"
    one = AlternativeEffect(name, fit, 19.0, math.nan, replaces=(wheel,))
    shift = Step("star_tracker_shift", fit, fit, 20.0, (one,))
    steps = (shift, Step(wheel, fit, fit, 6.0), Step("rate_bias", fit, fit, 9.0))
    assert ambiguous_sets(steps, Rules(), FAR) == ((shift.added, name), (wheel, name))
    both = AlternativeEffect(shift.added, fit, 19.0, math.nan, beside=(wheel,))
    instead = Step(name, fit, fit, 20.0, (both,), stochastic=True)
    assert ambiguous_sets((instead,), Rules(), FAR) == ((name, shift.added, wheel),)


def test_names_beside_what_may_have_no_name_may_each_hold_a_part_of_it():
    fit = SimpleNamespace()
    shapes = (NamelessShape("body torque", 19.0),)
    fixed = Step("constant_torque", fit, fit, 30.0)
    random = Step("torque_noise", fit, fit, 20.0, stochastic=True, nameless=shapes)
    assert names_may_imitate((fixed, random), Rules())
    assert not names_may_imitate((random,), Rules())
    assert not names_may_imitate((fixed, fixed), Rules())
    # A random effect that nothing without a name equals stays beside the names.
    assert not names_may_imitate((fixed, random), Rules(log_evidence_margin=0.5))


def test_a_random_effect_is_weighed_against_what_is_averaged_as_it_is(monkeypatch):
    """Not against the best of a finer signal; several claims pay for their choice."""
    fit = SimpleNamespace(linearised=lambda: None)
    shapes = (NamelessShape("body torque", 25.0),)
    monkeypatch.setattr(nameless, "torque_response", lambda estimate: None)
    monkeypatch.setattr(nameless, "driven_evidence", lambda *_: {("rate sensor", "body rate"): 7.0})
    step = Step("torque_noise", fit, fit, 20.0, stochastic=True, nameless=shapes)
    assert rival_of((step,), 24) == Rival("body torque", pytest.approx(5.0), 0)
    weak = Step("torque_noise", fit, fit, 20.0, stochastic=True)
    assert rival_of((weak,), 24) == Rival(
        "rate sensor that follows body rate", pytest.approx(-13.0), 0
    )
    both = (Step("constant_torque", fit, fit, 4.0, nameless=shapes), weak)
    assert rival_of(both, 24).log_bayes_factor == pytest.approx(1.0 + cost_of_further(1, 1, 25))


def test_each_slew_is_tested_against_its_own_noise(flown):
    """As a fit that discounts each slew by its own dispersion leaves it."""
    fitted = estimate(Model(flown.campaign))
    discount = np.array([[1.0, 1.0, 1.0], [0.25, 1.0, 1.0], [1.0, 1.0, 4.0]])
    chi2 = fitted.information.chi2
    louder = replace(fitted, discount=discount)
    tests = final_tests(louder)
    dof = fitted.information.n_data.sum(0) - louder.tested_residuals.parameters
    for i, channel in enumerate(("rate", "attitude", "momentum")):
        assert tests[channel].reduced_chi2 == pytest.approx(chi2[:, i].sum() / dof[i])
    series = [
        np.sqrt(d) * x for d, x in zip(discount[:, 0], fitted.residual_series["rate"], strict=True)
    ]
    assert tests["rate"].p_white == whiteness(series)


def test_only_too_much_or_structure_is_misfit():
    assert is_explained({"rate": chi2_test(500.0, 1000.0)}, Rules())  # less than the noise
    assert is_explained({"rate": chi2_test(1000.0, 1000.0, 0.3)}, Rules())
    assert not is_explained({"rate": chi2_test(1300.0, 1000.0)}, Rules())
    assert not is_explained({"rate": chi2_test(1000.0, 1000.0, 1e-6)}, Rules())
    assert is_explained({"rate": chi2_test(1000.0, 1000.0, 1e-6)}, Rules(misfit_p_value=1e-7))
