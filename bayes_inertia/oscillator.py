"""Fingerprints of a flexible mode: the torque that an appendage would put on the body, over a range of frequencies.

A mode's effect is of second order in its coupling vector delta, so that its derivative at the null is
zero. To first order in the products delta_i delta_j it is the body torque tau_i = -eta_j'' of unit
oscillators eta_j'' + 2 z W eta_j' + W^2 eta_j = -w_j', which needs no simulation.
"""

from __future__ import annotations

import numpy as np
from scipy import signal

from bayes_inertia.fingerprint import Imprint
from bayes_inertia.torque_response import TorqueResponse

PREFIX = "flexible_mode@"
_DAMPING = 0.005
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def frequencies(response: TorqueResponse, n: int = 16) -> np.ndarray:
    """n frequencies [Hz] from two periods in a slew to the fastest that the telemetry's sampling shows well."""
    durations = response.time[:, -1] - response.time[:, 0]
    sampling = np.median([np.median(np.diff(s.time)) for s in response.at.model.campaign.slews])
    return np.geomspace(2.0 / float(np.median(durations)), 0.25 / float(sampling), n)


def imprints(response: TorqueResponse, scale: float, n: int = 16) -> tuple[Imprint, ...]:
    """One candidate a frequency, named `flexible_mode@<Hz>`: six columns, one a product of coupling components.

    Parameters
    ----------
    scale : prior size of the products delta_i delta_j [kg m^2].
    """
    return tuple(_imprint(response, f, scale) for f in frequencies(response, n))


def _imprint(response: TorqueResponse, frequency: float, scale: float) -> Imprint:
    torque = np.zeros((*response.rate_B.shape, len(_PAIRS)))
    for s, (time, rate) in enumerate(zip(response.time, response.rate_B, strict=True)):
        reaction = _reaction(time, rate, frequency)
        for k, (i, j) in enumerate(_PAIRS):
            torque[s, :, i, k] += reaction[:, j]
            if i != j:
                torque[s, :, j, k] += reaction[:, i]
    change = response.residual_change(scale * torque)
    columns = np.concatenate([np.asarray(c) for c in change], axis=1)
    return Imprint(f"{PREFIX}{frequency:.4g}", tuple(columns))


def _reaction(time: np.ndarray, rate: np.ndarray, frequency: float) -> np.ndarray:
    """-eta'' (n, 3) of unit oscillators shaken by the body rate (n, 3), undeformed at the beginning, on an even grid inside."""
    valid = np.append(np.diff(time) > 0.0, False)
    last = int(np.flatnonzero(valid)[-1]) + 2
    t = time[:last]
    even = np.linspace(t[0], t[-1], len(t))
    w = np.stack([np.interp(even, t, rate[:last, i]) for i in range(3)], -1)
    omega = 2.0 * np.pi * frequency
    # From w' to -eta'': s^2 / (s^2 + 2 z W s + W^2).
    system = signal.lti([1.0, 0.0, 0.0], [1.0, 2.0 * _DAMPING * omega, omega**2])
    acceleration = np.gradient(w, even, axis=0)
    shaken = np.stack([signal.lsim(system, acceleration[:, i], even)[1] for i in range(3)], -1)
    out = np.zeros_like(rate)
    out[:last] = np.stack([np.interp(t, even, shaken[:, i]) for i in range(3)], -1)
    return out
