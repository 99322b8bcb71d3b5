"""Physical inertia tensors: the chart holds all of them and nothing else."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bayes_inertia.maths import inertia_tensor

_from_chart = jax.jit(inertia_tensor.from_chart)
_to_chart = jax.jit(inertia_tensor.to_chart)
_is_physical = jax.jit(inertia_tensor.is_physical)

charts = st.tuples(*[st.floats(-2.0, 2.0)] * 3, *[st.floats(-3.0, 3.0)] * 3).map(np.array)
elements_ = st.tuples(*[st.floats(-1.0, 5.0)] * 3, *[st.floats(-2.0, 2.0)] * 3).map(np.array)


def _margin(elements: np.ndarray) -> float:
    """Smallest of: the principal moments, sums of two less the third; over the largest."""
    a, b, c = np.linalg.eigvalsh(np.array(inertia_tensor.tensor(elements)))
    return min(a, a + b - c) / max(abs(a), abs(c))


@given(charts)
@settings(max_examples=200, deadline=None)
def test_every_chart_vector_is_physical_and_comes_back(chart):
    elements = np.asarray(_from_chart(chart))
    assert bool(_is_physical(elements))
    moments = inertia_tensor.principal_moments(elements)
    assert moments[0] > 0.0
    assert moments[0] + moments[1] > moments[2] * (1.0 - 1e-12)
    np.testing.assert_allclose(
        _from_chart(_to_chart(elements)), elements, rtol=0, atol=1e-12 * moments[2]
    )
    # The way back loses digits where the body is thin: condition number of the second moments.
    condition = np.linalg.cond(
        np.array(inertia_tensor.second_moments(inertia_tensor.tensor(elements)))
    )
    np.testing.assert_allclose(
        _to_chart(elements), chart, rtol=0, atol=1e-14 * condition * (1.0 + np.abs(chart).max())
    )


@given(elements_)
@settings(max_examples=400, deadline=None)
def test_is_physical_agrees_with_the_triangle_inequalities(elements):
    # The determinant of moments below 1e-108 kg m^2 is zero in floating point: no body is so light.
    margin = _margin(elements) if np.abs(elements).max() > 1e-100 else 0.0
    if abs(margin) > 1e-9:
        assert bool(_is_physical(elements)) == (margin > 0.0)


@given(charts, st.floats(1e-6, 1e6))
@settings(max_examples=50, deadline=None)
def test_being_physical_does_not_depend_on_the_unit(chart, scale):
    elements = np.asarray(_from_chart(chart))
    beyond = elements.copy()
    beyond[0] = (
        elements[1] + elements[2] + abs(elements[3]) + 1e-3
    )  # Jxx > Jyy + Jzz: never physical
    assert bool(_is_physical(elements * scale))
    assert not bool(_is_physical(beyond * scale))


def test_point_masses_give_physical_tensors_with_products_as_tensor_elements():
    rng = np.random.default_rng(4)
    mass, at = rng.uniform(0.1, 2.0, 20), rng.normal(size=(20, 3))
    tensor = sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(mass, at, strict=True))
    elements = inertia_tensor.elements(jnp.asarray(tensor))
    assert bool(inertia_tensor.is_physical(elements))
    np.testing.assert_allclose(inertia_tensor.tensor(elements), tensor, rtol=1e-15)
    assert np.isclose(elements[3], -np.sum(mass * at[:, 0] * at[:, 1]))  # Jxy = -sum m x y
    np.testing.assert_allclose(
        inertia_tensor.second_moments(tensor), np.einsum("k,ki,kj->ij", mass, at, at), atol=1e-12
    )


def test_the_chart_is_smooth_and_its_inverse_is_nan_outside():
    slope = jax.jacfwd(inertia_tensor.from_chart)(jnp.array([0.1, -0.2, 0.3, 0.5, -0.4, 0.2]))
    assert np.all(np.isfinite(slope))
    assert np.linalg.matrix_rank(slope) == 6
    assert np.isnan(inertia_tensor.to_chart(jnp.array([5.0, 2.0, 2.0, 0.0, 0.0, 0.0]))).any()


def test_principal_moments_do_not_depend_on_the_axes():
    turn = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    tensor = turn @ np.diag([1.0, 2.0, 2.5]) @ turn.T
    np.testing.assert_allclose(
        inertia_tensor.principal_moments(np.asarray(inertia_tensor.elements(tensor))),
        [1.0, 2.0, 2.5],
        rtol=1e-12,
    )


def test_wheel_spin_is_added_along_the_wheel_axes():
    axes = np.array([[0.6, 0.0], [0.8, 0.0], [0.0, 1.0]])
    spin = inertia_tensor.wheel_spin_tensor(jnp.asarray(axes), jnp.array([1e-3, 2e-3]))
    expected = 1e-3 * np.outer(axes[:, 0], axes[:, 0]) + 2e-3 * np.outer(axes[:, 1], axes[:, 1])
    np.testing.assert_allclose(spin, expected, rtol=1e-14)


def test_no_draws_of_a_case_that_is_too_improbable():
    assert inertia_tensor.draw_physical(lambda n: np.ones((n, 9)), 0).shape == (0, 9)
