"""Nuisances: what a slew has of its own and nobody asks for, whitened by its prior."""

from __future__ import annotations

from typing import NamedTuple

from jax import Array


class Nuisances(NamedTuple):
    """Whitened nuisances of one slew.

    Parameters
    ----------
    start : (n_start,) array
        Start rate and attitude, then start momentum or tachometer shapes.
    coefficients : tuple of (k,) arrays
        Of each effect, or empty where all effects have a fixed shape.
    """

    start: Array
    coefficients: tuple[Array, ...]


class NuisanceScale(NamedTuple):
    """Prior sd that turns whitened nuisances into physical ones.

    Parameters
    ----------
    local : (n_start,) array
        Of one slew's nuisances without coefficients [rad/s, rad, N m s].
    bias : (axes,) array
        Of the rate bias [rad/s].
    """

    local: Array
    bias: Array
