"""The device that turns a spacecraft without enough wheels: its limits, and its input along a slew.

Thrusters and told torques push; gimballed rotors carry momentum. What a slew asks of either is a
vector in body axes (`planned_motion`), which must stay inside what the device can give. A kind that
flies is a class here and a line in `_FLYING`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

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

    def given_B(self, inputs: AnyArray) -> Array:
        """Torques (n, 3) of inputs (n, k) [N m]."""
        return jnp.asarray(inputs) @ jnp.asarray(self.torque_B)

    def inputs(self, wanted_B: Array) -> Array:
        """Inputs (n, k) between their ends that give torques (n, 3), by alternating projections."""

        def closer(levels: Array, _: None) -> tuple[Array, None]:
            missing = wanted_B - levels @ self.torque_B
            return jnp.clip(levels + missing @ self.shares, self.lowest, self.highest), None

        none = jnp.zeros((len(wanted_B), len(self.torque_B)))
        return jax.lax.scan(closer, none, None, NUMERICS.projections)[0]


class Gimbals(NamedTuple):
    """What carries momentum: k rotors, whose gimbal angles are the input."""

    momentum: AnyArray  # (k,) of each rotor [N m s]
    along_B: AnyArray  # (k, 3) spin axes at angle zero
    across_B: AnyArray  # (k, 3) spin axes at a right angle
    start: AnyArray  # (k,) angles before the first slew [rad]

    def carried_B(self, angle: AnyArray) -> tuple[Array, Array]:
        """Momentum (3,) at gimbal angles (k,), and its derivative (3, k) by them [N m s]."""
        c, s = jnp.cos(angle)[:, None], jnp.sin(angle)[:, None]
        spin, turning = c * self.along_B + s * self.across_B, c * self.across_B - s * self.along_B
        return self.momentum @ spin, (self.momentum[:, None] * turning).T

    def given_B(self, inputs: AnyArray) -> Array:
        """Momenta (n, 3) at gimbal angles (n, k) [N m s]."""
        return jax.vmap(lambda angle: self.carried_B(angle)[0])(jnp.asarray(inputs))

    def inputs(self, wanted_B: Array) -> Array:
        """Gimbal angles (n, k) that carry momenta (n, 3) in n rows of a slew."""
        first = self._angles_from(jnp.asarray(self.start), wanted_B[0], NUMERICS.steps_to_start)

        def row(angle: Array, wanted: Array) -> tuple[Array, Array]:
            angle = self._angles_from(angle, wanted, NUMERICS.steps_of_row)
            return angle, angle

        return jax.lax.scan(row, first, wanted_B)[1]

    def _angles_from(self, angle: Array, wanted_B: Array, steps: int) -> Array:
        """Gimbal angles (k,) near others that carry a momentum (3,), by Newton's method."""
        first = self.carried_B(angle)[0]

        def nearer(angle: Array, share: Array) -> tuple[Array, None]:
            carried, slope = self.carried_B(angle)
            missing = first + share * (wanted_B - first) - carried
            # Damped, so that a singular direction moves no gimbal far.
            square = slope @ slope.T
            damped = square + NUMERICS.gimbal_damping * jnp.trace(square) * jnp.eye(3)
            return angle + slope.T @ jnp.linalg.solve(damped, missing), None

        shares = np.minimum(1.0, (np.arange(steps) + 1.0) / max(1, steps - 2))
        return jax.lax.scan(nearer, angle, jnp.asarray(shares))[0]


