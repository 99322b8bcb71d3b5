"""A star tracker: q_meas = q * dq(e), e a small rotation in body axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew, between_fix_groups
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels.channel import Channel, Readings, SensorAtFit
from bayes_inertia.physics.slew_context import SlewContext, Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput

_turned = jax.jit(lambda q, small_rotation: quaternion.turned(q, small_rotation))


@dataclass(frozen=True)
class AttitudeChannel(Channel):
    """Quaternions, body from inertial, scalar last; residuals are small rotations, sign-free."""

    hook = "attitude_output"
    columns = "quaternion"
    tells_angle = True
    components = "body_axis"
    blank = (0.0, 0.0, 0.0, 1.0)

    def readings(self, campaign: Campaign, slew: Slew) -> Readings:
        """The fixes."""
        known = self.stream.of(slew)
        known = np.full((len(slew.time), 4), np.nan) if known is None else known
        rows = np.flatnonzero(np.isfinite(known).all(axis=1))
        values = known[rows]
        return Readings(values, np.ones((len(rows), 3), bool), rows)

    def start(self, campaign: Campaign, slew: Slew) -> dict[str, np.ndarray]:
        """The first fix."""
        values = self.readings(campaign, slew).values
        return {"attitude": values[0]} if len(values) else {}

    def constants(self, campaign: Campaign) -> Any:
        """Of a further tracker the times (slews, m) between groups of its fixes."""
        if self.stream.field:
            return ()
        between = []
        for slew in campaign.slews:
            fixed = np.isin(np.arange(len(slew.time)), self.readings(campaign, slew).row)
            between.append(between_fix_groups(slew, fixed))
        m = max(map(len, between))
        rows = [np.pad(times, (0, m - len(times)), constant_values=np.inf) for times in between]
        return on_device(np.stack(rows))

    def context(self, constants: Any, slew: SlewContext) -> SlewContext:
        """With the groups of this tracker's fixes, where they are others than the first's."""
        if isinstance(constants, tuple) or slew.fix_group is None:
            return slew
        return slew._replace(fix_group=jnp.searchsorted(constants[slew.index], slew.time))

    def sensed(self, constants: Any, bias: Array, slew: SlewInput, trajectory: Trajectory) -> Array:
        """The attitude itself."""
        return trajectory.attitude

    def gap(self, measured: Array, predicted: Array) -> Array:
        """The small rotation from the predicted attitude to the measured one [rad]."""
        return quaternion.error(predicted, measured)

    def moved(self, values: AnyArray, change: AnyArray) -> AnyArray:
        """Attitudes turned by small rotations in body axes [rad]."""
        return np.asarray(_turned(values, change))

    def column_sigma(self, campaign: Campaign) -> np.ndarray:
        """Components of a quaternion are half a small rotation."""
        tracker = self.stream.hardware(campaign)
        return np.full(4, 0.5 * tracker.sigma_cross if tracker else np.inf)

    def noise(self, campaign: Campaign, theta: np.ndarray, drive: Drive) -> np.ndarray:
        """Root of the covariance and its inverse (2, 3, 3) [rad, 1/rad]; zero without tracker."""
        tracker = self.stream.hardware(campaign)
        if tracker is None:
            return np.zeros((2, 3, 3))
        along = np.outer(tracker.boresight_B, tracker.boresight_B)
        across = np.eye(3) - along
        root = tracker.sigma_cross * across + tracker.sigma_roll * along
        inverse = across / tracker.sigma_cross + along / tracker.sigma_roll
        return np.stack([root, inverse])

    def factors(self, noise: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """The inverse root where there is a fix (..., 3, 3)."""
        return valid[..., :1, None] * noise[1]

    def drawn(self, noise: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Small rotations [rad]."""
        return unit @ noise[0]

    def whitened_motion(self, fit: SensorAtFit, turn: np.ndarray, rate_B: np.ndarray) -> np.ndarray:
        """The turn itself."""
        return self.whitened_columns(fit.factors, turn)
