"""Fingerprint of a flexible mode: the torque that an appendage would put on the body, at its most likely frequency.

A mode's effect is of second order in its coupling vector delta, so that its derivative at the null is
zero. To first order in the products delta_i delta_j it is the body torque tau_i = -eta_j'' of unit
oscillators eta_j'' + 2 z W eta_j' + W^2 eta_j = -w_j', which needs no simulation. Of the six products only three numbers are
free: the gain of the best coupling at one frequency is distributed, without a mode, like chi^2 with three degrees of freedom in its tail
(the area of the manifold of directions delta delta^T is that of the half sphere of three amplitudes).

A ringing that begins with a slew of length T changes its phase over the slew by 2 pi T df: frequencies are tried at half of 1/T, and closer
around the best.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import optimize, signal, stats

from bayes_inertia.diagnosis.evidence import log_bayes_factor_around
from bayes_inertia.diagnosis.score_test import Imprint
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.optimizer import re_estimate, without_effect
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects import FlexibleMode

_DAMPING = 0.005
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_FIRST, _SECOND = np.array(_PAIRS).T
# At most so many frequencies are tried; so many at a time; so many of them are looked at more closely.
_MOST, _CHUNK, _CLOSER = 320, 20, 6
_BETWEEN = np.array([-0.5, -0.25, 0.25, 0.5])
_DIRECTIONS = 400
# Independent trials per frequency tried, as the closer look finds maxima between: simulated maxima ask for 1.0 to 2.0.
_TRIALS = 2.0


@array_dataclass
class Ringing(Imprint):
    """The flexible mode that the residuals show best.

    Attributes
    ----------
    frequency : [Hz]. coupling : (3,) in prior sd; minus it is the same mode.
    products : (slews, numbers, 6) changes of the residuals by the products delta_i delta_j (xx, yy, zz, xy, xz, yz), in squares of the prior sd.
    """

    frequency: float
    coupling: np.ndarray
    products: np.ndarray


def theta_of(ringing: Ringing, at: Estimate) -> np.ndarray:
    """`at.theta` (d,) with the ringing's coupling and frequency, in a model that holds the effect."""
    space = at.model.space
    part, theta = space.slice_of(ringing.name), at.theta.copy()
    coupling, frequency = slice(part.start, part.start + 3), part.start + 3
    theta[coupling] = np.clip(ringing.coupling, -10.0, 10.0) * space.sd[coupling]
    theta[frequency] = ringing.frequency
    return theta


def with_ringing(at: Estimate) -> Estimate:
    """The estimate begun again from the ringing that its residuals show best, if that is better; only if the model has a free flexible mode.

    Zero coupling is a stationary point of the posterior, where an optimizer stays, and far from the right frequency there is another.
    """
    mode = next((e for e in at.model.effects if isinstance(e, FlexibleMode)), None)
    first = at.model.space.slice_of(mode.name).start if mode is not None else None
    if first is None or first not in at.free:
        return at
    without = without_effect(at, mode.name)
    ringing = best_ringing(
        mode.name, torque_response(without), without.linearised(), at.model.space.sd[first] ** 2
    )
    found = re_estimate(without, theta_of(ringing, without), at.free)
    return found if found.objective < at.objective else at


def frequencies(response: TorqueResponse) -> np.ndarray:
    """Frequencies [Hz] from two periods in a slew to the fastest that the telemetry's sampling shows well."""
    duration = float(np.median(response.time[:, -1] - response.time[:, 0]))
    sampling = float(
        np.median([np.median(np.diff(s.time)) for s in response.at.model.campaign.slews])
    )
    low, high = 2.0 / duration, 0.25 / sampling
    return np.linspace(low, high, int(np.clip(np.ceil((high - low) * 2.0 * duration), 2, _MOST)))


def best_ringing(name: str, response: TorqueResponse, fit: LinearisedFit, scale: float) -> Ringing:
    """The flexible mode, called `name`, that would gain most.

    Parameters
    ----------
    scale : square of the prior sd of the coupling's components [kg m^2].
    """
    tried = frequencies(response)
    gains = _gains(response, fit, scale, tried)
    closer = tried[np.argsort(-gains)[:_CLOSER], None] + (tried[1] - tried[0]) * _BETWEEN
    closer = np.unique(np.clip(closer, tried[0], tried[-1]))
    closer_gains = _gains(response, fit, scale, closer)
    best = (
        closer[np.argmax(closer_gains)]
        if closer_gains.max() > gains.max()
        else tried[np.argmax(gains)]
    )
    columns, pull, matrix = _normal(response, fit, np.array([best]), scale)
    coupling, gain = _best_coupling(pull[0], matrix[0])
    tangents = _tangents(coupling)
    evidence = log_bayes_factor_around(
        0.5 * gain, tangents.T @ matrix[0] @ tangents, coupling
    ) - float(np.log(len(tried)))
    return Ringing(
        name,
        columns @ tangents,
        gain,
        len(coupling),
        int(np.ceil(_TRIALS * len(tried))),
        evidence,
        float(best),
        coupling,
        columns,
    )


