"""A diagnosis: what was scored, what was added step by step, and the answer.

An effect may be larger than its prior allows. The prior then pulls the fit away from the data and
punishes the right name: it is fitted with a prior as wide as its size, what that costs is in its
evidence, and the verdict says that either the prior is too narrow or the cause is another.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.limits import LIMITS, Rules
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.inference.residual_tests import ChannelTest
from bayes_inertia.inference.treatment import DirtTreatment, records_of_dirt
from bayes_inertia.maths.printed import Card, shown_as
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.formula import Formula

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class BeyondPrior:
    """An effect that is larger than its prior allows.

    Parameters
    ----------
    effect : str
        Its name.
    parameter : str
        Its parameter that lies furthest out.
    value : float
        What was fitted for it.
    unit : str
        Its unit.
    prior_sds : float
        How far it lies from where the effect does nothing, in sds of its prior as stated.
    prior_scale : float
        By how much the prior was widened.
    """

    effect: str
    parameter: str
    value: float
    unit: str
    prior_sds: float
    prior_scale: float


def within_prior(fitted: Estimate, effect: str, rules: Rules, *, tolerance: float) -> Estimate:
    """Refit an effect with a wider prior, if the one that it has is exceeded.

    `rules`: how far a parameter may lie from where it does nothing. Returns: the same object where
    the prior is kept to.
    """
    for _ in range(LIMITS.rounds_of_prior):
        distance = float(np.abs(_distances(fitted, effect)).max(initial=0.0))
        if distance <= rules.prior_sd_at_most:
            break
        # By powers of two: sizes that differ by noise get one prior.
        wider, model = float(2.0 ** np.ceil(np.log2(distance))), fitted.model
        effects = tuple(
            replace(e, prior_scale=wider * e.prior_scale) if e.name == effect else e
            for e in model.effects
        )
        wide = move_to(fitted, replace(model, effects=effects))
        fitted = re_estimate(wide, wide.theta, wide.free, tolerance=tolerance)
    return fitted


def _distances(fitted: Estimate, effect: str) -> np.ndarray:
    """How far each amplitude lies from where it does nothing [prior sd]; 0 for shapes."""
    space = fitted.model.space
    part = space.slice_of(effect)
    distance = (fitted.theta - space.nulls)[part] / space.sd[part]
    return np.where([prior.logarithmic for prior in space.priors[part]], 0.0, distance)


@dataclass(frozen=True)
class Candidate:
    """One candidate effect, scored at a fit without it.

    Parameters
    ----------
    effect : str
        Its name.
    dof : int
        Degrees of freedom of the score: 0 if the campaign cannot see the effect.
    score : float
        Score statistic: chi^2 with `dof` if the effect is absent.
    p_value : float
        Probability of at least this score if the effect is absent.
    log_bayes_factor : float
        Log evidence for the effect against nothing, to first order.
    """

    effect: str
    dof: int
    score: float
    p_value: float
    log_bayes_factor: float


@array_dataclass
class AlternativeEffect:
    """An effect that explains the data about as well as the one added in its place.

    Parameters
    ----------
    effect : str
        Its name.
    log_bayes_factor : float
        Log evidence of its row of the table, less that of the row of the effects named.
    correlation : float
        Canonical correlation with the effect added: 1 if the data cannot tell them apart; NaN of
        what has no fixed shape.
    """

    effect: str
    log_bayes_factor: float
    correlation: float


@dataclass(frozen=True)
class Step:
    """One effect added.

    Parameters
    ----------
    added : str
        Name of the effect.
    before, after : Estimate
        The fits without and with it.
    log_bayes_factor : float
        Log evidence for the fit after against the fit before.
    alternatives : tuple of AlternativeEffect
        Effects that explain the data about as well.
    stochastic : bool
        Whether the effect has no fixed shape.
    """

    added: str
    before: Estimate
    after: Estimate
    log_bayes_factor: float
    alternatives: tuple[AlternativeEffect, ...] = ()
    stochastic: bool = False


@dataclass(frozen=True)
class Hypothesis:
    """One possible answer, and how probable it is.

    Parameters
    ----------
    kind : {"nothing", "effects", "nameless", "others"}
        Nothing is missing; just these effects; something without a name; any other set of effects.
    effects : tuple of str
        Which effects.
    log_prior : float
        Log probability beforehand.
    log_evidence : float
        Of the data, against nothing.
    probability : float
        Afterwards.
    sampled_gain : float or None
        Log evidence of its own fit by importance sampling, less that by Laplace's approximation;
        None where it has no fit of its own, or hardly any probability.
    pareto_k : float or None
        Shape of the tail of the weights of that: above 0.7 its J and K are rough.
    """

    kind: Literal["nothing", "effects", "nameless", "others"]
    effects: tuple[str, ...]
    log_prior: float
    log_evidence: float
    probability: float = 0.0
    sampled_gain: float | None = None
    pareto_k: float | None = None


@array_dataclass
class AlternativeParameters:
    """J and K if `effect` is the true one and not `instead_of`, which was named.

    Parameters
    ----------
    effect : str
        The effect assumed, or several joined by "and"; a value of `NAMELESS` for what has
        no name; empty where nothing is missing, "others" for all further rows.
    instead_of : str
        The effects named, joined alike; empty for one more effect, see `undetected_alternatives`.
    probability : float
        Of this, from the evidence. What is missing from 1 in the sum over all alternatives belongs
        to the effects named.
    names : tuple of str
        Of the elements of J and K.
    mean : (9,) array
        Of J and K, SI units.
    covariance : (9, 9) array
        By Laplace's approximation.

    Examples
    --------
    >>> variance = np.full((1, 1), 4e-6)
    >>> AlternativeParameters(
    ...     "wheel_friction", "viscous_torque", 0.25, ("K1",), np.ones(1), variance
    ... ).sd
    array([0.002])
    """

    effect: str
    instead_of: str
    probability: float
    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (9,)."""
        return np.sqrt(np.diag(self.covariance))


