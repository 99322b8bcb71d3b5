"""Effects without a fixed shape, and shapes without a name: their coefficients and significance.

A signal of unit size has coefficients c = T z, z standard normal; with size a the data are r = D a
T z + e beyond all that is fitted. With A = D^T P D and g = D^T P r, P projecting off the fit with
its priors, the log evidence against no signal is

    1/2 sum_i [ a^2 u_i^2 / (1 + a^2 l_i) - log(1 + a^2 l_i) ],

l the eigenvalues of T^T A T and u the gradient T^T g along its eigenvectors. It is averaged over
sizes and over shapes (a correlation time) with their prior. A fit takes the coefficients of two
slews as independent; here a process that goes on between slews is one over the campaign. Where a
process on knots can act, two rivals without a name can act as well: a signal that is smooth (a
squared-exponential kernel, of any length), and one that is the same in every slew.

Such an average has a mean of one without its signal, so that its p-value is at most one over it
(Markov's inequality). That bound is too cautious by a factor of about 20. The p-value itself is
simulated: of one candidate

    P(B >= b) = E[ 1(B >= b) / B ],

the expectation over campaigns that have the signal, drawn from its prior (importance sampling: such
a campaign is B times as probable with the signal as without). A thousand campaigns are enough for
any p-value, because all of them are near b or above it. That of the largest of several is at most
the sum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.special import logsumexp

from bayes_inertia.diagnosis.hypothesis_table import (
    Names,
    RandomMember,
    draw_coefficients,
    log_evidence_of_random,
)
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.result import Candidate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.marginal_posterior import prior_roots
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect, require_effects, require_of_effect
from bayes_inertia.physics.effects import REMAINDERS, STOCHASTIC
from bayes_inertia.physics.effects.scales import sd_and_time
from bayes_inertia.physics.effects.tachometer_noise_walk import TachometerNoiseWalk
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.processes import Process
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.stated_noise import stated_terms
from bayes_inertia.physics.stochastic_effect import StochasticEffect

NAMELESS = {
    "body torque": "nameless_body_torque",
    "wheel torque": "nameless_wheel_torque",
    "rate sensor": "nameless_rate_error",
    "tachometers": "nameless_tachometer_error",
    "star tracker": "nameless_star_tracker_error",
}


@array_dataclass
class ProjectedSignal:
    """Coefficients of all slews, everything fitted projected off.

    Parameters
    ----------
    gradient : (slews, k) array
        g, by slew.
    matrix : (slews, k, slews, k) array
        A: what is fitted in common couples slews.
    cross : (slews, k, c) array
        Their products with the columns of effects of a fixed shape.
    """

    gradient: np.ndarray
    matrix: np.ndarray
    cross: np.ndarray

    def repeated(self) -> ProjectedSignal:
        """The same if the coefficients are one draw for all slews."""
        return ProjectedSignal(
            self.gradient.sum(0, keepdims=True),
            self.matrix.sum((0, 2))[None, :, None],
            self.cross.sum(0, keepdims=True),
        )


def projected_signal(
    fit: LinearisedFit, columns: np.ndarray, others: np.ndarray
) -> tuple[ProjectedSignal, np.ndarray]:
    """Project everything fitted off a signal.

    `columns` (slews, numbers, k): changes of its whitened residuals by the coefficients of each
    slew. `others` (slews, numbers, c): columns of effects of a fixed shape. Returns: the signal;
    the share (unknowns, slews k) of each slew's columns that the fit imitates.
    """
    slews, _, k = columns.shape
    gradient, matrix = np.zeros((slews, k)), np.zeros((slews, k, slews, k))
    imitated = np.zeros((len(fit.inverse_root), slews, k))
    for s, own in enumerate(columns):
        gradient[s] = own.T @ fit.residual[s]
        matrix[s, :, s] = own.T @ own
        imitated[fit.index(s), s] = fit.columns[s].T @ own
    imitated = fit.inverse_root @ imitated.reshape(len(imitated), -1)
    matrix -= (imitated.T @ imitated).reshape(matrix.shape)
    fitted = (imitated.T @ fit.whitened_gradient).reshape(slews, k)
    cross = np.swapaxes(columns, 1, 2) @ others
    cross -= (imitated.T @ fit.imitated(others)).reshape(cross.shape)
    return ProjectedSignal(fitted - gradient, matrix, cross), imitated


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


# Where in a slew's signal chain an effect enters, in the words of `unexplained`.
SOURCES = {
    "body_torque": "body torque",
    "delivered_torque": "wheel torque",
    "rate_output": "rate sensor",
    "momentum_output": "tachometers",
    "attitude_output": "star tracker",
}

STOCHASTIC_CANDIDATES: tuple[StochasticEffect, ...] = tuple(
    e for e in STOCHASTIC if isinstance(e, StochasticEffect) and e not in REMAINDERS
)


def candidate_kinds(
    library: Sequence[Effect], stochastic: Sequence[Effect]
) -> tuple[tuple[Effect, ...], tuple[StochasticEffect, ...]]:
    """Candidates of a fixed shape, and those without one, whichever list they are given in."""
    library, stochastic = require_effects(library), require_effects(stochastic)
    every = (*stochastic, *library)
    random = {e.name: e for e in every if isinstance(e, StochasticEffect)}
    for effect in random.values():
        what = "acts where no random candidate is looked for"
        advice = f"give one that acts through {', '.join(SOURCES)}, or fit it by its name"
        require_of_effect(any(map(effect.acts, SOURCES)), effect, what, advice)
    fixed = (e for e in (*library, *stochastic) if not isinstance(e, StochasticEffect))
    return tuple(fixed), tuple(random.values())


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


def p_values_decide(weighed: Sequence[Candidate]) -> bool:
    """Whether bounds of the p-values leave open what is significant.

    Returns: false where the largest evidence is weak, or so clear that its bound is enough.

    Examples
    --------
    >>> of = [Candidate("torque_noise", 2, 2.0 * x, 0.1, x) for x in (0.5, 5.0, 50.0)]
    >>> [p_values_decide([candidate]) for candidate in of]
    [False, True, False]
    """
    largest = max((c.log_bayes_factor for c in weighed), default=0.0)
    return LIMITS.weak < largest < LIMITS.clear


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


def usable(
    effects: Sequence[StochasticEffect], model: Model, numbers: int
) -> tuple[StochasticEffect, ...]:
    """Those that the campaign can have and that are not fitted or stated already.

    `model`: of the fit. What its campaign states is integrated out at the stated size.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> [effect.name for effect in usable(STOCHASTIC_CANDIDATES[:1], Model(small_campaign()), 99)]
    ['rate_random_walk']
    """
    fitted = {effect.name for effect in model.structure.effects} | {*stated_terms(model.campaign)}
    campaign = model.campaign
    return tuple(
        effect
        for effect in effects
        if 0 < numbers * effect.coefficient_count(campaign) <= LIMITS.largest_columns
        and effect.parameters(campaign)
        and effect.name not in fitted
    )


def parameters_at(model: Model, effect: Effect, size: float, shape: float) -> np.ndarray:
    """An effect's parameters: so many medians in size, so many prior sds from them in shape."""
    part = model.space.slice_of(effect.name)
    values = model.space.mean[part]
    values[0] *= size
    values[1:] *= np.exp(shape * np.asarray(model.space.marginals()["scale"])[part][1:])
    return values