def _gains(
    response: TorqueResponse, fit: LinearisedFit, scale: float, tried: np.ndarray
) -> np.ndarray:
    """Gain of the best coupling at each frequency, over an even set of directions."""
    products = _products(_directions())
    found = []
    for some in np.split(tried, np.arange(_CHUNK, len(tried), _CHUNK)):
        _, pull, matrix = _normal(response, fit, some, scale)
        along = np.maximum(pull @ products.T - 0.5, 0.0)
        power = np.einsum("da,fab,db->fd", products, matrix, products, optimize=True)
        found.append(np.max(along**2 / np.maximum(power, 1e-300), axis=1))
    return np.concatenate(found)


def _normal(
    response: TorqueResponse, fit: LinearisedFit, some: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (slews, numbers, 6 f) of modes of some frequencies, and each one's projected gradient (f, 6) and normal matrix (f, 6, 6)."""
    k, columns = len(_PAIRS), _columns(response, some, scale)
    taken = fit.imitated(columns)
    pull = fit.pull(columns, taken).reshape(len(some), k)
    taken, own = taken.reshape(-1, len(some), k), columns.reshape(*columns.shape[:2], len(some), k)
    matrix = np.einsum("snfa,snfb->fab", own, own, optimize=True) - np.einsum(
        "ufa,ufb->fab", taken, taken
    )
    return columns, pull, matrix


def _best_coupling(pull: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Coupling (3,) with the largest gain 2 pull.p - p.matrix.p - |delta|^2 of its products p, and the gain."""
    directions = _directions()
    products = _products(directions)
    along, power = (
        np.maximum(pull @ products.T - 0.5, 0.0),
        np.einsum("da,ab,db->d", products, matrix, products),
    )
    k = int(np.argmax(along**2 / np.maximum(power, 1e-300)))
    start = directions[k] * np.sqrt(along[k] / max(power[k], 1e-300))

    def loss(delta: np.ndarray) -> tuple[float, np.ndarray]:
        p, left = _products(delta), pull - matrix @ _products(delta)
        return float(delta @ delta - p @ (pull + left)), 2.0 * delta - 2.0 * _tangents(
            delta
        ).T @ left

    found = optimize.minimize(loss, start, jac=True, method="BFGS")
    coupling = found.x * (np.sign(found.x[np.argmax(np.abs(found.x))]) or 1.0)
    return coupling, float(max(-found.fun, 0.0))


def _products(delta: np.ndarray) -> np.ndarray:
    """Products delta_i delta_j (..., 6) of couplings (..., 3)."""
    return delta[..., _FIRST] * delta[..., _SECOND]


def _tangents(delta: np.ndarray) -> np.ndarray:
    """Derivatives (6, 3) of the products."""
    unit = np.eye(3)
    return unit[_FIRST] * delta[_SECOND, None] + unit[_SECOND] * delta[_FIRST, None]


@lru_cache(maxsize=1)
def _directions() -> np.ndarray:
    """Directions (n, 3) that cover the half sphere evenly."""
    points = stats.qmc.Sobol(2, scramble=False).random_base2(int(np.ceil(np.log2(_DIRECTIONS))))
    height, angle = points[:, 0], 2.0 * np.pi * points[:, 1]
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=-1)


def _columns(response: TorqueResponse, tried: np.ndarray, scale: float) -> np.ndarray:
    """Changes of the residuals (slews, numbers, 6 len(tried)) by unit modes of the frequencies tried."""
    torque = np.zeros((*response.rate_B.shape, len(tried), len(_PAIRS)))
    for s, (time, rate) in enumerate(zip(response.time, response.rate_B, strict=True)):
        for f, frequency in enumerate(tried):
            reaction = _reaction(time, rate, frequency)
            for k, (i, j) in enumerate(_PAIRS):
                torque[s, :, i, f, k] += reaction[:, j]
                if i != j:
                    torque[s, :, j, f, k] += reaction[:, i]
    change = response.residual_change(scale * torque.reshape(*torque.shape[:3], -1))
    return np.concatenate([np.asarray(c) for c in change], axis=1)


@lru_cache(maxsize=4 * _MOST)
def _filter(frequency: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """From w' to -eta'': s^2 / (s^2 + 2 z W s + W^2) as a digital filter, exact for an input that is linear between samples."""
    omega = 2.0 * np.pi * frequency
    above, below, _ = signal.cont2discrete(
        ([1.0, 0.0, 0.0], [1.0, 2.0 * _DAMPING * omega, omega**2]), step, method="foh"
    )
    return np.ravel(above), below


def _reaction(time: np.ndarray, rate: np.ndarray, frequency: float) -> np.ndarray:
    """-eta'' (n, 3) of unit oscillators shaken by the body rate (n, 3), undeformed at the beginning, on an even grid inside."""
    valid = np.append(np.diff(time) > 0.0, False)
    last = int(np.flatnonzero(valid)[-1]) + 2
    t = time[:last]
    even = np.linspace(t[0], t[-1], len(t))
    w = np.stack([np.interp(even, t, rate[:last, i]) for i in range(3)], -1)
    shaken = signal.lfilter(
        *_filter(frequency, round(float(even[1] - even[0]), 12)),
        np.gradient(w, even, axis=0),
        axis=0,
    )
    out = np.zeros_like(rate)
    out[:last] = np.stack([np.interp(t, even, shaken[:, i]) for i in range(3)], -1)
    return out
