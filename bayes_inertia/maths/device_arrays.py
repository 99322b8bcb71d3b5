"""Arrays of the host as arrays of JAX, without compiling anything."""

from __future__ import annotations

import jax
import numpy as np
from jax import Array

from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.maths.values import AnyArray


def on_device(values: AnyArray) -> Array:
    """Numbers of the host as an array of JAX.

    `jnp.asarray` compiles a copy for every new shape, some 20 ms each; this compiles nothing.

    Parameters
    ----------
    values : array_like
        Numbers; they must not be changed afterwards, the array may share their memory.

    Returns
    -------
    Array
        Of the same shape and type.

    Raises
    ------
    SettingsError
        As `require_usable_jax`.

    Examples
    --------
    >>> on_device((1.0, 2.0)).shape
    (2,)
    """
    require_usable_jax()
    return jax.device_put(np.asarray(values))
