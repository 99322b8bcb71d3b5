"""Inputs of a model whose noise is stated: gimbal angles, and tachometers that drive it.

What they tell is momentum that is carried inside. Its noise shakes the predicted rates, and the
slow part of it, estimated along, turns the predicted attitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayes_inertia.campaign.actuators import GimballedRotors
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.physics.actuators.gimballed_rotors import turning
from bayes_inertia.physics.slew_input import Drive


class NoisyInput(NamedTuple):
    """One input of k numbers a reading.

    Parameters
    ----------
    sigma : (k,) array
        Noise of a reading.
    readings : callable
        Of a slew: times (m,) on its clock and values (m, k).
    momentum : callable
        Of values (m, k): what each number adds to the momentum (m, 3, k), per unit.
    less : callable
        A slew without errors (m, k) of these readings.
    """

    sigma: np.ndarray
    readings: Callable[[Slew], tuple[np.ndarray, np.ndarray]]
    momentum: Callable[[np.ndarray], np.ndarray]
    less: Callable[[Slew, np.ndarray], Slew]


def noisy_inputs(campaign: Campaign, drive: Drive) -> tuple[NoisyInput, ...]:
    """The inputs whose noise a campaign states, as a model with this drive takes them.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> [len(noisy_inputs(small_campaign(), drive)) for drive in ("commanded", "measured")]
    [0, 1]
    """
    devices = (d for d in campaign.actuators if isinstance(d, GimballedRotors) and d.angle_sigma)
    found = [_of_gimbals(device) for device in devices]
    sigma = np.array([wheel.momentum_sigma or 0.0 for wheel in campaign.wheels])
    if drive == "measured" and sigma.all() and len(sigma):
        found.append(_of_wheels(sigma, campaign.wheel_axes_B))
    return tuple(found)


def _of_gimbals(device: GimballedRotors) -> NoisyInput:
    """The angles of gimbals."""

    def readings(slew: Slew) -> tuple[np.ndarray, np.ndarray]:
        stream = (slew.inputs or {})[device.name]
        return stream.time, stream.values

    def momentum(angle: np.ndarray) -> np.ndarray:
        return np.swapaxes(np.asarray(device.momentum)[:, None] * turning(device, angle), -1, -2)

    def less(slew: Slew, error: np.ndarray) -> Slew:
        stream = (slew.inputs or {})[device.name]
        better = replace(stream, values=stream.values - error)
        return replace(slew, inputs={**(slew.inputs or {}), device.name: better})

    return NoisyInput(np.full(device.columns, device.angle_sigma), readings, momentum, less)


def _of_wheels(sigma: np.ndarray, axes_B: np.ndarray) -> NoisyInput:
    """Tachometers, at the rows where all wheels are read; axes (3, wheels)."""

    def read(slew: Slew) -> np.ndarray:
        return np.isfinite(np.asarray(slew.wheel_momentum)).all(axis=1)

    def readings(slew: Slew) -> tuple[np.ndarray, np.ndarray]:
        rows = read(slew)
        return slew.time[rows], np.asarray(slew.wheel_momentum)[rows]

    def momentum(values: np.ndarray) -> np.ndarray:
        return np.broadcast_to(axes_B, (len(values), *axes_B.shape))

    def less(slew: Slew, error: np.ndarray) -> Slew:
        better = np.array(slew.wheel_momentum)
        better[read(slew)] -= error
        return replace(slew, wheel_momentum=better)

    return NoisyInput(sigma, readings, momentum, less)
