"""Log evidence of sets of effects, all from one linear model: one Gram matrix and one gradient.

At a fit, everything fitted projected off, the data are r = X a + (random signals) + unit noise. The
columns X of all effects have the Gram matrix S = X^T X and the gradient u = X^T r. A set whose
amplitudes have the prior covariance W W^T has the log evidence against nothing

    1/2 [ u^T W (1 + W^T S W)^-1 W^T u - log det (1 + W^T S W) ].

Each member has a size of its own, over which the evidence is averaged: at the stated one alone an
effect of which little is needed would be punished for all that might have been there (Lindley's
paradox). Sizes are log-uniform from what the campaign can just not see up to the stated prior, a
mixture of g-priors (Liang et al. 2008), and with a small probability beyond it, so that a strong
effect pays once for its unlikely size, and not with the square of it. An effect's directions share
one size, or each has its own (one bad wheel of three): both are as probable.

To take a member of known size into a set is to condition S and u on it, so that a set is weighed
member by member: for a random signal of hundreds of coefficients that leaves a matrix as small as
that of the effects. Beforehand it is as likely as not that nothing is missing; sets of one size are
alike (Scott and Berger, Annals of Statistics 38, 2010).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaln, log_ndtr, logsumexp

from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.maths.numerics import NUMERICS
from bayes_inertia.maths.values import array_dataclass


def log_prior_of_set(size: int, members: int) -> float:
    """Log probability beforehand of one set of effects.

    `members`: how many there are to choose from; "no name" is one of them.

    Examples
    --------
    >>> [round(float(np.exp(log_prior_of_set(size, 10))), 4) for size in (0, 1, 2)]
    [0.5, 0.045, 0.001]
    """
    if size == 0:
        return float(np.log(1.0 - LIMITS.missing))
    choices = gammaln(members + 1) - gammaln(size + 1) - gammaln(members - size + 1)
    of_size = LIMITS.missing * (1.0 - LIMITS.further) * LIMITS.further ** (size - 1)
    return float(np.log(of_size) - choices)


def smallest_size(powers: np.ndarray, largest: float) -> float:
    """The size that a campaign can just not see, from which sizes are tried.

    `powers` (n,): information along the directions of an effect of size one.

    Examples
    --------
    >>> round(smallest_size(np.array([1.0, 900.0]), 1.0), 6), smallest_size(np.array([1.0]), 1.0)
    (0.01, 0.1)
    """
    strongest = max(float(powers.max(initial=0.0)), 1e-300)
    return float(min(LIMITS.invisible / np.sqrt(strongest), LIMITS.largest_start * largest))


def few_sizes(powers: np.ndarray, largest: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Sizes to average evidence over, even in their logarithm, and their weights.

    `powers` (n,): information along the directions of a signal of size one. Returns `sizes,
    weights`: `count` from what a campaign can just not see on, and few beyond the prior.

    Examples
    --------
    >>> sizes, weights = few_sizes(np.array([9.0]), 1.0, 4)
    >>> sizes.round(2).tolist(), float(weights.sum().round(6))
    ([0.1, 0.22, 0.46, 1.0, 2.15, 6.81, 21.54, 68.13], 1.0)
    """
    stated = np.geomspace(smallest_size(powers, largest), largest, count)
    wider = np.geomspace(largest, LIMITS.widest * largest, LIMITS.wider_sizes + 1)
    wider = wider[2 :: LIMITS.fewer]
    each = [(1.0 - LIMITS.wrong_prior) / count, LIMITS.wrong_prior / LIMITS.wider_sizes]
    each[1] = LIMITS.fewer * each[1]
    return np.concatenate([stated, wider]), np.repeat(each, [count, len(wider)])


# What each member of a set stands for.
Names = frozenset[str]


@array_dataclass
class System:
    """The linear model of all effects of a fixed shape.

    Parameters
    ----------
    matrix : (c, c) array
        S, columns in units of prior sd.
    gradient : (c,) array
        u.

    Further columns may stand for what the effects move: conditioned along, they are never members.
    """

    matrix: np.ndarray
    gradient: np.ndarray


