"""Tachometers: momentum of each wheel relative to the body; in the measured drive an input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.physics.channels.channel import Readings, SensorAtFit, SeparateColumns
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import SlewInput


@dataclass(frozen=True)
class MomentumChannel(SeparateColumns):
    """Momentum of each wheel [N m s]; wheels have noise of their own."""

    hook = "momentum_output"
    columns = components = "wheel"

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

    def whitened_motion(self, fit: SensorAtFit, turn: np.ndarray, rate_B: np.ndarray) -> np.ndarray:
        """A wheel that keeps its momentum turns slower in a body that turns with it."""
        spin, axes_B = fit.campaign.spin_inertias, fit.campaign.wheel_axes_B
        return -np.einsum("snw,w,iw,snik->snwk", fit.factors, spin, axes_B, rate_B)
