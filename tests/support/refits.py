"""Rounds of a search and refits with one effect more, without the search itself."""

from __future__ import annotations

from bayes_inertia.diagnosis.candidates import ranked_candidates, score_candidates
from bayes_inertia.diagnosis.refitting import ScoredRound, refit


def scored(estimate) -> ScoredRound:
    """All candidates at an estimate; none is significant or not."""
    tests = score_candidates(estimate)
    return ScoredRound(estimate, tests, ranked_candidates(tests), 1.0, None)


def refitted(estimate, effect: str):
    """The fit with one effect more."""
    begun = scored(estimate)
    (candidate,) = (c for c in begun.candidates if c.effect == effect)
    return refit(begun, candidate)
