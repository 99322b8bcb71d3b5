"""Effects without a fixed shape as candidates, and shapes without a name as their rivals.

Every candidate is weighed to first order at a fit (`signal_evidence`). Where a process on knots or
pieces can act, two rivals without a name can act as well: a signal that is smooth (a squared-
exponential kernel, of any length), and one that is the same in every slew. What is random in the
sense of a candidate is neither.

Roots of the prior covariance of a candidate's coefficients, at one size and one shape.

A fit takes the coefficients of two slews as independent. Some processes go on between slews (a
random walk); where candidates are weighed, these are one process over the whole campaign.

An error of the tachometers of free shape: no effect of the library has knots there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.diagnosis.coefficient_columns import PROGRAMS, coefficient_columns
from bayes_inertia.diagnosis.filtered_candidates import (
    filtered_candidate,
    filtered_effects,
    is_strong,
)
from bayes_inertia.diagnosis.prior_sizes import LARGEST_RANDOM_SIZE
from bayes_inertia.diagnosis.random_significance import RandomSignal, p_values_of_largest
from bayes_inertia.diagnosis.signal_evidence import (
    GainOfSizes,
    ProjectedSignal,
    SignalEvidence,
    SignalPrior,
    gain_of_one_process,
    projected_signal,
    signal_evidence,
)
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.coefficients import prior_roots
from bayes_inertia.inference.compiled_programs import forget_surplus
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import REMAINDERS, STOCHASTIC
from bayes_inertia.physics.effects.scales import sd_and_time
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.random_basis import (
    hat_functions,
    on_axes,
    on_each_axis,
    ornstein_uhlenbeck_root,
    slew_duration,
    slew_fraction,
)
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.stated_noise import stated_terms
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# Where in a slew's signal chain an effect enters, in the words of `unexplained`.
SOURCES = {
    "body_torque": "body torque",
    "delivered_torque": "wheel torque",
    "rate_output": "rate sensor",
    "momentum_output": "tachometers",
    "attitude_output": "star tracker",
}
# Correlation times that are tried, in prior sds from the median.
_SHAPES = np.linspace(-2.0, 2.0, 5)
# Length scales of a smooth signal: from this share of the knots' spacing to the whole slew.
_SHORTEST, _LENGTHS = 0.7, 6
_JITTER = 1e-9  # of the smooth kernel's variance
# Largest log evidence of all: below the first nothing is found, and above the second the bound by
# Markov's inequality is enough. Between them p-values are simulated.
_WEAK, _CLEAR = 1.5, 9.0
# Effects of more numbers than these in their columns are left out, to save memory.
_MOST_NUMBERS = 5e7
# P-values are not simulated if that takes matrices of more numbers, to save memory.
_LARGEST_MATRICES = 5e7

STOCHASTIC_CANDIDATES: tuple[StochasticEffect, ...] = tuple(
    e for e in STOCHASTIC if isinstance(e, StochasticEffect) and e not in REMAINDERS
)


@dataclass(frozen=True)
class StochasticCandidate:
    """An effect without a fixed shape, or a shape without a name, weighed at a fit.

    Parameters
    ----------
    effect : str
        Name of the effect; empty for a shape without a name.
    source : str
        Where it enters: "body torque", "rate sensor", "star tracker", ...
    log_bayes_factor : float
        Log evidence against nothing, to first order.
    start : tuple of float
        The effect's parameters where the evidence is largest; empty without a name.
    simulated_p_value : float or None
        Probability that any effect without a fixed shape has such evidence where there is none;
        None if that was not simulated.
    """

    effect: str
    source: str
    log_bayes_factor: float
    start: tuple[float, ...] = ()
    simulated_p_value: float | None = None

    @property
    def p_value(self) -> float:
        """Probability of such evidence where nothing is random.

        If it was not simulated an upper bound by Markov's inequality: the expectation of a Bayes
        factor is one.

        >>> round(StochasticCandidate("rate_random_walk", "rate sensor", 7.0).p_value, 4)
        0.0009
        """
        if self.simulated_p_value is not None:
            return self.simulated_p_value
        return float(np.exp(-max(self.log_bayes_factor, 0.0)))


def stochastic_candidates(
    estimate: Estimate,
    effects: Sequence[StochasticEffect],
    fit: LinearisedFit | None = None,
    response: TorqueResponse | None = None,
    *,
    nameless: bool = True,
) -> tuple[StochasticCandidate, ...]:
    """Weigh effects without a fixed shape, and shapes without a name, at a fit.

    `effects`: the first parameter of each scales its signal, the others give it its shape.
    `nameless`: whether shapes without a name are weighed too: they take as long again. Returns:
    best evidence first; effects that the campaign cannot have or see are left out.
    """
    forget_surplus(PROGRAMS)
    fit, response = fit or estimate.linearised(), response or torque_response(estimate)
    campaign, drive = estimate.model.campaign, estimate.model.structure.drive
    numbers, shapes = fit.residual.size, (TachometerShape(),) if nameless else ()
    named = usable(effects, fit.model, numbers)
    both = (*named, *usable(shapes, fit.model, numbers))
    model = Model(campaign, both, drive)
    roots = [_roots_at(model, x) for x in _SHAPES]
    candidates: list[StochasticCandidate] = []
    on_knots: dict[StochasticEffect, SignalEvidence] = {}
    gains: dict[StochasticEffect, GainOfSizes] = {}
    for i, effect in enumerate(both):
        columns = coefficient_columns(response, effect)
        if columns.any():
            own = [of_all[i] for of_all in roots]
            signal = projected_signal(fit, columns)
            on_knots[effect] = _on_knots(effect, model, signal, own)
            at_best = own[on_knots[effect].shape]
            if at_best.across is not None and is_strong(on_knots[effect]):
                gains[effect] = gain_of_one_process(signal, at_best.best, at_best.each)
            if nameless:
                candidates += _without_a_name(effect, model, signal, [x.blocks for x in own])
    filtered = filtered_effects(fit, on_knots)
    for effect, evidence in on_knots.items():
        if effect in filtered:
            candidates.append(_filtered(effect, model, evidence, fit, gains.get(effect)))
        else:
            candidates.append(_weighed(effect, model, evidence))
    return tuple(sorted(candidates, key=lambda c: -c.log_bayes_factor))


def p_values_decide(weighed: Sequence[StochasticCandidate]) -> bool:
    """Whether bounds of the p-values leave open what is significant.

    Returns: false where the largest evidence is weak, or so clear that its bound is enough.

    Examples
    --------
    >>> of = [StochasticCandidate("torque_noise", "body torque", x) for x in (0.5, 5.0, 50.0)]
    >>> [p_values_decide([candidate]) for candidate in of]
    [False, True, False]
    """
    largest = max((c.log_bayes_factor for c in weighed if c.effect), default=0.0)
    return _WEAK < largest < _CLEAR


def with_p_values(
    weighed: Sequence[StochasticCandidate],
    effects: Sequence[StochasticEffect],
    fit: LinearisedFit,
    response: TorqueResponse,
    rng: np.random.Generator,
) -> tuple[StochasticCandidate, ...]:
    """Simulate how probable such evidence is where nothing is random.

    Returns: the same with p-values; in campaigns of very many slews they stay bounds, to save
    memory.
    """
    kept = usable(effects, fit.model, fit.residual.size)
    counts = [e.coefficient_count(fit.model.campaign) for e in kept]
    squares = len(_SHAPES) * (len(fit.residual) * np.array(counts)) ** 2
    if not kept or squares.sum() > _LARGEST_MATRICES:
        return tuple(weighed)
    model = Model(fit.model.campaign, kept, fit.model.structure.drive)
    roots = [_roots_at(model, x) for x in _SHAPES]
    signals = []
    for i, effect in enumerate(kept):
        columns = coefficient_columns(response, effect)
        if columns.any():
            own = [of_all[i] for of_all in roots]
            signals.append(RandomSignal(columns, _prior(effect, model, own)))
    values = np.array([c.log_bayes_factor for c in weighed])
    p_values = p_values_of_largest(fit, signals, values, rng).tolist()
    return tuple(replace(c, simulated_p_value=p) for c, p in zip(weighed, p_values, strict=True))


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
    campaign, kept = model.campaign, []
    for effect in effects:
        count = effect.coefficient_count(campaign)
        known = not effect.parameters(campaign) or effect.name in fitted
        if not known and count > 0 and numbers * count <= _MOST_NUMBERS:
            kept.append(effect)
    return tuple(kept)


def medians(model: Model) -> np.ndarray:
    """The centre of the prior of all parameters.

    Returns (d,).
    """
    constants = model.space.constants()
    mean, logarithmic = np.asarray(constants["mean"]), np.asarray(constants["logarithmic"])
    return np.where(logarithmic, np.exp(np.where(logarithmic, mean, 0.0)), mean)


def _parameters_at(model: Model, effect: Effect, size: float, shape: float) -> np.ndarray:
    """An effect's parameters: so many medians in size, so many prior sds from them in shape."""
    part = model.space.slice_of(effect.name)
    values = medians(model)[part]
    values[0] *= size
    values[1:] *= np.exp(shape * np.asarray(model.space.constants()["scale"])[part][1:])
    return values


