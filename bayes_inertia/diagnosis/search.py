"""What is missing in the model: score all candidates, refit the best, name, admit ambiguity, or say "unknown".

Forward search with re-linearisation: at the current fit every candidate effect is scored at once
(`fingerprint`); the family-wise threshold comes from simulating the joint distribution of all scores. The
best few are refitted in full and compared by evidence; what the data cannot tell apart is reported as a set.
Effects that a later one makes needless are dropped again. What remains unexplained is called unknown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats
from scipy.special import logsumexp

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.diagnosis.compilation import compile_ahead
from bayes_inertia.diagnosis.driven_disturbances import NAMED
from bayes_inertia.diagnosis.evidence import log_bayes_factor
from bayes_inertia.diagnosis.flexible_mode_search import Ringing, best_ringing, theta_of
from bayes_inertia.diagnosis.noise_level import noise_factors
from bayes_inertia.diagnosis.result import NOISE, Candidate, Diagnosis, Rival, Step
from bayes_inertia.diagnosis.score_test import Fingerprints, fingerprints, unfitted
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.diagnosis.unexplained import unknown_torque
from bayes_inertia.errors import EffectError
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import (
    estimate,
    move_to,
    re_estimate,
    with_noise,
    without_effect,
)
from bayes_inertia.inference.residual_tests import ChannelTest, channel_tests
from bayes_inertia.maths.linear_algebra import VISIBLE
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, FlexibleMode
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_input import Drive

FLEXIBLE = "flexible_mode"
# By how much log evidence to first order may be wrong, for candidates worth a refit as rivals.
_FIRST_ORDER = 2.0
# Of the objective, for refits that are compared: what is left of it is a hundredth at most, while evidence is weighed in units.
_COMPARED = 1e-5


@dataclass(frozen=True)
class Rules:
    """The thresholds of the search.

    Attributes
    ----------
    false_alarms : probability of naming anything in a campaign without hidden effect. (2 %: an interval over 200 campaigns
        then stays below 5 %.)
    refits : candidates that are refitted in each step, unless their first-order log evidence is less than `hopeless`
        times that of the best. most : effects that can be named at all.
    margin : log evidence by which the best must beat another that could imitate it, and something without a name must beat the names.
    alike : canonical correlation with the best above which another candidate counts as an imitation. (0.6: where an ideal
        test finds an effect in 99 % of campaigns, one less alike wins by chance in less than 1 %.)
    misfit : p-value of the whole residuals below which the data are not explained.
    """

    false_alarms: float = 0.02
    refits: int = 6
    hopeless: float = 0.3
    most: int = 4
    margin: float = 3.0
    alike: float = 0.6
    misfit: float = 1e-4


def diagnose(
    campaign: Campaign,
    *,
    library: Sequence[Effect] = LIBRARY,
    drive: Drive | None = None,
    rules: Rules | None = None,
    seed: int = 0,
) -> Diagnosis:
    """Find where model and data disagree, and which effects explain it.

    Parameters
    ----------
    library : candidate effects; instances of your own may be among them. seed : of optimizer starts and thresholds.

    Raises
    ------
    CampaignError, EstimateError : as `estimate`. EffectError : two candidates of one name.
    """
    rules, rng = rules or Rules(), np.random.default_rng([seed, 3])
    usable, skipped = _usable(campaign, library)
    whole = Model(campaign, tuple(e for e in usable if not isinstance(e, FlexibleMode)), drive)
    with ThreadPoolExecutor(1) as meanwhile:
        compiled = meanwhile.submit(compile_ahead, whole)
        simple = estimate(Model(campaign, (), drive), seed=seed, discount=False)
        noise = noise_factors(simple)
        compiled.result()
    base = at = move_to(with_noise(simple, noise), whole)
    flexible = next((e for e in usable if isinstance(e, FlexibleMode)), None)
    first = None
    steps: list[Step] = []
    for _ in range(2):
        steps, at, seen = _search(at, steps, flexible, rules, rng)
        first = first or seen
        # An effect's own jumps can look like noise: measure the noise again, without them.
        settled = noise_factors(at)
        if settled == noise:
            break
        noise, at = settled, with_noise(at, settled)
    return _verdict(base, at, steps, first, noise, skipped, rules)


def _search(
    at: Estimate, steps: list[Step], flexible: Effect | None, rules: Rules, rng: np.random.Generator
):
    """Add effects until none is significant; also what was seen before the first was added."""
    seen, dropped = None, set()
    while True:
        marks = _marks(at, flexible)
        limit = marks.threshold(rules.false_alarms, rng)
        found = _candidates(marks)
        seen = seen or (found, limit, marks)
        open_still = [c for c in found if c.effect not in dropped]
        step = (
            _best_step(at, marks, open_still, flexible, rules, limit)
            if len(steps) < rules.most
            else None
        )
        if step is None:
            return steps, at, seen
        before = {s.added for s in steps}
        steps = _without_needless([*steps, step], flexible, rules)
        at, dropped = steps[-1].after, dropped | before - {s.added for s in steps}


def _usable(
    campaign: Campaign, library: Sequence[Effect]
) -> tuple[list[Effect], tuple[tuple[str, str], ...]]:
    """Candidates that the campaign's columns allow, and those that they do not."""
    for name, times in Counter(e.name for e in library).items():
        if times > 1:
            raise EffectError(
                f"{times} candidates have this name",
                where=name,
                advice="give them names of their own, or diagnose with one at a time",
            )
    for e in library:
        if e.name == FLEXIBLE and not isinstance(e, FlexibleMode):
            raise EffectError(
                "only one mode shared by all slews can be a candidate",
                where=FLEXIBLE,
                advice="give a FlexibleMode itself",
            )
    lacking = {
        e.name: [n for n in e.needs if any(_empty(getattr(s, n)) for s in campaign.slews)]
        for e in library
    }
    skipped = tuple(
        (name, f"needs {', '.join(columns)} in every slew")
        for name, columns in lacking.items()
        if columns
    )
    return [e for e in library if not lacking[e.name]], skipped


