"""From the steps of a search to the verdict."""

import math
from types import SimpleNamespace

from bayes_inertia.diagnosis.conclusion import (
    is_explained,
    nameless_lead,
    without_named_alternatives,
)
from bayes_inertia.diagnosis.result import AlternativeEffect, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.inference.residual_tests import chi2_test


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
    assert nameless_lead((), 17) == -math.inf


def test_only_too_much_or_structure_is_misfit():
    assert is_explained({"rate": chi2_test(500.0, 1000.0)}, Rules())  # less than the noise
    assert is_explained({"rate": chi2_test(1000.0, 1000.0, 0.3)}, Rules())
    assert not is_explained({"rate": chi2_test(1300.0, 1000.0)}, Rules())
    assert not is_explained({"rate": chi2_test(1000.0, 1000.0, 1e-6)}, Rules())
    assert is_explained({"rate": chi2_test(1000.0, 1000.0, 1e-6)}, Rules(misfit_p_value=1e-7))