def _roots_at(model: Model, shape: float) -> list[CandidateRoots]:
    theta = medians(model)
    for effect in model.effects:
        part = model.space.slice_of(effect.name)
        theta[part] = _parameters_at(model, effect, 1.0, shape)
    slews = model.data.contexts
    blocks = prior_roots(model.structure, theta, slews)
    active = model.structure.active_effects(jnp.asarray(theta))
    return [
        candidate_roots(effect, p, slews, np.asarray(own))
        for (effect, p), own in zip(active, blocks, strict=True)
        if isinstance(effect, StochasticEffect)
    ]


def _on_knots(
    effect: StochasticEffect, model: Model, signal: ProjectedSignal, roots: list[CandidateRoots]
) -> SignalEvidence:
    """Evidence of an effect; `roots` are its own at each of `_SHAPES`."""
    return signal_evidence(signal, _prior(effect, model, roots))


def _prior(effect: StochasticEffect, model: Model, roots: list[CandidateRoots]) -> SignalPrior:
    """What an effect may be like; `roots` are its own at each of `_SHAPES`."""
    shapes, largest = _settings(effect, model)
    best = [own.best for own in roots[: len(shapes)]]
    return SignalPrior(best, np.exp(-0.5 * shapes**2), largest)


def _weighed(effect: StochasticEffect, model: Model, own: SignalEvidence) -> StochasticCandidate:
    """The candidate that an effect is."""
    name = "" if isinstance(effect, TachometerShape) else effect.name
    start = tuple(_best(effect, model, own).tolist()) if name else ()
    return StochasticCandidate(name, _source(effect), own.log_bayes_factor, start)


