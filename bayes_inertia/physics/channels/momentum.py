"""Tachometers: momentum of each wheel relative to the body; in the measured drive an input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels.channel import Channel, Readings
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput


@dataclass(frozen=True)
class MomentumChannel(Channel):
    """Momentum of each wheel [N m s]; wheels have noise of their own."""

    hook = "momentum_output"
    axes = residual_axes = ("slew", "row", "wheel")

    def readings(self, campaign: Campaign, slew: Slew) -> Readings:
        """Of wheels whose noise is stated."""
        shape, measured = (len(slew.time), len(campaign.wheels)), slew.wheel_momentum
        measured = np.full(shape, np.nan) if measured is None else measured
        sensed = np.array([w.momentum_sigma is not None for w in campaign.wheels], dtype=bool)
        valid = np.isfinite(measured) & sensed
        return Readings(np.nan_to_num(measured), valid, np.arange(len(slew.time)))

    def start(self, campaign: Campaign, slew: Slew) -> dict[str, np.ndarray]:
        """The first reading of each wheel."""
        if slew.wheel_momentum is None:
            return {}
        known = [column[np.isfinite(column)] for column in slew.wheel_momentum.T]
        return {"wheel_momentum": np.array([x[0] if len(x) else 0.0 for x in known])}

    def sensed(self, constants: Any, bias: Array, slew: SlewInput, trajectory: Trajectory) -> Array:
        """The wheels' momentum itself."""
        return trajectory.wheel_momentum

    def noise(self, campaign: Campaign, theta: np.ndarray, drive: Drive) -> np.ndarray:
        """Sigma (wheels,) [N m s], infinite without tachometer."""
        return np.array([w.momentum_sigma or np.inf for w in campaign.wheels])

    def variance(self, noise: np.ndarray) -> np.ndarray:
        """Wheel by wheel."""
        return np.square(noise)

    def factors(self, noise: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """One over sigma (..., wheels)."""
        return np.where(valid, 1.0 / noise, 0.0) if self.compared else np.zeros(valid.shape)

    def drawn(self, noise: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """To single precision."""
        sigma = np.where(np.isfinite(noise), noise, np.nan)
        return (sigma * unit).astype(np.float32)

    def whitened(self, factors: Array, gap: Array) -> Array:
        """Wheel by wheel."""
        return factors * gap

    def unwhitened(self, factors: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Wheel by wheel."""
        return residual / np.where(factors > 0, factors, 1.0)

    def diagonal(self, factors: AnyArray) -> np.ndarray:
        """The factors themselves."""
        return np.asarray(factors)

    def whitened_columns(self, factors: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Wheel by wheel."""
        return factors[..., None] * error

    def whitened_motion(
        self,
        campaign: Campaign,
        theta: np.ndarray,
        factors: np.ndarray,
        turn: np.ndarray,
        rate_B: np.ndarray,
    ) -> np.ndarray:
        """A wheel that keeps its momentum turns slower in a body that turns with it."""
        spin, axes_B = campaign.spin_inertias, campaign.wheel_axes_B
        return -np.einsum("snw,w,iw,snik->snwk", factors, spin, axes_B, rate_B)
