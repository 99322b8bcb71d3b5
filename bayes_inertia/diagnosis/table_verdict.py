"""What a table of hypotheses says: what is named, what could be it as well, and how sure it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.hypothesis_table import Names
from bayes_inertia.diagnosis.limits import LIMITS, Rules
from bayes_inertia.diagnosis.random_signals import NAMELESS
from bayes_inertia.diagnosis.result import Hypothesis
from bayes_inertia.diagnosis.table_search import SHAPELESS, Table
from bayes_inertia.inference.settings import NOTHING

_SOURCES = {name: source for source, name in NAMELESS.items()}


class Reading(NamedTuple):
    """What a table says.

    Parameters
    ----------
    verdict : str
        As `Diagnosis.verdict`.
    named : tuple of str
        Effects of the best row with names alone.
    ambiguous_with : tuple of tuples of str
        Sets that cannot be told apart, the member of the best row first, `NOTHING` last.
    why_unknown : str
        As `Diagnosis.why_unknown`.
    nameless_lead : float
        Log odds of the best row with a shape without a name against the best without.
    nameless_source : str
        Where that shape enters.
    """

    verdict: str
    named: tuple[str, ...] = ()
    ambiguous_with: tuple[tuple[str, ...], ...] = ()
    why_unknown: str = ""
    nameless_lead: float = -np.inf
    nameless_source: str = ""

    @property
    def row(self) -> Names:
        """The row of the effects named."""
        return frozenset(self.named)


def read_table(table: Table, rules: Rules, *, significant: bool) -> Reading:
    """Read the verdict off a table.

    `significant`: whether anything is, at the level of false alarms of the rules; where nothing is,
    nothing is named.
    """
    best = next(iter(table.rows))
    if not significant or not best:
        return Reading("consistent")
    row = next((row for row in table.rows if row and not row & SHAPELESS), frozenset[str]())
    named = tuple(sorted(row, key=lambda name: -_single(table, name)))
    shape = next((row for row in table.rows if row & SHAPELESS), None)
    reading = Reading("named", named)
    if shape is not None:
        lead = float(np.log(table.rows[shape]) - np.log(table.rows[row]))
        (own,) = shape & SHAPELESS
        reading = reading._replace(nameless_lead=lead, nameless_source=_SOURCES[own])
    if reading.nameless_lead > rules.log_evidence_margin:
        # Beside the shape, the names may still explain a part.
        verdict = "partial" if shape is not None and shape - SHAPELESS else "unknown"
        kept = tuple(name for name in named if shape is not None and name in shape)
        if verdict == "unknown" or not kept:
            return reading._replace(verdict="unknown", why_unknown="imitation")
        return reading._replace(verdict=verdict)
    sets = _ambiguous_sets(table, named, rules)
    return reading._replace(verdict="ambiguous" if sets else "named", ambiguous_with=sets)


def _ambiguous_sets(
    table: Table, named: tuple[str, ...], rules: Rules
) -> tuple[tuple[str, ...], ...]:
    """What stands in other rows in place of the effects named; nothing, if nothing does."""
    row, sets = frozenset(named), dict[str, list[str]]()
    least = table.rows[row] * np.exp(-rules.log_evidence_margin)
    for other, probability in _answers(table):
        lost, gained = [name for name in named if name not in other], sorted(other - row)
        if probability <= least:
            continue
        for name in lost[:1] if gained else lost:
            places = sets.setdefault(name, [])
            found = [*gained, *lost[1:]] if gained else [NOTHING]
            places += [name for name in found if name not in places]
    order = {name: sorted(places, key=lambda n: n == NOTHING) for name, places in sets.items()}
    return tuple((name, *order[name]) for name in named if name in sets)


def _answers(table: Table) -> list[tuple[Names, float]]:
    """Rows and their probabilities; those that differ in the shape without a name are one."""
    joined: dict[tuple[Names, bool], tuple[Names, float]] = {}
    for row, probability in table.rows.items():
        key = row - SHAPELESS, bool(row & SHAPELESS)
        first, before = joined.get(key, (row, 0.0))
        joined[key] = first, before + probability
    return list(joined.values())


def unexplained_reading(table: Table, reading: Reading) -> Reading:
    """The reading where the best row leaves residuals that are not noise.

    Names that a shape without a name does not make needless explain a part; else nothing is named.
    """
    shape = next((row for row in table.rows if row & SHAPELESS), frozenset[str]())
    if reading.named and set(reading.named) <= shape:
        return reading._replace(verdict="partial", ambiguous_with=())
    return reading._replace(verdict="unknown", ambiguous_with=(), why_unknown="misfit")


def _single(table: Table, name: str) -> float:
    return table.log_evidence.get(frozenset([name]), -np.inf)


def hypotheses_of(table: Table) -> tuple[Hypothesis, ...]:
    """The rows that are listed, most probable first; their probabilities add up to one.

    Shapes without a name are one hypothesis, beside each set of names.
    """
    groups: dict[tuple[str, Names], list[Names]] = {}
    for row in table.rows:
        names = row - SHAPELESS
        kind = "nameless" if row & SHAPELESS else "effects" if names else "nothing"
        groups.setdefault((kind, names), []).append(row)
    rows = [_together(table, kind, names, members) for (kind, names), members in groups.items()]
    rows.sort(key=lambda row: -row.probability)
    kept = [row for row in rows if row.kind == "nothing" or not row.effects]
    kept += [row for row in rows if row not in kept][: LIMITS.listed]
    rest = [row for row in rows if row not in kept]
    if rest:
        prior = float(logsumexp([row.log_prior for row in rest]))
        joint = float(logsumexp([row.log_prior + row.log_evidence for row in rest]))
        total = sum(row.probability for row in rest)
        kept.append(Hypothesis("others", (), prior, joint - prior, total))
    return tuple(sorted(kept, key=lambda row: -row.probability))


def _together(table: Table, kind: str, names: Names, members: list[Names]) -> Hypothesis:
    """Rows that differ in the shape without a name alone, as one."""
    prior = float(logsumexp([table.log_prior[row] for row in members]))
    joint = logsumexp([table.log_prior[row] + table.log_evidence[row] for row in members])
    probability = sum(table.rows[row] for row in members)
    effects = tuple(sorted(names, key=lambda name: -_single(table, name)))
    return Hypothesis(kind, effects, prior, float(joint) - prior, float(probability))  # type: ignore[arg-type]
