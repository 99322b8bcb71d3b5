"""How much compiled code a process keeps: no more than so many bytes, whatever campaigns come.

JAX keeps thousands of programs, one for each shape that a function was ever called with. A process
that fits campaign after campaign would grow with every new set of effects.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bayes_inertia.inference.hyperparameters import PROGRAMS as OF_EVIDENCE
from bayes_inertia.inference.likelihood import PROGRAMS as OF_LIKELIHOOD
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.marginal_posterior import PROGRAMS as OF_POSTERIOR
from bayes_inertia.maths.kept_programs import KeptProgram, return_freed_memory


def forget_surplus(
    programs: Iterable[Any] = (*OF_EVIDENCE, *OF_LIKELIHOOD, *OF_POSTERIOR),
    most: int = LIMITS.most_programs,
    most_bytes: int = LIMITS.most_bytes,
) -> None:
    """Forget large programs that were not called for longest, and functions with many small ones.

    What is needed again is compiled again, or comes from the cache on disk. JAX has no public count
    of a function's programs, and `jax.clear_caches` would forget those of all functions: hence
    `_cache_size`.

    `most`: programs that each compiled function of JAX may keep. `most_bytes`: [bytes] of all
    programs of every `KeptProgram` together.

    Examples
    --------
    >>> forget_surplus()
    """
    programs = list(programs)
    for program in programs:
        if not isinstance(program, KeptProgram) and program._cache_size() > most:
            program.clear_cache()
    kept = [program for program in programs if isinstance(program, KeptProgram)]
    every = [(*entry, program) for program in kept for entry in program.sizes()]
    surplus = sum(size for _, size, *_ in every) - most_bytes
    for _, size, form, program in sorted(every, key=lambda entry: entry[0]):
        if surplus > 0:
            program.forget(form)
            surplus -= size
    return_freed_memory()
