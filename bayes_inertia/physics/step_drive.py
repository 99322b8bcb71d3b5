"""What drives the wheels within integration steps that span several telemetry rows.

Wheel momentum is known beforehand: the integral of held commands, or the tachometers' readings with
straight lines between them. Both have a kink at every row. Over each step the integrator is given
the cubic with the same first four moments, which moves the step's end as the kinked curve does but
for products of small numbers (the argument of Magnus and averaging methods; Blanes et al 2009,
section 5). What the cubic leaves out turns the body to and fro within the step, to first order by
its own integral, which is known at every row.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.special import comb

from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.slew_input import Drive, SlewInput


class StepGrid(NamedTuple):
    """How the m integration steps of r rows each lie on the grid.

    Parameters
    ----------
    time : (m,) array
        Beginnings of the steps [s].
    length : (m,) array
        Their lengths [s]; 0 in padding.
    fraction : (m, r) array
        Part of the step that has passed at each row.
    width : (m, r) array
        Part of the step from each row to the next.
    """

    time: Array
    length: Array
    fraction: Array
    width: Array


def step_grid(time: Any, step: Any, rows_per_step: int, xp: ModuleType = jnp) -> StepGrid:
    """Integration steps of so many rows each.

    `time` (n,): the grid [s]; n is a multiple of `rows_per_step`. `step` (n,): time to the next
    grid point [s]; 0 in padding.

    Examples
    --------
    >>> step_grid(np.arange(4.0), np.array([1.0, 1.0, 1.0, 0.0]), 2, np).fraction.tolist()
    [[0.0, 0.5], [0.0, 1.0]]
    """
    pieces = step.reshape(-1, rows_per_step)
    length = pieces.sum(axis=1)
    safe = xp.where(length > 0.0, length, 1.0)[:, None]
    width = pieces / safe
    fraction = xp.cumsum(width, axis=1) - width
    return StepGrid(time[::rows_per_step], length, fraction, width)


def step_ends(values: Any, last: Any, rows_per_step: int, xp: ModuleType = jnp) -> Any:
    """Each step's r rows and its end.

    `values` (n, k); `last` (k,). Returns (m, r + 1, k): the last of each step is the first of the
    next.

    Examples
    --------
    >>> step_ends(np.arange(4.0)[:, None], np.array([9.0]), 2, np)[..., 0].tolist()
    [[0.0, 1.0, 2.0], [2.0, 3.0, 9.0]]
    """
    n, k = values.shape
    pieces = values.reshape(n // rows_per_step, rows_per_step, k)
    ends = xp.concatenate([pieces[1:, 0], last[None]])
    return xp.concatenate([pieces, ends[:, None]], axis=1)


def moment_weights(grid: StepGrid, xp: ModuleType = jnp) -> Any:
    """Weights of a step's rows in the cubic with the moments of the line through them.

    Returns (m, r + 1, 4): from values at the rows to coefficients of 1, s, s^2, s^3; s is the part
    of the step that has passed.
    """
    points, shares, legendre, norm = _moment_rule(degree := NUMERICS.drive_degree)
    at = grid.fraction[..., None] + grid.width[..., None] * points
    powers = xp.stack([at**power for power in range(degree + 1)], -1)
    values = powers @ legendre.T * norm
    left = xp.einsum("mr,q,mrql->mrl", grid.width, shares * (1.0 - points), values)
    right = xp.einsum("mr,q,mrql->mrl", grid.width, shares * points, values)
    none = xp.zeros_like(left[:, :1])
    weights = xp.concatenate([left, none], axis=1) + xp.concatenate([none, right], axis=1)
    # In padding time stands still, and so does what is given there.
    still = np.zeros((grid.fraction.shape[1] + 1, degree + 1))
    still[0, 0] = 1.0
    return xp.where((grid.length > 0.0)[:, None, None], weights @ legendre, still)


@cache
def _moment_rule(degree: int) -> tuple[np.ndarray, ...]:
    """Points of Gauss in 0 to 1 and their shares, exact for degree five; Legendre's polynomials.

    These are orthogonal on 0 to 1: each row the coefficients of 1, s, s^2, ...; and one over the
    mean square of each.
    """
    power = np.arange(degree + 1)
    order = power[:, None]
    legendre = comb(order, power) * comb(order + power, power) * (-1.0) ** (order - power)
    points = 0.5 + 0.5 * np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
    shares = np.array([5.0, 8.0, 5.0]) / 18.0
    return points, shares, legendre + 0.0, 2.0 * power + 1.0  # no -0.0


def polynomials(grid: StepGrid, pieces: Any, xp: ModuleType = jnp) -> Any:
    """The cubic of each step that has the first four moments of the line through its rows.

    `pieces` (m, r + 1, k). Returns (m, 4, k): coefficients of 1, s, s^2, s^3; s is the part of the
    step that has passed.

    Examples
    --------
    >>> grid = step_grid(np.arange(2.0), np.array([1.0, 1.0]), 2, np)
    >>> cubic = polynomials(grid, np.array([[[1.0], [2.0], [3.0]]]), np)[0, :, 0]
    >>> np.allclose(cubic, [1.0, 2.0, 0.0, 0.0])
    True
    """
    return xp.einsum("mrl,mrk->mlk", moment_weights(grid, xp), pieces)


def left_out(grid: StepGrid, pieces: Any, coefficients: Any, xp: ModuleType = jnp) -> Any:
    """Integral over time of what the cubics leave out, from each step's beginning to its rows.

    `pieces` (m, r + 1, k); `coefficients` (m, 4, k). Returns (m, r, k): in the unit of the values
    times seconds; zero at the beginning of each step and at its end.
    """
    area = 0.5 * (pieces[:, :-1] + pieces[:, 1:]) * grid.width[..., None]
    passed = xp.cumsum(area, axis=1) - area
    s = grid.fraction[..., None]
    of_cubic = xp.zeros_like(passed)
    for power in range(NUMERICS.drive_degree, -1, -1):
        of_cubic = s * (coefficients[:, None, power] / (power + 1.0) + of_cubic)
    return grid.length[:, None, None] * (passed - of_cubic)


class StepPoints(NamedTuple):
    """Grid points, and what is known beforehand there.

    Parameters
    ----------
    step : (k,) array of int
        The integration step of each.
    fraction : (k,) array
        Part of the step that has passed.
    left_out : (k, wheels) array
        Integral of what the cubics leave out [N m s^2].
    """

    step: Array
    fraction: Array
    left_out: Array


class KnownMomentum(NamedTuple):
    """Momentum of the wheels that is known before the integration.

    What commands give them since the first row (commanded drive), or all of it, relative to the
    body (measured drive).

    Parameters
    ----------
    steps : StepGrid
        The m integration steps of r rows each.
    at_rows : (n, wheels) array
        At the rows [N m s].
    cubic : (m, 4, wheels) array
        Over each step: coefficients of 1, s, s^2, s^3 [N m s].
    left_out : (m, r, wheels) array or None
        Integral of what the cubics leave out [N m s^2]; None for steps of one row, where that is
        nothing.
    fixes : StepPoints, optional
        Where the attitude is wanted; None for the rows.
    """

    steps: StepGrid
    at_rows: Array
    cubic: Array
    left_out: Array | None
    fixes: StepPoints | None = None

    def with_points(self, fixes: Array | None) -> KnownMomentum:
        """With `fixes` at some grid points (f,); None: at all rows."""
        if fixes is None or self.left_out is None:
            return self
        fraction, lacking = self.steps.fraction, self.left_out
        lacking = lacking.reshape(fraction.size, -1)
        points = StepPoints(fixes // fraction.shape[1], fraction.ravel()[fixes], lacking[fixes])
        return self._replace(fixes=points)


def known_momentum(
    slew: SlewInput, torque: Array, drive: Drive, rows_per_step: int
) -> KnownMomentum:
    """Wheel momentum that follows from held commands, or from tachometers.

    `torque` (n, wheels): torque delivered to the wheels and held over each grid step [N m].

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> slew = idle_slew([0.0, 1.0, 2.0, 3.0])
    >>> torque = jnp.array([[1.0], [0.0], [0.0], [0.0]])
    >>> known_momentum(slew, torque, "commanded", 2).at_rows[:, 0].tolist()
    [0.0, 1.0, 1.0, 1.0]
    """
    context = slew.context
    steps = step_grid(context.time, context.step, rows_per_step)
    if drive == "commanded":
        # Kept apart from the start value, so that draws of one slew share these rows.
        gained = jnp.cumsum(torque * context.step[:, None], axis=0)
        at_rows = jnp.concatenate([jnp.zeros((1, torque.shape[1])), gained[:-1]])
        return KnownMomentum(steps, at_rows, *_over_steps(steps, at_rows, gained[-1]))
    if slew.tachometer_error is None:
        read = slew.momentum
        return KnownMomentum(steps, read, *_over_steps(steps, read, read[-1]))
    readings, shapes, size = slew.tachometer_error
    cubic, lacking = _over_steps(steps, readings, readings[-1])
    of_shapes, _ = _over_steps(steps, shapes, shapes[-1])
    cubic = cubic - jnp.einsum("mlk,wk->mlw", of_shapes, size)
    return KnownMomentum(steps, slew.momentum, cubic, lacking)


def _over_steps(steps: StepGrid, at_rows: Array, last: Array) -> tuple[Array, Array | None]:
    """The cubics of all steps, and the integral of what they leave out (None for single rows)."""
    rows_per_step = steps.fraction.shape[1]
    pieces = step_ends(at_rows, last, rows_per_step)
    cubic = polynomials(steps, pieces)
    return cubic, left_out(steps, pieces, cubic) if rows_per_step > 1 else None


def value(coefficients: tuple, fraction: Any) -> Any:
    """A polynomial by Horner's rule.

    Examples
    --------
    >>> value((1.0, 2.0, 3.0), 2.0)
    17.0
    """
    total = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = coefficient + fraction * total
    return total


def derivative(coefficients: tuple) -> tuple:
    """The derivative of a polynomial with respect to s, for `value`.

    Examples
    --------
    >>> derivative((1.0, 2.0, 3.0))
    (2.0, 6.0)
    """
    return tuple(k * c for k, c in enumerate(coefficients))[1:]
