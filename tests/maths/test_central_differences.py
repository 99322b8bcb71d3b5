"""Slopes and curvatures by central differences: exact for quadratics, of second order else."""

import numpy as np
import pytest

from bayes_inertia.maths.central_differences import quadratic_at


def test_a_quadratic_is_derived_exactly_and_its_value_can_be_given():
    rng = np.random.default_rng(1)
    slope, half = rng.normal(size=3), rng.normal(size=(3, 3))
    matrix, at, asked = half + half.T, rng.normal(size=3), []

    def function(x):
        asked.append(len(x))
        return 2.0 + x @ slope + 0.5 * np.einsum("mi,ij,mj->m", x, matrix, x)

    plain = quadratic_at(function, at, 0.3)
    given = quadratic_at(function, at, 0.3, value=plain.value)
    assert asked == [13, 12]
    assert plain.value == pytest.approx(2.0 + at @ slope + 0.5 * at @ matrix @ at, rel=1e-12)
    for found in (plain, given):
        np.testing.assert_allclose(found.gradient, slope + matrix @ at, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(found.hessian, matrix, rtol=0.0, atol=1e-11)


def test_the_error_falls_with_the_square_of_the_step():
    def function(x):
        return np.exp(x[:, 0] + 2.0 * x[:, 1])

    at = np.array([0.1, -0.2])
    truth = np.exp(at[0] + 2.0 * at[1]) * np.array([[1.0, 2.0], [2.0, 4.0]])
    wide, narrow = (
        np.abs(quadratic_at(function, at, step).hessian - truth).max() for step in (0.1, 0.05)
    )
    assert wide / narrow == pytest.approx(4.0, rel=0.05)
