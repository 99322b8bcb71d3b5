"""Score tests of candidate effects: what each would do to the residuals, beyond all that is fitted.

The sensitivities of every candidate's parameters at their null are projected off the fitted
parameters and nuisances. With u the projected gradient and S the projected normal matrix, both in
units of the candidates' prior sd, u^T S^-1 u is the score statistic (Rao 1948): chi^2 with its rank
as degrees of freedom if the effect is absent. Directions in which a prior-sized effect would move
the residuals by less than one sigma in all are not counted: this campaign cannot see them.

What has no fixed shape has no score, but the Bayes factor of a random signal. It has a mean of one
where there is no signal, so that its p-value is at most one over it (Markov's inequality). That
bound is too cautious by a factor of about 20. The p-value itself is simulated: of one candidate

    P(B >= b) = E[ 1(B >= b) / B ],

the expectation over campaigns that have the signal, drawn from its prior (importance sampling: such
a campaign is B times as probable with the signal as without). A thousand campaigns are enough for
any p-value, because all of them are near b or above it. That of the largest of several is at most
the sum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.special import logsumexp

from bayes_inertia.diagnosis.candidates import FlexibleModeCandidate
from bayes_inertia.diagnosis.hypothesis_table import (
    Names,
    RandomMember,
    draw_coefficients,
    log_evidence_of_random,
    visible,
)
from bayes_inertia.diagnosis.limits import LIMITS, Rules
from bayes_inertia.diagnosis.linear_system import LinearModel
from bayes_inertia.diagnosis.result import Candidate
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import Point
from bayes_inertia.inference.noise_model import log_normalisation
from bayes_inertia.inference.objective import negative_log_posterior, prior_equations
from bayes_inertia.maths.linear_algebra import canonical_correlation, inverse_root
from bayes_inertia.maths.values import array_dataclass


def log_evidence_of_fit(estimate: Estimate) -> float:
    """Compute the log density of the data under a fit's model, everything integrated out.

    By Laplace's approximation around the fit itself. Fits whose noise differs can be compared.

    Returns: up to a constant that all models of the same readings share; -inf where the fit has no
    end.
    """
    if not np.isfinite(estimate.objective):
        return -np.inf
    precision, _ = prior_equations(estimate.model, estimate.theta, estimate.free)
    priors, of_fit = (float(np.linalg.slogdet(x)[1]) for x in (precision, estimate.hessian))
    norms = log_normalisation(estimate.model, estimate.white)
    return norms - estimate.objective + 0.5 * (priors - of_fit)


class Sampled(NamedTuple):
    """Laplace's approximation of a fit checked by importance sampling.

    `sampled_gain`: log evidence by it, less Laplace's; `pareto_k`: shape of the tail of its
    weights, below 0.7 where the gain can be relied on (Vehtari et al. 2024).
    """

    sampled_gain: float
    pareto_k: float


def sampled_evidence(estimate: Estimate, rng: np.random.Generator) -> Sampled | None:
    """Draw all unknowns of a fit from Laplace's approximation and weigh them by their posterior.

    Returns: none where most draws are impossible.
    """
    model, point, free = estimate.model, estimate.point, estimate.free
    f, b = len(free), len(point.bias)
    z = rng.standard_normal((LIMITS.importance_draws, len(estimate.hessian)))
    log_weights = []
    for own, step in zip(z, z @ inverse_root(estimate.hessian), strict=True):
        theta = point.theta.copy()
        theta[free] += step[:f]
        if np.any((theta < model.space.lower) | (theta > model.space.upper)):
            continue
        local = point.local + step[f + b :].reshape(point.local.shape)
        drawn = Point(theta, point.bias + step[f : f + b], local)
        lost = negative_log_posterior(model, drawn, estimate.white) - estimate.objective
        log_weights.append(0.5 * own @ own - lost)
    possible = np.array(log_weights)[np.isfinite(log_weights)]
    if len(possible) < LIMITS.importance_draws // 4:
        return None
    gain = logsumexp(possible) - np.log(len(z))
    return Sampled(float(gain), pareto_k(possible))


def pareto_k(log_weights: np.ndarray) -> float:
    """Shape of the upper tail of importance weights, of their logarithms (n,); inf where unknown.

    >>> pareto_k(np.zeros(128))
    0.0
    """
    from arviz_stats.base import array_stats

    # It takes the log likelihoods that leaving-one-out divides by. One weight beyond all others
    # has no shape.
    with np.errstate(all="ignore"), suppress(ValueError):
        return float(np.nan_to_num(array_stats.psislw(-log_weights)[1], nan=np.inf))
    return 0.0  # the largest are equal: no tail


@array_dataclass
class ScoreTests:
    """Projected sensitivities of all candidates, in units of prior sd, and their score tests.

    Parameters
    ----------
    names : tuple of str
        Of the candidates.
    indices : tuple of (n,) array of int
        Where each candidate's n parameters stand among all c.
    one_sided : tuple of bool
        Whether a candidate is one parameter that cannot be negative.
    gradient : (c,) array
        The projected gradient u.
    matrix : (c, c) array
        The projected normal matrix S.
    nonlinear : mapping
        Candidates that are not linear in their parameters, by name. They were scored already.
    """

    names: tuple[str, ...]
    indices: tuple[np.ndarray, ...]
    one_sided: tuple[bool, ...]
    gradient: np.ndarray
    matrix: np.ndarray
    nonlinear: Mapping[str, FlexibleModeCandidate]

    def dof(self, k: int) -> int:
        """Count the degrees of freedom of a score."""
        nonlinear = self.nonlinear.get(self.names[k])
        return len(visible(self.matrix, self.indices[k])[0]) if nonlinear is None else nonlinear.dof

    def score(self, k: int, gradient: np.ndarray | None = None) -> np.ndarray:
        """Compute the score statistic of a candidate.

        `gradient` (..., c): other gradients than that of the data; a nonlinear candidate has one
        score only. Returns (...): chi^2 with `dof(k)` degrees of freedom if the effect is absent.
        """
        if self.names[k] in self.nonlinear:
            return np.asarray(self.nonlinear[self.names[k]].score)
        gradient = self.gradient if gradient is None else gradient
        powers, directions = visible(self.matrix, self.indices[k])
        along = gradient[..., self.indices[k]] @ directions
        if self.one_sided[k]:
            along = np.maximum(along * np.sign(directions.sum(0)), 0.0)
        return np.sum(along**2 / powers, axis=-1)

    def p_value(self, k: int, score: np.ndarray) -> np.ndarray:
        """Compute the probability of at least this score if the effect is absent.

        It is 1 if the campaign cannot see the effect, halved if the effect is one-sided, and
        Sidak's if it is the best of many.
        """
        dof = self.dof(k)
        if dof == 0:
            return np.ones_like(score)
        sides = 0.5 if self.one_sided[k] else 1.0
        # Every score is at least zero, which is what an effect of the other sign has.
        single = np.where(np.asarray(score) > 0, sides * stats.chi2.sf(score, dof), 1.0)
        nonlinear = self.nonlinear.get(self.names[k])
        trials = 1 if nonlinear is None else nonlinear.trials
        return -np.expm1(trials * np.log1p(-np.minimum(single, 1.0 - 1e-16)))

    def canonical_correlation(self, j: int, k: int) -> float:
        """Compute the largest correlation between what two candidates can do.

        Returns: 1 means that the data cannot tell them apart.
        """
        both = np.concatenate([self.indices[j], self.indices[k]])
        return canonical_correlation(self.matrix[np.ix_(both, both)], len(self.indices[j]))

    @property
    def correlations(self) -> dict[tuple[str, str], float]:
        """Canonical correlations of all pairs of linear candidates."""
        linear = [k for k, name in enumerate(self.names) if name not in self.nonlinear]
        return {
            (self.names[j], self.names[k]): self.canonical_correlation(j, k)
            for j, k in combinations(linear, 2)
        }

    def threshold(
        self, false_alarms: float, rng: np.random.Generator, draws: int = 20_000, further: int = 0
    ) -> float:
        """Find the p-value below which a candidate is significant among all.

        By simulation of the joint distribution of all scores, so that correlated candidates do
        not cost double.

        `false_alarms`: probability that the smallest of all p-values falls below it if no effect is
        present. `further`: tests beside these whose p-values are bounds: each is counted with its
        full share.
        """
        values, vectors = np.linalg.eigh(self.matrix)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        gradients = rng.standard_normal((draws, root.shape[1])) @ root.T
        smallest = np.ones(draws)
        for k in range(len(self.names)):
            # The best of many was chosen by these data: what matters of it is that its corrected
            # p-value is uniform.
            p = (
                rng.uniform(size=draws)
                if self.names[k] in self.nonlinear
                else self.p_value(k, self.score(k, gradients))
            )
            smallest = np.minimum(smallest, p)
        # From zero on: of candidates that the campaign cannot see every p-value is one.
        smallest = np.append(0.0, np.sort(smallest))
        alarms = np.append(0.0, np.linspace(0.0, 1.0, draws)) + further * smallest
        return float(np.interp(false_alarms, alarms, smallest))


def score_tests(linear: LinearModel) -> ScoreTests:
    """Score all effects of a linear model against all that is fitted."""
    members, mode = linear.members, linear.mode
    n = linear.columns.shape[-1]
    return ScoreTests(
        names=tuple(m.name for m in members),
        indices=tuple(m.columns for m in members),
        one_sided=tuple(m.one_sided for m in members),
        gradient=linear.system.gradient[:n],
        matrix=linear.system.matrix[:n, :n],
        nonlinear={} if mode is None else {mode.name: mode},
    )


def scored(
    linear: LinearModel,
    random: Sequence[RandomMember],
    log_evidence: Mapping[Names, float],
    rules: Rules,
    rng: np.random.Generator,
    log_costs: Mapping[str, float],
) -> tuple[tuple[Candidate, ...], float]:
    """All candidates, best evidence first, and the p-value below which one is significant.

    Their evidence is that of their rows of the table. `log_costs`: of those that were searched for
    among many, whose p-values count as many tests (Bonferroni, weighted by their prior
    probabilities).
    """
    tests = score_tests(linear)
    threshold = tests.threshold(rules.false_alarm_probability, rng, further=LIMITS.random_tests)
    fixed = []
    for k, name in enumerate(tests.names):
        score = tests.score(k)
        p_value = float(tests.p_value(k, score)) * float(np.exp(log_costs.get(name, 0.0)))
        value = log_evidence[frozenset([name])]
        fixed.append(Candidate(name, tests.dof(k), float(score), min(1.0, p_value), value))
    found = random_candidates(random, log_evidence)
    largest = max((c.log_bayes_factor for c in found), default=0.0)
    # Where the largest evidence is weak, or so clear that its bound is enough, bounds decide.
    bounded = not LIMITS.weak < largest < LIMITS.clear
    if not bounded and not any(c.p_value < threshold for c in fixed):
        found = with_p_values(found, random, rng.spawn(1)[0])
    return tuple(sorted((*fixed, *found), key=lambda row: -row.log_bayes_factor)), threshold


def random_candidates(
    members: Sequence[RandomMember], log_evidence: Mapping[Names, float]
) -> tuple[Candidate, ...]:
    """List the effects without a fixed shape; their evidence is that of their rows of the table.

    Degrees of freedom are their parameters, a score is twice the log evidence, a p-value an upper
    bound by Markov's inequality: the expectation of a Bayes factor is one.
    """
    rows = []
    for member in members:
        if member.starts is not None:
            value = log_evidence[frozenset([member.name])]
            score, dof = 2.0 * max(value, 0.0), member.starts.shape[1]
            rows.append(Candidate(member.name, dof, score, float(np.exp(-0.5 * score)), value))
    return tuple(rows)


def with_p_values(
    weighed: Sequence[Candidate], members: Sequence[RandomMember], rng: np.random.Generator
) -> tuple[Candidate, ...]:
    """Simulate how probable such evidence is where nothing is random.

    `members`: at the fit. Returns: the same with p-values; in campaigns of very many slews they
    stay bounds, to save memory.
    """
    effects = [member for member in members if member.starts is not None]
    if not effects or any(member.matrix is None for member in effects):
        return tuple(weighed)
    p_values = p_values_of_largest(effects, np.array([c.log_bayes_factor for c in weighed]), rng)
    return tuple(replace(c, p_value=float(p)) for c, p in zip(weighed, p_values, strict=True))


def p_values_of_largest(
    members: Sequence[RandomMember],
    log_bayes_factors: np.ndarray,
    rng: np.random.Generator,
    draws: int = LIMITS.draws,
) -> np.ndarray:
    """Probability that any Bayes factor is so large where nothing is random, at most.

    `log_bayes_factors` (m,). Returns (m,): the sum over the members, each simulated by itself.
    """
    asked, total = np.asarray(log_bayes_factors)[:, None], np.zeros(len(log_bayes_factors))
    for member in members:
        assert member.matrix is not None
        drawn = draw_coefficients(member, rng, draws)
        powers, along = np.linalg.eigh(member.matrix)
        sd = np.sqrt(np.maximum(powers, 0.0))[:, None]
        noise = along @ (sd * rng.standard_normal(drawn.shape))
        evidence = logsumexp(log_evidence_of_random(member, member.matrix @ drawn + noise), axis=0)
        total += np.mean((evidence >= asked) * np.exp(-evidence), axis=1)
    return np.minimum(total, 1.0)
