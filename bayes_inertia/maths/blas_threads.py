"""One thread for linear algebra: matrices are small, and more threads wait for each other."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

from threadpoolctl import threadpool_limits


def on_one_blas_thread[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """The same function, its linear algebra on one thread.

    Examples
    --------
    >>> on_one_blas_thread(abs)(-2)
    2
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
