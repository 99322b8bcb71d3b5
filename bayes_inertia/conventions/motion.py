"""The motion of all slews that the rates tell, and what errors of the rates do to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.rotations import accumulated, matrix_to_start, of_angle
from bayes_inertia.conventions.sampled_slews import SampledSlews


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of all slews under one reading of rate and time.

    Parameters
    ----------
    rate_B : (S, N, 3) array
        Rate of the body [rad/s].
    path : (S, N, 4) array
        Attitude relative to that at the slew's first moment.
    to_start : (S, N, 3, 3) array
        From body axes to those of the first moment.
    by_scale : (S, N, 3, 9) array
        Rotation, in the axes of the first moment, that an error of 1 in each element of the matrix
        from readings to rates adds.
    by_bias : (S, N, 3, 3) array
        The same for a bias of 1 rad/s.
    duration : (S,) array
        Of each slew [s].
    """

    rate_B: np.ndarray
    path: np.ndarray
    to_start: np.ndarray
    by_scale: np.ndarray
    by_bias: np.ndarray
    duration: np.ndarray


def motion_of(slews: SampledSlews, reading: Reading) -> Motion:
    """The motion that the rates of a reading tell."""
    shift = reading.bias_B
    steps = reading.time * np.diff(slews.time, axis=1)[..., None]
    turns = reading.time * np.diff(slews.turn, axis=1) @ reading.rate.T - shift * steps
    path = accumulated(of_angle(turns))
    start = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*path.shape[:1], 1, 4))
    path = np.concatenate([start, path], axis=1)
    to_start = matrix_to_start(path)
    middle = 0.5 * (to_start[:, 1:] + to_start[:, :-1])
    scale = np.einsum("snia,snb->sniab", middle, turns)
    return Motion(
        rate_B=slews.rate @ reading.rate.T - shift,
        path=path,
        to_start=to_start,
        by_scale=_running(scale.reshape(*scale.shape[:3], 9)),
        by_bias=_running(middle * steps[..., None]),
        duration=reading.time * (slews.time[:, -1] - slews.time[:, 0]),
    )


def _running(steps: np.ndarray) -> np.ndarray:
    """Sums along the moments (axis 1), from zero."""
    return np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
