"""Effects without a fixed shape against the effects that a search has added, on equal terms.

Each hypothesis is the first so many effects of the search, with or without one effect that has no
fixed shape beside them. Its log evidence is the sum of what its effects claim, less what each
further one costs (`prior_of_sets`). The best is kept; what cannot be told from it stays beside it.
Where a shape without a name explains the data as well or better, `conclusion` says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_inertia.diagnosis.needless_steps import without_needless_steps
from bayes_inertia.diagnosis.prior_of_sets import cost_of_further
from bayes_inertia.diagnosis.random_refits import instances, with_stochastic
from bayes_inertia.diagnosis.refitting import ScoredRound
from bayes_inertia.diagnosis.result import AlternativeEffect, Candidate, NamelessShape, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.stochastic_candidates import (
    StochasticCandidate,
    stochastic_candidates,
)
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths.at_once import at_once
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# Of signals rather than of named effects there is no correlation.
_NOT_COMPARED = float("nan")


@dataclass(frozen=True)
class Contest:
    """What effects without a fixed shape make of the steps of a search.

    Parameters
    ----------
    steps : tuple of Step
        The steps that remain, and at most one more.
    final : Estimate
        The fit after them.
    weighed : tuple of tuples of StochasticCandidate
        At the fit before each step of the search and after the last.
    displaced : tuple of Effect
        What the search had added where the effect without a fixed shape stands now.
    """

    steps: tuple[Step, ...]
    final: Estimate
    weighed: tuple[tuple[StochasticCandidate, ...], ...]
    displaced: tuple[Effect, ...] = ()


def contest(
    steps: Sequence[Step],
    final: Estimate,
    rounds: Sequence[ScoredRound],
    effects: Sequence[StochasticEffect],
    rules: Rules,
) -> Contest:
    """Weigh effects without a fixed shape against the steps of a search, and refit the winner.

    `rounds`: the rounds of the search; estimates that were scored there are not weighed again.
    """
    known = {id(r.estimate): r.stochastic for r in rounds}
    levels = [*(step.before for step in steps), final]
    weighed = tuple(
        known[id(e)] if id(e) in known else stochastic_candidates(e, effects) for e in levels
    )
    kept = tuple(
        replace(step, nameless=_nameless(at)) for step, at in zip(steps, weighed, strict=False)
    )
    best = [next((c for c in at if c.effect), None) for at in weighed]
    evidence = standing(best, rounds[0].threshold)
    claims = [step.log_bayes_factor for step in kept]
    members = len(rounds[0].candidates) + len(effects) + 1
    k, lead = best_level(claims, evidence, members)
    near = best[k]
    step = _named(levels[k], weighed[k], effects, rules) if lead > 0.0 else None
    if step is not None:
        before, step = without_needless_steps(kept[:k], step, weighed, members)
        if before < k:
            step = replace(step, nameless=_nameless(weighed[before]))
        else:
            step = _with_displaced_as_alternatives(step, kept[k:], lead, rules)
        fitted = instances(final.model.effects)
        displaced = tuple(fitted[s.added] for s in kept[before:])
        return Contest((*kept[:before], step), step.after, weighed, displaced)
    if near and k < len(kept) and -rules.log_evidence_margin < lead <= 0.0:
        least = near.log_bayes_factor - lead - rules.log_evidence_margin
        rivals = [c for c in weighed[k] if c.effect and c.log_bayes_factor > least]
        others = _alternatives(levels[k], rivals[: rules.max_alternatives], effects)
        if others:
            kept = (*kept[:k], *_with_common_alternatives(kept[k:], others, lead, rules))
    return Contest(kept, final, weighed)


def _with_displaced_as_alternatives(
    step: Step, displaced: Sequence[Step], lead: float, rules: Rules
) -> Step:
    """An effect without a fixed shape, with the steps that it hardly beats as alternatives."""
    margin = rules.log_evidence_margin
    if displaced and abs(step.log_bayes_factor - displaced[0].log_bayes_factor) < margin:
        step = _with_alternative(step, _as_alternative(displaced[0]), rules)
    if len(displaced) < 2 or lead > margin:
        return step
    first, *others = (s.added for s in displaced)
    weight = step.log_bayes_factor - lead
    together = AlternativeEffect(
        first, displaced[-1].after, weight, _NOT_COMPARED, beside=tuple(others)
    )
    return _with_alternative(step, together, rules)


def _with_common_alternatives(
    steps: Sequence[Step], others: Sequence[AlternativeEffect], lead: float, rules: Rules
) -> tuple[Step, ...]:
    """Steps that effects without a fixed shape hardly lose to, with these as their alternatives.

    `lead` is that of the first of them. It stays in the set; the others stand behind what explains
    the data better.
    """
    first, *later = steps
    replaced = tuple(s.added for s in later)
    gap = first.log_bayes_factor + lead - others[0].log_bayes_factor
    best, *further = (
        replace(other, log_bayes_factor=other.log_bayes_factor + gap, replaces=replaced)
        for other in others
    )
    ranked = sorted((*first.alternatives, *further), key=lambda a: -a.log_bayes_factor)
    return (_with_alternative(replace(first, alternatives=tuple(ranked)), best, rules), *later)


def _with_alternative(step: Step, alternative: AlternativeEffect, rules: Rules) -> Step:
    """A step that what explains the data about as well stands beside."""
    return replace(step, alternatives=(alternative, *step.alternatives)[: rules.max_alternatives])


def _as_alternative(step: Step) -> AlternativeEffect:
    """What a step added, as what could be there instead."""
    return AlternativeEffect(step.added, step.after, step.log_bayes_factor, _NOT_COMPARED)


def standing(best: Sequence[StochasticCandidate | None], threshold: float) -> list[float]:
    """What the best effect without a fixed shape is worth after each number of steps.

    Where the search added a step something is missing for sure, and what could be there instead
    needs no significance of its own. After the last step it does.

    `best`: at the fit before each step and after the last. `threshold`: of the p-value, for an
    effect that nothing else speaks for. Returns: log evidence; -inf where the effect does not
    count.

    Examples
    --------
    >>> weak = StochasticCandidate("rate_random_walk", "rate sensor", 5.0)
    >>> standing([weak], 1e-3), standing([weak, weak], 1e-3)
    ([-inf], [5.0, -inf])
    """
    last = len(best) - 1
    return [
        c.log_bayes_factor
        if c is not None and (k < last or c.p_value < threshold)
        else -float("inf")
        for k, c in enumerate(best)
    ]


def best_level(
    claims: Sequence[float], evidence: Sequence[float], members: int
) -> tuple[int, float]:
    """After how many steps one effect without a fixed shape is best added.

    `claims`: log evidence of the n steps of a search, each against the fit before it. `evidence`:
    log evidence of the best effect without a fixed shape, against the fit before each step and
    after the last; -inf where none is significant. `members`: how many there were to choose from;
    "no name" is one of them. Returns `level`: steps that are kept before it; `lead`: log evidence
    by which this beats the n steps alone.

    Examples
    --------
    A torque of 30 against a random walk of 20, which adds nothing once the torque is known:

    >>> best_level([30.0], [20.0, -np.inf], 25)
    (0, -10.0)
    """
    totals = [
        sum(claims[:k]) + of_level - cost_of_further(0, k + 1, members)
        for k, of_level in enumerate(evidence)
    ]
    level = int(np.argmax(totals))
    alone = sum(claims) - cost_of_further(0, len(claims), members)
    return level, float(totals[level] - alone)


def as_candidates(weighed: Sequence[StochasticCandidate]) -> tuple[Candidate, ...]:
    """The rows of effects without a fixed shape among those of the library.

    Returns: their degrees of freedom are the parameters, their score is twice the log evidence.
    """
    return tuple(
        Candidate(
            effect=c.effect,
            dof=len(c.start),
            score=max(2.0 * c.log_bayes_factor, 0.0),
            p_value=c.p_value,
            log_bayes_factor=c.log_bayes_factor,
        )
        for c in weighed
        if c.effect
    )


def _nameless(weighed: Sequence[StochasticCandidate]) -> tuple[NamelessShape, ...]:
    return tuple(NamelessShape(c.source, c.log_bayes_factor) for c in weighed if not c.effect)


def _named(
    before: Estimate,
    weighed: Sequence[StochasticCandidate],
    effects: Sequence[StochasticEffect],
    rules: Rules,
) -> Step | None:
    """The step that adds the best effect without a fixed shape, with what could be it as well.

    None if no motion can be computed with it at the fit before.
    """
    if all(c.effect for c in weighed):
        weighed = stochastic_candidates(before, effects)
    first, *others = (c for c in weighed if c.effect)
    least = first.log_bayes_factor - rules.log_evidence_margin
    rivals = [c for c in others if c.log_bayes_factor > least][: rules.max_alternatives]
    found = _alternatives(before, [first, *rivals], effects)
    if not found or found[0].effect != first.effect:
        return None
    best, *alternatives = found
    return Step(
        first.effect,
        before,
        best.estimate,
        first.log_bayes_factor,
        tuple(alternatives),
        stochastic=True,
        nameless=_nameless(weighed),
    )


def _alternatives(
    before: Estimate,
    candidates: Sequence[StochasticCandidate],
    effects: Sequence[StochasticEffect],
) -> list[AlternativeEffect]:
    """Fits with each of several candidates more, if they have an end.

    A model of fewer effects takes longer integration steps: what an absurd fit made of a mode or a
    lag may overflow there.
    """
    known = instances(effects)
    fits = at_once([partial(with_stochastic, before, known[c.effect], c.start) for c in candidates])
    return [
        AlternativeEffect(c.effect, fitted, c.log_bayes_factor, _NOT_COMPARED)
        for c, fitted in zip(candidates, fits, strict=True)
        if np.isfinite(fitted.objective)
    ]
