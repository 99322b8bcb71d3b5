"""Which mistake, undone, makes the data consistent: single ones first, then pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.hypothesis import Mistake, both
from bayes_inertia.conventions.laws import CLOSURE
from bayes_inertia.conventions.linear_fit import LinearFit, worst
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.mounting import turned_beside_bias, turned_sensor
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.stale_bias import beside_stale_bias, with_own_bias

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


@dataclass(frozen=True)
class Judgement:
    """What is wrong with a campaign's conventions.

    Parameters
    ----------
    remedies : tuple of Remedy
        What makes inconsistent data consistent, the best first, with what the data hold equal.
    reading : Reading
        Conventions as stated, with the bias that the telemetry tells where the stated one is stale.
    """

    remedies: tuple[Remedy, ...]
    reading: Reading

    def mended(self, stated: Reading) -> Reading:
        """The conventions that agree best with the data.

        Parameters
        ----------
        stated : Reading
            Conventions as stated.

        Returns
        -------
        Reading
            With the first remedy, if there is one.
        """
        return self.remedies[0].mistake.mend(stated) if self.remedies else self.reading


def judged(misfits: Misfits, stated: Reading, singles: Sequence[Mistake]) -> Judgement:
    """What makes inconsistent data consistent: nothing, a stale bias, mistakes, or both.

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
    Judgement
        Pairs only where no single mistake explains the data.
    """
    before = worst(misfits.of(stated))
    if before <= limits.SUSPICIOUS:
        return Judgement((), stated)
    own = with_own_bias(misfits, stated)
    reading = own if _is_stale(misfits, stated, own) else stated
    biased = worst(misfits.of(reading))
    search = _Search(misfits, stated, before)
    if before <= limits.IMPOSSIBLE:
        return Judgement(_surely(search, singles, reading, biased), reading)
    return Judgement(_impossible(search, singles, biased), reading)


def _is_stale(misfits: Misfits, stated: Reading, own: Reading) -> bool:
    """Whether another bias explains the data much better, closure among them where fixes are."""
    before, after = misfits.of(stated), misfits.of(own)
    pairs = [(worst(before), worst(after))]
    if CLOSURE in before:
        pairs.append((before[CLOSURE].worst, after[CLOSURE].worst))
    return all(then < now / limits.STALE_IMPROVEMENT for now, then in pairs)


@dataclass(frozen=True, eq=False)
class _Search:
    """What mistakes are judged by: the laws, the stated conventions, and their misfit."""

    misfits: Misfits
    stated: Reading
    before: float

    def alone(self, singles: Sequence[Mistake]) -> list[Mistake]:
        return [*singles, *turned_sensor(self.misfits, self.stated)]

    def beside_bias(self, singles: Sequence[Mistake]) -> list[Mistake]:
        turned = turned_beside_bias(self.misfits, self.stated)
        return [beside_stale_bias(self.misfits, mistake) for mistake in (*singles, *turned)]

    def ranked(self, tried: Sequence[Mistake], limit: float) -> tuple[Remedy, ...]:
        return _ranked(self.misfits, self.stated, self.before, tried, limit)


def _surely(
    search: _Search, singles: Sequence[Mistake], reading: Reading, biased: float
) -> tuple[Remedy, ...]:
    """Mistakes that explain data that are possible as stated, but much better."""
    tried, left = search.alone(singles), search.before
    if reading is not search.stated:
        tried, left = search.beside_bias(singles), biased
    return search.ranked(tried, left / limits.SURE_IMPROVEMENT) if left > limits.SUSPICIOUS else ()


def _impossible(search: _Search, singles: Sequence[Mistake], biased: float) -> tuple[Remedy, ...]:
    """Mistakes that explain impossible data; none where a stale bias explains them as well."""
    alone = search.ranked(search.alone(singles), limits.ORDINARY)
    if alone and alone[0].after < limits.CLEAR:
        return alone
    explained = biased < min(limits.ORDINARY, search.before / limits.IMPROVEMENT)
    if explained and not _as_good(alone, biased):
        return ()
    beside = search.ranked(search.beside_bias(singles), limits.PAIR_ORDINARY)
    if alone and (not beside or _as_good(alone, beside[0].after)):
        return alone
    if search.before < limits.PAIR_IMPOSSIBLE or (beside and beside[0].after < limits.CLEAR):
        return beside
    pairs = search.ranked(_pairs(search.misfits, search.stated, singles), limits.PAIR_ORDINARY)
    return beside if beside and not _as_good(pairs, beside[0].after) else pairs


def _as_good(remedies: Sequence[Remedy], other: float) -> bool:
    """Whether a remedy mends as well as another explanation does, or better."""
    return bool(remedies) and min(remedy.after for remedy in remedies) <= _alike(other)


def _alike(misfit: float) -> float:
    """The misfit below which the data hold two explanations equal."""
    return limits.EQUAL_FACTOR * misfit + limits.EQUAL_MISFIT


def _ranked(
    misfits: Misfits,
    stated: Reading,
    before: float,
    tried: Sequence[Mistake],
    ordinary: float,
) -> tuple[Remedy, ...]:
    """Those that mend, cut to the best and its equals, the most common mistake first."""
    mending = []
    limit = min(ordinary, before / limits.IMPROVEMENT)
    for mistake in tried:
        mended = mistake.mend(stated)
        if misfits.mends(mended, limit):
            mending.append(Remedy(mistake, before, worst(misfits.of(mended))))
    if not mending:
        return ()
    best = min(remedy.after for remedy in mending)
    equals = [remedy for remedy in mending if remedy.after <= _alike(best)]
    equals.sort(key=lambda remedy: (remedy.mistake.rarity, remedy.after))
    return tuple({_proposed(remedy.mistake): remedy for remedy in reversed(equals)}.values())[::-1]


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