def _filtered(
    effect: StochasticEffect,
    model: Model,
    own: SignalEvidence,
    fit: LinearisedFit,
    gain: GainOfSizes | None,
) -> StochasticCandidate:
    """The candidate that an effect is, its whole process filtered out of the readings.

    The filter begins anew in every slew: what a process gains by going on between them is told
    by its knots.
    """
    value, start = filtered_candidate(fit, effect, _best(effect, model, own), own, gain)
    return StochasticCandidate(effect.name, _source(effect), value, start)


def _best(effect: StochasticEffect, model: Model, own: SignalEvidence) -> np.ndarray:
    """Its parameters where the evidence on knots is largest."""
    shapes, _ = _settings(effect, model)
    return _parameters_at(model, effect, own.size, shapes[own.shape])


def _without_a_name(
    effect: StochasticEffect, model: Model, signal: ProjectedSignal, blocks: list[np.ndarray]
) -> list[StochasticCandidate]:
    """A smooth signal, and one that repeats in every slew, where an effect on knots enters."""
    if blocks[0].shape[-1] == 1:
        return []
    shapes, largest = _settings(effect, model)
    once = [dense(b[:1]) for b in blocks]
    of_shapes = SignalPrior(once, np.exp(-0.5 * shapes**2), largest)
    same = signal_evidence(signal.repeated(), of_shapes)
    smooth = [dense(b) for b in _smooth(blocks[len(blocks) // 2])]
    free = signal_evidence(signal, SignalPrior(smooth, np.ones(len(smooth)), largest))
    source = _source(effect)
    return [StochasticCandidate("", source, x.log_bayes_factor) for x in (same, free)]


def _settings(effect: StochasticEffect, model: Model) -> tuple[np.ndarray, float]:
    """The shapes to try [prior sd], and the largest size in medians."""
    part = model.space.slice_of(effect.name)
    scale = float(np.asarray(model.space.constants()["scale"])[part.start])
    shapes = _SHAPES if part.stop - part.start > 1 else np.zeros(1)
    return shapes, float(np.exp(LARGEST_RANDOM_SIZE * scale))


def _source(effect: StochasticEffect) -> str:
    return next(name for hook, name in SOURCES.items() if effect.acts(hook))


def _smooth(blocks: np.ndarray) -> list[np.ndarray]:
    """Roots (slews, b, m, m) of squared-exponential kernels of the same mean variance."""
    m = blocks.shape[-1]
    sd = np.sqrt(np.mean(np.sum(blocks**2, -1)))
    apart = np.subtract.outer(np.arange(m), np.arange(m))
    roots = []
    for length in np.geomspace(_SHORTEST, m, _LENGTHS):
        kernel = np.exp(-0.5 * (apart / length) ** 2) + _JITTER * np.eye(m)
        roots.append(np.broadcast_to(sd * np.linalg.cholesky(kernel), blocks.shape))
    return roots


# Of the mean variance, added to it: where a walk is zero its covariance is singular.
_CANDIDATE_ROOTS_JITTER = 1e-9


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
    def each(self) -> np.ndarray:
        """Of each slew (slews, b m, b m), where slews are independent."""
        return dense(self.blocks)

    @property
    def best(self) -> np.ndarray:
        """Of all slews (slews b m, slews b m) where they are one process, else of each."""
        if self.across is None:
            return self.each
        n, b, m, _ = self.blocks.shape
        joint = np.zeros((n, b, m, n, b, m))
        for i in range(b):
            joint[:, i, :, :, i] = self.across.reshape(n, m, n, m)
        return joint.reshape(n * b * m, n * b * m)


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
    floor = _CANDIDATE_ROOTS_JITTER * np.trace(covariance) / len(covariance)
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
    whole = np.zeros((slews, b, m, b, m))
    for i in range(b):
        whole[:, i, :, i] = blocks[:, i]
    return whole.reshape(slews, b * m, b * m)


@dataclass(frozen=True)
class TachometerShape(StochasticEffect):
    """An error of the tachometers on knots: the shape without a name where no effect has knots."""

    name: ClassVar[str] = "tachometer_shape"
    knots: int = 17

    def parameters(self, campaign):
        sigma = [wheel.momentum_sigma for wheel in campaign.wheels if wheel.momentum_sigma]
        return sd_and_time(campaign, "N m s", max(sigma), None, 1.5) if sigma else ()

    def coefficient_count(self, campaign):
        return len(campaign.wheels) * self.knots if self.parameters(campaign) else 0

    def coefficient_root(self, p, slew, count):
        spacing = slew_duration(slew) / (self.knots - 1)
        root = ornstein_uhlenbeck_root(p["sd"], p["time"], spacing, self.knots)
        return on_each_axis(root, count // self.knots)

    def momentum_output(self, p, slew, trajectory, momentum):
        hats = hat_functions(slew_fraction(slew, slew.time), self.knots)
        return momentum + on_axes(hats, p["coefficients"], momentum.shape[1])
