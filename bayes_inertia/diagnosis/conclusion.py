"""From the steps of a search to the verdict: named, ambiguous, consistent or unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.diagnosis.candidates import FLEXIBLE_MODE
from bayes_inertia.diagnosis.hypotheses import Level, hypotheses, with_shapes
from bayes_inertia.diagnosis.nameless import (
    ambiguous_sets,
    nameless_rival,
    nameless_shapes,
    names_may_imitate,
)
from bayes_inertia.diagnosis.refitting import ScoredRound
from bayes_inertia.diagnosis.result import (
    Candidate,
    Diagnosis,
    Step,
)
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.score_test import ScoreTests
from bayes_inertia.diagnosis.stochastic_contest import as_candidates
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.residual_tests import ChannelTest, channel_tests
from bayes_inertia.inference.rounding import has_one_error, rounding_steps
from bayes_inertia.physics.effect import Effect


class Outcome(NamedTuple):
    """What a search came to.

    Parameters
    ----------
    first : ScoredRound
        All candidates, scored at the fit with nothing added.
    levels : tuple of Level
        What was weighed at each fit.
    steps : tuple of Step
        What was added.
    final : Estimate
        The fit with everything added.
    displaced : tuple of Effect
        What had been added and gave way to an effect without a fixed shape.
    """

    first: ScoredRound
    levels: tuple[Level, ...]
    steps: tuple[Step, ...]
    final: Estimate
    displaced: tuple[Effect, ...] = ()


def conclude(
    outcome: Outcome,
    noise: dict[str, float],
    skipped: tuple[tuple[str, str], ...],
    rules: Rules,
) -> Diagnosis:
    """Reach the verdict.

    `noise`: factor by which each channel's noise exceeds what is stated.
    """
    first, final = outcome.first, outcome.final
    tests, candidates = final_tests(final), _all_candidates(first)
    shapes = nameless_shapes(outcome.steps)
    levels = with_shapes(outcome.levels, shapes)
    rival = nameless_rival(outcome.steps, len(candidates), shapes)
    lead = rival.log_bayes_factor
    beaten = lead > rules.log_evidence_margin or names_may_imitate(outcome.steps, rules)
    why_unknown = _why_unknown(beaten, is_explained(tests, rules))
    steps = without_named_alternatives(outcome.steps)
    sets = ambiguous_sets(steps, rules, rival)
    named = tuple(s.added for s in steps)
    verdict = _verdict(why_unknown, sets, named)
    return Diagnosis(
        verdict=verdict,
        named=() if why_unknown else named,
        ambiguous_with=sets if verdict == "ambiguous" else (),
        candidates=candidates,
        threshold=first.threshold,
        steps=steps,
        base=first.estimate,
        final=final,
        noise=noise,
        tests=tests,
        rules=rules,
        skipped=skipped,
        correlations=_correlations(first.tests),
        why_unknown=why_unknown,
        nameless_lead=lead,
        nameless_source=rival.source,
        nameless_instead_of=rival.instead_of,
        displaced=outcome.displaced,
        hypotheses=hypotheses(levels, steps, lowest_p_value(tests), len(candidates), rules),
    )


def _all_candidates(first: ScoredRound) -> tuple[Candidate, ...]:
    """Those of the library and those without a fixed shape, best evidence first."""
    rows = (*first.candidates, *as_candidates(first.stochastic))
    return tuple(sorted(rows, key=lambda row: -row.log_bayes_factor))


def _why_unknown(beaten: bool, explained: bool) -> str:
    if not explained:
        return "misfit"
    return "imitation" if beaten else ""


def _verdict(why_unknown: str, sets: Sequence[Sequence[str]], named: Sequence[str]) -> str:
    if why_unknown:
        return "unknown"
    if sets:
        return "ambiguous"
    return "named" if named else "consistent"


def without_named_alternatives(steps: Sequence[Step]) -> tuple[Step, ...]:
    """Take effects that were named too out of the alternatives.

    What is needed beside another effect is no alternative to it.

    Returns: the same steps; no alternative is among the effects added.
    """
    added = {step.added for step in steps}
    return tuple(
        replace(s, alternatives=tuple(a for a in s.alternatives if a.effect not in added))
        for s in steps
    )


def _correlations(tests: ScoreTests) -> dict[tuple[str, str], float]:
    """Canonical correlations of all pairs of linear candidates."""
    return {
        (a, b): tests.canonical_correlation(i, j)
        for i, a in enumerate(tests.names)
        for j, b in enumerate(tests.names)
        if i < j and FLEXIBLE_MODE not in (a, b)
    }


def final_tests(estimate: Estimate) -> dict[str, ChannelTest]:
    """Test the residuals against the noise as used: stated noise times what was measured of it."""
    scale = np.sqrt(estimate.discount)
    tested, info = estimate.tested_residuals, estimate.information
    series = {
        c: [s * x for s, x in zip(scale[:, i], tested.series[c], strict=True)]
        for i, c in enumerate(CHANNELS)
    }
    # Slews of one noise are added before they are scaled, as they always were.
    relative = estimate.discount / estimate.discount[0]
    chi2 = (tested.chi2 * relative).sum(0) * scale[0] ** 2
    dof = info.n_data.sum(0) - tested.parameters
    steps = rounding_steps(estimate.model.campaign)
    largest = dict(zip(CHANNELS, scale.max(0), strict=True))
    rounded = [c for c, of_components in steps.items() if has_one_error(largest[c] * of_components)]
    return channel_tests(series, chi2, dof, rounded)


def is_explained(tests: dict[str, ChannelTest], rules: Rules) -> bool:
    """Test whether nothing is left in the residuals that noise would not leave."""
    return min(_p_values(tests), default=1.0) > rules.misfit_p_value


def lowest_p_value(tests: dict[str, ChannelTest]) -> float:
    """The lowest p-value of all tests of the residuals, corrected for their number (Sidak).

    Examples
    --------
    >>> lowest_p_value({"rate": ChannelTest(1.2, (0.9, 1.1), 0.01, 0.5)}) < 0.02
    True
    """
    p_values = _p_values(tests)
    return float(-np.expm1(len(p_values) * np.log1p(-min([*p_values, 1.0 - 1e-16]))))


def _p_values(tests: dict[str, ChannelTest]) -> list[float]:
    """Of residuals that are not smaller than the noise, and of all for structure."""
    large = [
        t.p_chi2
        for t in tests.values()
        if t.p_chi2 is not None and t.reduced_chi2 is not None and t.reduced_chi2 > 1.0
    ]
    return large + [t.p_white for t in tests.values() if t.p_white is not None]