def _empty(column: np.ndarray | None) -> bool:
    return column is None or not np.isfinite(column).all(axis=-1).any()


def _marks(at: Estimate, flexible: Effect | None) -> Fingerprints:
    """Fingerprints of everything that is not fitted yet."""
    waiting = unfitted(at)
    if flexible is None or any(e.name == FLEXIBLE for e in at.model.effects):
        return fingerprints(at, waiting)
    coupling, fit = flexible.parameters(at.model.campaign)[0].priors[0].sd, at.linearised()
    return fingerprints(
        at, waiting, (best_ringing(FLEXIBLE, torque_response(at), fit, coupling**2),), fit
    )


def _candidates(marks: Fingerprints) -> list[Candidate]:
    """All candidates, best evidence first."""
    scores = [float(marks.score(k)) for k in range(len(marks.names))]
    found = [
        Candidate(
            name,
            marks.dof(k),
            score,
            float(marks.p_value(k, np.asarray(score))),
            marks.log_bayes_factor(k),
        )
        for k, (name, score) in enumerate(zip(marks.names, scores, strict=True))
    ]
    return sorted(found, key=lambda c: -c.log_bayes_factor)


def _best_step(
    at: Estimate, marks: Fingerprints, found: list[Candidate], flexible, rules: Rules, limit: float
) -> Step | None:
    """Refit the most promising of the significant candidates and take the one with the best evidence."""
    significant = [c for c in found if c.p_value < limit]
    worth = [
        c
        for c in significant
        if c.log_bayes_factor >= rules.hopeless * significant[0].log_bayes_factor
        or c is significant[0]
    ]
    fits = [_fitted(at, marks, c, flexible) for c in worth[: rules.refits]]
    refitted = sorted(
        (f for f in fits if f.log_bayes_factor > 0.0 and f.p_value < limit),
        key=lambda f: -f.log_bayes_factor,
    )
    if not refitted:
        return None
    if not at.model.campaign.has_tachometers:
        refitted = (
            sorted((_again(at, marks, f) for f in refitted[:2]), key=lambda f: -f.log_bayes_factor)
            + refitted[2:]
        )
    # Brought to its end only now; weighed as it was beside the others, for in the measured drive the noise follows J.
    best = replace(
        refitted[0],
        after=re_estimate(refitted[0].after, refitted[0].after.theta, refitted[0].after.free),
    )
    others = [*refitted[1:], *(f for f in fits if all(f.effect != r.effect for r in refitted))]
    others += [
        _fitted(at, marks, c, flexible)
        for c in _near(marks, best, found, {f.effect for f in fits}, rules)
    ]
    return Step(
        best.effect, at, best.after, best.log_bayes_factor, _rivals(marks, best, others, rules)
    )


@dataclass(frozen=True)
class _Fitted:
    """A candidate refitted: the fit, its log evidence against the fit without it, and the p-value of what it gains."""

    effect: str
    after: Estimate
    log_bayes_factor: float
    p_value: float


def _fitted(
    at: Estimate, marks: Fingerprints, candidate: Candidate, flexible: Effect | None
) -> _Fitted:
    return _weighed(at, marks, candidate.effect, _refit(at, marks, candidate, flexible))


def _weighed(at: Estimate, marks: Fingerprints, effect: str, after: Estimate) -> _Fitted:
    k, gained = marks.names.index(effect), 2.0 * (at.objective - after.objective)
    return _Fitted(
        effect,
        after,
        log_bayes_factor(at, after, effect),
        float(marks.p_value(k, np.asarray(max(gained, 0.0)))),
    )