def roots_at(model: Model, shape: float) -> list[CandidateRoots]:
    """Roots of all random effects of a model, of size one, so many prior sds from their times."""
    theta = model.space.mean
    for effect in model.effects:
        part = model.space.slice_of(effect.name)
        theta[part] = parameters_at(model, effect, 1.0, shape)
    slews = model.data.contexts
    blocks = prior_roots(model.structure, theta, slews)
    active = model.structure.active_effects(jnp.asarray(theta))
    # Devices of the campaign, which have no coefficients, stand before them.
    pairs = zip(active, model.structure.coefficients, strict=False)
    random = [(e, p) for (e, p), n in pairs if n and isinstance(e, StochasticEffect)]
    return [
        candidate_roots(effect, p, slews, np.asarray(own))
        for (effect, p), own in zip(random, blocks, strict=True)
    ]


class Forms(NamedTuple):
    """What a random effect may look like.

    `roots`: of unit size; `shapes` [prior sd] and `log_odds` of each.
    """

    roots: list[np.ndarray]
    shapes: np.ndarray
    log_odds: np.ndarray


def forms_of(effect: StochasticEffect, model: Model, roots: Sequence[CandidateRoots]) -> Forms:
    """All forms that an effect may have; `roots` are its own at each of `LIMITS.shapes`.

    What goes on between slews, such as a gyro's bias, may last longer than a slew, and may begin
    anew in each, where it was measured before: a stationary process is the neighbour of a walk. An
    error of the rates that is one draw a slew, as a drift that restarts, may be the same in all
    slews: both are as probable. The star tracker's is `star_tracker_shift` then.
    """
    part, lasts = model.space.slice_of(effect.name), roots[0].across is not None
    shapes = np.array(LIMITS.shapes) if part.stop - part.start > 1 else np.zeros(1)
    shapes = shapes if lasts else shapes[shapes <= LIMITS.longest_in_slew]
    on = [own.best for own in roots[: len(shapes)]]
    # A time that nobody stated is a guess: beyond what is thought of all are as probable.
    odds = -0.5 * np.minimum(shapes, LIMITS.longest_in_slew) ** 2
    if lasts:
        long = (shapes == shapes[-1]) | (shapes >= LIMITS.longest_in_slew)
        other = [own.anew for own, kept in zip(roots, long, strict=False) if kept]
    elif roots[0].blocks.shape[-1] == 1 and effect.acts("rate_output"):
        long = np.full(len(shapes), True)
        other = [own.repeated for own in roots[: len(shapes)]]
    else:
        return Forms(on, shapes, odds)
    more = odds[long] + logsumexp(odds) - logsumexp(odds[long])
    return Forms([*on, *other], np.append(shapes, shapes[long]), np.append(odds, more))


