"""Candidates refitted in full: the effect with the best evidence, and others that match it.

First-order scores say which candidates are promising. Those few are refitted and compared by their
evidence. What the data cannot tell apart from the best stays beside it as an alternative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_inertia.diagnosis.evidence import COMPARISON_TOLERANCE, log_bayes_factor
from bayes_inertia.diagnosis.flexible_mode_search import FlexibleModeCandidate, theta_with_mode
from bayes_inertia.diagnosis.result import AlternativeEffect, Candidate, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.score_test import ScoreTests
from bayes_inertia.diagnosis.stochastic_candidates import StochasticCandidate
from bayes_inertia.diagnosis.wide_prior import within_prior
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.maths.at_once import at_once
from bayes_inertia.physics.effects import FlexibleMode
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.progress import Progress, silent

# By how much log evidence to first order may be wrong.
_FIRST_ORDER_ERROR = 2.0
_MAX_AMPLITUDE = 10.0  # [prior sd] of an effect at the start of its refit


@dataclass(frozen=True)
class ScoredRound:
    """One round of the search: all candidates scored at one estimate.

    Parameters
    ----------
    estimate : Estimate
        The fit that the candidates are to be added to.
    tests : ScoreTests
        The score tests of all candidates there.
    candidates : tuple of Candidate
        The same as a list, best evidence first.
    threshold : float
        p-value below which a candidate is significant.
    flexible_mode : FlexibleMode or None
        The candidate that has a model of its own.
    stochastic : tuple of StochasticCandidate
        Effects without a fixed shape, and shapes without a name.
    """

    estimate: Estimate
    tests: ScoreTests
    candidates: tuple[Candidate, ...]
    threshold: float
    flexible_mode: FlexibleMode | None
    stochastic: tuple[StochasticCandidate, ...] = ()


@dataclass(frozen=True)
class Refit:
    """A candidate refitted.

    Parameters
    ----------
    effect : str
        Its name.
    estimate : Estimate
        The fit with it.
    log_bayes_factor : float
        Log evidence for this fit against the one without the effect.
    p_value : float
        Probability of such a gain of chi^2 if the effect is absent.
    """

    effect: str
    estimate: Estimate
    log_bayes_factor: float
    p_value: float


def best_step(
    scored: ScoredRound, dropped: set[str], rules: Rules, say: Progress = silent
) -> Step | None:
    """Refit the most promising significant candidates and take the one with the best evidence.

    `dropped`: effects that were found needless before and are not tried again. Returns: the effect
    added, with its alternatives; None if no candidate is needed.
    """
    remaining = [c for c in scored.candidates if c.effect not in dropped]
    refits = _refitted(scored, _promising(remaining, scored.threshold, rules), rules, say)
    needed = _by_evidence(
        r for r in refits if r.log_bayes_factor > 0.0 and r.p_value < scored.threshold
    )
    if not needed:
        return None
    if not scored.estimate.model.campaign.has_tachometers:
        needed = _by_evidence(_refit_from_afar(scored, r) for r in needed[:2]) + needed[2:]
    # Brought to its end only now. It keeps the weight that it had beside the others: in the
    # measured drive the noise follows J.
    fit = needed[0].estimate
    best = replace(needed[0], estimate=re_estimate(fit, fit.theta, fit.free))
    needed_names = {r.effect for r in needed}
    others = needed[1:] + [r for r in refits if r.effect not in needed_names]
    refitted = {r.effect for r in refits}
    untried = [c for c in remaining if c.effect not in refitted]
    others += _refitted(scored, _imitations(scored.tests, best, untried, rules), rules, say)
    return Step(
        best.effect,
        scored.estimate,
        best.estimate,
        best.log_bayes_factor,
        _alternatives(scored.tests, best, others, rules),
        compared=tuple((r.effect, r.log_bayes_factor) for r in others),
    )


def _refitted(
    scored: ScoredRound, candidates: Sequence[Candidate], rules: Rules, say: Progress
) -> list[Refit]:
    """Candidates refitted, two at a time: compiled code needs no interpreter lock."""
    if candidates:
        say(f"refitting with {', '.join(c.effect for c in candidates)}", 0, 0)
    return at_once([partial(refit, scored, candidate, rules) for candidate in candidates])


def refit(scored: ScoredRound, candidate: Candidate, rules: Rules) -> Refit:
    """Fit one candidate more, begun at its first-order amplitude.

    `scored`: the fit without it, and the score tests there. `rules`: how far from its prior an
    effect may lie before that is widened.
    """
    mode = scored.tests.nonlinear.get(candidate.effect)
    if isinstance(mode, FlexibleModeCandidate) and scored.flexible_mode is not None:
        fitted = _with_mode(scored.estimate, scored.flexible_mode, mode)
        fitted = within_prior(fitted, candidate.effect, rules, tolerance=COMPARISON_TOLERANCE)
        return _weighed(scored, candidate.effect, fitted)
    estimate, space = scored.estimate, scored.estimate.model.space
    part = space.slice_of(candidate.effect)
    amplitude = scored.tests.amplitude(scored.tests.names.index(candidate.effect))
    theta = estimate.theta.copy()
    theta[part] += np.clip(amplitude, -_MAX_AMPLITUDE, _MAX_AMPLITUDE) * space.sd[part]
    inset = 1e-3 * space.sd[part]
    theta[part] = np.clip(theta[part], space.lower[part] + inset, space.upper[part] - inset)
    free = np.concatenate([estimate.free, np.arange(part.start, part.stop)])
    fitted = re_estimate(estimate, theta, free, tolerance=COMPARISON_TOLERANCE)
    fitted = within_prior(fitted, candidate.effect, rules, tolerance=COMPARISON_TOLERANCE)
    return _weighed(scored, candidate.effect, fitted)


def _promising(
    candidates: Sequence[Candidate], threshold: float, rules: Rules
) -> Sequence[Candidate]:
    """Significant candidates whose evidence is not far below the best one's."""
    significant = [c for c in candidates if c.p_value < threshold]
    promising = [
        c
        for c in significant
        if c is significant[0]
        or c.log_bayes_factor >= rules.refit_share * significant[0].log_bayes_factor
    ]
    return promising[: rules.max_refits]


