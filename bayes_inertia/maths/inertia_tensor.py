"""Physical inertia tensors: elements, principal moments, a chart of all of them, random ones.

A tensor J belongs to a body of non-negative mass density exactly if tr(J)/2 1 - J (the second
moments of mass) is positive semi-definite, which contains the triangle inequalities
(Traversaro et al. 2016; Wensing, Kim and Slotine 2018). Elements are ordered as in
`ELEMENTS`; products of inertia are tensor ELEMENTS (J[0, 1] = Jxy), as in Ferguson's paper.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths import jax_settings as jax_settings
from bayes_inertia.maths.tensor_elements import COLUMNS_OF_ELEMENTS, ROWS_OF_ELEMENTS
from bayes_inertia.maths.tensor_elements import ELEMENTS as ELEMENTS
from bayes_inertia.maths.values import AnyArray


def tensor(elements: AnyArray) -> AnyArray:
    """The tensors (..., 3, 3) of elements (..., 6) in the order of `ELEMENTS` [kg m^2].

    Of numpy's arrays it makes one of numpy: nothing is compiled.

    `elements` (..., 6) [kg m^2].

    Examples
    --------
    >>> tensor(jnp.array([3., 2., 1., .25, .5, 0.]))[0].tolist()
    [3.0, 0.25, 0.5]
    """
    xx, yy, zz, xy, xz, yz = (elements[..., i] for i in range(6))
    stack = np.stack if isinstance(elements, np.ndarray) else jnp.stack
    rows = [stack(row, -1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    return stack(rows, -2)


def elements(tensor_B: AnyArray) -> AnyArray:
    """The elements (..., 6) of symmetric tensors (..., 3, 3).

    `tensor_B` (..., 3, 3) [kg m^2]. Returns (..., 6) [kg m^2].

    Examples
    --------
    >>> elements(tensor(jnp.arange(6.))).tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    """
    return tensor_B[..., ROWS_OF_ELEMENTS, COLUMNS_OF_ELEMENTS]


def second_moments(tensor_B: AnyArray) -> AnyArray:
    """tr(J)/2 1 - J (..., 3, 3): the second moments of mass, positive definite for any real body.

    `tensor_B` (..., 3, 3) [kg m^2]. Returns (..., 3, 3) [kg m^2].

    Examples
    --------
    >>> jnp.diag(second_moments(jnp.diag(jnp.array([3., 2., 2.])))).tolist()
    [0.5, 1.5, 1.5]
    """
    trace = tensor_B[..., 0, 0] + tensor_B[..., 1, 1] + tensor_B[..., 2, 2]
    return 0.5 * trace[..., None, None] * np.eye(3) - tensor_B


@np.errstate(over="ignore", invalid="ignore")
def is_physical(elements_: AnyArray) -> AnyArray:
    """Whether tensors given by elements (..., 6) satisfy the triangle inequalities (bool, ...).

    Of numpy's arrays it makes one of numpy: nothing is compiled.

    `elements_` (..., 6) [kg m^2].

    Examples
    --------
    >>> is_physical(jnp.array([[3., 2., 2., 0., 0., 0.], [5., 2., 2., 0., 0., 0.]])).tolist()
    [True, False]
    """
    m = second_moments(tensor(elements_))
    minor_2 = m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] ** 2
    minor_3 = (
        m[..., 0, 0] * (m[..., 1, 1] * m[..., 2, 2] - m[..., 1, 2] ** 2)
        - m[..., 0, 1] * (m[..., 0, 1] * m[..., 2, 2] - m[..., 1, 2] * m[..., 0, 2])
        + m[..., 0, 2] * (m[..., 0, 1] * m[..., 1, 2] - m[..., 1, 1] * m[..., 0, 2])
    )  # Sylvester's criterion
    return (m[..., 0, 0] > 0.0) & (minor_2 > 0.0) & (minor_3 > 0.0)


def from_chart(chart: Array) -> Array:
    """Elements (..., 6) of the tensor whose second moments have a log-Cholesky factor (..., 6).

    The chart is unconstrained: every real vector is a physical tensor. Its components are the
    logarithms of the factor's diagonal, then its elements 10, 20, 21.

    Returns (..., 6) [kg m^2].

    Examples
    --------
    >>> bool(is_physical(from_chart(jnp.array([-1., 0., 1., 5., -3., 2.]))))
    True
    """
    a, b, c = (jnp.exp(chart[..., i]) for i in range(3))
    d, e, f = (chart[..., i] for i in range(3, 6))
    xx, yy, zz = a**2, d**2 + b**2, e**2 + f**2 + c**2
    return jnp.stack([yy + zz, xx + zz, xx + yy, -a * d, -a * e, -(d * e + b * f)], axis=-1)


def to_chart(elements_: Array) -> Array:
    """The inverse of `from_chart`; NaN for an unphysical tensor.

    `elements_` (..., 6) [kg m^2]. Returns (..., 6).

    Examples
    --------
    >>> x = jnp.array([3., 2., 2., .25, 0., -.5])
    >>> bool(jnp.allclose(from_chart(to_chart(x)), x))
    True
    """
    factor = jnp.linalg.cholesky(second_moments(tensor(elements_)))
    diagonal = [jnp.log(factor[..., i, i]) for i in range(3)]
    return jnp.stack([*diagonal, factor[..., 1, 0], factor[..., 2, 0], factor[..., 2, 1]], axis=-1)


def principal_moments(elements_: np.ndarray) -> np.ndarray:
    """Principal moments (..., 3), ascending [kg m^2].

    `elements_` (..., 6) [kg m^2].

    Examples
    --------
    >>> principal_moments(np.array([3., 1., 2., 0., 0., 0.])).tolist()
    [1.0, 2.0, 3.0]
    """
    return np.linalg.eigvalsh(tensor(np.asarray(elements_)))


def wheel_spin_tensor(wheel_axes_B: AnyArray, spin_inertia: AnyArray) -> Array:
    """sum Js_i g_i g_i^T (3, 3) [kg m^2]: what J_locked has more than J (axes are columns).

    `wheel_axes_B` (3, wheels); `spin_inertia` (wheels,) [kg m^2].

    Examples
    --------
    >>> wheel_spin_tensor(jnp.eye(3)[:, :1], jnp.array([1e-3]))[0, 0].item()
    0.001
    """
    return jnp.einsum("iw,w,jw->ij", wheel_axes_B, spin_inertia, wheel_axes_B)


def with_wheel_spin(tensor_B: Array, wheel_axes_B: Array, spin_inertia: Array) -> Array:
    """J_locked of a spacecraft whose tensor without the wheels' spin is J.

    `wheel_axes_B` (3, wheels); `spin_inertia` (wheels,) [kg m^2]. `tensor_B` (..., 3, 3): J of
    everything except the wheels' spin [kg m^2]. Returns (..., 3, 3) [kg m^2].

    Examples
    --------
    >>> with_wheel_spin(jnp.eye(3), jnp.eye(3)[:, :1], jnp.array([0.5]))[0, 0].item()
    1.5
    """
    return tensor_B + wheel_spin_tensor(wheel_axes_B, spin_inertia)


def without_wheel_spin(locked_B: Array, wheel_axes_B: Array, spin_inertia: Array) -> Array:
    """J without the wheels' spin of a spacecraft whose tensor with locked wheels is J_locked.

    `wheel_axes_B` (3, wheels); `spin_inertia` (wheels,) [kg m^2]. `locked_B` (..., 3, 3): J_locked,
    the inertia of everything with the wheels locked [kg m^2]. Returns (..., 3, 3): J of everything
    except the wheels' spin [kg m^2].

    Examples
    --------
    >>> without_wheel_spin(jnp.eye(3), jnp.eye(3)[:, :1], jnp.array([0.5]))[0, 0].item()
    0.5
    """
    return locked_B - wheel_spin_tensor(wheel_axes_B, spin_inertia)


def draw_physical(
    draw: Callable[[int], np.ndarray],
    n: int,
    *,
    wheel_spin: np.ndarray | None = None,
    ends: tuple[AnyArray, AnyArray] = (-np.inf, np.inf),
    rounds: int = 10_000,
    where: str = "key inertia",
    advice: str = "reduce relative_sigma or product_sigma",
) -> np.ndarray:
    """Draw parameter vectors, and draw again those whose inertia tensor no body has.

    The draws follow the given distribution, cut off where tensors are unphysical. Where all first
    draws are physical, the generator is used exactly as without this function.

    `draw`: takes a number n and returns n independent draws, an (n, d) array with d >= 6; the first
    six columns are the elements of J in the order of `ELEMENTS` [kg m^2].
    `wheel_spin` (6,): elements of the wheels' spin tensor [kg m^2], where the draws hold J_locked:
    taken off before J is judged. None where they hold J. `ends`: lower and upper ones of a prior's
    support (d,). `rounds`: after so many, or as many draws without a physical one, hardly any can
    be physical. Returns (n, d).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> rows = draw_physical(lambda n: rng.normal([1, 1, 1.99, 0, 0, 0], 0.01, (n, 6)), 50)
    >>> bool(is_physical(rows[:, :6]).all())
    True
    """
    rows = draw(n)
    if not n:  # of a case too improbable for a draw
        return rows
    taken_off = 0.0 if wheel_spin is None else wheel_spin
    for k in range(rounds):
        outside = (rows < ends[0]) | (rows > ends[1])
        bad = ~is_physical(rows[:, :6] - taken_off) | outside.any(axis=1)
        if not bad.any():
            return rows
        if bad.all() and (k + 1) * n >= rounds:
            break
        rows[bad] = draw(int(bad.sum()))
    raise CampaignError(
        "hardly any draw of the inertia tensor is physical", where=where, advice=advice
    )
