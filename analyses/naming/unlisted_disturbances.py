"""Disturbances that no effect of the library describes: twelve kinds, five without any fixed shape.

Sizes leave chi^2 some hundreds too large.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from analyses.naming.second_simulator import (
    Deadband,
    Disturbance,
    Leak,
    RateSquared,
    Ripple,
    Swirl,
    Wander,
)

_GRID = np.arange(0.0, 20_000.0, 0.5)  # on which random signals are drawn [s]
_SLOSH_TIME = 8.0  # correlation time [s]
_PHASE_STEP = 0.1  # sd of a phase's step on the grid [rad]
_BURST_EVERY, _BURST_LENGTH = 40.0, 3.0  # [s]


class Pump(Disturbance):
    """A pump reverses every 8.5 s: a torque of square shape on the campaign's clock."""

    def body_torque(self, t, since, rate_B):
        return self.size * np.sign(np.sin(2.0 * np.pi * t / 17.0)) * np.array([0.2, 1.0, 0.3])


class Outgassing(Disturbance):
    """A vent pushes and fades within minutes of the campaign's beginning."""

    def body_torque(self, t, since, rate_B):
        return self.size * np.exp(-t / 900.0) * np.array([1.0, 0.2, -0.4])


@dataclass(frozen=True)
class _Random(Disturbance):
    """A disturbance with a random path (n, 3) on the grid."""

    path: np.ndarray | None = None

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """The path at other times (..., 3)."""
        index = np.minimum(np.searchsorted(_GRID, t), len(_GRID) - 1)
        return self.path[index]


class Bursts(_Random):
    """A valve opens at random moments for a few seconds, each time in another direction."""

    def body_torque(self, t, since, rate_B):
        return self.size * self.at(t)


class Slosh(_Random):
    """Fuel in motion: a random torque as large as the body turns fast."""

    def body_torque(self, t, since, rate_B):
        return self.size * np.linalg.norm(rate_B) * self.at(t)


class Flutter(_Random):
    """The rate sensor beats with something whose frequency wanders about 0.06 Hz."""

    def rate_error(self, t, rng):
        return self.size * self.at(t)


class TrackerWalk(Disturbance):
    """The star tracker's error walks from fix to fix, before and after each slew."""

    def tracker_error(self, late, rng):
        steps = rng.normal(size=(len(late), 3))
        before = np.where(late[:, None], 0.0, steps)
        after = np.where(late[:, None], steps, 0.0)
        walks = np.where(late[:, None], np.cumsum(after, axis=0), np.cumsum(before, axis=0))
        return self.size * walks


def _bursts(rng: np.random.Generator) -> np.ndarray:
    path = np.zeros((len(_GRID), 3))
    for begin in np.flatnonzero(rng.random(len(_GRID)) < (_GRID[1] - _GRID[0]) / _BURST_EVERY):
        path[begin : begin + int(_BURST_LENGTH / (_GRID[1] - _GRID[0]))] = rng.normal(size=3)
    return path


def _gauss_markov(rng: np.random.Generator) -> np.ndarray:
    kept = np.exp(-(_GRID[1] - _GRID[0]) / _SLOSH_TIME)
    fresh = rng.normal(size=(len(_GRID), 3)) * np.sqrt(1.0 - kept**2)
    path = np.zeros_like(fresh)
    for k in range(1, len(path)):
        path[k] = kept * path[k - 1] + fresh[k]
    return path


def _flutter(rng: np.random.Generator) -> np.ndarray:
    walk = np.cumsum(rng.normal(size=len(_GRID))) * _PHASE_STEP
    return np.sin(2.0 * np.pi * 0.06 * _GRID + walk)[:, None] * np.array([1.0, 0.6, -0.5])


OUTSIDE: Mapping[str, Disturbance] = {
    "outside_swirl": Swirl(2e-6),
    "outside_leak": Leak(4e-6),
    "outside_rate_squared": RateSquared(3e-7),
    "outside_ripple": Ripple(1e-5),
    "outside_deadband": Deadband(1e-5),
    "outside_wander": Wander(4e-4),
}
# What has no shape is drawn anew for each campaign.
_DRAWN: Mapping[str, Callable[[np.random.Generator], Disturbance]] = {
    "outside_pump": lambda rng: Pump(1.2e-5),
    "outside_outgassing": lambda rng: Outgassing(1e-6),
    "outside_bursts": lambda rng: Bursts(6e-6, _bursts(rng)),
    "outside_slosh": lambda rng: Slosh(1e-4, _gauss_markov(rng)),
    "outside_flutter": lambda rng: Flutter(1e-5, _flutter(rng)),
    "outside_tracker_walk": lambda rng: TrackerWalk(2e-5),
}
KINDS = (*OUTSIDE, *_DRAWN)
# Without any fixed shape, and the random effect of the library that enters at the same place.
SHAPELESS: Mapping[str, str] = {
    "outside_wander": "star_tracker_low_frequency",
    "outside_bursts": "torque_noise",
    "outside_slosh": "torque_noise",
    "outside_flutter": "rate_bias_instability",
    "outside_tracker_walk": "star_tracker_low_frequency",
}


def outside(kind: str, rng: np.random.Generator) -> Disturbance:
    """The disturbance of a campaign."""
    return OUTSIDE[kind] if kind in OUTSIDE else _DRAWN[kind](rng)
