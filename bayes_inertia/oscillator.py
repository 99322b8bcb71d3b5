"""Fingerprint of a flexible mode: the torque that an appendage would put on the body, at its most likely frequency.

A mode's effect is of second order in its coupling vector delta, so that its derivative at the null is
zero. To first order in the products delta_i delta_j it is the body torque tau_i = -eta_j'' of unit
oscillators eta_j'' + 2 z W eta_j' + W^2 eta_j = -w_j', which needs no simulation. A ringing that lasts
a slew of length T has a line of width 1/T: frequencies are tried at half of that spacing.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import signal

from bayes_inertia.fingerprint import Imprint
from bayes_inertia.projection import Projection
from bayes_inertia.torque_response import TorqueResponse

PREFIX = "flexible_mode@"
_DAMPING = 0.005
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# At most so many frequencies are tried; so many at a time.
_MOST, _CHUNK = 160, 20


def frequencies(response: TorqueResponse) -> np.ndarray:
    """Frequencies [Hz] from two periods in a slew to the fastest that the telemetry's sampling shows well."""
    duration = float(np.median(response.time[:, -1] - response.time[:, 0]))
    sampling = float(np.median([np.median(np.diff(s.time)) for s in response.at.model.campaign.slews]))
    low, high = 2.0 / duration, 0.25 / sampling
    return np.linspace(low, high, int(np.clip(np.ceil((high - low) * 2.0 * duration), 2, _MOST)))


def best_imprint(response: TorqueResponse, fit: Projection, scale: float) -> Imprint:
    """The frequency whose ringing the residuals show best, named `flexible_mode@<Hz>`: six columns, one a product of coupling components.

    Parameters
    ----------
    scale : prior size of the products delta_i delta_j [kg m^2].
    """
    tried, k = frequencies(response), len(_PAIRS)
    best, found = -np.inf, None
    for start in range(0, len(tried), _CHUNK):
        some = tried[start : start + _CHUNK]
        columns = _columns(response, some, scale)
        taken = fit.taken(columns)
        pull = fit.pull(columns, taken).reshape(len(some), k)
        taken, own = taken.reshape(-1, len(some), k), columns.reshape(*columns.shape[:2], len(some), k)
        matrix = np.einsum("snfa,snfb->fab", own, own, optimize=True) - np.einsum("ufa,ufb->fab", taken, taken)
        powers, directions = np.linalg.eigh(matrix)
        along = np.einsum("fa,fab->fb", pull, directions)
        # Directions are weighed as the evidence does, so that those without power do not count.
        scores = np.sum(along**2 / (1.0 + np.maximum(powers, 0.0)), axis=1)
        if scores.max() > best:
            best, f = float(scores.max()), int(scores.argmax())
            found = Imprint(f"{PREFIX}{some[f]:.4g}", own[:, :, f], len(tried))
    return found


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
    above, below, _ = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 2.0 * _DAMPING * omega, omega**2]), step, method="foh")
    return np.ravel(above), below


def _reaction(time: np.ndarray, rate: np.ndarray, frequency: float) -> np.ndarray:
    """-eta'' (n, 3) of unit oscillators shaken by the body rate (n, 3), undeformed at the beginning, on an even grid inside."""
    valid = np.append(np.diff(time) > 0.0, False)
    last = int(np.flatnonzero(valid)[-1]) + 2
    t = time[:last]
    even = np.linspace(t[0], t[-1], len(t))
    w = np.stack([np.interp(even, t, rate[:last, i]) for i in range(3)], -1)
    shaken = signal.lfilter(*_filter(frequency, round(float(even[1] - even[0]), 12)), np.gradient(w, even, axis=0), axis=0)
    out = np.zeros_like(rate)
    out[:last] = np.stack([np.interp(t, even, shaken[:, i]) for i in range(3)], -1)
    return out
