"""Candidate effects: which of a library can be tried in a campaign, and how each scores.

A flexible mode is searched by itself. Its effect is of second order in its coupling vector delta:
the derivative at the null is zero. To first order in the products delta_i delta_j it is the body
torque tau_i = -eta_j'' of unit oscillators eta_j'' + 2 z W eta_j' + W^2 eta_j = -w_j', shaken by
the known body rate, which needs no simulation. Of the six products only three numbers are free: the
gain of the best coupling at one frequency is distributed, without a mode, like chi^2 with three
degrees of freedom in its tail (the area of the manifold of directions delta delta^T is that of the
half sphere of three amplitudes). A ringing that begins with a slew of length T changes its phase
over the slew by 2 pi T df: frequencies are tried at half of 1/T, and closer around the best.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy import optimize, stats
from scipy.special import logsumexp

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import reading_step
from bayes_inertia.diagnosis.hypothesis_table import few_sizes
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.optimizer import re_estimate, without_effects
from bayes_inertia.maths.inertia_tensor import tensor
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect, require_of_effect
from bayes_inertia.physics.effects import FlexibleMode, candidates_in
from bayes_inertia.physics.forward_model import lacks

# Products of the coupling's components: xx, yy, zz, xy, xz, yz; and what each is in a tensor.
_ROW, _COLUMN = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]).T
_UNIT = np.eye(3)
_TENSORS = np.maximum(
    _UNIT[_ROW, :, None] * _UNIT[_COLUMN, None, :], _UNIT[_COLUMN, :, None] * _UNIT[_ROW, None, :]
)


def oscillator_columns(
    response: TorqueResponse, frequencies: np.ndarray, scale: float
) -> np.ndarray:
    """Compute the changes of the residuals by unit modes.

    `frequencies` (f,) [Hz]. `scale`: size of a unit product of the coupling's components [kg m^2].
    Returns (slews, numbers, 6 f).
    """
    torque_B = np.zeros((*response.rate_B.shape, len(frequencies), len(_ROW)))
    for s, (time, rate_B) in enumerate(zip(response.time, response.rate_B, strict=True)):
        for f, frequency in enumerate(frequencies):
            reaction = _reaction(time, rate_B, frequency)
            torque_B[s, :, :, f] = np.einsum("kij,nj->nik", scale * _TENSORS, reaction)
    return response.changes({"body_torque": torque_B.reshape(*torque_B.shape[:3], -1)})


def _reaction(time: np.ndarray, rate_B: np.ndarray, frequency: float) -> np.ndarray:
    """-eta'' (n, 3) of unit oscillators shaken by the body rate (n, 3), undeformed at the start.

    They are run on an even grid.
    """
    valid = np.append(np.diff(time) > 0.0, False)
    last = int(np.flatnonzero(valid)[-1]) + 2
    t = time[:last]
    even = np.linspace(t[0], t[-1], len(t))
    w = np.stack([np.interp(even, t, rate_B[:last, i]) for i in range(3)], -1)
    step = round(float(even[1] - even[0]), 12)
    # Slow to import, and a fit without a flexible mode needs none of it.
    from scipy.signal import lfilter

    shaken = lfilter(*_filter(frequency, step), np.gradient(w, even, axis=0), axis=0)
    out = np.zeros_like(rate_B)
    out[:last] = np.stack([np.interp(t, even, shaken[:, i]) for i in range(3)], -1)
    return out


# A bounded memory of a pure function: all slews of one length share a frequency's filter, and every
# round of a search asks for the same frequencies again.
@lru_cache(maxsize=LIMITS.filters)
def _filter(frequency: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """From w' to -eta'': s^2 / (s^2 + 2 z W s + W^2) as a digital filter.

    It is exact for an input that is linear between samples.
    """
    from scipy.signal import cont2discrete

    omega = 2.0 * np.pi * frequency
    oscillator = [1.0, 0.0, 0.0], [1.0, 2.0 * LIMITS.damping_ratio * omega, omega**2]
    above, below, _ = cont2discrete(oscillator, step, method="foh")
    return np.ravel(above), below


@array_dataclass
class FlexibleModeCandidate:
    """The flexible mode that the residuals show best.

    Parameters
    ----------
    name : str
        Of the effect.
    columns : (slews, numbers, 3) array
        Changes of the whitened residuals, all channels one after the other, by small changes of
        its coupling [prior sd].
    score : float
        chi^2 that it gains.
    dof : int
        Degrees of freedom of the score if the effect is absent, but for being the best of many.
    trials : int
        How many independent ones it is the best of.
    elsewhere : float
        Mean evidence, against nothing, of modes at the frequencies at which none is seen.
    frequency : float
        [Hz].
    coupling : (3,) array
        In prior sd; minus it is the same mode.
    products : (slews, numbers, 6) array
        Changes of the residuals by the products delta_i delta_j (xx, yy, zz, xy, xz, yz), in
        squares of the prior sd.
    """

    name: str
    columns: np.ndarray
    score: float
    dof: int
    trials: int
    elsewhere: float
    frequency: float
    coupling: np.ndarray
    products: np.ndarray


def theta_with_mode(estimate: Estimate, mode: FlexibleModeCandidate) -> np.ndarray:
    """Put a mode's coupling and frequency into the parameters of a fit.

    Returns (d,).
    """
    space = estimate.model.space
    part, theta = space.slice_of(mode.name), estimate.theta.copy()
    coupling, frequency = slice(part.start, part.start + 3), part.start + 3
    largest = LIMITS.largest_amplitude
    delta = np.clip(mode.coupling, -largest, largest) * space.sd[coupling]
    share = delta @ np.linalg.solve(np.asarray(tensor(theta[:6])), delta)
    theta[coupling] = delta * min(1.0, np.sqrt(LIMITS.largest_appendage / max(share, 1e-300)))
    theta[frequency] = mode.frequency
    return theta


def restarted_with_mode(estimate: Estimate) -> Estimate:
    """Begin a fit again from the mode that its residuals show best.

    Zero coupling is a stationary point of the posterior, where an optimizer stays, and far from the
    right frequency there is another.

    Returns: the better of the two fits; the given one if its model has no free flexible mode.
    """
    space, effects = estimate.model.space, estimate.model.effects
    mode = next((e for e in effects if isinstance(e, FlexibleMode)), None)
    first = space.slice_of(mode.name).start if mode is not None else None
    if mode is None or first not in estimate.free:
        return estimate
    without = without_effects(estimate, {mode.name})
    fit, scale = without.linearised(), float(space.sd[first] ** 2)
    best = best_flexible_mode(mode.name, torque_response(without), fit, scale)
    restarted = re_estimate(without, theta_with_mode(without, best), estimate.free)
    return restarted if restarted.objective < estimate.objective else estimate


def frequencies(response: TorqueResponse) -> np.ndarray:
    """List the frequencies to try.

    Returns (n,): from two periods in a slew to the fastest that the telemetry's sampling shows well
    [Hz].
    """
    duration = float(np.median(response.time[:, -1] - response.time[:, 0]))
    low, high = 2.0 / duration, 0.25 / reading_step(response.estimate.model.campaign)
    wanted = np.ceil((high - low) * 2.0 * duration)
    return np.linspace(low, high, int(np.clip(wanted, 2, LIMITS.frequencies)))


def best_flexible_mode(
    name: str, response: TorqueResponse, fit: LinearisedFit, scale: float
) -> FlexibleModeCandidate:
    """Find the flexible mode that would gain most.

    `fit`: the same fit, ready to project columns off it. `scale`: square of the prior sd of the
    coupling's components [kg m^2].
    """
    tried = frequencies(response)
    slope, power = _at_frequencies(response, fit, scale, tried)
    gains = _gains(slope, power)
    offsets = (tried[1] - tried[0]) * np.array(LIMITS.refinement_offsets)
    closer = tried[np.argsort(-gains)[: LIMITS.refined_frequencies], None] + offsets
    closer = np.unique(np.clip(closer, tried[0], tried[-1]))
    gains = np.append(gains, _gains(*_at_frequencies(response, fit, scale, closer)))
    best = np.append(tried, closer)[np.argmax(gains)]
    columns = oscillator_columns(response, np.array([best]), scale)
    matrix, gradient = fit.projected(columns)
    coupling, gain = _best_coupling(gradient, matrix)
    tangents = _tangents(coupling)
    return FlexibleModeCandidate(
        name=name,
        columns=columns @ tangents,
        score=gain,
        dof=len(coupling),
        trials=int(np.ceil(LIMITS.trials_a_frequency * len(tried))),
        elsewhere=float(np.mean([_evidence_unseen(*x) for x in zip(slope, power, strict=True)])),
        frequency=float(best),
        coupling=coupling,
        products=columns,
    )


def _at_frequencies(
    response: TorqueResponse, fit: LinearisedFit, scale: float, tried: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slope and curvature (f, directions) of a mode at each frequency, over even directions."""
    found, step, k = [], LIMITS.frequencies_at_a_time, len(_ROW)
    for part in np.split(tried, np.arange(step, len(tried), step)):
        matrix, gradient = fit.projected(oscillator_columns(response, part, scale))
        each = np.arange(len(part))
        blocks = matrix.reshape(len(part), k, len(part), k)[each, :, each]
        found.append(_along_directions(gradient.reshape(-1, k), blocks))
    slope, power = (np.concatenate(x) for x in zip(*found, strict=True))
    return slope, power