@array_dataclass
class FixedMember:
    """An effect of a fixed shape.

    Parameters
    ----------
    name : str
        Of the effect.
    index : (n,) array of int
        Its amplitudes among the columns.
    shape : (m,) array of int
        Columns that give it its shape, of prior sd one whatever its size.
    sizes, weights : (g,) arrays
        Sizes to average over [prior sd], and their probabilities.
    one_sided : bool
        Whether it is one amplitude that cannot be negative.
    log_cost : float
        What its search cost, as that over a mode's frequencies.
    log_elsewhere : float
        Log evidence, with its probability, of what the search found no trace of: the same effect
        may act there.
    """

    name: str
    index: np.ndarray
    shape: np.ndarray
    sizes: np.ndarray
    weights: np.ndarray
    one_sided: bool = False
    log_cost: float = 0.0
    log_elsewhere: float = -np.inf

    @property
    def all_sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """Sizes (g,) of its columns and their log weights; zero where it acts without a trace."""
        found = np.log(self.weights) - self.log_cost
        if np.isneginf(self.log_elsewhere):
            return self.sizes, found
        return np.append(self.sizes, 0.0), np.append(found, self.log_elsewhere)

    @property
    def columns(self) -> np.ndarray:
        """All its columns, in the order of its parameters."""
        return np.sort(np.concatenate([self.index, self.shape]))