def _near(
    marks: Fingerprints, best: _Fitted, found: list[Candidate], done: set[str], rules: Rules
) -> list[Candidate]:
    """Candidates that were not refitted but could imitate the best about as well: two at most.

    They need not be significant alone: that something is there is known from the best.
    """
    least = max(best.log_bayes_factor - rules.margin, 0.0) - _FIRST_ORDER
    near = [
        c
        for c in found
        if c.effect not in done
        and c.log_bayes_factor > least
        and _alike(marks, best.effect, c.effect) > rules.alike
    ]
    return near[:2]


def _rivals(
    marks: Fingerprints, best: _Fitted, others: list[_Fitted], rules: Rules
) -> tuple[Rival, ...]:
    """Effects that explain the data nearly as well as the best and can imitate it: two at most."""
    rivals = []
    for other in sorted(others, key=lambda f: -f.log_bayes_factor):
        alike = _alike(marks, best.effect, other.effect)
        if (
            other.log_bayes_factor > max(best.log_bayes_factor - rules.margin, 0.0)
            and alike > rules.alike
        ):
            rivals.append(Rival(other.effect, other.after, other.log_bayes_factor, alike))
    return tuple(rivals[:2])


def _alike(marks: Fingerprints, one: str, other: str) -> float:
    return marks.canonical_correlation(marks.names.index(one), marks.names.index(other))


def _refit(
    at: Estimate, marks: Fingerprints, candidate: Candidate, flexible: Effect | None
) -> Estimate:
    """The fit with one candidate more, begun at its first-order amplitude."""
    imprint = marks.imprints.get(candidate.effect)
    if isinstance(imprint, Ringing):
        return _refit_mode(at, imprint, flexible)
    space = at.model.space
    part = space.slice_of(candidate.effect)
    theta = at.theta.copy()
    theta[part] += (
        np.clip(marks.amplitude(marks.names.index(candidate.effect)), -10.0, 10.0) * space.sd[part]
    )
    margin = 1e-3 * space.sd[part]
    theta[part] = np.clip(theta[part], space.lower[part] + margin, space.upper[part] - margin)
    return re_estimate(
        at, theta, np.concatenate([at.free, np.arange(part.start, part.stop)]), tolerance=_COMPARED
    )


def _again(at: Estimate, marks: Fingerprints, fit: _Fitted) -> _Fitted:
    """A refit begun once more from afar, if it gained less than to first order: where nothing measures the wheels' momentum there are local optima."""
    gained = 2.0 * (at.objective - fit.after.objective)
    if gained > float(marks.score(marks.names.index(fit.effect))) - _FIRST_ORDER:
        return fit
    other = re_estimate(
        fit.after, fit.after.theta, fit.after.free, gently=True, tolerance=_COMPARED
    )
    return fit if other.objective > fit.after.objective else _weighed(at, marks, fit.effect, other)


def _refit_mode(at: Estimate, ringing: Ringing, flexible: Effect) -> Estimate:
    """The fit with a flexible mode, begun at the coupling that is best to first order."""
    mode = replace(flexible, frequency=_round_frequency(ringing.frequency))
    whole = Model(at.model.campaign, (*at.model.effects, mode), at.model.structure.drive)
    lifted = move_to(at, whole)
    part = whole.space.slice_of(FLEXIBLE)
    return re_estimate(
        lifted,
        theta_of(ringing, lifted),
        np.concatenate([lifted.free, np.arange(part.start, part.stop)]),
        tolerance=_COMPARED,
    )


def _round_frequency(frequency: float) -> float:
    """The nearest power of two [Hz]: the prior's median, rounded so that fits of many campaigns share compiled code."""
    return float(2.0 ** np.round(np.log2(frequency)))


def _without_needless(steps: list[Step], flexible: Effect | None, rules: Rules) -> list[Step]:
    """Drop effects, other than the newest, that the fit can do without."""
    i = 0
    while i < len(steps) - 1:
        if _needless(steps[-1].after, steps[i].added):
            steps = _dropped(steps, i, flexible, rules)
        else:
            i += 1
    return steps


def _needless(at: Estimate, effect: str) -> bool:
    """Whether the amplitudes fitted for an effect are within their noise, where the campaign can see them (Wald's test)."""
    space, part = at.model.space, at.model.space.slice_of(effect)
    seen = np.arange(space.size)[part][[not p.logarithmic for p in space.priors[part]]]
    amplitude = (at.theta - space.nulls)[seen] / space.sd[seen]
    precision = np.linalg.inv(
        at.covariance[np.ix_(seen, seen)] / np.outer(space.sd[seen], space.sd[seen])
    )
    powers, directions = np.linalg.eigh(precision - np.eye(len(seen)))
    keep = powers > VISIBLE
    along = directions[:, keep].T @ precision @ amplitude
    return bool(stats.chi2.sf(np.sum(along**2 / powers[keep]), max(keep.sum(), 1)) > 0.01)


