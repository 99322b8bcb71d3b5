"""The dogleg on hard problems."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_inertia.maths.least_squares import Equations, dogleg


@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_dogleg_finds_rosenbrocks_minimum_at_any_scaling(scale):
    def rows(x):
        y = x / np.array([1.0, scale])
        jacobian = np.array([[-1.0, 0.0], [-20.0 * y[0], 10.0]]) / np.array([1.0, scale])
        return np.array([1.0 - y[0], 10.0 * (y[1] - y[0] ** 2)]), jacobian

    def equations(x):
        r, j = rows(x)
        return Equations(j.T @ j, j.T @ r, lambda y: j.T @ rows(y)[0])

    x, objective = dogleg(
        lambda x: 0.5 * np.sum(rows(x)[0] ** 2),
        equations,
        lambda x, s: x + s,
        np.array([-1.2, 1.0 * scale]),
        np.array([1.0, scale]),
        tolerance=1e-14,
    )
    np.testing.assert_allclose(x, [1.0, scale], rtol=1e-6)
    assert objective < 1e-12


@pytest.mark.parametrize("stiffness", [1e3, 1e5])
def test_dogleg_reaches_the_end_of_a_narrow_curved_valley(stiffness):
    """A valley as steep as that of a wheel momentum that nothing measures; damping alone stops half
    way.
    """

    def rows(x):
        return np.array([stiffness * (x[1] - np.sin(x[0])), x[0] - 3.0]), np.array(
            [[-stiffness * np.cos(x[0]), stiffness], [1.0, 0.0]]
        )

    def equations(x):
        r, j = rows(x)
        return Equations(j.T @ j, j.T @ r, lambda y: j.T @ rows(y)[0])

    x, objective = dogleg(
        lambda x: 0.5 * np.sum(rows(x)[0] ** 2),
        equations,
        lambda x, s: x + s,
        np.array([-3.0, 0.5]),
        np.ones(2),
    )
    np.testing.assert_allclose(x, [3.0, np.sin(3.0)], atol=1e-4)
    assert objective < 1e-7


def test_dogleg_survives_points_without_derivatives():
    """Where the objective is finite but its derivatives are not, a step or correction is given up,
    not the descent.
    """

    def gradient(x):
        hole = np.nan if 1.0 < x[0] < 2.5 else 1.0
        return hole * np.array([x[0] - 3.0 + 4.0 * (x[0] - 3.0) ** 3])

    def equations(x):
        hole = np.nan if 1.0 < x[0] < 2.5 else 1.0
        return Equations(hole * np.array([[1.0 + 12.0 * x[0] ** 2]]), gradient(x), gradient)

    for start in (-4.0, 0.5, 6.0):
        x, objective = dogleg(
            lambda x: 0.5 * (x[0] - 3.0) ** 2 + (x[0] - 3.0) ** 4,
            equations,
            lambda x, s: x + s,
            np.array([start]),
            np.ones(1),
        )
        assert np.isfinite(objective)
        assert objective <= 0.5 * (start - 3.0) ** 2 + (start - 3.0) ** 4
    x, _ = dogleg(
        lambda x: 0.5 * (x[0] - 3.0) ** 2,
        lambda x: Equations(np.full((1, 1), np.nan), np.full(1, np.nan), lambda y: y),
        lambda x, s: x + s,
        np.array([5.0]),
        np.ones(1),
    )
    assert x[0] == 5.0
    # Nor does a start without an objective, whose derivatives are finite.
    x, objective = dogleg(
        lambda x: np.inf,
        lambda x: Equations(np.eye(1), x, lambda y: y),
        lambda x, s: x + s,
        np.array([5.0]),
        np.ones(1),
    )
    assert (x[0], objective) == (5.0, np.inf)
    # A start without an objective is left behind, and the descent goes on.
    x, _ = dogleg(
        lambda x: 0.5 * x[0] ** 2 if x[0] < 4.5 else np.inf,
        lambda x: Equations(np.eye(1), x, lambda y: y),
        lambda x, s: x + s,
        np.array([5.0]),
        np.ones(1),
        expected=1.0,
    )
    assert x[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("misfit", [0.0, 3.0])
def test_a_misfit_that_blurs_the_minimum_is_not_followed_to_the_last_digit(misfit):
    """A decay fitted to data with a wave: steps at the end are far below what the misfit blurs."""
    time = np.linspace(0.0, 3.0, 100)
    data = 10.0 * np.exp(-time) + misfit * np.sin(4.0 * time)
    counted = []

    def rows(x):
        decay = np.exp(-x[1] * time)
        return x[0] * decay - data, np.stack([decay, -time * x[0] * decay], 1)

    def equations(x):
        counted.append(x)
        r, j = rows(x)
        return Equations(j.T @ j, j.T @ r, lambda y: j.T @ rows(y)[0])

    def descent(**stop):
        counted.clear()
        start, size = np.array([3.0, 3.0]), np.ones(2)
        x, reached = dogleg(
            lambda x: 0.5 * np.sum(rows(x)[0] ** 2), equations, np.add, start, size, **stop
        )
        return x, reached, len(counted)

    exact, least, steps = descent(tolerance=1e-12)
    x, reached, fewer = descent(tolerance=1e-12, expected=1e-4)
    if misfit:
        sd = np.sqrt(np.diag(np.linalg.inv(equations(exact)[0])) * 2.0 * least / len(time))
        assert fewer < steps
        assert np.all(np.abs(x - exact) < 1e-2 * sd)
    else:
        assert fewer == steps
        np.testing.assert_allclose(x, exact)
    assert reached - least < 1e-3 * max(least, 1e-9)
