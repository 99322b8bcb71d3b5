"""Compiled programs that the next process takes as they are.

JAX's persistent cache keeps what the compiler made, and finds it by a digest of the traced program:
each process traces and lowers a model again, which takes as long as the optimizer. A program here
is found by what is traced instead: the model's structure, the shapes of the arrays, and the
package's own code. It lies in the folder of JAX's cache, among its entries and within its limits,
and where no such cache is set nothing is kept.
"""

from __future__ import annotations

import ctypes
import gc
import os
import pickle
import sys
import warnings
import zlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import suppress
from functools import cache, update_wrapper
from pathlib import Path
from threading import Lock
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


class ProgramsInMemory:
    """All programs of a process: beyond a size, those that were not called for longest go.

    What is needed again is compiled again, or comes from the cache on disk.

    Parameters
    ----------
    most_bytes : int
        [bytes] of all programs together, as the compiler describes them; in memory they take 30
        times as much, 0.4 GB. A flight and its diagnosis need 7 to 12 MB, and would compile again
        and again if there were less. A process shall stay below 1.5 GB, while it compiles too.
    clear_after : int
        [bytes] of programs after which what JAX itself keeps is forgotten: as much as a campaign of
        a new shape adds. Traces, and a program for each single operation, are 25 MB for each shape.
    """

    def __init__(self, most_bytes: int = 12 * 2**20, clear_after: int = 4 * 2**20) -> None:
        self.most_bytes, self.clear_after = most_bytes, clear_after
        self._programs: OrderedDict[tuple[KeptProgram, Hashable], tuple[Any, int]] = OrderedDict()
        self._since_cleared = 0  # [bytes] of programs since JAX's own were forgotten.
        self._lock = Lock()

    def get(self, of: KeptProgram, form: Hashable) -> Callable[..., Any] | None:
        """The program of a function for a form; None where there is none."""
        with self._lock:
            found = self._programs.get((of, form))
            if found is None:
                return None
            self._programs.move_to_end((of, form))
            return found[0]

    def put(self, of: KeptProgram, form: Hashable, program: Any) -> None:
        """Hold one more program, at the expense of the oldest."""
        modules = program.runtime_executable().hlo_modules()
        size = sum(len(module.as_serialized_hlo_module_proto()) for module in modules)
        with self._lock:
            self._programs[of, form] = program, size
            while self.size() > self.most_bytes and len(self._programs) > 1:
                self._programs.popitem(last=False)
            self._since_cleared += size
            cleared = self._since_cleared > self.clear_after
            if cleared:
                self._since_cleared = 0
        if cleared:
            jax.clear_caches()
            gc.collect()  # Traces hold each other.
        return_freed_memory()

    def size(self) -> int:
        """[bytes] of all programs, as the compiler describes them."""
        return sum(size for _, size in self._programs.values())

    def held(self) -> tuple[tuple[KeptProgram, Hashable], ...]:
        """Functions and forms of all programs, the oldest first."""
        with self._lock:
            return tuple(self._programs)


# Compiled code is the process', as in JAX: who compiles cannot know what else was compiled.
IN_MEMORY = ProgramsInMemory()


class KeptProgram:
    """A compiled function of what decides its code and of arrays.

    Called by functions that JAX transforms it is one of them. A process holds no more of all such
    programs together than `ProgramsInMemory` says.

    Parameters
    ----------
    function : callable
        From (*static, *arrays) to arrays. What is static is hashable and decides, with the shapes
        of the arrays, what is compiled: a model's structure.
    static : int
        How many arguments are static.
    memory : ProgramsInMemory
        Holds the programs; all functions share one.
    **options
        Of `jax.jit`.

    Examples
    --------
    >>> KeptProgram(lambda power, x: x**power)(3, np.array([2.0])).tolist()
    [8.0]
    """

    def __init__(
        self,
        function: Callable[..., Any],
        static: int = 1,
        memory: ProgramsInMemory = IN_MEMORY,
        **options: Any,
    ) -> None:
        update_wrapper(self, function)
        self._function, self._static, self._memory = function, static, memory
        self._traced: Any = jax.jit(function, static_argnums=tuple(range(static)), **options)
        self._preparing: dict[Hashable, Lock] = {}

    def __call__(self, *arguments: Any) -> Any:
        require_usable_jax()
        static, arrays = arguments[: self._static], arguments[self._static :]
        leaves, tree = jax.tree.flatten(arrays)
        if any(isinstance(x, jax.core.Tracer) for x in leaves):
            return self._traced(*arguments)
        form = (static, tree, tuple(_form(x) for x in leaves))
        program = self._memory.get(self, form)
        if program is None:
            # A program that two threads want is compiled by one.
            with self._preparing.setdefault(form, Lock()):
                program = self._memory.get(self, form)
                if program is None:
                    program = self._prepared(form, arrays)
                    self._memory.put(self, form, program)
            self._preparing.pop(form, None)
        return program(*arrays)

    def _prepared(self, form: tuple, arrays: tuple) -> Callable[..., Any]:
        """The program of a form: kept, or compiled now."""
        kept = _kept_entries()
        key = None if kept is None else _key(self._function, form)
        if key is None:
            return self._compiled(form, arrays)
        content = None
        with suppress(OSError, TimeoutError):
            content = kept.get(key)
        if content:  # Neither absent nor `_NOT_KEPT`.
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
        # The compiler needs memory of its own: not beside what arrays have left.
        return_freed_memory()
        # Not by a call: two threads would compile the same program twice.
        compiled = self._traced.trace(*form[0], *arrays).lower().compile()
        self._traced.clear_cache()
        return compiled


def return_freed_memory() -> None:
    """Give back to the system what compiler and arrays have freed: 100 MB and more."""
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
    static, tree, shapes = form
    if any(type(part).__module__.split(".")[0] != _PACKAGE for part in _with_code(static)):
        return None
    device = jax.devices()[0]
    what = (
        pickle.dumps(static),
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


def _with_code(static: Any) -> Iterator[Any]:
    """Effects and sensors: what is static and brings code of its own."""
    if hasattr(static, "effects"):
        yield from _with_code((*static.effects, *getattr(static, "channels", ())))
    elif isinstance(static, tuple):
        for part in static:
            yield from _with_code(part)
    elif type(static).__module__ != "builtins":
        yield static


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
