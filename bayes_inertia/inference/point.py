"""A point of the full parameter space: what is sampled and what is integrated out, together."""

from __future__ import annotations

from typing import Any

import jax

from bayes_inertia.maths.values import array_dataclass


@jax.tree_util.register_dataclass
@array_dataclass
class Point:
    """Where residuals are evaluated; compiled code takes it as one argument.

    Parameters
    ----------
    theta : (d,) array
        Parameters of the model, in physical units.
    bias : (axes,) array
        Deviation of the rate bias from its prior mean, in prior sd.
    local : (slews, n_local) array
        Nuisances of each slew (start state; in the measured drive slow tachometer noise), in
        prior sd.

    Examples
    --------
    >>> import numpy as np
    >>> Point(np.zeros(9), np.zeros(3), np.zeros((2, 9))).n_local
    9
    """

    # Of numpy on the host, of JAX in compiled code.
    theta: Any
    bias: Any
    local: Any

    @property
    def n_local(self) -> int:
        """Nuisances of one slew."""
        return self.local.shape[1]
