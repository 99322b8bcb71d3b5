"""Compiled programs that the next process takes as they are.

JAX's persistent cache keeps what the compiler made, and finds it by a digest of the traced program:
each process traces and lowers a model again, which takes as long as the optimizer. A program here
is found by what is traced instead: the model's structure, the shapes of the arrays, and the
package's own code. It lies in the folder of JAX's cache, among its entries and within its limits,
and where no such cache is set nothing is kept.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import sys
import warnings
import zlib
from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import cache, update_wrapper
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any

import jax
import numpy as np
from jax.experimental import serialize_executable

import bayes_inertia
from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.sealing import sha256_of

_PACKAGE = bayes_inertia.__name__
# What is kept of a program that cannot be read back: nobody tries again.
_NOT_KEPT = b""


class KeptProgram:
    """A compiled function of a model's structure and of arrays.

    Called by functions that JAX transforms it is one of them. `compiled_programs` asks for the size
    of its programs and forgets them.

    Parameters
    ----------
    function : callable
        From (structure, *arrays) to arrays. The structure is hashable and decides, with the shapes
        of the arrays, what is compiled.
    **options
        Of `jax.jit`.

    Examples
    --------
    >>> KeptProgram(lambda power, x: x**power)(3, np.array([2.0])).tolist()
    [8.0]
    """

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        update_wrapper(self, function)
        self._function = function
        self._traced: Any = jax.jit(function, static_argnums=0, **options)
        self._ready: dict[Hashable, _Ready] = {}
        self._preparing: dict[Hashable, Lock] = {}

    def __call__(self, structure: Any, *arrays: Any) -> Any:
        require_usable_jax()
        leaves, tree = jax.tree.flatten(arrays)
        if any(isinstance(x, jax.core.Tracer) for x in leaves):
            return self._traced(structure, *arrays)
        form = (structure, tree, tuple(_form(x) for x in leaves))
        ready = self._ready.get(form)
        if ready is None:
            # A program that two threads want is compiled by one.
            with self._preparing.setdefault(form, Lock()):
                ready = self._ready.get(form) or _Ready(self._prepared(form, arrays))
                self._ready[form] = ready
        ready.used = perf_counter()
        return ready.program(*arrays)

    def clear_cache(self) -> None:
        """Forget all programs of this process."""
        self._ready.clear()
        self._preparing.clear()
        self._traced.clear_cache()

    def sizes(self) -> list[tuple[float, int, Hashable]]:
        """Of each program when it was last called, its size [bytes], and what it is called for."""
        return [(ready.used, ready.size, form) for form, ready in list(self._ready.items())]

    def forget(self, form: Hashable) -> None:
        """Forget one program of this process."""
        self._ready.pop(form, None)
        self._preparing.pop(form, None)
        self._traced.clear_cache()

    def _cache_size(self) -> int:
        return len(self._ready) + self._traced._cache_size()

    def _prepared(self, form: tuple, arrays: tuple) -> Callable[..., Any]:
        """The program of a form: kept, or compiled now."""
        kept = _kept_entries()
        key = None if kept is None else _key(self._function, form)
        if key is None:
            return self._compiled(form, arrays)
        content = None
        with suppress(OSError, TimeoutError):
            content = kept.get(key)
        if content == _NOT_KEPT:
            return self._compiled(form, arrays)
        if content is not None:
            try:
                return _loaded(content, arrays)
            except Exception as error:  # The libraries raise whatever they stumble over.
                # As JAX says it of its own entries.
                what = "Error reading persistent compilation cache entry for"
                warnings.warn(f"{what} '{key.split('-')[0]}': {error}", stacklevel=4)
        compiled = self._compiled(form, arrays)
        if content is None:
            # Where the folder cannot be written, the next process compiles again.
            with suppress(OSError, TimeoutError):
                kept.put(key, _proved(compiled, arrays))
        return compiled

    def _compiled(self, form: tuple, arrays: tuple) -> Any:
        # Not by a call: two threads would compile the same program twice.
        compiled = self._traced.trace(form[0], *arrays).lower().compile()
        self._traced.clear_cache()
        return_freed_memory()
        return compiled


class _Ready:
    """A program of this process, its size [bytes], and when it was last called."""

    def __init__(self, program: Any) -> None:
        modules = program.runtime_executable().hlo_modules()
        self.size = sum(len(module.as_serialized_hlo_module_proto()) for module in modules)
        self.program, self.used = program, perf_counter()


def return_freed_memory() -> None:
    """Give back to the system what the compiler has freed: 100 MB and more for each program."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # Of other C libraries than glibc.
            ctypes.CDLL(None).malloc_trim(0)


