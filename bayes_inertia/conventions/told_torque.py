"""Torques on the body that somebody told: effects named in a command, with their priors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayes_inertia.conventions.motion import Motion
from bayes_inertia.conventions.sampled_slews import SampledSlews


@dataclass(frozen=True, eq=False)
class ToldTorque:
    """The torque on the body in one slew that effects told, in body axes.

    Parameters
    ----------
    time : (n,) array
        Moments on the slew's own clock [s].
    impulse_B : (n, 3) array
        Integral of the torque since the first of them, at the priors' means [N m s].
    doubt : (n,) array
        Integral of the size by which the priors' sds may change it [N m s].
    """

    time: np.ndarray
    impulse_B: np.ndarray
    doubt: np.ndarray

    def at(self, moments: np.ndarray) -> np.ndarray:
        """Impulse and doubt (N, 4) at moments (N,) [s]."""
        columns = np.column_stack([self.impulse_B, self.doubt])
        return np.stack([np.interp(moments, self.time, column) for column in columns.T], axis=-1)


def told_impulse(
    slews: SampledSlews, moving: Motion, torques: Mapping[str, ToldTorque]
) -> tuple[np.ndarray, np.ndarray]:
    """What told torques add to the momentum (S, N, 3) in axes that do not turn, and doubt (S, N).

    `torques`: by the name of the slew; where a slew has none, nothing is added [N m s].
    """
    at = np.zeros((*slews.time.shape, 4))
    for k, name in enumerate(slews.names):
        if name in torques:
            at[k] = torques[name].at(slews.time[k])
    middle = 0.5 * (moving.to_start[:, 1:] + moving.to_start[:, :-1])
    steps = np.einsum("snij,snj->sni", middle, np.diff(at[..., :3], axis=1))
    added = np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
    return added, at[..., 3] - at[:, :1, 3]