def _by_evidence(refits) -> list[Refit]:
    return sorted(refits, key=lambda r: -r.log_bayes_factor)


def _weighed(scored: ScoredRound, effect: str, fitted: Estimate) -> Refit:
    """A refit with its evidence and the p-value of what it gains."""
    gain = 2.0 * (scored.estimate.objective - fitted.objective)
    k = scored.tests.names.index(effect)
    return Refit(
        effect,
        fitted,
        log_bayes_factor(scored.estimate, fitted, effect),
        float(scored.tests.p_value(k, np.asarray(max(gain, 0.0)))),
    )


def _refit_from_afar(scored: ScoredRound, first: Refit) -> Refit:
    """A refit begun once more from afar, if it gained less than to first order.

    Where nothing measures the wheels' momentum there are local optima.
    """
    gain = 2.0 * (scored.estimate.objective - first.estimate.objective)
    score = float(scored.tests.score(scored.tests.names.index(first.effect)))
    if gain > score - _FIRST_ORDER_ERROR:
        return first
    fitted = re_estimate(
        first.estimate,
        first.estimate.theta,
        first.estimate.free,
        weak_data_first=True,
        tolerance=COMPARISON_TOLERANCE,
    )
    if fitted.objective > first.estimate.objective:
        return first
    return _weighed(scored, first.effect, fitted)


def _with_mode(
    estimate: Estimate, flexible_mode: FlexibleMode, candidate: FlexibleModeCandidate
) -> Estimate:
    """The fit with a flexible mode, begun at the coupling that is best to first order."""
    model = estimate.model
    mode = replace(flexible_mode, frequency=_power_of_two(candidate.frequency))
    larger = Model(model.campaign, (*model.effects, mode), model.structure.drive)
    start = move_to(estimate, larger)
    part = larger.space.slice_of(candidate.name)
    return re_estimate(
        start,
        theta_with_mode(start, candidate),
        np.concatenate([start.free, np.arange(part.start, part.stop)]),
        tolerance=COMPARISON_TOLERANCE,
    )


def _power_of_two(frequency: float) -> float:
    """The nearest power of two [Hz], the prior's median: fits of many campaigns share its code."""
    return float(2.0 ** np.round(np.log2(frequency)))


def _imitations(
    tests: ScoreTests, best: Refit, candidates: Sequence[Candidate], rules: Rules
) -> list[Candidate]:
    """Candidates that could imitate the best about as well: two at most.

    They need not be significant alone: that something is there is known from the best.
    """
    least = max(best.log_bayes_factor - rules.log_evidence_margin, 0.0) - _FIRST_ORDER_ERROR
    imitations = [
        c
        for c in candidates
        if c.log_bayes_factor > least
        and tests.correlation_between(best.effect, c.effect) > rules.imitation_correlation
    ]
    return imitations[: rules.max_alternatives]


def _alternatives(
    tests: ScoreTests, best: Refit, others: Sequence[Refit], rules: Rules
) -> tuple[AlternativeEffect, ...]:
    """Effects that explain the data nearly as well as the best and can imitate it."""
    least = max(best.log_bayes_factor - rules.log_evidence_margin, 0.0)
    alternatives = []
    for other in _by_evidence(others):
        correlation = tests.correlation_between(best.effect, other.effect)
        if other.log_bayes_factor > least and correlation > rules.imitation_correlation:
            alternatives.append(
                AlternativeEffect(other.effect, other.estimate, other.log_bayes_factor, correlation)
            )
    return tuple(alternatives[: rules.max_alternatives])