@array_dataclass
class FlyingDevice:
    """A device that flies plans, as it was at the end of a campaign; here one that is told torques.

    `given_B`: the strongest torques that a told torque gave in the campaign stand for all that it
    can give.
    """

    record: Any  # of `campaign.actuators`
    between: Between  # what it does from one reading of its input to the next
    start: np.ndarray  # (k,) its last input
    given_B: np.ndarray  # (n, 3) the strongest inputs of a campaign, where they are torques [N m]
    carries_momentum: ClassVar[bool] = False  # whether its limit is one of momentum, not of torque

    @property
    def array(self) -> Jets | Gimbals:
        """For compiled code."""
        return _jets(np.eye(3), -np.inf, np.inf)

    @property
    def pushes_B(self) -> np.ndarray:
        """Torques (n, 3) whose sums, none taken less than zero times, it gives [N m]."""
        return self.given_B

    @property
    def reach(self) -> np.ndarray:
        """The most (m,) that it gives along each of `directions_B` [N m, or N m s]."""
        return np.asarray(np.maximum((self.given_B @ directions_B().T).max(axis=0), 0.0))

    @property
    def axes(self) -> int:
        """About how many body axes it turns the spacecraft both ways."""
        pushes = self.pushes_B
        largest = float(np.abs(pushes).max())
        ways = [s * axis for axis in np.eye(3) for s in (1.0, -1.0)] if largest else []
        reached = [nnls(pushes.T / largest, way)[1] < 1e-6 for way in ways]
        return sum(a and b for a, b in zip(reached[::2], reached[1::2], strict=True))


class _Thrusters(FlyingDevice):
    """Thrusters between nothing and full thrust."""

    @property
    def array(self) -> Jets:
        return _jets(self.record.torque_B, 0.0, 1.0)

    @property
    def pushes_B(self) -> np.ndarray:
        return self.record.torque_B

    @property
    def reach(self) -> np.ndarray:
        along = self.record.torque_B @ directions_B().T
        return np.asarray(np.maximum(along, 0.0).sum(axis=0))


class _Rotors(FlyingDevice):
    """Gimballed rotors at any gimbal angles."""

    carries_momentum = True

    @property
    def array(self) -> Gimbals:
        record, along = self.record, self.record.spin_axes_at_zero_B
        across = np.cross(record.gimbal_axes_B, along)
        return Gimbals(np.asarray(record.momentum), along, across, self.start)

    @property
    def reach(self) -> np.ndarray:
        along = np.clip(self.record.gimbal_axes_B @ directions_B().T, -1.0, 1.0)
        return np.asarray(self.record.momentum @ np.sqrt(1.0 - along**2))

    @property
    def axes(self) -> int:
        _, along, across, _ = self.array
        return int(np.linalg.matrix_rank(np.concatenate([along, across]), tol=1e-6))


# Those that turn about axes that stay: a torquer's torque is at right angles to the field.
_FLYING: Mapping[type, type[FlyingDevice]] = MappingProxyType(
    {GimballedRotors: _Rotors, Thruster: _Thrusters, KnownTorque: FlyingDevice}
)


def _jets(torque_B: np.ndarray, lowest: float, highest: float) -> Jets:
    one = np.ones(len(torque_B))
    return Jets(torque_B, lowest * one, highest * one, np.linalg.pinv(torque_B))


def directions_B() -> np.ndarray:
    """Unit vectors (m, 3) all over the sphere, on Fibonacci's spiral."""
    m = NUMERICS.envelope_directions
    z = 1.0 - (2.0 * np.arange(m) + 1.0) / m
    around = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(m)
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(around), across * np.sin(around), z], axis=1)


def flying_device(campaign: Campaign) -> FlyingDevice | None:
    """The device beside wheels that turns a campaign's spacecraft about most axes; None without."""
    found = [
        _device(flies, record, campaign)
        for kind, flies in _FLYING.items()
        for record in campaign.actuators
        if isinstance(record, kind) and getattr(record, "frame", "body") == "body"
    ]
    return max(found, key=lambda device: device.axes, default=None)


def _device(flies: type[FlyingDevice], record: Actuator, campaign: Campaign) -> FlyingDevice:
    streams = [(slew.inputs or {})[record.name] for slew in campaign.slews]
    given = np.concatenate([s.values for s in streams]) if record.columns == 3 else np.zeros((1, 3))
    rows = np.argsort(np.linalg.norm(given, axis=1))[-NUMERICS.torques_of_envelope :]
    return flies(record, streams[-1].between, streams[-1].values[-1], given[rows])


def share_of_reach(wanted_B: AnyArray, reach: AnyArray) -> Array:
    """What a device must give (..., 3), as a fraction (...) of the most that it can."""
    return jnp.max(jnp.asarray(wanted_B) @ directions_B().T / reach, axis=-1)
