"""Unit inputs for effects without a fixed shape, and the covariance of their coefficients.

Reduced bases over one slew: hat functions on evenly spaced knots with the covariance of a random
walk or an Ornstein-Uhlenbeck process at them, for what is read; and means of the second over equal
pieces, for what is integrated. Rasmussen and Williams, "Gaussian Processes for Machine
Learning", section 4.2.1.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from bayes_inertia.physics.slew_context import SlewContext


def slew_fraction(slew: SlewContext, t: Array) -> Array:
    """How much of a slew is over.

    `t` (...) [s]. Returns (...): 0 at its first row, 1 at its last.
    """
    return (t - slew.time[0]) / slew_duration(slew)


def slew_duration(slew: SlewContext) -> Array:
    """Time from the first to the last row of a slew.

    Returns [s].
    """
    return jnp.maximum(slew.time[-1] - slew.time[0], 1e-9)


def hat_functions(fraction: Array, knots: int) -> Array:
    """Weights of evenly spaced knots in straight lines between them.

    `fraction` (...): where, 0 to 1; beyond, the nearest knot counts. Returns (..., knots).

    Examples
    --------
    >>> hat_functions(jnp.array(0.25), 3).tolist()
    [0.5, 0.5, 0.0]
    """
    place = jnp.clip(fraction, 0.0, 1.0) * (knots - 1)
    return jnp.maximum(0.0, 1.0 - jnp.abs(place[..., None] - jnp.arange(knots)))


def random_walk_root(density: Array, slew: SlewContext, knots: int) -> Array:
    """Root of the covariance of a random walk at evenly spaced knots of a slew.

    The walk is zero in the middle of its campaign. A slew begins with what it became since (or
    before). These offsets of two slews are taken as independent.

    Returns (knots, knots).
    """
    duration = slew_duration(slew)
    # Never zero: where the campaign is one slew its offset is as large as the walk.
    away = jnp.abs(slew.start + slew.time[0] - slew.middle) + duration
    step = jnp.full(knots - 1, jnp.sqrt(duration / (knots - 1)))
    steps = jnp.concatenate([jnp.sqrt(away)[None], step])
    return density * jnp.tril(jnp.broadcast_to(steps, (knots, knots)))


def random_walk_covariance(density: Array, slews: SlewContext, knots: int) -> Array:
    """Covariance of one random walk at evenly spaced knots of all slews of a campaign.

    The walk is zero in the middle of its campaign and goes on between slews.

    Returns (slews knots, slews knots).
    """
    since = _knots_since_middle(slews, knots)
    away = jnp.minimum(jnp.abs(since)[:, None], jnp.abs(since))
    return density**2 * jnp.where(since[:, None] * since > 0.0, away, 0.0)


def ornstein_uhlenbeck_covariance(
    sd: Array, correlation_time: Array, slews: SlewContext, knots: int
) -> Array:
    """Covariance of one Ornstein-Uhlenbeck process at evenly spaced knots of all slews.

    Returns (slews knots, slews knots).
    """
    since = _knots_since_middle(slews, knots)
    apart = jnp.abs(since[:, None] - since)
    return sd**2 * jnp.exp(-apart / jnp.maximum(correlation_time, 1e-9))


def _knots_since_middle(slews: SlewContext, knots: int) -> Array:
    """Times (slews knots,) of evenly spaced knots, from the campaign's middle [s]."""
    first, last = slews.time[:, 0], slews.time[:, -1]
    places = first[:, None] + (last - first)[:, None] * jnp.linspace(0.0, 1.0, knots)
    return (slews.start[:, None] + places - slews.middle[:, None]).ravel()