def visible(matrix: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The directions of an effect that a campaign can see.

    `matrix` (c, c): S. `index` (n,): the effect's columns. Returns `powers` (r,): signal-to-noise
    power of an effect of prior size; `directions` (n, r): unit vectors.
    """
    powers, directions = np.linalg.eigh(matrix[np.ix_(index, index)])
    seen = powers > NUMERICS.visible_power
    return powers[seen], directions[:, seen]


@array_dataclass
class Signal:
    """One form of a random signal: independent directions of unit prior variance at size one.

    Parameters
    ----------
    powers : (m,) array
        Information along each.
    basis : (n, m) array
        Its coefficients by unit values along each; (0, m) where it is not kept, to save memory.
    cross : (m, c) array
        Product of each with the columns of the effects.
    gradient : (m,) array
        Product of each with the residuals.
    sizes, weights : (g,) arrays
        Sizes to average over, and their probabilities.
    """

    powers: np.ndarray
    basis: np.ndarray
    cross: np.ndarray
    gradient: np.ndarray
    sizes: np.ndarray
    weights: np.ndarray


def signal_of(
    matrix: np.ndarray, gradient: np.ndarray, cross: np.ndarray, root: np.ndarray, largest: float
) -> Signal:
    """One form of a random signal, along its independent directions.

    `matrix` (n, n), `gradient` (n,), `cross` (n, c): of its coefficients, everything fitted
    projected off. `root` (n, n): of their covariance at size one. `largest`: size that its prior
    has.
    """
    powers, vectors = np.linalg.eigh(root.T @ matrix @ root)
    powers, basis = np.maximum(powers, 0.0), root @ vectors
    sizes = few_sizes(powers, largest, LIMITS.random_sizes)
    return Signal(powers, basis, basis.T @ cross, basis.T @ gradient, *sizes)


@array_dataclass
class RandomMember:
    """An effect without a fixed shape, or a shape without a name.

    Parameters
    ----------
    name : str
        Of the effect, or of the shape.
    signals : sequence of Signal
        Forms that it may have, each as probable: correlation times, kernels.
    log_odds : (signals,) array
        Log prior odds of these.
    starts : (b, h) array or None
        Parameters of the effect at each of its forms and sizes; none of a shape without a name.
    matrix : (n, n) array or None
        Gram matrix of its coefficients; None where it is not kept, to save memory.
    """

    name: str
    signals: Sequence[Signal]
    log_odds: np.ndarray
    starts: np.ndarray | None = None
    matrix: np.ndarray | None = None

    @property
    def log_shares(self) -> np.ndarray:
        """Log prior probabilities (signals,) of its forms."""
        return self.log_odds - logsumexp(self.log_odds)

    @property
    def likely_start(self) -> np.ndarray:
        """Parameters (h,) of the effect where its evidence is largest."""
        assert self.starts is not None
        return self.starts[np.argmax(log_evidence_of_random(self))]


class Given(NamedTuple):
    """The linear model given members of known sizes, one entry for each combination of sizes.

    Parameters
    ----------
    log_weight : (b,) array
        Log evidence of the combination, its prior probability included.
    matrix : (b, c, c) array
        S beyond these members.
    gradient : (b, c) array
        u beyond them.
    """

    log_weight: np.ndarray
    matrix: np.ndarray
    gradient: np.ndarray


def nothing(system: System) -> Given:
    """The linear model given that nothing acts."""
    return Given(np.zeros(1), system.matrix[None], system.gradient[None])


def given_fixed(before: Given, member: FixedMember, *, likely: bool = False) -> Given:
    """The linear model given one effect more, at each of its sizes.

    `likely`: only combinations of sizes that count.
    """
    (sizes, log_weights), index = member.all_sizes, np.concatenate([member.index, member.shape])
    sd = np.ones((len(sizes), len(index)))
    sd[:, : len(member.index)] = sizes[:, None]
    block = before.matrix[:, index][:, :, index]
    inner = sd[:, :, None] * block[:, None] * sd[:, None, :] + np.eye(len(index))
    root = np.linalg.cholesky(inner)
    along = np.linalg.solve(root, (sd * before.gradient[:, None, index])[..., None])[..., 0]
    gain = 0.5 * np.sum(along**2, -1) - np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(-1)
    if member.one_sided:
        gain = gain + _log_share_above(sd[:, 0], before, index[0])
    weight = before.log_weight[:, None] + gain + log_weights
    # Matrices of what counts alone: of all combinations they would take gigabytes.
    b, size = np.nonzero(_counts(weight) if likely else np.ones_like(weight))
    rows = np.linalg.solve(root[b, size], sd[size][:, :, None] * before.matrix[b][:, index])
    matrix = before.matrix[b]
    matrix -= np.swapaxes(rows, -1, -2) @ rows
    gradient = before.gradient[b] - (along[b, size][:, None, :] @ rows)[:, 0]
    return Given(weight[b, size], matrix, gradient)


def _counts(weight: np.ndarray) -> np.ndarray:
    """Whether combinations of sizes with these log weights count; all of few do."""
    few = weight.size <= LIMITS.many_sizes
    return np.full(weight.shape, few) | (weight > logsumexp(weight) - LIMITS.negligible_sizes)


def _log_share_above(size: np.ndarray, before: Given, i: int) -> np.ndarray:
    """Log of what a prior of one sign gains (b, g): twice the probability of that sign."""
    power, gradient = before.matrix[:, i, i, None], before.gradient[:, i, None]
    return np.log(2.0) + log_ndtr(size * gradient / np.sqrt(1.0 + size**2 * power))


def given_random(system: System, member: RandomMember) -> Given:
    """The linear model given a random signal, at each of its forms and sizes."""
    parts = []
    for signal, log_odds in zip(member.signals, member.log_shares, strict=True):
        shares, cross = _shares(signal), signal.cross
        matrix = np.array([cross.T @ (share[:, None] * cross) for share in shares])
        gradient = system.gradient - (shares * signal.gradient) @ cross
        parts.append(Given(_gains(signal) + log_odds, system.matrix - matrix, gradient))
    return Given(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _shares(signal: Signal) -> np.ndarray:
    """Posterior variance (g, m) of each direction at each size."""
    variance = signal.sizes[:, None] ** 2
    return variance / (1.0 + variance * signal.powers)


def _gains(signal: Signal, gradient: np.ndarray | None = None) -> np.ndarray:
    """Log evidence (g, ...) at each size, its probability included; of other gradients (n, k)."""
    along = signal.gradient if gradient is None else signal.basis.T @ gradient
    seen = np.log1p(signal.sizes[:, None] ** 2 * signal.powers).sum(1)
    return ((0.5 * (_shares(signal) @ along**2).T - 0.5 * seen) + np.log(signal.weights)).T


def log_evidence_of_random(member: RandomMember, gradient: np.ndarray | None = None) -> np.ndarray:
    """Log evidence (b,) of a random signal at each of its forms and sizes, with probabilities.

    `gradient` (n, k): others than that of the data; then (b, k).
    """
    gains = [
        _gains(signal, gradient) + log_odds
        for signal, log_odds in zip(member.signals, member.log_shares, strict=True)
    ]
    return np.concatenate(gains)


def draw_coefficients(member: RandomMember, rng: np.random.Generator, k: int) -> np.ndarray:
    """Coefficients (n, k) of k signals drawn from the prior."""
    weights = [
        s.weights * np.exp(x) for s, x in zip(member.signals, member.log_shares, strict=True)
    ]
    chosen = rng.choice(sum(map(len, weights)), k, p=np.concatenate(weights))
    drawn, first = np.zeros((len(member.signals[0].basis), k)), 0
    for signal in member.signals:
        own = (chosen >= first) & (chosen < first + len(signal.sizes))
        size = signal.sizes[chosen[own] - first]
        normal = rng.standard_normal((len(signal.powers), len(size)))
        drawn[:, own] = signal.basis @ (size * normal)
        first += len(signal.sizes)
    return drawn


def _gain_at_size(given: Given) -> np.ndarray:
    """Log evidence (b,) of all columns at prior sds of one."""
    inner = given.matrix + np.eye(given.matrix.shape[-1])
    along = np.linalg.solve(inner, given.gradient[..., None])[..., 0]
    return 0.5 * (np.sum(given.gradient * along, -1) - np.linalg.slogdet(inner)[1])


def log_evidence_with(given: Given, member: FixedMember) -> float:
    """Log evidence of the members given and one effect more, averaged over all sizes.

    Its directions share one size, or each has its own: both are as probable.
    """
    if len(member.shape):
        unit = FixedMember("", member.shape, member.index[:0], np.ones(1), np.ones(1))
        given = given_fixed(given, unit)
    block = given.matrix[:, member.index][:, :, member.index]
    powers, directions = np.linalg.eigh(block)
    along = np.einsum("bji,bj->bi", directions, given.gradient[:, member.index])
    variance = member.sizes[:, None] ** 2
    seen = 1.0 + variance * np.maximum(powers, 0.0)[:, None]
    values = 0.5 * (variance * along[:, None] ** 2 / seen - np.log(seen))
    if member.one_sided:
        values = values + _log_share_above(member.sizes, given, member.index[0])[..., None]
    together = logsumexp(values.sum(-1), b=member.weights, axis=1)
    each = logsumexp(values, b=member.weights[:, None], axis=1).sum(-1)
    found = np.logaddexp(together, each) - np.log(2.0) - member.log_cost
    of_member = np.logaddexp(found, member.log_elsewhere)
    return float(logsumexp(given.log_weight + of_member))


def fixed_member(
    name: str, index: np.ndarray, shape: np.ndarray, matrix: np.ndarray, **more: Any
) -> FixedMember:
    """A member whose columns `index` have the Gram matrix `matrix`; `more`: as `FixedMember`."""
    powers = np.linalg.eigvalsh(matrix[np.ix_(index, index)])
    return FixedMember(name, index, shape, *few_sizes(powers, 1.0, LIMITS.fixed_sizes), **more)


def log_evidence_of_columns(gradient: np.ndarray, matrix: np.ndarray) -> float:
    """Log evidence for amplitudes (c,) in units of their prior sd, averaged over sizes.

    Examples
    --------
    >>> [log_evidence_of_columns(np.array([u]), np.array([[100.0]])) > 0.0 for u in (60.0, 3.0)]
    [True, False]
    """
    every = np.arange(len(gradient))
    member = fixed_member("", every, every[:0], matrix)
    return log_evidence_with(nothing(System(matrix, gradient)), member)


def evidence_of_sets(
    system: System,
    fixed: Sequence[FixedMember],
    random: Sequence[RandomMember] = (),
    largest: int = 3,
    fitted: Names = frozenset(),
) -> dict[Names, float]:
    """Weigh sets of up to `largest` effects, larger ones by extension of the best.

    `fitted`: the set that the model was linearised at: it is weighed whatever its parts are worth.
    Returns: log evidence against nothing of nothing, every single member, every pair with at most
    one random member, and larger sets best first; random members beside the best sets.

    Examples
    --------
    >>> S, u = np.diag([100.0, 100.0]), np.array([60.0, 3.0])
    >>> sizes, even = np.geomspace(0.03, 1.0, 8), np.full(8, 1.0 / 8)
    >>> a, b = (FixedMember(n, np.array([i]), np.array([], int), sizes, even)
    ...         for i, n in enumerate("ab"))
    >>> values = evidence_of_sets(System(S, u), [a, b])
    >>> max(values, key=values.get) == {"a"}, len(values)
    (True, 4)
    """
    members, begin = {member.name: member for member in fixed}, nothing(system)
    found: dict[Names, float] = {frozenset(): 0.0}
    level: list[Names] = [frozenset()]
    for size in range(1, largest + 1):
        if size > 2:
            best_first = sorted(level, key=lambda names: -found[names])
            level = best_first[: LIMITS.parents]
            level += [names for names in best_first[LIMITS.parents :] if names <= fitted]
        values: dict[Names, list[float]] = {}
        for names in level:
            given = given_all(begin, [members[n] for n in sorted(names)])
            for name in (n for n in members if n not in names):
                value = log_evidence_with(given, members[name])
                values.setdefault(names | {name}, []).append(value)
        # Which member is weighed last, with sizes of its own for each direction, is as probable.
        found |= {names: float(logsumexp(v) - np.log(len(v))) for names, v in values.items()}
        level = list(values)
    best = sorted(found, key=lambda names: -found[names])
    several = [names for names in best if len(names) > 1][: LIMITS.parents]
    for member in random:
        own, given = frozenset([member.name]), given_random(system, member)
        found[own] = float(logsumexp(given.log_weight))
        for names in [frozenset([name]) for name in members] + several:
            found[own | names] = log_evidence_of(given, [members[n] for n in sorted(names)])
    return found


def log_evidence_of(given: Given, members: Sequence[FixedMember]) -> float:
    """Log evidence of the members given and a set of effects, averaged over all sizes."""
    given, members = of_columns(given, members)
    likely = _counts(given.log_weight + _gain_at_size(given))
    given = Given(*(x[likely] for x in given))
    values = []
    for last in members:
        others = [m for m in members if m is not last]
        values.append(log_evidence_with(given_all(given, others), last))
    return float(logsumexp(values) - np.log(len(values)))


def of_columns(
    given: Given, members: Sequence[FixedMember], further: int = 0
) -> tuple[Given, list[FixedMember]]:
    """The linear model of a few effects alone, and of so many last columns."""
    last = np.arange(given.gradient.shape[1] - further, given.gradient.shape[1])
    moved, parts, first = list[FixedMember](), [last], 0
    for m in members:
        here = np.arange(first, first + len(m.index) + len(m.shape))
        own, shape = here[: len(m.index)], here[len(m.index) :]
        moved.append(replace(m, index=own, shape=shape))
        parts[-1:] = [m.index, m.shape, last]
        first += len(here)
    index = np.concatenate(parts)
    small = given.matrix[:, index][:, :, index], given.gradient[:, index]
    return Given(given.log_weight, *small), moved


def given_all(begin: Given, members: Iterable[FixedMember]) -> Given:
    """The linear model given several effects more."""
    for member in members:
        begin = given_fixed(begin, member, likely=True)
    return begin


def posterior(
    log_evidence: Mapping[Names, float], log_prior: Mapping[Names, float]
) -> dict[Names, float]:
    """Probabilities of sets, most probable first.

    Examples
    --------
    >>> a, none = frozenset("a"), frozenset()
    >>> rows = posterior({none: 0.0, a: 4.0}, {none: np.log(0.5), a: np.log(0.05)})
    >>> {tuple(k): round(v, 2) for k, v in rows.items()}
    {('a',): 0.85, (): 0.15}
    """
    weights = {names: value + log_prior[names] for names, value in log_evidence.items()}
    total = logsumexp(list(weights.values()))
    ranked = sorted(weights.items(), key=lambda item: -item[1])
    return {names: float(np.exp(weight - total)) for names, weight in ranked}
