"""What is missing in the model: add effects one by one, until none is significant.

Forward search with re-linearisation: at the current fit every candidate effect is scored at once
(`score_test`). The family-wise threshold comes from simulating the joint distribution of all
scores. The best few are refitted in full and compared by evidence (`refitting`). What the data
cannot tell apart is reported as a set. Effects that a later one makes needless are dropped again
(`pruning`). Effects without a fixed shape compete with what was added (`stochastic_contest`). What
remains unexplained is called unknown (`conclusion`).

Effects that a later one makes needless: they are dropped from the steps of a search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from bayes_inertia.campaign.block_means import without_surplus_rows
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.candidates import (
    CandidateEffects,
    candidate_effects,
    ranked_candidates,
    score_candidates,
)
from bayes_inertia.diagnosis.clean_start import (
    CleanStart,
    at_measured_level,
    clean_start,
    measured_again,
)
from bayes_inertia.diagnosis.conclusion import Outcome, conclude
from bayes_inertia.diagnosis.evidence import log_bayes_factor
from bayes_inertia.diagnosis.hypotheses import search_levels
from bayes_inertia.diagnosis.refitting import ScoredRound, best_step
from bayes_inertia.diagnosis.result import AlternativeEffect, Diagnosis, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.score_test import unfitted
from bayes_inertia.diagnosis.stochastic_candidates import (
    STOCHASTIC_CANDIDATES,
    p_values_decide,
    stochastic_candidates,
    with_p_values,
)
from bayes_inertia.diagnosis.stochastic_contest import contest
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import without_effect
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.maths.linear_algebra import VISIBLE
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, FlexibleMode
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.stochastic_effect import StochasticEffect
from bayes_inertia.progress import Progress, silent

_MAX_NOISE_ROUNDS = 3
# As how many tests all effects without a fixed shape count together: their p-values are of the
# largest Bayes factor of all, or bounds of that.
_RANDOM_TESTS = 1


@on_one_blas_thread
def diagnose(
    campaign: Campaign,
    *,
    library: Sequence[Effect] = LIBRARY,
    stochastic: Sequence[StochasticEffect] = STOCHASTIC_CANDIDATES,
    drive: Drive | None = None,
    rules: Rules | None = None,
    seed: int = 0,
    as_stated: bool = False,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find where model and data disagree, and which effects explain it.

    Parameters
    ----------
    campaign : Campaign
        What was flown. Of slews with thousands of rows block means are taken.
    library : sequence of Effect
        Candidate effects; instances of your own may be among them.
    stochastic : sequence of StochasticEffect
        Candidates without a fixed shape. The first parameter of each scales its signal.
    drive : {"commanded", "measured"}, optional
        What drives the model: torque commands or tachometers. By default what the campaign allows.
    rules : Rules, optional
        Thresholds of the search; `Rules()` by default.
    seed : int
        Of the optimizer's starts and of the simulated thresholds.
    as_stated : bool
        Take the telemetry as it is: leave no outlier out, take no block means, and take the noise
        for white.
    progress : callable or None
        Called with (stage, done, of); `of` is 0 where a stage is not counted.

    Returns
    -------
    Diagnosis
        The verdict, the effects named, and every step that led there.

    Raises
    ------
    CampaignError
        If the campaign lacks what the drive needs.
    EstimateError
        If the base model cannot be fitted.
    EffectError
        If two candidates have one name.

    Examples
    --------
    It takes half a minute, so this is no doctest::

        diagnosis = diagnose(read_campaign("my_campaign"))
        diagnosis.verdict, diagnosis.named
        # ('named', ('wheel_command_lag',))
    """
    say = progress or silent
    if not as_stated:
        campaign = without_surplus_rows(campaign)
    own = [e for e in library if isinstance(e, StochasticEffect)]
    stochastic = tuple({e.name: e for e in (*stochastic, *own)}.values())
    library = [e for e in library if e not in own]
    rules, effects = rules or Rules(), candidate_effects(campaign, library)
    model = Model(campaign, effects.linear, drive)
    say("fitting J and K, measuring the noise", 0, 0)
    begin = clean_start(model, seed=seed, as_stated=as_stated, stochastic=stochastic)
    diagnosis = _diagnosed(begin, effects, stochastic, rules, seed, say)
    if diagnosis.verdict != "unknown" or diagnosis.treatment.colour is None:
        return diagnosis
    # What no effect explains beside correlated noise may be what looks like such noise.
    say("fitting J and K again, with white noise", 0, 0)
    begin = clean_start(model, seed=seed, coloured=False)
    return _diagnosed(begin, effects, stochastic, rules, seed, say)