def _dropped(steps: list[Step], i: int, flexible: Effect | None, rules: Rules) -> list[Step]:
    """The search as if step i had not been taken; its effect stays beside the next one, if it explains the data about as well and is alike."""
    gone, kept, before = steps[i], list(steps[:i]), steps[i].before
    for step in steps[i + 1 :]:
        after = without_effect(step.after, gone.added)
        kept.append(
            replace(
                step,
                before=before,
                after=after,
                log_bayes_factor=log_bayes_factor(before, after, step.added),
            )
        )
        before = after
    marks, next_one = _marks(gone.before, flexible), kept[i]
    alike = _alike(marks, next_one.added, gone.added)
    if alike > rules.alike and gone.log_bayes_factor > next_one.log_bayes_factor - rules.margin:
        beside = Rival(gone.added, gone.after, gone.log_bayes_factor, alike)
        kept[i] = replace(next_one, alternatives=(beside, *next_one.alternatives)[:2])
    return kept


def final_tests(at: Estimate) -> dict[str, ChannelTest]:
    """Tests of the residuals against the noise as used (stated noise times what was measured of it)."""
    scale = {c: np.sqrt(at.discount[0, i]) for i, c in enumerate(CHANNELS)}
    series = {c: [scale[c] * x for x in slews] for c, slews in at.residual_series.items()}
    info = at.information
    return channel_tests(series, info.chi2.sum(0), info.n_data.sum(0) - at.effective_parameters)


def explained(tests: dict[str, ChannelTest], rules: Rules) -> bool:
    """Whether nothing is left in the residuals that noise would not leave."""
    loud = [t.p_chi2 for t in tests.values() if t.p_chi2 is not None and t.reduced_chi2 > 1.0]
    structured = [t.p_white for t in tests.values() if t.p_white is not None]
    return min([*loud, *structured], default=1.0) > rules.misfit


def _verdict(
    base: Estimate,
    at: Estimate,
    steps: list[Step],
    first: tuple,
    noise: dict[str, float],
    skipped,
    rules: Rules,
) -> Diagnosis:
    found, limit, marks = first
    tests = final_tests(at)
    # What was named too, and is needed beside the other, is no alternative to it.
    both = {s.added for s in steps}
    steps = [
        replace(
            s, alternatives=tuple(rival for rival in s.alternatives if rival.effect not in both)
        )
        for s in steps
    ]
    louder = any(factor > 1.0 for factor in noise.values())
    sets = tuple(
        (s.added, *(rival.effect for rival in s.alternatives)) for s in steps if s.alternatives
    )
    names = tuple(s.added for s in steps) + ((NOISE,) if louder else ())
    lead = nameless_lead(steps, len(found))
    why = "misfit" if not explained(tests, rules) else "imitation" if lead > rules.margin else ""
    if why:
        verdict, names = "unknown", ()
    elif sets:
        verdict = "ambiguous"
    elif names:
        verdict = "named"
    else:
        verdict = "consistent"
    correlations = {
        (a, b): marks.canonical_correlation(i, j)
        for i, a in enumerate(marks.names)
        for j, b in enumerate(marks.names)
        if i < j and FLEXIBLE not in (a, b)
    }
    return Diagnosis(
        verdict,
        names,
        sets if verdict == "ambiguous" else (),
        tuple(found),
        limit,
        tuple(steps),
        base,
        at,
        noise,
        tests,
        skipped,
        correlations,
        why,
        lead,
    )


def nameless_lead(steps: Sequence[Step], choices: int) -> float:
    """Log evidence by which something without a name explains the data better than the effects named, or than the last of them; -inf without steps.

    Several effects together can imitate one that is not in the library, each taking a part. A torque or sensor error of any
    shape has far more freedom and pays for it in evidence, one in proportion to something known (`proportional`) has about as much:
    where either wins clearly, the names are not the cause.

    Parameters
    ----------
    choices : number of candidates. A claim of several effects at once pays for each further choice among them (Scott and Berger 2010).
    """
    claimed, lead = np.log(choices), -np.inf
    for step in reversed(steps):
        claimed += step.log_bayes_factor - np.log(choices)
        lead = max(lead, _nameless(step.before) - claimed)
    return float(lead)


def _nameless(at: Estimate) -> float:
    """The best log evidence for a disturbance without a name in what an estimate leaves.

    A disturbance in proportion to something is one hypothesis, whatever it follows: its evidence is the average over all that it may.
    """
    free = unknown_torque(at)
    followed = [evidence for key, evidence in free.followed.items() if key not in NAMED]
    return max(
        *(h.log_evidence for h in (free.torque, free.other) if h is not None),
        float(logsumexp(followed) - np.log(len(followed))),
    )
