"""Effects that a later one makes needless: they are dropped from the steps of a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from bayes_inertia.diagnosis.candidates import score_candidates
from bayes_inertia.diagnosis.evidence import log_bayes_factor
from bayes_inertia.diagnosis.result import AlternativeEffect, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import without_effect
from bayes_inertia.maths.linear_algebra import VISIBLE
from bayes_inertia.physics.effects import FlexibleMode

_NEEDLESS_P_VALUE = 0.01  # of the fitted amplitudes, above which an effect is needless


def drop_needless(
    steps: Sequence[Step], flexible_mode: FlexibleMode | None, rules: Rules
) -> list[Step]:
    """Drop effects, other than the newest, that the fit can do without.

    Parameters
    ----------
    steps : sequence of Step
        What was added, in order.
    flexible_mode : FlexibleMode or None
        The candidate that has a model of its own.
    rules : Rules
        The thresholds.

    Returns
    -------
    list of Step
        The steps that remain, as if the others had not been taken.
    """
    kept = list(steps)
    i = 0
    while i < len(kept) - 1:
        if is_needless(kept[-1].after, kept[i].added):
            kept = _without_step(kept, i, flexible_mode, rules)
        else:
            i += 1
    return kept


def is_needless(estimate: Estimate, effect: str) -> bool:
    """Test whether the amplitudes fitted for an effect are within their noise (Wald's test).

    Only directions that the campaign can see count.

    Parameters
    ----------
    estimate : Estimate
        A fit with the effect.
    effect : str
        Its name.

    Returns
    -------
    bool
        Whether the fit can do without it.
    """
    space = estimate.model.space
    part = space.slice_of(effect)
    amplitudes = np.arange(space.size)[part][[not p.logarithmic for p in space.priors[part]]]
    sd = space.sd[amplitudes]
    amplitude = (estimate.theta - space.nulls)[amplitudes] / sd
    covariance = estimate.covariance[np.ix_(amplitudes, amplitudes)] / np.outer(sd, sd)
    precision = np.linalg.inv(covariance)
    powers, directions = np.linalg.eigh(precision - np.eye(len(amplitudes)))
    visible = powers > VISIBLE
    along = directions[:, visible].T @ precision @ amplitude
    chi2 = np.sum(along**2 / powers[visible])
    return bool(stats.chi2.sf(chi2, max(visible.sum(), 1)) > _NEEDLESS_P_VALUE)


def _without_step(
    steps: list[Step], i: int, flexible_mode: FlexibleMode | None, rules: Rules
) -> list[Step]:
    """The search as if step i had not been taken.

    Its effect stays beside the next one, if it explains the data about as well and is alike.
    """
    dropped, kept, before = steps[i], list(steps[:i]), steps[i].before
    for step in steps[i + 1 :]:
        after = without_effect(step.after, dropped.added)
        evidence = log_bayes_factor(before, after, step.added)
        kept.append(replace(step, before=before, after=after, log_bayes_factor=evidence))
        before = after
    tests, successor = score_candidates(dropped.before, flexible_mode), kept[i]
    correlation = tests.correlation_between(successor.added, dropped.added)
    least = successor.log_bayes_factor - rules.log_evidence_margin
    if correlation > rules.imitation_correlation and dropped.log_bayes_factor > least:
        beside = AlternativeEffect(
            dropped.added, dropped.after, dropped.log_bayes_factor, correlation
        )
        alternatives = (beside, *successor.alternatives)[: rules.max_alternatives]
        kept[i] = replace(successor, alternatives=alternatives)
    return kept
