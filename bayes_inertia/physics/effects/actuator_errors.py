"""Errors of a device beside wheels: its gain and its direction, beyond what the campaign states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.physics.actuators import DeviceEffect
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, scalar, vector


@dataclass(frozen=True)
class ActuatorError(Effect):
    """What a device makes with an error, less what it makes as it is stated.

    Parameters
    ----------
    acting : DeviceEffect or None
        What the device does; None before a campaign is known.
    """

    acting: DeviceEffect | None = None

    @property
    def needs(self) -> tuple[str, ...]:  # type: ignore[override]
        """What the device needs."""
        return self.acting.needs if self.acting else ()

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The device's input."""
        return self.acting.inputs if self.acting else ()

    def acts(self, hook):
        own = hook in ("body_torque", "carried_momentum")
        return own and self.acting is not None and self.acting.acts(hook)

    def body_torque(self, p, slew, t, state):
        torque = self._made_by.body_torque
        return torque(p, slew, t, state) - torque({}, slew, t, state)

    def carried_momentum(self, p, slew, t, inputs):
        momentum = self._made_by.carried_momentum
        return momentum(p, slew, t, inputs) - momentum({}, slew, t, inputs)

    @property
    def _made_by(self) -> DeviceEffect:
        assert self.acting is not None
        return self.acting

    def _sd(self, least: float, stated: str) -> float:
        """Ten times the sd that the campaign states, and something where it states none."""
        return max(least, 10.0 * getattr(self.acting.record, stated, 0.0) if self.acting else 0.0)


@dataclass(frozen=True)
class ActuatorGain(ActuatorError):
    """A device makes more or less torque, dipole or momentum than it is stated to.

    Parameters
    ----------
    sigma : float, optional
        Prior sd; 0.05 is the spread of thrust or dipole that nobody calibrated. Ten times a stated
        `gain_sigma` if that is more.

    Examples
    --------
    >>> ActuatorGain(device="torquers").name
    'gain[torquers]'
    """

    name: ClassVar[str] = "actuator_gain"
    kind: ClassVar[str] = "gain"
    sigma: float = 0.05

    def parameters(self, campaign):
        sd = self._sd(self.sigma, "gain_sigma")
        return (scalar("gain", unit="", prior=Normal(1.0, sd), null=1.0),)


@dataclass(frozen=True)
class ActuatorDirection(ActuatorError):
    """All torques, dipoles or momenta of a device are turned by a small rotation about body axes.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each angle [rad]; 0.02 (1 deg) is common for thrusters that were bolted. Ten
        times a stated `direction_sigma` if that is more.

    Examples
    --------
    >>> ActuatorDirection(device="jets").name
    'direction[jets]'
    """

    name: ClassVar[str] = "actuator_direction"
    kind: ClassVar[str] = "direction"
    sigma: float = 0.02

    def parameters(self, campaign):
        sd = self._sd(self.sigma, "direction_sigma")
        return (vector("direction", "xyz", unit="rad", prior=Normal(0.0, sd)),)
