"""What mends a campaign: a key, then a clock, then what one stream alone may have wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.clocks import Clocks, clocks, known_offsets, shifted_misfit
from bayes_inertia.conventions.columns import without_sign
from bayes_inertia.conventions.doubts import Factors
from bayes_inertia.conventions.hypothesis import Mistake
from bayes_inertia.conventions.linear_fit import worst
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.search import Judgement, Remedy

Columns = Mapping[str, Mapping[str, Any]]


def what_mends(
    misfits: Misfits,
    judgement: Judgement,
    singles: Sequence[Mistake],
    columns: Columns,
    differ: Factors | None,
) -> tuple[tuple[Remedy, ...], Clocks]:
    """All that makes the data consistent, the best first, and what is said of the clocks.

    `columns` [columns]. Returns `remedies`: empty where nothing mends it; `clocks`: what the laws
    say of the streams' clocks.
    """
    mending, clock = judgement.remedies, Clocks()
    if not mending:
        clock = clocks(misfits, judgement.reading, columns)
        mending = _of_clocks(misfits, judgement.reading, clock)
    # Two mistakes at once are less likely than one in a stream.
    first = mending[0].mistake if mending else None
    if first is None or (len(first.changes) > 1 and first not in singles):
        return _of_streams(misfits, judgement.reading, columns, differ) or mending, clock
    exact = _of_factor(misfits, judgement.reading, columns, differ)
    better = [remedy for remedy in exact if remedy.after < limits.CLEARLY * mending[0].after]
    return (*mending, *better), clock


def _of_streams(
    misfits: Misfits, reading: Reading, columns: Columns, differ: Factors | None
) -> tuple[Remedy, ...]:
    """What is wrong with one stream: its factor, its signs, or its clock by a known offset."""
    if exact := _of_factor(misfits, reading, columns, differ):
        return exact
    before = worst(misfits.of(reading))
    if before <= limits.IMPOSSIBLE:
        return ()
    unsigned = without_sign(misfits, reading, before)
    return known_offsets(misfits, reading, columns) if unsigned is None else (unsigned,)


def _of_factor(
    misfits: Misfits, reading: Reading, columns: Columns, differ: Factors | None
) -> tuple[Remedy, ...]:
    """Spin inertias that are wrong by the factor between commands and tachometers."""
    mistake = None if differ is None else differ.mistake(misfits.campaign, columns)
    if mistake is None:
        return ()
    before, after = (worst(misfits.of(r)) for r in (reading, mistake.mend(reading)))
    mends = after < min(limits.PAIR_ORDINARY, before / limits.IMPROVEMENT)
    return (Remedy(mistake, before, after),) if mends else ()


def _of_clocks(misfits: Misfits, reading: Reading, clock: Clocks) -> tuple[Remedy, ...]:
    """Wrong clocks whose mending makes all laws hold."""
    return tuple(
        remedy
        for remedy in clock.remedies
        if shifted_misfit(misfits, reading, remedy) < limits.ORDINARY
    )
