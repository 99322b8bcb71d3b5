"""How JAX must compute. Every module that can start a computation imports this one.

JAX has these settings once a process, so that the user's own computations get them too, from the
first name of the package that computes. Attitude residuals of arc seconds on angles of radians need
double precision. A compiled program that is kept is proved by calling it, and its error must come
with the call, not later; ensembles run in threads that each wait for their own result. Memory that
its compiler frees goes back to the system.
"""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from threading import Event

import jax

from bayes_inertia.errors import SettingsError, require

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_cpu_enable_async_dispatch", False)


# Threads of the compiler share two arenas, where what they freed lies: with an arena each a
# diagnosis holds up to 0.4 GB more.
if sys.platform == "linux" and "MALLOC_ARENA_MAX" not in os.environ:
    with suppress(OSError, AttributeError):  # Of another C library.
        ctypes.CDLL(None).mallopt(-8, 2)  # M_ARENA_MAX of malloc.h, glibc

_forked_late = Event()


def _after_fork() -> None:
    """Note in a child whether JAX had computed before; it has no public way to ask."""
    with suppress(ImportError):
        from jax._src.xla_bridge import backends_are_initialized

        if backends_are_initialized():
            _forked_late.set()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def require_usable_jax() -> None:
    """Raise where JAX would compute for ever, or in single precision.

    Examples
    --------
    >>> require_usable_jax()
    """
    alone, what = not _forked_late.is_set(), "was forked after JAX had computed and would hang"
    advice = 'start processes with spawn: multiprocessing.get_context("spawn")'
    require(alone, "this process", what, advice, error=SettingsError)
    double, what = jax.config.jax_enable_x64, "double precision was switched off"
    advice = 'switch it on again: jax.config.update("jax_enable_x64", True)'
    require(double, "JAX", what, advice, error=SettingsError)