class FormulaTerm(NamedTuple):
    """One formula, weighed.

    Parameters
    ----------
    formula : Formula
        The formula.
    log_evidence : float
        Of it against nothing, to first order.
    log_prior : float
        Log probability beforehand, if there is a formula: places, drivers of a place, forms of a
        driver and members of a form are each as probable.
    """

    formula: Formula
    log_evidence: float
    log_prior: float

    @property
    def log_weight(self) -> float:
        """Log evidence and log prior."""
        return self.log_evidence + self.log_prior


@dataclass(frozen=True)
class FormulaSearch:
    """All terms of the grammar of formulas, weighed at one fit.

    Parameters
    ----------
    terms : tuple of FormulaTerm
        Most probable first.
    """

    terms: tuple[FormulaTerm, ...]

    @property
    def log_evidence(self) -> float:
        """For any formula against nothing.

        Without one its exponential has the expectation 1: it exceeds 1 / p with probability p at
        most (Markov's inequality), however many terms there are.
        """
        return float(logsumexp([term.log_weight for term in self.terms]))

    def equals(self, margin: float) -> tuple[FormulaTerm, ...]:
        """Terms that are nearly as probable as the best.

        Parameters
        ----------
        margin : float
            Log odds that they may be behind it.

        Returns
        -------
        tuple of FormulaTerm
            The best first.
        """
        best = self.terms[0].log_weight
        return tuple(term for term in self.terms if best - term.log_weight < margin)


def _card(diagnosis: Diagnosis) -> Card:
    """The verdict, and the most probable answers."""
    named = " and ".join(diagnosis.named)
    campaign = diagnosis.final.model.campaign.name
    rows = tuple(
        (" and ".join(h.effects) or h.kind, f"{h.probability:.1%}", f"{h.log_evidence:.1f}")
        for h in diagnosis.hypotheses[: LIMITS.listed]
    )
    answers = ", ".join(f"{name} {share}" for name, share, _ in rows[:3])
    if diagnosis.why_unknown == "misfit":
        answers = f"the residuals fit no answer; if one had to be right: {answers}"
    verdict = ", ".join(part for part in (diagnosis.verdict, named) if part)
    lines = (f"Diagnosis of {campaign}: {verdict}", answers)
    head = ("answer", "probability", "log evidence")
    return Card(tuple(line for line in lines if line), head, rows)


