"""What a flexible mode of a given frequency would do to the residuals, without simulating it.

A unit oscillator eta'' + 2 z W eta' + W^2 eta = -w' along each axis is shaken by the body's known
rate. Its reaction -eta'' acts on the body as a torque.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bayes_inertia.diagnosis.torque_response import TorqueResponse

# Products of the coupling's components: xx, yy, zz, xy, xz, yz.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_DAMPING_RATIO = 0.005
_MAX_FILTERS = 1280  # frequencies of a search times four lengths of slews


def oscillator_columns(
    response: TorqueResponse, frequencies: np.ndarray, scale: float
) -> np.ndarray:
    """Compute the changes of the residuals by unit modes.

    Parameters
    ----------
    response : TorqueResponse
        Of the fit without a mode.
    frequencies : (f,) array
        Of the modes [Hz].
    scale : float
        Size of a unit product of the coupling's components [kg m^2].

    Returns
    -------
    (slews, numbers, 6 f) array
        For each frequency the six products `PAIRS`.
    """
    torque_B = np.zeros((*response.rate_B.shape, len(frequencies), len(PAIRS)))
    for s, (time, rate_B) in enumerate(zip(response.time, response.rate_B, strict=True)):
        for f, frequency in enumerate(frequencies):
            reaction = _reaction(time, rate_B, frequency)
            for k, (i, j) in enumerate(PAIRS):
                torque_B[s, :, i, f, k] += reaction[:, j]
                if i != j:
                    torque_B[s, :, j, f, k] += reaction[:, i]
    change = response.residual_change(scale * torque_B.reshape(*torque_B.shape[:3], -1))
    return np.concatenate([np.asarray(c) for c in change], axis=1)


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
@lru_cache(maxsize=_MAX_FILTERS)
def _filter(frequency: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """From w' to -eta'': s^2 / (s^2 + 2 z W s + W^2) as a digital filter.

    It is exact for an input that is linear between samples.
    """
    from scipy.signal import cont2discrete

    omega = 2.0 * np.pi * frequency
    above, below, _ = cont2discrete(
        ([1.0, 0.0, 0.0], [1.0, 2.0 * _DAMPING_RATIO * omega, omega**2]), step, method="foh"
    )
    return np.ravel(above), below
