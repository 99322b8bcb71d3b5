"""Errors of a device beside wheels: gains, direction and delay, beyond what the campaign states."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jax import Array

from bayes_inertia.physics.actuators.device import DeviceEffect, error_of
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, scalar
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.slew_input import InputRows


@dataclass(frozen=True)
class ActuatorError(Effect):
    """What a device makes with an error, less what it makes as it is stated.

    Parameters
    ----------
    acting : DeviceEffect or None
        What the device does; None before a campaign is known.
    sigma : float or None, optional
        Prior sd of the error.
    """

    acting: DeviceEffect | None = None
    sigma: float | None = None

    @property
    def needs(self) -> tuple[str, ...]:  # type: ignore[override]
        """What the device needs."""
        return self.acting.needs if self.acting else ()

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The device's input."""
        return self.acting.inputs if self.acting else ()

    def parameters(self, campaign):
        record = self.acting.record if self.acting else None
        # Ten times the sd that the campaign states, and something where it states none.
        sd = max(self.sigma or 0.0, 10.0 * getattr(record, f"{self.kind}_sigma", 0.0))
        return (error_of(record, self.kind, sd),)

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

    name = "actuator_gain"
    kind = "gain"
    sigma: float = 0.05


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

    name = "actuator_direction"
    kind = "direction"
    sigma: float = 0.02


@dataclass(frozen=True)
class ActuatorEachGain(ActuatorError):
    """Each torquer, thruster or rotor of a device, or component of a torque, has a gain of its own.

    Parameters
    ----------
    sigma : float, optional
        Prior sd, as of `ActuatorGain`. Ten times a stated `each_gain_sigma` if that is more.

    Examples
    --------
    >>> ActuatorEachGain(device="jets").name
    'each_gain[jets]'
    """

    name = "actuator_each_gain"
    kind = "each_gain"
    sigma: float = 0.05


@dataclass(frozen=True)
class ActuatorDelay(ActuatorError):
    """A device does what it is told tau >= 0 later.

    What it does over a grid interval has the exact mean of the delayed input, so that momentum is
    exact at every sample. Before the first row it did what it does there.

    Parameters
    ----------
    sigma : float or None, optional
        Prior scale of tau [s]; None takes 1/300 of a slew's duration, as `WheelCommandLag` does.

    Examples
    --------
    >>> ActuatorDelay(device="torquers").name
    'delay[torquers]'
    """

    name = "actuator_delay"
    kind = "delay"
    sigma: float | None = None

    def acts(self, hook):
        return hook == "delivered_inputs" and self.acting is not None

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else campaign.scale_of_motion()[1] / 300.0
        return (scalar("tau", unit="s", prior=Normal(0.0, sigma, lower=0.0)),)

    def delivered_inputs(self, p, slew, inputs):
        return {**inputs, self.device: _delayed(inputs[self.device], slew, p["tau"])}


def _delayed(rows: InputRows, slew: SlewContext, tau: Array) -> InputRows:
    """The input tau earlier: its exact mean over each interval, and its rise where it is a line."""
    first, last, time, step = rows.first, rows.last, slew.time, slew.step[:, None]
    safe = jnp.where(step > 0.0, step, 1.0)
    slope = (last - first) / safe
    area = jnp.cumsum(0.5 * (first + last) * step, axis=0) - 0.5 * (first + last) * step

    def earlier(times: Array) -> tuple[Array, Array]:
        """The input and its integral since the first row, before it what it is there."""
        k = jnp.clip(jnp.searchsorted(time, times - tau, side="left") - 1, 0, len(time) - 1)
        passed = (times - tau - time[k])[:, None]
        risen = slope[k] * jnp.maximum(passed, 0.0)
        return first[k] + risen, area[k] + (first[k] + 0.5 * risen) * passed

    (begin, before), (end, after) = earlier(time), earlier(time + slew.step)
    half = jnp.where(jnp.any(first != last), 0.5 * (end - begin), 0.0)
    mean = (after - before) / safe
    moves = step > 0.0
    return InputRows(jnp.where(moves, mean - half, first), jnp.where(moves, mean + half, last))
