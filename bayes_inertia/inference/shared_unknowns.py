"""Unknowns of a linearised fit, scaled and ordered for elimination slew by slew."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.inference.point import N_BIAS, Point
from bayes_inertia.physics.forward_model import Model


class SharedFirst(NamedTuple):
    """Unknowns in prior sds, in the order in which they are eliminated: what slews share first.

    Parameters
    ----------
    scale : (f + 3 + n_local,) array
        One prior sd of (theta[free], bias, own nuisances).
    order : (f + 3 + n_local,) array of int
        Where each stands among those: the bias, theta[free], own nuisances.
    precision, gradient : (3 + f,) arrays
        Of the prior of what slews share, in that order.
    """

    scale: np.ndarray
    order: np.ndarray
    precision: np.ndarray
    gradient: np.ndarray


def shared_first(model: Model, point: Point, free: np.ndarray) -> SharedFirst:
    """How unknowns are scaled and ordered, so that the matrix of what slews share is well scaled.

    `free` (f,).
    """
    slope, distance = (rows[free] for rows in prior_rows(model, point.theta))
    unit = np.where(slope != 0.0, slope, 1.0)
    f, end = len(free), len(free) + N_BIAS + point.n_local
    return SharedFirst(
        np.concatenate([1.0 / unit, np.ones(N_BIAS + point.n_local)]),
        np.r_[f : f + N_BIAS, :f, f + N_BIAS : end],
        np.concatenate([np.ones(N_BIAS), (slope / unit) ** 2]),
        np.concatenate([point.bias, slope * distance / unit]),
    )
