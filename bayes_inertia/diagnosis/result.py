"""A diagnosis: what was scored, what was added step by step, and the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.wide_prior import BeyondPrior, beyond_prior
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.residual_tests import ChannelTest
from bayes_inertia.inference.treatment import DirtTreatment, records_of_dirt
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect


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


@dataclass(frozen=True)
class AlternativeEffect:
    """An effect that explains the data about as well as the one added in its place.

    Parameters
    ----------
    effect : str
        Its name.
    estimate : Estimate
        The fit with it in place of the effect added.
    log_bayes_factor : float
        Log evidence for it against the fit before the step.
    correlation : float
        Canonical correlation with the effect added: 1 if the data cannot tell them apart.
    beside : tuple of str, optional
        Effects that stand with it in that place: only together they explain the data.
    replaces : tuple of str, optional
        Effects of later steps that it makes needless as well.
    """

    effect: str
    estimate: Estimate
    log_bayes_factor: float
    correlation: float
    beside: tuple[str, ...] = ()
    replaces: tuple[str, ...] = ()


@dataclass(frozen=True)
class NamelessShape:
    """A signal that no effect of the library describes.

    Parameters
    ----------
    source : str
        Where it enters: "body torque", "rate sensor", "wheel torque", "tachometers"; and what it
        follows, as in "body torque that follows wheel momentum", where it follows something known.
    log_bayes_factor : float
        Log evidence for it against nothing.
    """

    source: str
    log_bayes_factor: float


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
    nameless : tuple of NamelessShape
        Shapes without a name, weighed against the fit before, best evidence first.
    compared : tuple of (str, float)
        Effects that were refitted in its place, and their log evidence.
    """

    added: str
    before: Estimate
    after: Estimate
    log_bayes_factor: float
    alternatives: tuple[AlternativeEffect, ...] = ()
    stochastic: bool = False
    nameless: tuple[NamelessShape, ...] = ()
    compared: tuple[tuple[str, float], ...] = ()


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
    """

    kind: Literal["nothing", "effects", "nameless", "others"]
    effects: tuple[str, ...]
    log_prior: float
    log_evidence: float
    probability: float = 0.0


@array_dataclass
class Diagnosis:
    """The answer.

    Parameters
    ----------
    verdict : {"consistent", "named", "ambiguous", "unknown"}
        What was found.
    named : tuple of str
        Effects added.
    ambiguous_with : tuple of tuple of str
        Sets of effects, the named one first, that this campaign cannot tell apart.
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
        Log evidence by which a disturbance without a name (of free shape, or in proportion to
        something known) explains the data better than what was named; -inf if nothing was.
    nameless_source : str
        Where that disturbance enters; empty if nothing was named.
    nameless_instead_of : int
        The first of the steps, from 0, in whose place it stands.
    treatment : DirtTreatment
        What was done about dirt in the telemetry; its level is `noise`.
    hypotheses : tuple of Hypothesis
        Possible answers, most probable first; their probabilities add up to one.
    displaced : tuple of Effect
        Effects of fixed shape that the search added before one without a fixed shape took their
        place. Where that one does not explain the data either, J and K are fitted with them.
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
    nameless_instead_of: int = 0
    treatment: DirtTreatment = field(default_factory=DirtTreatment)
    hypotheses: tuple[Hypothesis, ...] = ()
    displaced: tuple[Effect, ...] = ()

    @property
    def effects_added(self) -> tuple[Effect, ...]:
        """The effects of the steps, in their order, with the settings they were found with."""
        instances = {effect.name: effect for effect in self.final.model.effects}
        return tuple(instances[step.added] for step in self.steps)

    @property
    def beyond_prior(self) -> tuple[BeyondPrior, ...]:
        """Effects named that are larger than their priors allow."""
        names = tuple(step.added for step in self.steps if step.added in self.named)
        return beyond_prior(self.final, names, self.rules)

    @property
    def dirt(self) -> tuple[Dirt, ...]:
        """What is wrong with the telemetry, and what was done about it before the search."""
        done = replace(self.treatment, masked=(), colour=None)
        return records_of_dirt(self.final.model.campaign, done)
