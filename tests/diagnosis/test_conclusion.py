"""Whether the residuals of a fit are noise."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.diagnosis.limits import Rules
from bayes_inertia.diagnosis.residuals import is_explained
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.residual_tests import chi2_test, whiteness
from bayes_inertia.physics.forward_model import Model


@pytest.mark.slow
def test_each_slew_is_tested_against_its_own_noise(flown):
    """As a fit that discounts each slew by its own dispersion leaves it."""
    fitted = estimate(Model(flown.campaign))
    discount = np.array([[1.0, 1.0, 1.0], [0.25, 1.0, 1.0], [1.0, 1.0, 4.0]])
    chi2 = fitted.information.chi2
    louder = replace(fitted, discount=discount)
    tests = louder.final_tests
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