def largest_size(effect: StochasticEffect, model: Model) -> float:
    """The largest size that the prior of an effect has, in medians."""
    scale = np.asarray(model.space.marginals()["scale"])[model.space.slice_of(effect.name).start]
    return float(np.exp(LIMITS.largest_random_size * scale))


def smooth_roots(blocks: np.ndarray) -> list[np.ndarray]:
    """Roots (slews, b, m, m) of squared-exponential kernels of the same mean variance."""
    m = blocks.shape[-1]
    sd = np.sqrt(np.mean(np.sum(blocks**2, -1)))
    apart = np.subtract.outer(np.arange(m), np.arange(m))
    roots = []
    for length in np.geomspace(LIMITS.shortest, m, LIMITS.lengths):
        kernel = np.exp(-0.5 * (apart / length) ** 2) + LIMITS.jitter * np.eye(m)
        roots.append(np.broadcast_to(sd * np.linalg.cholesky(kernel), blocks.shape))
    return roots


@array_dataclass
class CandidateRoots:
    """Of one effect.

    Parameters
    ----------
    blocks : (slews, b, m, m) array
        Of each slew, where slews are independent: the diagonal blocks.
    across : (slews m, slews m) array or None
        Of one block in all slews, where these are one process.
    """

    blocks: np.ndarray
    across: np.ndarray | None = None

    @property
    def anew(self) -> np.ndarray:
        """Of the process less its first value in each slew (slews, b m, b m)."""
        return dense(self.blocks - self.blocks[..., :1, :])

    @property
    def repeated(self) -> np.ndarray:
        """Of all slews (slews b m, slews b m), where one draw is that of each of them."""
        slews = len(self.blocks)
        return np.kron(np.ones((slews, 1)) * np.eye(1, slews), dense(self.blocks)[0])

    @property
    def best(self) -> np.ndarray:
        """Of all slews (slews b m, slews b m) where they are one process, else of each."""
        if self.across is None:
            return dense(self.blocks)
        n, b, m, _ = self.blocks.shape
        across = self.across.reshape(n, m, n, m)
        return np.einsum("smtk,ij->simtjk", across, np.eye(b)).reshape(n * b * m, n * b * m)


def candidate_roots(
    effect: StochasticEffect, p: Mapping[str, Array], slews: SlewContext, blocks: np.ndarray
) -> CandidateRoots:
    """The roots of an effect.

    `blocks` (slews, b, m, m).
    """
    across = effect.covariance_across_slews(p, slews)
    if across is None:
        return CandidateRoots(blocks)
    covariance = np.asarray(across)
    floor = LIMITS.jitter * np.trace(covariance) / len(covariance)
    return CandidateRoots(blocks, np.linalg.cholesky(covariance + floor * np.eye(len(covariance))))


def dense(blocks: np.ndarray) -> np.ndarray:
    """Block-diagonal matrices of their diagonal blocks.

    `blocks` (slews, b, m, m). Returns (slews, b m, b m).

    Examples
    --------
    >>> dense(np.ones((1, 2, 1, 1)))[0].tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    slews, b, m, _ = blocks.shape
    return np.einsum("simk,ij->simjk", blocks, np.eye(b)).reshape(slews, b * m, b * m)


@dataclass(frozen=True)
class TachometerShape(TachometerNoiseWalk):
    """An error of the tachometers on knots: the shape without a name where no effect has knots."""

    name: ClassVar[str] = "tachometer_shape"

    def parameters(self, campaign):
        sigma = [wheel.momentum_sigma for wheel in campaign.wheels if wheel.momentum_sigma]
        return sd_and_time(campaign, "N m s", max(sigma), None, 1.5) if sigma else ()

    def reading_noise(self, p):
        return Process("momentum", p["sd"], p["time"], self.knots)