def _diagnosed(
    begin: CleanStart,
    effects: CandidateEffects,
    stochastic: Sequence[StochasticEffect],
    rules: Rules,
    seed: int,
    say: Progress,
) -> Diagnosis:
    """The verdict of a search from a clean start."""
    rng = np.random.default_rng([seed, 3])
    rounds: list[ScoredRound] = []
    steps: list[Step] = []
    for rounds_left in reversed(range(_MAX_NOISE_ROUNDS)):
        if begin.estimate is begin.base:
            rounds, steps = [], []
        candidates = _Candidates(effects.flexible_mode, stochastic)
        steps, scored, final = _forward_search(begin.estimate, steps, candidates, rules, rng, say)
        rounds += scored
        say("measuring the noise again", 0, 0)
        # An effect's own jumps can look like noise: measure the noise again, without them.
        again = measured_again(begin, final, scored[-1].stochastic)
        # Steps and fit are of one noise: without time for another search its shape stays.
        if again is None or (again.estimate is again.base and not rounds_left):
            break
        begin, final = again, again.estimate
    say(f"trying {len(stochastic)} effects without a fixed shape", 0, 0)
    settled = contest(steps, final, rounds, stochastic, rules)
    say("weighing all answers", 0, 0)
    levels = search_levels(steps, final, rounds, settled.weighed)
    final = settled.final
    if settled.steps and settled.steps[-1].stochastic:
        begin, final = at_measured_level(begin, final)
    outcome = Outcome(rounds[0], levels, settled.steps, final, settled.displaced)
    diagnosis = conclude(outcome, dict(begin.noise), effects.skipped, rules)
    return replace(diagnosis, treatment=replace(begin.treatment, level=dict(begin.noise)))


class _Candidates(NamedTuple):
    """What is scored beside the linear candidates, which the model holds."""

    flexible_mode: FlexibleMode | None
    stochastic: Sequence[StochasticEffect]


def _forward_search(
    estimate: Estimate,
    steps: list[Step],
    candidates: _Candidates,
    rules: Rules,
    rng: np.random.Generator,
    say: Progress,
) -> tuple[list[Step], list[ScoredRound], Estimate]:
    """Add effects until none is significant: the steps, all rounds, and the last fit."""
    rounds: list[ScoredRound] = []
    dropped: set[str] = set()
    while True:
        say(_scoring(estimate, candidates), 0, 0)
        rounds.append(_score(estimate, candidates, rules, rng))
        full = len(steps) >= rules.max_effects
        step = None if full else best_step(rounds[-1], dropped, rules, say)
        if step is None:
            return steps, rounds, estimate
        say(f"testing what {step.added} makes needless", 0, 0)
        before = {s.added for s in steps}
        steps = drop_needless([*steps, step], candidates.flexible_mode, rules)
        estimate, dropped = steps[-1].after, dropped | (before - {s.added for s in steps})


def _scoring(estimate: Estimate, candidates: _Candidates) -> str:
    """The stage in which all candidates are scored."""
    held, mode = [e.name for e in estimate.model.effects], candidates.flexible_mode
    searched = mode is not None and mode.name not in held
    return f"scoring {len(unfitted(estimate)) + searched + len(candidates.stochastic)} effects"


def _score(
    estimate: Estimate, candidates: _Candidates, rules: Rules, rng: np.random.Generator
) -> ScoredRound:
    fit, response = estimate.linearised(), torque_response(estimate)
    effects, mode = candidates.stochastic, candidates.flexible_mode
    tests = score_candidates(estimate, mode, fit, response)
    threshold = tests.threshold(rules.false_alarm_probability, rng, further=_RANDOM_TESTS)
    ranked = ranked_candidates(tests)
    # Where nothing is significant nobody asks for what has no name.
    significant = any(c.p_value < threshold for c in ranked)
    weighed = stochastic_candidates(estimate, effects, fit, response, nameless=significant)
    if not significant and p_values_decide(weighed):
        weighed = with_p_values(weighed, effects, fit, response, rng.spawn(1)[0])
    return ScoredRound(estimate, tests, ranked, threshold, mode, weighed)


_NEEDLESS_P_VALUE = 0.01  # of the fitted amplitudes, above which an effect is needless


def drop_needless(
    steps: Sequence[Step], flexible_mode: FlexibleMode | None, rules: Rules
) -> list[Step]:
    """Drop effects, other than the newest, that the fit can do without.

    `flexible_mode`: the candidate that has a model of its own. Returns: the steps that remain, as
    if the others had not been taken.
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