def ornstein_uhlenbeck_root(
    sd: Array, correlation_time: Array, spacing: Array, knots: int
) -> Array:
    """Root of the covariance of an Ornstein-Uhlenbeck process at evenly spaced knots.

    Its covariance is sd^2 exp(-|t - t'| / time): from knot to knot x' = r x + sqrt(1 - r^2) noise
    with r = exp(-spacing / time).

    `correlation_time` [s]; `spacing` [s]. Returns (knots, knots).

    Examples
    --------
    >>> root = ornstein_uhlenbeck_root(2.0, 3.0, 1.0, 4)
    >>> bool(jnp.allclose((root @ root.T)[0, 2], 4.0 * jnp.exp(-2.0 / 3.0)))
    True
    """
    time = jnp.maximum(correlation_time, 1e-9)
    steps = jnp.arange(knots)
    apart = steps[:, None] - steps[None, :]
    kept = jnp.where(apart >= 0, jnp.exp(-jnp.maximum(apart, 0) * spacing / time), 0.0)
    fresh = jnp.sqrt(-jnp.expm1(-2.0 * spacing / time))
    return sd * kept * jnp.where(steps == 0, 1.0, fresh)


def on_pieces(fraction: Array, coefficients: Array, axes: int) -> Array:
    """Signals on several axes that are constant over equal pieces of a slew.

    `fraction` (...): when, 0 to 1; beyond, the nearest piece counts. `coefficients` (axes k,):
    values on k pieces, in the order of `on_each_axis`. Returns (..., axes).

    Examples
    --------
    >>> on_pieces(jnp.array(0.7), jnp.array([1.0, 2.0, 3.0, 4.0]), 2).tolist()
    [2.0, 4.0]
    """
    values = coefficients.reshape(axes, -1)
    pieces = values.shape[1]
    place = jnp.clip(jnp.floor(fraction * pieces), 0, pieces - 1).astype(int)
    return values.T[place]


def ornstein_uhlenbeck_mean_root(
    sd: Array, correlation_time: Array, width: Array, pieces: int
) -> Array:
    """Root of the covariance of an Ornstein-Uhlenbeck process' means over equal pieces of time.

    What integrates a process (a rate, of a torque) sees its means, not its values at knots. With
    x = width / time the variance of a mean is 2 sd^2 (x - 1 + exp(-x)) / x^2, the covariance of
    pieces k apart sd^2 (1 - exp(-x))^2 exp(-(k - 1) x) / x^2.

    `correlation_time` [s]; `width` [s]. Returns (pieces, pieces).

    Examples
    --------
    >>> root = ornstein_uhlenbeck_mean_root(2.0, 1e6, 1.0, 3)
    >>> bool(jnp.allclose(root @ root.T, 4.0, rtol=1e-3))
    True
    """
    x = jnp.maximum(width / jnp.maximum(correlation_time, 1e-9), 1e-4)
    steps = jnp.arange(pieces)
    apart = jnp.abs(steps[:, None] - steps[None, :])
    across = (jnp.expm1(-x) / x) ** 2 * jnp.exp(-jnp.maximum(apart - 1, 0) * x)
    own = 2.0 * (x + jnp.expm1(-x)) / x**2
    return sd * jnp.linalg.cholesky(jnp.where(apart == 0, own, across))


def on_each_axis(root: Array, axes: int) -> Array:
    """The root for independent processes of one kind on several axes.

    `root` (k, k). Returns (axes, k, k).

    Examples
    --------
    >>> on_each_axis(jnp.array([[2.0]]), 2).tolist()
    [[[2.0]], [[2.0]]]
    """
    return jnp.broadcast_to(root, (axes, *root.shape))


def independent(sd: Array | float, count: int) -> Array:
    """The root for independent coefficients.

    `sd` (count,). Returns (count, 1, 1).

    Examples
    --------
    >>> independent(2.0, 3).shape
    (3, 1, 1)
    """
    return jnp.broadcast_to(jnp.asarray(sd), (count,))[:, None, None]


def on_axes(functions: Array, coefficients: Array, axes: int) -> Array:
    """Signals on several axes from coefficients in the order of `on_each_axis`.

    `functions` (..., k); `coefficients` (axes k,). Returns (..., axes).

    Examples
    --------
    >>> on_axes(jnp.array([1.0, 0.5]), jnp.array([1.0, 2.0, 0.0, 4.0]), 2).tolist()
    [2.0, 2.0]
    """
    return functions @ coefficients.reshape(axes, -1).T
