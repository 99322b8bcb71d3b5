"""The linear model of all that may be missing agrees with scores, refits and fits in full."""

from dataclasses import replace

import numpy as np
import pytest
from support.refits import fitted_with

from bayes_inertia.diagnosis.hypothesis_table import (
    given_fixed,
    log_evidence_of,
    log_evidence_of_columns,
    nothing,
)
from bayes_inertia.diagnosis.linear_system import linear_model, parameters_of
from bayes_inertia.diagnosis.table_search import amplitudes
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.physics.effects import FlexibleMode
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def log_bayes_factor(before, after, effect):
    """Log evidence for a fit with an effect against the fit without it: Laplace around the fit."""
    space = after.model.space
    part = np.arange(space.size)[space.slice_of(effect)]
    shape = np.array([space.priors[i].logarithmic for i in part], bool)
    slope, distance = (rows[part] for rows in prior_rows(after.model, after.theta))
    covariance = after.covariance[np.ix_(part, part)] * np.outer(slope, slope)
    # In units of the stated prior sd, shapes integrated out: information of the data, and the
    # gradient at zero amplitude.
    posterior = inverse(covariance[np.ix_(~shape, ~shape)])
    occam_of_shape = (
        -0.5 * np.linalg.slogdet(inverse(covariance)[np.ix_(shape, shape)])[1]
        if shape.any()
        else 0.0
    )
    gain = before.objective - after.objective
    information = posterior - np.eye(len(posterior))
    (scale,) = (e.prior_scale for e in after.model.effects if e.name == effect)
    # Linear around the best amplitudes, in units of the prior sd that they were fitted with.
    gradient = posterior @ distance[~shape]
    at_fitted_scale = 0.5 * float(gradient @ np.linalg.solve(posterior, gradient))
    evidence = gain - at_fitted_scale
    evidence += log_evidence_of_columns(gradient / scale, information / scale**2)
    return float(evidence + occam_of_shape)


@pytest.fixture(scope="module")
def weighed(lagging):
    """The linear model at the fit without effects."""
    return linear_model(lagging.base, (), lagging.base.objective)


@pytest.mark.slow
def test_a_shape_has_no_amplitude_to_begin_a_refit_from():
    """An effect of three amplitudes and a frequency: one number for each of its parameters."""
    campaign, mode = small_campaign(), FlexibleMode()
    plain = estimate(Model(campaign), starts=1, discount=False)
    held = move_to(plain, Model(campaign, (mode,)))
    # Undeformed it leaves no trace: a coupling at which it does.
    theta = held.theta.copy()
    part = held.model.space.slice_of(mode.name)
    theta[part][:3] = held.model.space.sd[part][:3]
    linear = linear_model(replace(held, point=replace(held.point, theta=theta)))
    found = amplitudes(linear, frozenset([mode.name]))[mode.name]
    logarithmic = [prior.logarithmic for prior in held.model.space.priors[part]]
    assert len(found) == len(logarithmic)
    assert np.all((found == 0.0) == logarithmic)


@pytest.mark.long
@pytest.mark.slow
def test_a_refit_has_the_evidence_of_its_own_fit(lagging):
    """Of a strong effect, which is far from linear at the fit without it."""
    fitted = fitted_with(lagging.base.model, "wheel_torque_gain")
    linear = linear_model(fitted, ("wheel_torque_gain",), lagging.base.objective)
    own = [m for m in linear.members if m.name == "wheel_torque_gain"]
    found = log_evidence_of(nothing(linear.system), own) + linear.offset
    expected = log_bayes_factor(lagging.base, fitted, "wheel_torque_gain")
    assert found == pytest.approx(expected, rel=1e-3, abs=0.25)
    # Negative control: without the effect held, it is projected off and no member.
    without = linear_model(fitted, (), lagging.base.objective)
    assert "wheel_torque_gain" not in {m.name for m in without.members}


@pytest.mark.long
@pytest.mark.slow
def test_J_and_K_of_a_row_are_those_of_its_fit(lagging, weighed):
    """Of an effect that is weak here, so that the fit is linear in it."""
    (member,) = (m for m in weighed.members if m.name == "rate_bias")
    direct = fitted_with(lagging.base.model, "rate_bias")
    mean, covariance = parameters_of(weighed, given_fixed(nothing(weighed.system), member))
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(mean - direct.theta[:9]) < 0.5 * direct.sd[:9])
    assert np.all(np.abs(sd / direct.sd[:9] - 1.0) < 0.2)
    assert np.any(np.abs(mean - lagging.base.theta[:9]) > 1e-3 * sd)
