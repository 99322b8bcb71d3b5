"""Which mistake, undone, makes the data consistent: single ones first, then pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.hypothesis import Mistake, both
from bayes_inertia.conventions.linear_fit import LinearFit
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.mounting import turned_sensor
from bayes_inertia.conventions.reading import Reading

# Two mistakes that are together rarer than this are not tried.
_RAREST_PAIR = 4


@dataclass(frozen=True)
class Remedy:
    """A mistake whose mending makes the data consistent.

    Parameters
    ----------
    mistake : Mistake
        What to mend.
    before, after : float
        Worst misfit of the laws that it concerns, as stated and mended [sd].
    """

    mistake: Mistake
    before: float
    after: float


def worst(fits: dict[str, LinearFit]) -> float:
    """The worst misfit of all laws.

    Parameters
    ----------
    fits : dict of str to LinearFit
        By law.

    Returns
    -------
    float
        In standard deviations; 0 without any law.
    """
    return max((fit.worst for fit in fits.values()), default=0.0)


def remedies(misfits: Misfits, stated: Reading, singles: Sequence[Mistake]) -> list[Remedy]:
    """What makes inconsistent data consistent, the best first, with what the data hold equal to it.

    Parameters
    ----------
    misfits : Misfits
        The telemetry and its laws.
    stated : Reading
        Conventions as stated.
    singles : sequence of Mistake
        The mistakes to try.

    Returns
    -------
    list of Remedy
        None if nothing helps; pairs only where no single mistake explains the data.
    """
    before = worst(misfits.of(stated))
    tried = [*singles, *turned_sensor(misfits, stated)]
    alone = _ranked(misfits, stated, before, tried, limits.ORDINARY)
    if alone or before < limits.PAIR_IMPOSSIBLE:
        return alone
    pairs = _pairs(misfits, stated, singles)
    return _ranked(misfits, stated, before, pairs, limits.PAIR_ORDINARY)


def _ranked(
    misfits: Misfits,
    stated: Reading,
    before: float,
    tried: Sequence[Mistake],
    ordinary: float,
) -> list[Remedy]:
    """Those that mend, cut to the best and its equals, the most common mistake first."""
    mending = []
    limit = min(ordinary, before / limits.IMPROVEMENT)
    for mistake in tried:
        mended = mistake.mend(stated)
        if misfits.mends(mended, limit):
            mending.append(Remedy(mistake, before, worst(misfits.of(mended))))
    if not mending:
        return []
    best = min(remedy.after for remedy in mending)
    alike = limits.EQUAL_FACTOR * best + limits.EQUAL_MISFIT
    equals = [remedy for remedy in mending if remedy.after <= alike]
    equals.sort(key=lambda remedy: (remedy.mistake.rarity, remedy.after))
    return list({_proposed(remedy.mistake): remedy for remedy in reversed(equals)}.values())[::-1]


def _proposed(mistake: Mistake) -> str:
    """What a mistake proposes; two roads to one proposal are one."""
    return repr(sorted((change.key, change.mended) for change in mistake.changes))


def _pairs(misfits: Misfits, stated: Reading, singles: Sequence[Mistake]) -> list[Mistake]:
    """Pairs of mistakes in different keys: of each that mends a law alone, and of common ones."""
    broken = _broken(misfits.of(stated))
    helpful = [m for m in singles if _broken(misfits.of(m.mend(stated))) < broken]
    pairs = {
        frozenset((id(a), id(b))): both(a, b) for a in helpful for b in singles if _differ(a, b)
    }
    if not any(misfits.mends(pair.mend(stated), limits.PAIR_ORDINARY) for pair in pairs.values()):
        for i, a in enumerate(singles):
            for b in singles[:i]:
                if _may_meet(a, b):
                    pairs.setdefault(frozenset((id(a), id(b))), both(a, b))
    return list(pairs.values())


def _broken(fits: dict[str, LinearFit]) -> frozenset[str]:
    return frozenset(law for law, fit in fits.items() if fit.worst > limits.ORDINARY)


def _differ(first: Mistake, second: Mistake) -> bool:
    keys = {change.key for change in first.changes}
    return not keys & {change.key for change in second.changes}


def _may_meet(first: Mistake, second: Mistake) -> bool:
    """Whether two mistakes of which neither mends a law alone are tried together."""
    common = first.rarity + second.rarity <= _RAREST_PAIR
    return common and _differ(first, second) and not (_scales(first) and _scales(second))


def _scales(mistake: Mistake) -> bool:
    """Whether a mistake is one of scale; two of these in different quantities may compensate."""
    return any(
        isinstance(c.stated, str) and c.key.endswith(".unit") and "time" not in c.key
        for c in mistake.changes
    ) or any(c.key.endswith((".spin_inertia", "inertia.tensor")) for c in mistake.changes)


def misfit_of(fits: dict[str, LinearFit]) -> dict[str, float]:
    """The misfit of each law [sd].

    Parameters
    ----------
    fits : dict of str to LinearFit
        By law.

    Returns
    -------
    dict of str to float
        By law.
    """
    return {law: float(np.round(fit.worst, 3)) for law, fit in fits.items()}
