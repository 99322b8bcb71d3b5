"""Independent pieces of compiled work, two at a time: one core alone would leave the other idle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax

_THREADS = 2


def at_once[T](tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Call functions that work in compiled code, two at a time.

    Compiled code runs beside other threads of Python. Results do not depend on how many there are.

    Returns: what they return, in their order; arrays of JAX are computed.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> [int(x) for x in at_once([lambda: jnp.arange(3).sum(), lambda: jnp.arange(5).sum()])]
    [3, 10]
    """
    if len(tasks) == 1:
        return [jax.block_until_ready(tasks[0]())]
    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(lambda task: jax.block_until_ready(task()), tasks))
