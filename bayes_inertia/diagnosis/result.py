"""A diagnosis: what was scored, what was added step by step, and the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.residual_tests import ChannelTest

NOISE = "noise_level"


@dataclass(frozen=True)
class Candidate:
    """One candidate at the base fit: `score` is chi^2 with `dof` if the effect is absent; `log_bayes_factor` to first order."""

    effect: str
    dof: int
    score: float
    p_value: float
    log_bayes_factor: float


@dataclass(frozen=True)
class Rival:
    """An effect that explains the data about as well as the one added in its place: the fit with it, its log evidence, canonical correlation of the two."""

    effect: str
    after: Estimate
    log_bayes_factor: float
    correlation: float


@dataclass(frozen=True)
class Step:
    """One effect added: the fits before and after, and others that explain the data as well."""

    added: str
    before: Estimate
    after: Estimate
    log_bayes_factor: float
    alternatives: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """The answer.

    Attributes
    ----------
    verdict : "consistent", "named", "ambiguous" or "unknown". named : effects added (and `noise_level`).
    ambiguous_with : sets of effects, the named one first, that this campaign cannot tell apart.
    candidates : all candidates, scored at the base fit. threshold : p-value below which one is significant.
    steps : what was added. base, final : the fits with nothing and with everything added.
    noise : factor by which each channel's noise exceeds what is stated. tests : of the final residuals, at that noise.
    skipped : candidates that could not be tried, and why. correlations : canonical ones, of pairs of candidates.
    why_unknown : "misfit" (the residuals are not explained), "imitation" (effects added would explain them, but something of
        free shape does so better), or "".
    nameless_lead : log evidence by which something without a name explains the data better than what was named; -inf if nothing was.
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
    skipped: tuple[tuple[str, str], ...] = ()
    correlations: dict[tuple[str, str], float] = field(default_factory=dict)
    why_unknown: str = ""
    nameless_lead: float = -math.inf
