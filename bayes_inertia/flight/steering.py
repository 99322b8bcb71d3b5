"""The device that turns a spacecraft without enough wheels: its limits, and its input along a slew.

Thrusters and told torques push; gimballed rotors carry momentum. What a slew asks of either is a
vector in body axes (`planned_motion`), which must stay inside what the device can give.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import nnls

from bayes_inertia.campaign.actuators import Actuator, GimballedRotors, KnownTorque, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.inputs import Between
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.maths.values import AnyArray, array_dataclass


class Jets(NamedTuple):
    """What pushes: k torques, each as strong as its input says."""

    torque_B: AnyArray  # (k, 3) at an input of 1 [N m]
    lowest: AnyArray  # (k,) least input: 0 for a thruster
    highest: AnyArray  # (k,) largest input: 1 for a thruster
    shares: AnyArray  # (3, k) least inputs of either sign for a torque along each axis [1/(N m)]


class Gimbals(NamedTuple):
    """What carries momentum: k rotors, whose gimbal angles are the input."""

    momentum: AnyArray  # (k,) of each rotor [N m s]
    along_B: AnyArray  # (k, 3) spin axes at angle zero
    across_B: AnyArray  # (k, 3) spin axes at a right angle
    start: AnyArray  # (k,) angles before the first slew [rad]

    def carried_B(self, angle: Array) -> tuple[Array, Array]:
        """Momentum (3,) at gimbal angles (k,), and its derivative (3, k) by them [N m s]."""
        c, s = jnp.cos(angle)[:, None], jnp.sin(angle)[:, None]
        spin, turning = c * self.along_B + s * self.across_B, c * self.across_B - s * self.along_B
        return self.momentum @ spin, (self.momentum[:, None] * turning).T


@array_dataclass
class FlyingDevice:
    """The device that flies plans, as it was at the end of a campaign."""

    record: Actuator
    between: Between  # what it does from one reading of its input to the next
    start: np.ndarray  # (k,) its last input
    given_B: np.ndarray  # (n, 3) torques that a told torque gave in the campaign [N m]

    @property
    def arrays(self) -> dict[str, Jets | Gimbals]:
        """By its name, for compiled code."""
        record = self.record
        if isinstance(record, GimballedRotors):
            along = record.spin_axes_at_zero_B
            across = np.cross(record.gimbal_axes_B, along)
            return {record.name: Gimbals(np.asarray(record.momentum), along, across, self.start)}
        one, torque_B = np.ones(record.columns), np.eye(3)
        lowest, highest = -np.inf * one, np.inf * one
        if isinstance(record, Thruster):
            torque_B, lowest, highest = record.torque_B, 0.0 * one, one
        return {record.name: Jets(torque_B, lowest, highest, np.linalg.pinv(torque_B))}

    @property
    def carries_momentum(self) -> bool:
        """Whether its limit is one of momentum, not of torque."""
        return isinstance(self.record, GimballedRotors)

    @property
    def reach(self) -> np.ndarray:
        """The most (m,) that it gives along each of `directions_B` [N m, or N m s]."""
        directions, record = directions_B(), self.record
        if isinstance(record, GimballedRotors):
            along = np.clip(record.gimbal_axes_B @ directions.T, -1.0, 1.0)
            return np.asarray(record.momentum @ np.sqrt(1.0 - along**2))
        if isinstance(record, Thruster):
            return np.asarray(np.maximum(record.torque_B @ directions.T, 0.0).sum(axis=0))
        return np.asarray(np.maximum((self.given_B @ directions.T).max(axis=0), 0.0))

    @property
    def axes(self) -> int:
        """About how many body axes it turns the spacecraft both ways."""
        record = self.record
        if isinstance(record, GimballedRotors):
            along = record.spin_axes_at_zero_B
            both = np.concatenate([along, np.cross(record.gimbal_axes_B, along)])
            return int(np.linalg.matrix_rank(both, tol=1e-6))
        pushes = record.torque_B if isinstance(record, Thruster) else self.given_B
        largest = float(np.abs(pushes).max())
        ways = [s * axis for axis in np.eye(3) for s in (1.0, -1.0)] if largest else []
        reached = [nnls(pushes.T / largest, way)[1] < 1e-6 for way in ways]
        return sum(a and b for a, b in zip(reached[::2], reached[1::2], strict=True))


def directions_B() -> np.ndarray:
    """Unit vectors (m, 3) all over the sphere, on Fibonacci's spiral."""
    m = NUMERICS.envelope_directions
    z = 1.0 - (2.0 * np.arange(m) + 1.0) / m
    around = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(m)
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(around), across * np.sin(around), z], axis=1)


