"""How many compiled programs a process keeps: few, whatever shapes of campaigns come.

JAX keeps thousands, a program for each shape that a function was ever called with. A process that
fits campaign after campaign would grow with every new shape.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bayes_inertia.inference.coefficients import PROGRAMS as OF_COEFFICIENTS
from bayes_inertia.inference.filtered_evidence import PROGRAMS as OF_FILTERS
from bayes_inertia.inference.hyperparameters import PROGRAMS as OF_EVIDENCE
from bayes_inertia.inference.likelihood import PROGRAMS as OF_LIKELIHOOD
from bayes_inertia.inference.marginal_posterior import PROGRAMS as OF_POSTERIOR

# Of each function. A diagnosis needs up to a dozen: drives, noises, flexible modes.
MOST_PROGRAMS = 24


def forget_surplus(
    programs: Iterable[Any] = (
        *OF_COEFFICIENTS,
        *OF_EVIDENCE,
        *OF_FILTERS,
        *OF_LIKELIHOOD,
        *OF_POSTERIOR,
    ),
    most: int = MOST_PROGRAMS,
) -> None:
    """Forget the programs of every function that has more than so many of them.

    What is needed again is compiled again, or comes from the cache on disk. JAX has no public count
    of a function's programs, and `jax.clear_caches` would forget those of all functions: hence
    `_cache_size`.

    Examples
    --------
    >>> forget_surplus()
    """
    for program in programs:
        if program._cache_size() > most:
            program.clear_cache()