def _kept_entries() -> Any:
    """JAX's cache on disk, or None where there is none, or for other devices than processors."""
    folder = jax.config.jax_compilation_cache_dir
    if not folder or not jax.config.jax_enable_compilation_cache or "://" in folder:
        return None
    if jax.default_backend() != "cpu":
        return None
    return _entries_in(folder, jax.config.jax_compilation_cache_max_size)


@cache
def _entries_in(folder: str, size: int) -> Any:
    """JAX's own class, so that both kinds of entries have one lock and one limit."""
    try:
        from jax._src.lru_cache import LRUCache

        return LRUCache(folder, max_size=size)
    except (ImportError, OSError, RuntimeError):
        return None


def _form(x: Any) -> tuple:
    """What a compiled program expects of an array."""
    typed = hasattr(x, "dtype")
    return np.shape(x), x.dtype if typed else type(x), getattr(x, "weak_type", not typed)


def _key(function: Callable[..., Any], form: tuple) -> str | None:
    """By what a program is found; None for effects and sensors whose code is not the package's."""
    structure, tree, shapes = form
    parts = (*getattr(structure, "effects", ()), *getattr(structure, "channels", ()))
    if any(type(part).__module__.split(".")[0] != _PACKAGE for part in parts):
        return None
    device = jax.devices()[0]
    what = (
        pickle.dumps(structure),
        str(tree),
        repr(shapes),
        jax.__version__,
        device.client.platform_version,
        device.device_kind,
        len(jax.devices()),
        os.environ.get("XLA_FLAGS", ""),
        _digest_of_package(),
    )
    name = f"{_PACKAGE}_{function.__name__.strip('_')}"
    return f"{name}-{sha256_of(pickle.dumps(what))}"


@cache
def _digest_of_package() -> str:
    """Of its code: what was traced from other code is another program."""
    files = sorted(Path(__file__).parents[1].rglob("*.py"))
    return sha256_of(*(file.read_bytes() for file in files))


def _packed(compiled: jax.stages.Compiled) -> bytes:
    code, _, results = serialize_executable.serialize(compiled)
    # A tree's definition cannot be stored; a tree can.
    tree = jax.tree.unflatten(results, range(results.num_leaves))
    return zlib.compress(pickle.dumps((code, tree)), 1)


@cache
def _connect_linear_algebra() -> None:
    """LAPACK's functions reach compiled code when a program that calls one is lowered, not when
    one is loaded, and calling them before would end the process.
    """
    jax.jit(jax.lax.linalg.cholesky).lower(np.eye(1))


def _loaded(content: bytes, arrays: tuple) -> Callable[..., Any]:
    _connect_linear_algebra()
    code, results = pickle.loads(zlib.decompress(content))
    trees = jax.tree.structure((arrays, {})), jax.tree.structure(results)
    return serialize_executable.deserialize_and_load(code, *trees)


def _proved(compiled: jax.stages.Compiled, arrays: tuple) -> bytes:
    """A program to keep, once it was read back and gives the same bits.

    What JAX itself took from its cache cannot be kept again.
    """
    try:
        content = _packed(compiled)
        kept = jax.block_until_ready(jax.tree.leaves(_loaded(content, arrays)(*arrays)))
    except Exception:  # The libraries raise whatever they stumble over.
        return _NOT_KEPT
    same = zip(kept, jax.tree.leaves(compiled(*arrays)), strict=True)
    equal = all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in same)
    return content if equal else _NOT_KEPT