def _gains(slope: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Gain (f,) of the best coupling at each frequency."""
    return np.max(_beyond_prior(slope) ** 2 / power, axis=1)


def _evidence_unseen(slope: np.ndarray, power: np.ndarray) -> float:
    """Evidence of a mode at one frequency, averaged over its directions (d,) and sizes.

    At most one: where more speaks for a mode, it is seen, and another row of the table.
    """
    squares, weights = few_sizes(power, 1.0, LIMITS.fixed_sizes)
    gain = squares[:, None] * slope - 0.5 * squares[:, None] ** 2 * power
    return float(np.exp(min(logsumexp(gain, b=weights[:, None] / len(slope)), 0.0)))


def _along_directions(gradient: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slope and curvature (f, directions) along each of an even set of directions, per mode.

    `gradient` (f, 6), `matrix` (f, 6, 6): of the products of the coupling's components.
    """
    products = _products(_directions())
    power = np.einsum("da,fab,db->fd", products, matrix, products, optimize=True)
    return gradient @ products.T, np.maximum(power, 1e-300)


def _beyond_prior(slope: np.ndarray) -> np.ndarray:
    """Slopes less that of the coupling's prior."""
    return np.maximum(slope - 0.5, 0.0)


def _best_coupling(projected_gradient: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Coupling (3,) of the largest gain, and the gain 2 gradient.p - p.matrix.p - |delta|^2.

    p are the products of the coupling delta.
    """
    (slope,), (power,) = _along_directions(projected_gradient[None], matrix[None])
    along = _beyond_prior(slope)
    k = int(np.argmax(along**2 / power))
    start = _directions()[k] * np.sqrt(along[k] / power[k])

    def loss(delta: np.ndarray) -> tuple[float, np.ndarray]:
        p, left = _products(delta), projected_gradient - matrix @ _products(delta)
        value = float(delta @ delta - p @ (projected_gradient + left))
        return value, 2.0 * delta - 2.0 * _tangents(delta).T @ left

    optimum = optimize.minimize(loss, start, jac=True, method="BFGS")
    coupling = optimum.x * (np.sign(optimum.x[np.argmax(np.abs(optimum.x))]) or 1.0)
    return coupling, float(max(-optimum.fun, 0.0))


def _products(delta: np.ndarray) -> np.ndarray:
    """Products delta_i delta_j (..., 6) of couplings (..., 3)."""
    return delta[..., _ROW] * delta[..., _COLUMN]


def _tangents(delta: np.ndarray) -> np.ndarray:
    """Derivatives (6, 3) of the products."""
    return _UNIT[_ROW] * delta[_COLUMN, None] + _UNIT[_COLUMN] * delta[_ROW, None]


def _directions() -> np.ndarray:
    """Directions (n, 3) that cover the half sphere evenly."""
    doublings = int(np.ceil(np.log2(LIMITS.directions)))
    points = stats.qmc.Sobol(2, scramble=False).random_base2(doublings)
    height, angle = points[:, 0], 2.0 * np.pi * points[:, 1]
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=-1)


FLEXIBLE_MODE = "flexible_mode"


@dataclass(frozen=True)
class CandidateEffects:
    """The effects of a library that a campaign's columns allow.

    Parameters
    ----------
    linear : tuple of Effect
        Effects whose signal is of first order in their parameters. One model holds them all.
    flexible_mode : FlexibleMode or None
        Its signal is of second order in its coupling: it is searched by itself.
    skipped : tuple of (str, str)
        Names of effects that cannot be tried, and why.
    log_costs : mapping of float, optional
        Of effects that were searched for among many: by how much less probable each is beforehand.
    """

    linear: tuple[Effect, ...]
    flexible_mode: FlexibleMode | None
    skipped: tuple[tuple[str, str], ...]
    log_costs: Mapping[str, float] = field(default_factory=dict)


def candidate_effects(campaign: Campaign, library: Sequence[Effect]) -> CandidateEffects:
    """Sort a library into what a campaign allows and what it does not.

    `campaign`: what was flown. An effect needs its columns in every slew.
    """
    library = candidates_in(campaign, library)
    _check_names(library)
    wanted = {effect.name: _wanted(effect, campaign) for effect in library}
    usable = [effect for effect in library if not wanted[effect.name]]
    return CandidateEffects(
        tuple(effect for effect in usable if not isinstance(effect, FlexibleMode)),
        next((effect for effect in usable if isinstance(effect, FlexibleMode)), None),
        tuple((name, f"needs {what}") for name, what in wanted.items() if what),
    )


def _wanted(effect: Effect, campaign: Campaign) -> str:
    """What an effect needs and a campaign does not have; empty if it can act."""

    def is_told(given: np.ndarray | None) -> bool:
        return given is not None and bool(np.isfinite(given).all(axis=-1).any())

    empty = [c for c in effect.needs if not all(is_told(getattr(s, c)) for s in campaign.slews)]
    return f"{', '.join(empty)} in every slew" if empty else lacks(effect, campaign)


def _check_names(library: Sequence[Effect]) -> None:
    for name, times in Counter(effect.name for effect in library).items():
        advice = "give them names of their own, or diagnose with one at a time"
        require_of_effect(times == 1, name, f"{times} candidates have this name", advice)
    for effect in library:
        usable = effect.name != FLEXIBLE_MODE or isinstance(effect, FlexibleMode)
        what = "only one mode shared by all slews can be a candidate"
        require_of_effect(usable, effect, what, "give a FlexibleMode itself")


def flexible_mode_candidate(
    fit: LinearisedFit, effects: CandidateEffects, response: TorqueResponse
) -> FlexibleModeCandidate | None:
    """The best flexible mode at a fit; none if its model holds one, or it is no candidate."""
    mode, model = effects.flexible_mode, fit.model
    if mode is None or any(effect.name == FLEXIBLE_MODE for effect in model.effects):
        return None
    sd = mode.parameters(model.campaign)[0].priors[0].sd
    return best_flexible_mode(FLEXIBLE_MODE, response, fit, sd**2)