@shown_as(_card)
@array_dataclass
class Diagnosis:
    """The answer.

    Parameters
    ----------
    verdict : {"consistent", "named", "ambiguous", "formula", "partial", "unknown"}
        What was found. "formula": no effect of the library, but a disturbance in proportion to
        something known. "partial": what is named explains a part, beside it something without a
        name.
    named : tuple of str
        Effects added.
    ambiguous_with : tuple of tuple of str
        Sets of effects, the named one first, that this campaign cannot tell apart; "nothing",
        last, where the effect may as well not be there.
    candidates : tuple of Candidate
        All candidates, scored at the base fit, best evidence first.
    threshold : float
        p-value below which a candidate is significant.
    steps : tuple of Step
        What was added.
    base, final : Estimate
        The fits with nothing and with everything added. Where the verdict is "ambiguous" or
        "unknown" their sds are too small: `quoted_parameters` gives those to quote.
    noise : dict
        Factor by which each channel's noise exceeds what is stated.
    tests : dict
        Tests of the final residuals by channel, at that noise.
    rules : Rules
        The thresholds used.
    skipped : tuple of (str, str)
        Candidates that could not be tried, and why.
    correlations : dict
        Canonical correlations of pairs of candidates.
    why_unknown : {"", "misfit", "imitation"}
        "misfit": the residuals are not explained. "imitation": the effects added would
        explain them, but a disturbance without a name does so better.
    nameless_lead : float
        Log odds of the best row with a shape without a name (free, or in proportion to something
        known) against the best without; -inf if nothing was named.
    nameless_source : str
        Where that shape enters; empty if nothing was named.
    treatment : DirtTreatment
        What was done about dirt in the telemetry; its level is `noise`.
    hypotheses : tuple of Hypothesis
        Possible answers, most probable first; their probabilities add up to one: they compare the
        answers with each other, even where the residuals fit none ("misfit").
    other_rows : tuple of AlternativeParameters
        J and K of all rows of the table but that of the effects named; empty where the verdict is
        "partial" or "unknown".
    formulas : FormulaSearch or None
        All terms that were weighed, where a formula is named or may be what has no name.
    noise_probabilities : dict
        Of "white", "correlated" and "louder" noise, of those that were tried; empty where white
        noise alone was. "correlated": of the rates, taken if it has a twentieth. "louder": heavy
        tails, or noise that is louder at times, where residuals are too large and not structured in
        time; taken if it is more probable than what stood before.
    """

    verdict: str
    named: tuple[str, ...]
    ambiguous_with: tuple[tuple[str, ...], ...]
    candidates: tuple[Candidate, ...]
    threshold: float
    steps: tuple[Step, ...]
    base: Estimate
    final: Estimate
    noise: dict[str, float]
    tests: dict[str, ChannelTest]
    rules: Rules
    skipped: tuple[tuple[str, str], ...] = ()
    correlations: dict[tuple[str, str], float] = field(default_factory=dict)
    why_unknown: str = ""
    nameless_lead: float = -math.inf
    nameless_source: str = ""
    treatment: DirtTreatment = field(default_factory=DirtTreatment)
    hypotheses: tuple[Hypothesis, ...] = ()
    other_rows: tuple[AlternativeParameters, ...] = ()
    formulas: FormulaSearch | None = None
    noise_probabilities: dict[str, float] = field(default_factory=dict)

    def to_dataframe(self) -> pd.DataFrame:
        """The candidates as a table, best evidence first.

        Returns
        -------
        pandas.DataFrame
            One row an effect: degrees of freedom, score, p-value, log Bayes factor, and whether it
            was named.
        """
        from pandas import DataFrame

        rows = [asdict(c) | {"named": c.effect in self.named} for c in self.candidates]
        columns = [*(field.name for field in fields(Candidate)), "named"]
        return DataFrame(rows, columns=columns).set_index("effect")

    @property
    def effects_added(self) -> tuple[Effect, ...]:
        """The effects of the steps, in their order, with the settings they were found with."""
        instances = {effect.name: effect for effect in self.final.model.effects}
        return tuple(instances[step.added] for step in self.steps)

    @property
    def beyond_prior(self) -> tuple[BeyondPrior, ...]:
        """Effects named that are larger than their priors allow."""
        final, space, rows = self.final, self.final.model.space, []
        scales = {effect.name: effect.prior_scale for effect in final.model.effects}
        for effect in (step.added for step in self.steps if step.added in self.named):
            distances = np.abs(_distances(final, effect)) * scales[effect]
            if distances.max(initial=0.0) <= self.rules.prior_sd_at_most:
                continue
            k = space.slice_of(effect).start + int(np.argmax(distances))
            name, found = space.names[k].split(".", 1)[1], (float(final.theta[k]), space.units[k])
            rows.append(BeyondPrior(effect, name, *found, float(distances.max()), scales[effect]))
        return tuple(rows)

    @property
    def dirt(self) -> tuple[Dirt, ...]:
        """What is wrong with the telemetry, and what was done about it before the search."""
        done = replace(self.treatment, masked=(), colour={})
        return records_of_dirt(self.final.model.campaign, done)
