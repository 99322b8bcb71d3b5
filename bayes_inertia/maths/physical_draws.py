"""Random inertia tensors that a real body can have."""

from __future__ import annotations

from collections.abc import Callable

import jax
import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import padded_size, repeated
from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.maths.values import AnyArray

_is_physical = jax.jit(inertia_tensor.is_physical)


def are_physical(elements: np.ndarray) -> np.ndarray:
    """Which inertia tensors a real body can have.

    `elements` (n, 6): elements of J in the order of `inertia_tensor.ELEMENTS` [kg m^2]. Returns
    (n,): true where the triangle inequalities of the principal moments hold strictly.

    Examples
    --------
    >>> are_physical(np.array([[3.0, 2.0, 2.0, 0.0, 0.0, 0.0], [5.0, 2.0, 2.0, 0.0, 0.0, 0.0]]))
    array([ True, False])
    >>> are_physical(np.zeros((0, 6))).shape  # Of what hardly ever is drawn.
    (0,)
    """
    if not len(elements):
        return np.zeros(0, bool)
    require_usable_jax()
    padded = repeated(np.asarray(elements, float), padded_size(len(elements)), axis=0)
    return np.array(_is_physical(padded))[: len(elements)]


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
    six columns are the elements of J in the order of `inertia_tensor.ELEMENTS` [kg m^2].
    `wheel_spin` (6,): elements of the wheels' spin tensor [kg m^2], where the draws hold J_locked:
    taken off before J is judged. None where they hold J. `ends`: lower and upper ones of a prior's
    support (d,). `rounds`: after so many rounds hardly any draw can be physical. Returns (n, d).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> rows = draw_physical(lambda n: rng.normal([1, 1, 1.99, 0, 0, 0], 0.01, (n, 6)), 50)
    >>> bool(are_physical(rows).all())
    True
    """
    rows = draw(n)
    if not n:  # of a case too improbable for a draw
        return rows
    taken_off = 0.0 if wheel_spin is None else wheel_spin
    for _ in range(rounds):
        outside = (rows < ends[0]) | (rows > ends[1])
        bad = ~are_physical(rows[:, :6] - taken_off) | outside.any(axis=1)
        if not bad.any():
            return rows
        rows[bad] = draw(int(bad.sum()))
    raise CampaignError(
        "hardly any draw of the inertia tensor is physical", where=where, advice=advice
    )