def flying_device(campaign: Campaign) -> FlyingDevice | None:
    """The device beside wheels that turns a campaign's spacecraft about most axes.

    None where there is none. A torquer turns about no axis that stays: its torque is at right
    angles to the field.
    """
    kinds = (GimballedRotors, Thruster, KnownTorque)
    ranked = [x for kind in kinds for x in campaign.actuators if isinstance(x, kind)]
    found = [
        _device(record, campaign)
        for record in ranked
        if not (isinstance(record, KnownTorque) and record.frame != "body")
    ]
    return max(found, key=lambda device: device.axes, default=None)


def _device(record: Actuator, campaign: Campaign) -> FlyingDevice:
    streams = [(slew.inputs or {})[record.name] for slew in campaign.slews]
    given = np.concatenate([s.values for s in streams]) if record.columns == 3 else np.zeros((1, 3))
    rows = np.argsort(np.linalg.norm(given, axis=1))[-NUMERICS.torques_of_envelope :]
    return FlyingDevice(record, streams[-1].between, streams[-1].values[-1], given[rows])


def share_of_reach(wanted_B: AnyArray, reach: AnyArray) -> Array:
    """What a device must give (..., 3), as a fraction (...) of the most that it can."""
    return jnp.max(jnp.asarray(wanted_B) @ directions_B().T / reach, axis=-1)


def device_input(device: Jets | Gimbals, wanted_B: Array) -> Array:
    """The input (n, k) that gives torques [N m] or momenta [N m s] (n, 3) in n rows of a slew."""
    if isinstance(device, Jets):
        return _levels(device, wanted_B)
    first = _angles_from(device, jnp.asarray(device.start), wanted_B[0], NUMERICS.steps_to_start)

    def row(angle: Array, wanted: Array) -> tuple[Array, Array]:
        angle = _angles_from(device, angle, wanted, NUMERICS.steps_of_row)
        return angle, angle

    return jax.lax.scan(row, first, wanted_B)[1]


def _levels(jets: Jets, wanted_B: Array) -> Array:
    """Inputs (n, k) between their ends, by alternating projections."""

    def closer(levels: Array, _: None) -> tuple[Array, None]:
        missing = wanted_B - levels @ jets.torque_B
        return jnp.clip(levels + missing @ jets.shares, jets.lowest, jets.highest), None

    none = jnp.zeros((len(wanted_B), len(jets.torque_B)))
    return jax.lax.scan(closer, none, None, NUMERICS.projections)[0]


def _angles_from(gimbals: Gimbals, angle: Array, wanted_B: Array, steps: int) -> Array:
    """Gimbal angles (k,) near others that carry a momentum (3,), by Newton's method."""
    first = gimbals.carried_B(angle)[0]

    def nearer(angle: Array, share: Array) -> tuple[Array, None]:
        carried, slope = gimbals.carried_B(angle)
        missing = first + share * (wanted_B - first) - carried
        # Damped, so that a singular direction moves no gimbal far.
        square = slope @ slope.T
        damped = square + NUMERICS.gimbal_damping * jnp.trace(square) * jnp.eye(3)
        return angle + slope.T @ jnp.linalg.solve(damped, missing), None

    shares = np.minimum(1.0, (np.arange(steps) + 1.0) / max(1, steps - 2))
    return jax.lax.scan(nearer, angle, jnp.asarray(shares))[0]


def unreached(device: Jets | Gimbals, inputs: AnyArray, wanted_B: AnyArray) -> float:
    """The largest part of what is wanted (n, 3) that inputs (n, k) do not give [N m, N m s]."""
    if isinstance(device, Jets):
        given = np.asarray(inputs) @ np.asarray(device.torque_B)
    else:
        given = np.asarray(jax.vmap(lambda a: device.carried_B(a)[0])(jnp.asarray(inputs)))
    return float(np.abs(given - np.asarray(wanted_B)).max())
