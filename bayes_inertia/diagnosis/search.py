"""What is missing in the model: everything that may be is weighed in one table, and it is read off.

Dirt is treated first (`clean_start`). At the fit without effects every set of effects of the
library, random signals and shapes without a name have their log evidence from one linear model
(`linear_system`, `hypothesis_table`); the best row is refitted, and all are weighed again around it
(`table_search`); the noise is measured again beside it, until it stays. A score test whose
threshold is simulated guards the rate of false alarms. Verdict, steps, J and K of every row are
read off there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp, softmax

from bayes_inertia.campaign.block_means import without_surplus_rows
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.candidates import CandidateEffects, candidate_effects
from bayes_inertia.diagnosis.clean_start import (
    CleanStart,
    at_measured_level,
    clean_start,
    holds_correlated_noise,
    log_evidence_of_noise,
    measured_again,
    with_correlated_noise,
    with_louder_noise,
)
from bayes_inertia.diagnosis.formulas import search_formulas
from bayes_inertia.diagnosis.hypothesis_table import Names
from bayes_inertia.diagnosis.limits import LIMITS, Rules, rules_of
from bayes_inertia.diagnosis.linear_system import LinearModel, linear_model
from bayes_inertia.diagnosis.quoted_parameters import other_rows
from bayes_inertia.diagnosis.random_signals import STOCHASTIC_CANDIDATES, candidate_kinds
from bayes_inertia.diagnosis.residuals import is_explained
from bayes_inertia.diagnosis.result import (
    AlternativeEffect,
    Candidate,
    Diagnosis,
    FormulaSearch,
    FormulaTerm,
    Hypothesis,
    Step,
)
from bayes_inertia.diagnosis.score_test import (
    ScoreTests,
    log_evidence_of_fit,
    sampled_evidence,
    score_tests,
    scored,
)
from bayes_inertia.diagnosis.table_search import (
    SHAPELESS,
    Reading,
    Search,
    Table,
    fit_of,
    hypotheses_of,
    read_table,
    table_of,
    unexplained_reading,
    with_evidence,
    with_stochastic,
)
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.laplace import Estimate, model_of
from bayes_inertia.inference.optimizer import move_to, without_effects
from bayes_inertia.inference.settings import NOTHING, OPEN_VERDICTS
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.maths.values import require_flags
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.stochastic_effect import StochasticEffect
from bayes_inertia.progress import Progress, as_callback, with_bar


@dataclass(frozen=True)
class Weighed:
    """What a table says, and the fits that belong to it.

    Parameters
    ----------
    table : Table
        All hypotheses.
    reading : Reading
        What they say.
    begin : CleanStart
        The noise and the fit without effects.
    final : Estimate
        The fit of the best row.
    candidates : tuple of Candidate
        All candidates at the fit without effects, best evidence first.
    threshold : float
        p-value below which a candidate is significant.
    """

    table: Table
    reading: Reading
    begin: CleanStart
    final: Estimate
    candidates: tuple[Candidate, ...]
    threshold: float


def weigh_campaign(begin: CleanStart, search: Search) -> Weighed:
    """Weigh everything that may be missing, until noise and table agree."""
    rng, effects = np.random.default_rng([search.seed, 3]), search.effects
    rules, costs = search.rules, effects.log_costs
    count = len(effects.linear) + (effects.flexible_mode is not None) + len(search.stochastic)
    for rounds_left in reversed(range(LIMITS.rounds_of_noise)):
        search.say(f"weighing {count} effects and their sets", 0, 0)
        table = table_of(begin.base, search)
        at = table.first
        candidates, threshold = scored(at.linear, at.random, at.log_evidence, rules, rng, costs)
        # What was searched for as a formula was significant before.
        significant = bool(costs) or any(c.p_value < threshold for c in candidates)
        reading = read_table(table, rules, significant=significant)
        fixed = table.fixed_part(reading.row)
        final = fit_of(table, fixed, search)
        if not rounds_left:
            break
        search.say("measuring the noise again", 0, 0)
        again = measured_again(begin, final)
        if again is None:
            break
        begin = again
    for effect in [e for e in search.stochastic if e.name in reading.named]:
        search.say(f"fitting {effect.name}", 0, 0)
        table, fits = _with_random(table, fixed, final, effect)
        reading = read_table(table, rules, significant=True)
        fixed = table.fixed_part(reading.row)
        if effect.name in reading.row:
            begin, final = at_measured_level(begin, fits[fixed])
        else:
            final = fit_of(table, fixed, search)
    if not is_explained(final.final_tests, rules):
        reading = unexplained_reading(table, reading)
    return Weighed(table, reading, begin, final, candidates, threshold)


def _alternatives(
    table: Table, tests: ScoreTests, reading: Reading, added: str
) -> tuple[AlternativeEffect, ...]:
    """What could be there instead of an effect named."""
    own = next((names for names in reading.ambiguous_with if names[0] == added), ())
    place = {name: k for k, name in enumerate(tests.names)}
    found = []
    for other in own[1:]:
        # Rows with it, or with nothing, in place of the effect named.
        without = [row for row in table.rows if added not in row]
        rows = [r for r in without if (r < reading.row if other == NOTHING else other in r)]
        lead = table.log_evidence[rows[0]] - table.log_evidence[reading.row] if rows else -np.inf
        both = [place[name] for name in (added, other) if name in place]
        correlation = tests.canonical_correlation(*both) if len(both) == 2 else np.nan
        found.append(AlternativeEffect(other, float(lead), float(correlation)))
    return tuple(found)


def _steps(table: Table, reading: Reading, final: Estimate, search: Search) -> tuple[Step, ...]:
    """The effects of the best row one after the other, the best first, a random one last."""
    random, tests = {effect.name for effect in search.stochastic}, score_tests(table.first.linear)
    steps: list[Step] = []
    held, left, before, value = frozenset[str](), reading.row, table.first.estimate, 0.0
    while left:
        best = max(
            sorted(left - random or left),
            key=lambda name: table.log_evidence.get(held | {name}, -np.inf),
        )
        held, left = held | {best}, left - {best}
        after = fit_of(table, held, search) if left else final
        now = table.log_evidence.get(held, value)
        others = _alternatives(table, tests, reading, best)
        steps.append(Step(best, before, after, now - value, others, best in random))
        before, value = after, now
    return tuple(steps)


def _with_random(
    table: Table, fixed: Names, before: Estimate, effect: StochasticEffect
) -> tuple[Table, dict[Names, Estimate]]:
    """Fit the best row that has a random effect, and this effect with fewer others.

    Where the misfit is large a linear model around a fit without the random effect is rough: what
    takes a part of it there may be needless beside it. Returns: the table with the evidence of
    these fits, and the fits by what stands beside the random effect.
    """
    first, own = table.first, frozenset([effect.name])
    start = next(m.likely_start for m in first.random if m.name == effect.name)
    whole = with_stochastic(before, effect, start)
    fits, stop = {fixed: whole}, LIMITS.comparison_tolerance
    theta = move_to(first.estimate, whole.model).theta.copy()
    theta[whole.model.space.slice_of(effect.name)] = start
    for kept in {frozenset[str](), *(fixed - {name} for name in fixed)} - {fixed}:
        if kept | own in table.log_evidence:
            fits[kept] = without_effects(whole, fixed - kept, theta, tolerance=stop)
    evidence = {kept: log_evidence_of_fit(fit) for kept, fit in fits.items()}
    offset = table.log_evidence[fixed | own] - evidence[fixed]
    gained = {k: offset + e - table.log_evidence[k | own] for k, e in evidence.items()}
    rough = max(map(abs, gained.values())) > LIMITS.linear
    least = offset + max(e + table.log_prior[k | own] for k, e in evidence.items())
    values = {}
    for row, value in table.log_evidence.items():
        if own <= row and row - own in gained:
            values[row] = value + gained[row - own]
        # To first order around a fit without it, others beside the random effect may be rough.
        elif not (own <= row and (rough or value + table.log_prior[row] > least)):
            values[row] = value
    return with_evidence(table, values), fits


@with_bar
@on_one_blas_thread
def diagnose(
    campaign: Campaign | Model | Estimate,
    *,
    library: Sequence[Effect | str] = LIBRARY,
    stochastic: Sequence[StochasticEffect] = STOCHASTIC_CANDIDATES,
    drive: Drive | None = None,
    rules: Rules | None = None,
    seed: int = 0,
    as_stated: bool = False,
    progress: Progress | bool | None = None,
) -> Diagnosis:
    """Find where model and data disagree, and which effects explain it.

    Parameters
    ----------
    campaign : Campaign, Model or Estimate
        What was flown, or what was made of it: its effects are not kept, nor the noise that it was
        asked for. Of slews with thousands of rows block means are taken.
    library : sequence of Effect or str
        Candidate effects; instances of your own may be among them.
    stochastic : sequence of StochasticEffect
        Candidates without a fixed shape. The first parameter of each scales its signal.
    drive : {"commanded", "measured"}, optional
        What drives the model: torque commands or tachometers. By default what the campaign allows.
    rules : Rules, optional
        Thresholds of the verdict; `Rules()` by default.
    seed : int
        Of the optimizer's starts and of the simulated thresholds.
    as_stated : bool
        Take the telemetry as it is: leave no outlier out, take no block means, and take the noise
        for white.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

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
        If two candidates have one name, or one is no effect.

    Examples
    --------
    It takes half a minute, so this is no doctest::

        diagnosis = diagnose(read_campaign("my_campaign"))
        diagnosis.verdict, diagnosis.named
        # ('named', ('wheel_command_lag',))
    """
    require_flags(as_stated=as_stated)
    say = as_callback(progress)
    if not isinstance(campaign, Campaign):
        model = model_of(campaign)
        campaign, drive = model.campaign, drive or model.structure.drive
    if not as_stated:
        campaign = without_surplus_rows(campaign)
    library, stochastic = candidate_kinds(library, stochastic)
    rules, effects = rules_of(rules), candidate_effects(campaign, library)
    model = Model(campaign, effects.linear, drive)
    say("fitting J and K, measuring the noise", 0, 0)
    begin = clean_start(model, seed=seed, as_stated=as_stated)
    return _diagnosed(begin, Search(effects, stochastic, rules, seed, say))


def _with_likely_noise(begin: CleanStart, search: Search) -> tuple[Weighed, dict[str, float]]:
    """The table whose noise, white, correlated or louder, is most probable; and how probable each.

    Correlated noise that a twentieth of the probability leaves open is noise: nothing is named for
    it. What leaves its own channel structured is not that noise: a torque that rings is none.
    """
    weighed, taken = weigh_campaign(begin, search), "white"
    evidence = {taken: _log_evidence(weighed)}
    search.say("measuring correlated noise", 0, 0)
    coloured = with_correlated_noise(begin, begin.base, weighed.final)
    other = None if coloured is None else weigh_campaign(coloured, search)
    if other is not None and _is_white(other, search.rules):
        evidence["correlated"] = _log_evidence(other)
        lead = evidence["correlated"] - evidence[taken]
        if holds_correlated_noise(weighed.final) or lead > -search.rules.log_evidence_margin:
            weighed, taken = other, "correlated"
    louder = with_louder_noise(weighed.begin, weighed.final, search.rules)
    if louder is not None:
        other = weigh_campaign(louder, search)
        evidence["louder"] = _log_evidence(other)
        weighed = other if evidence["louder"] > evidence[taken] else weighed
    odds = softmax([*evidence.values()]).tolist()
    return weighed, dict(zip(evidence, odds, strict=True)) if len(odds) > 1 else {}


def _is_white(weighed: Weighed, rules: Rules) -> bool:
    """Whether correlated noise leaves only noise in the channels that are said to have it."""
    tests, coloured = weighed.final.final_tests, weighed.begin.treatment.colour
    return is_explained({channel: tests[channel] for channel in coloured}, rules)


def _diagnosed(begin: CleanStart, search: Search) -> Diagnosis:
    """What the most probable noise and its table say."""
    weighed, noise_probabilities = _with_likely_noise(begin, search)
    weighed, formulas = with_formulas(weighed, search)
    table, reading, noise = weighed.table, weighed.reading, dict(weighed.begin.noise)
    steps = _steps(table, reading, weighed.final, search)
    added = tuple(step.added for step in steps)
    told = reading._replace(named=() if reading.verdict == "unknown" else added)
    return Diagnosis(
        **told._asdict(),
        candidates=weighed.candidates,
        threshold=weighed.threshold,
        steps=steps,
        base=weighed.begin.base,
        final=weighed.final,
        noise=noise,
        tests=weighed.final.final_tests,
        rules=search.rules,
        skipped=search.effects.skipped,
        correlations=score_tests(table.first.linear).correlations,
        treatment=replace(weighed.begin.treatment, level=noise),
        hypotheses=_checked(table, search.seed),
        other_rows=() if reading.verdict in OPEN_VERDICTS else other_rows(table, reading.row),
        formulas=formulas,
        noise_probabilities=noise_probabilities,
    )


def _log_evidence(weighed: Weighed) -> float:
    """Log evidence of the noise of a table: of all its rows, or of the fit of the best.

    What a strong process does between its knots only a fit tells; what it does between slews, only
    the table.
    """
    table, base, final = weighed.table, weighed.begin.base, weighed.final
    levels = len(weighed.begin.treatment.by_residuals)
    joint = [table.log_evidence[row] + table.log_prior[row] for row in table.rows]
    of_rows = log_evidence_of_noise(base, levels) + float(logsumexp(joint))
    return max(of_rows, log_evidence_of_noise(final, levels) + table.log_prior[weighed.reading.row])


def _checked(table: Table, seed: int) -> tuple[Hypothesis, ...]:
    """The hypotheses; fits of probable ones checked by importance sampling."""
    rng, rows = np.random.default_rng([seed, 6]), []
    for row in hypotheses_of(table):
        fitted = table.refitted.get(frozenset(row.effects))
        alone = row.kind in ("nothing", "effects") and row.probability > LIMITS.least_probability
        sampled = sampled_evidence(fitted.estimate, rng) if fitted and alone else None
        rows.append(replace(row, **sampled._asdict()) if sampled else row)
    return tuple(rows)


def with_formulas(weighed: Weighed, search: Search) -> tuple[Weighed, FormulaSearch | None]:
    """Look for a formula that explains the data as well as what the table says.

    Where it may, the best formulas are weighed again beside the effects; where only a shape
    without a name is one of several answers, they say what that shape would be.

    Returns: the table with formulas if one is an answer, else as it was; and the search, unless no
    formula counts.
    """
    now, found, first = weighed, dict[str, FormulaTerm](), None
    for _ in range(LIMITS.rounds_of_formulas):
        if now.reading.verdict == "consistent" or (found and now.reading.verdict == "named"):
            break
        search.say("weighing formulas", 0, 0)
        known = {member.name for member in now.table.first.linear.members} - found.keys()
        searches = [search_formulas(*at, known) for at in _responses(now)]
        clearest = max(searches, key=lambda s: s.log_evidence)
        if clearest.log_evidence < -np.log(search.rules.false_alarm_probability):
            break
        contested = _contested(now, clearest, search.rules)
        if contested or _may_be_shapeless(now.reading):
            first = first or clearest
        equals = (s.equals(search.rules.log_evidence_margin) for s in searches)
        best = {t.formula.name: t for terms in equals for t in terms[: LIMITS.formulas_refitted]}
        if not contested or best.keys() <= found.keys():
            break
        found |= best
        larger = replace(
            search.effects,
            linear=(*search.effects.linear, *(term.formula for term in found.values())),
            log_costs={name: -term.log_prior for name, term in found.items()},
        )
        begin = _with_candidates(now.begin, larger)
        now = weigh_campaign(begin, replace(search, effects=larger))
    answers = {name for names in (now.reading.named, *now.reading.ambiguous_with) for name in names}
    if not found.keys() & answers or now.reading.verdict in OPEN_VERDICTS:
        return weighed, first if _may_be_shapeless(weighed.reading) else None
    named = found.keys() & set(now.reading.named)
    reading = now.reading._replace(verdict="formula") if named else now.reading
    return replace(now, reading=reading), first


def _may_be_shapeless(reading: Reading) -> bool:
    """Whether a shape without a name is one of those that cannot be told apart."""
    return any(name in SHAPELESS for names in reading.ambiguous_with for name in names)


def _contested(weighed: Weighed, search: FormulaSearch, rules: Rules) -> bool:
    """Whether a formula may be as probable as what is named."""
    table, reading = weighed.table, weighed.reading
    if reading.verdict in OPEN_VERDICTS:
        return True
    single = max(prior for row, prior in table.log_prior.items() if len(row) == 1)
    named = table.log_evidence[reading.row] + table.log_prior[reading.row]
    return search.terms[0].log_weight + single > named - rules.log_evidence_margin


def _responses(weighed: Weighed) -> list[tuple[TorqueResponse, LinearModel]]:
    """Fits at which formulas are looked for: without effects, and with what is named in part."""
    first, final = weighed.table.first, weighed.final
    fits = [(first.response, first.linear)]
    fixed = not any(isinstance(e, StochasticEffect) for e in final.model.effects)
    part = fixed and weighed.reading.named and weighed.reading.verdict in OPEN_VERDICTS
    return [*fits, (torque_response(final), linear_model(final))] if part else fits


def _with_candidates(begin: CleanStart, effects: CandidateEffects) -> CleanStart:
    """The start of a search among other effects."""
    stated = replace(begin.stated, effects=effects.linear)
    base = move_to(begin.base, replace(begin.base.model, effects=effects.linear))
    return replace(begin, stated=stated, base=base)
