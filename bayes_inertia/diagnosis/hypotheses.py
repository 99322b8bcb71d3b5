"""How probable each answer is: nothing, every set of effects that was weighed, or no name at all.

A search weighs many hypotheses on its way: at each of its fits one effect more, each of the
library, those without a fixed shape, and shapes without a name. The log evidence of a hypothesis is
what its effects claim, one after the other; `prior_of_sets` says how likely each is beforehand.
"No name" counts as one candidate among the others. What a p-value of the final residuals says
against all names is at most -1 / (e p log p) (Sellke, Bayarri and Berger 2001).

Evidences are of linearised models, and of effects whose true shapes differ from the library's: they
are more certain than they should be. They count divided by a temperature (`Rules`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.prior_of_sets import log_prior_of_set
from bayes_inertia.diagnosis.refitting import ScoredRound
from bayes_inertia.diagnosis.result import Hypothesis, NamelessShape, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.stochastic_candidates import StochasticCandidate
from bayes_inertia.inference.laplace import Estimate

# Sets of effects that are listed: the most probable ones; the others are one row.
_LISTED = 8
_LEAST_P_VALUE = 1e-300


class Level(NamedTuple):
    """What was weighed at one fit of a search.

    Parameters
    ----------
    effects : tuple of str
        What the fit holds.
    log_evidence : float
        Of the fit against nothing.
    one_more : mapping of float
        Log evidence of each further effect against the fit.
    nameless : tuple of float
        The same of shapes without a name.
    """

    effects: tuple[str, ...]
    log_evidence: float
    one_more: Mapping[str, float]
    nameless: tuple[float, ...]


def search_levels(
    steps: Sequence[Step],
    final: Estimate,
    rounds: Sequence[ScoredRound],
    weighed: Sequence[Sequence[StochasticCandidate]],
) -> tuple[Level, ...]:
    """What a search weighed at each of its fits.

    `weighed`: effects without a fixed shape, and shapes without a name, at the fit before each step
    and after the last.
    """
    scored = {id(r.estimate): r.candidates for r in rounds}
    estimates = [*(step.before for step in steps), final]
    levels, log_evidence = [], 0.0
    for i, (estimate, at) in enumerate(zip(estimates, weighed, strict=True)):
        one_more = {c.effect: c.log_bayes_factor for c in scored.get(id(estimate), ())}
        one_more |= {c.effect: c.log_bayes_factor for c in at if c.effect}
        if i < len(steps):
            # Refitted: better than to first order.
            one_more |= dict(steps[i].compared) | {steps[i].added: steps[i].log_bayes_factor}
        shapes = tuple(c.log_bayes_factor for c in at if not c.effect)
        names = tuple(step.added for step in steps[:i])
        levels.append(Level(names, log_evidence, one_more, shapes))
        log_evidence += steps[i].log_bayes_factor if i < len(steps) else 0.0
    return tuple(levels)


def with_shapes(
    levels: Sequence[Level], shapes: Sequence[Sequence[NamelessShape]]
) -> tuple[Level, ...]:
    """The levels of a search with all shapes without a name that were weighed."""
    known = [tuple(shape.log_bayes_factor for shape in at) for at in shapes]
    first = [level._replace(nameless=at) for level, at in zip(levels, known, strict=False)]
    return (*first, *levels[len(first) :])


def hypotheses(
    levels: Sequence[Level],
    steps: Sequence[Step],
    p_value: float,
    candidates: int,
    rules: Rules,
) -> tuple[Hypothesis, ...]:
    """Weigh all that a search has seen.

    Returns: most probable first; the probabilities add up to one.

    Examples
    --------
    >>> level = Level((), 0.0, {"wheel_command_lag": 12.0, "wheel_friction": 9.0}, (2.0,))
    >>> rows = hypotheses([level], [], 0.5, 2, Rules(evidence_temperature=1.0))
    >>> [(row.kind, row.effects, round(row.probability, 2)) for row in rows[:2]]
    [('effects', ('wheel_command_lag',), 0.95), ('effects', ('wheel_friction',), 0.05)]
    """
    sets = _sets(levels, steps)
    final = tuple(step.added for step in steps)
    nameless = [
        (len(level.effects) + 1, level.log_evidence + _average(level.nameless))
        for level in levels
        if level.nameless
    ]
    nameless.append((len(final) + 1, sets[final] + log_evidence_of(p_value)))
    beforehand = partial(log_prior_of_set, members=candidates + 1)
    rows = [
        Hypothesis("effects" if names else "nothing", names, beforehand(len(names)), value)
        for names, value in sets.items()
    ]
    rows = sorted(rows, key=lambda row: -(row.log_prior + row.log_evidence))
    nothing = [row for row in rows if row.kind == "nothing"]
    named = [row for row in rows if row.kind == "effects"]
    listed = [*nothing, *named[:_LISTED]]
    if named[_LISTED:]:
        listed.append(_together("others", named[_LISTED:]))
    shapes = [Hypothesis("nameless", (), beforehand(size), value) for size, value in nameless]
    return _normalised([*listed, _together("nameless", shapes)], rules.evidence_temperature)


def _sets(levels: Sequence[Level], steps: Sequence[Step]) -> dict[tuple[str, ...], float]:
    """Log evidence of every set of effects, against nothing."""
    weighed: dict[frozenset[str], tuple[tuple[str, ...], float]] = {}
    for level in levels:
        for name, value in level.one_more.items():
            names = (*level.effects, name)
            weighed.setdefault(frozenset(names), (names, level.log_evidence + value))
    for level in levels:
        weighed[frozenset(level.effects)] = (level.effects, level.log_evidence)
    final = tuple(step.added for step in steps)
    claimed = sum(step.log_bayes_factor for step in steps)
    weighed[frozenset(final)] = (final, claimed)
    for i, step in enumerate(steps):
        for other in step.alternatives:
            kept = (name for name in final[i + 1 :] if name not in other.replaces)
            names = (*final[:i], other.effect, *other.beside, *kept)
            value = claimed + other.log_bayes_factor - step.log_bayes_factor
            weighed.setdefault(frozenset(names), (names, value))
    return dict(weighed.values())


def log_evidence_of(p_value: float) -> float:
    """Bound the log evidence against a hypothesis by the p-value of a test of it.

    Returns: -log(-e p log p); 0 for p above 1/e.

    Examples
    --------
    >>> round(log_evidence_of(1e-4), 2), log_evidence_of(0.5)
    (5.99, 0.0)
    """
    p = max(p_value, _LEAST_P_VALUE)
    return float(-np.log(-math.e * p * np.log(p))) if p < 1.0 / math.e else 0.0


def _average(values: Sequence[float]) -> float:
    return float(logsumexp(values) - np.log(len(values)))


def _together(kind: Literal["nameless", "others"], rows: Sequence[Hypothesis]) -> Hypothesis:
    """Several hypotheses as one."""
    prior = float(logsumexp([row.log_prior for row in rows]))
    joint = float(logsumexp([row.log_prior + row.log_evidence for row in rows]))
    return Hypothesis(kind, (), prior, joint - prior)


def _normalised(rows: Sequence[Hypothesis], temperature: float) -> tuple[Hypothesis, ...]:
    weights = np.array([row.log_prior + row.log_evidence / temperature for row in rows])
    probabilities = np.exp(weights - logsumexp(weights))
    probabilities /= probabilities.sum()
    kept = [replace(r, probability=float(p)) for r, p in zip(rows, probabilities, strict=True)]
    return tuple(sorted(kept, key=lambda row: -row.probability))
