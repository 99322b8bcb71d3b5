"""The next correction slew, before and after what was missing is named."""

from dataclasses import replace

import numpy as np
import pytest
from support.refits import fitted_with

from bayes_inertia.design.after_campaign import correction_forecast
from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import ConstantTorque, EachSlew, InertiaChange
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_input import idle_slew
from bayes_inertia.report.verdict import diagnosis_verdict


@pytest.mark.long
@pytest.mark.slow
def test_the_next_correction_slew_before_and_after(lagging, flight, content_of, check_contract):
    # A lag is removed by feedback and leaves nothing at rest, but the K that was fitted without it
    # does.
    found = correction_forecast(lagging.base, lagging.final)
    assert found.expected[0] > 1.5 * found.promised[0]
    assert found.updated[0] < found.expected[0]
    same = correction_forecast(lagging.final, lagging.final)
    assert same.expected == same.updated
    content = content_of(lagging, correction=found)
    check_contract(content)
    assert any("should need a correction of" in s for s in diagnosis_verdict(content).sentences)


@pytest.mark.long
@pytest.mark.slow
def test_the_next_slew_is_flown_with_the_tensor_after_its_change(flight, rigid_library):
    size = np.array([0.15, 0.1, -0.1, 0.0, 0.0, 0.0])
    first = idle_slew([0.0, 1.0]).context
    assert np.allclose(
        InertiaChange().afterwards().inertia({"change": size}, first, np.eye(3)),
        np.diag([1.15, 1.1, 0.9]),
    )
    assert np.allclose(InertiaChange().inertia({"change": size}, first, np.eye(3)), np.eye(3))
    campaign = flight((InertiaChange(),), {"inertia_change": {"change": size}})
    model = Model(campaign, candidate_effects(campaign, rigid_library).linear)
    final = fitted_with(model, "inertia_change")
    # Without the change J is one for all slews, and right in none.
    found = correction_forecast(estimate(Model(campaign), starts=1), final)
    assert len({found.promised, found.expected, found.updated}) == 3
    assert found.updated[0] < 0.5 * found.expected[0]


@pytest.mark.long
@pytest.mark.slow
def test_what_differs_from_slew_to_slew_is_drawn_from_its_prior_in_the_next_slew(clean):
    """It was as in the first slew; what the next slew will have, only the prior tells."""
    apart = EachSlew.of(ConstantTorque(sigma=1e-4), clean)
    base, final = estimate(Model(clean), starts=1), estimate(Model(clean, (apart,)), starts=1)
    forecast = correction_forecast(base, final)
    assert forecast.expected[1] > 2.0 * forecast.promised[1]


@pytest.mark.long
@pytest.mark.slow
def test_wheels_about_two_axes_turn_no_body_anywhere(clean):
    found = estimate(Model(clean), starts=1)
    axes = zip(clean.wheels, np.eye(3)[[0, 1, 1]], strict=True)
    wheels = tuple(replace(wheel, axis_B=axis) for wheel, axis in axes)
    flat = replace(found.model, campaign=replace(clean, wheels=wheels))
    assert correction_forecast(found, found) is not None
    assert correction_forecast(found, replace(found, model=flat)) is None
