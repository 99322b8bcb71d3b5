"""What may be wrong with one device, by kind and name: `delay[mems]`, `gain[torquers]`."""

from __future__ import annotations

import difflib
import re
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, ClassVar, cast

import jax.numpy as jnp
import pydantic
from jax import Array

from bayes_inertia.campaign.actuators import Actuator
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor, StarTracker
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.actuators import KINDS as DEVICE_EFFECTS
from bayes_inertia.physics.actuators import DeviceEffect
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.sensor_errors import (
    DirectionDelay,
    DirectionMisalignment,
    FieldOffset,
    FieldScale,
    Misalignment,
    RateBias,
    RateBiasDrift,
    RateSensorDelay,
    RateSensorMisalignment,
    RateSensorNonlinearity,
    StarTrackerMisalignment,
    StarTrackerShift,
    StarTrackerTimeOffset,
)
from bayes_inertia.physics.parameters import Normal, scalar, vector
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.slew_input import InputRows


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

    name: ClassVar[str] = "actuator_each_gain"
    kind: ClassVar[str] = "each_gain"
    sigma: float = 0.05

    def parameters(self, campaign):
        sd = self._sd(self.sigma, "each_gain_sigma")
        names = [str(k + 1) for k in range(self._made_by.record.columns)]
        return (vector("each_gain", names, unit="", prior=Normal(1.0, sd), null=1.0),)


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

    name: ClassVar[str] = "actuator_delay"
    kind: ClassVar[str] = "delay"
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


# What may be wrong with a device, by its record.
KINDS: Mapping[Any, tuple[Effect, ...]] = MappingProxyType(
    {
        RateSensor: (
            RateBias(),
            RateBiasDrift(),
            RateSensorMisalignment(),
            RateSensorDelay(),
            RateSensorNonlinearity(),
        ),
        StarTracker: (StarTrackerMisalignment(), StarTrackerShift(), StarTrackerTimeOffset()),
        DirectionSensor: (
            DirectionMisalignment(),
            DirectionDelay(),
            FieldOffset(),
            FieldScale(),
        ),
        Actuator: (ActuatorGain(), ActuatorDirection(), ActuatorEachGain(), ActuatorDelay()),
    }
)
# Kinds of sensors whose first one has effects of the library.
_FIRST = (RateSensor, StarTracker)
_NAME = re.compile(r"(?P<kind>\w+)\[(?P<device>.+)\]")


@dataclass(frozen=True)
class OfDevice(Effect):
    """An effect named by kind and device, before a campaign says what the device is.

    Parameters
    ----------
    error : str
        The kind.
    settings : tuple of (str, object)
        Of the effect that it stands for.
    """

    error: str = ""
    settings: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of_name(cls, name: str, settings: Mapping[str, Any] | None = None) -> OfDevice | None:
        """The effect of a name such as `delay[mems]`; None for a name of another form.

        Examples
        --------
        >>> OfDevice.of_name("delay[mems]").device
        'mems'
        """
        match = _NAME.fullmatch(name)
        if match is None:
            return None
        kinds = list(dict.fromkeys(effect.kind for own in KINDS.values() for effect in own))
        if match["kind"] not in kinds:
            near = difflib.get_close_matches(match["kind"], kinds, 3, 0.4) or kinds
            raise EffectError(
                f"no kind of effect is called {match['kind']!r}",
                where=name,
                advice=f"perhaps {', '.join(near)}",
            )
        return cls(match["kind"], tuple((settings or {}).items()), device=match["device"])

    @property
    def name(self) -> str:  # type: ignore[override]
        """Kind and device."""
        return f"{self.error}[{self.device}]"

    def in_campaign(self, campaign: Campaign) -> Effect:
        """The effect of the device, with its settings."""
        devices = devices_of(campaign)
        if self.device not in devices:
            raise EffectError(
                f"no device of this campaign is called {self.device!r}",
                where=self.name,
                advice=f"devices here: {', '.join(devices)}",
            )
        known = errors_of(self.device, campaign)
        for effect in known:
            if effect.kind == self.error:
                return with_settings(effect, dict(self.settings)).in_campaign(campaign)
        what = f"{self.device} has no error of this kind"
        advice = f"effects of it: {', '.join(effect.name for effect in known)}"
        raise EffectError(what, where=self.name, advice=advice)


def devices_of(campaign: Campaign) -> dict[str, Any]:
    """Records of all sensors and of all actuators beside wheels, by name."""
    return campaign.sensors | {device.name: device for device in campaign.actuators}


def errors_of(device: str, campaign: Campaign) -> tuple[Effect, ...]:
    """What may be wrong with a device."""
    record = devices_of(campaign)[device]
    if isinstance(record, Actuator):
        acting = DEVICE_EFFECTS[type(record)](record)
        actuator_errors = cast("tuple[ActuatorError, ...]", KINDS[Actuator])
        return tuple(
            replace(e, acting=acting, device=device)
            for e in actuator_errors
            # A gain of each of one is the gain.
            if record.columns > 1 or not isinstance(e, ActuatorEachGain)
        )
    own = KINDS.get(type(record), ())
    is_field = getattr(record, "is_field", False)
    return tuple(
        replace(e, device=device)
        for e in own
        if is_field or not isinstance(e, FieldOffset | FieldScale)
    )


def candidates_in(campaign: Campaign, library: Sequence[Effect]) -> tuple[Effect, ...]:
    """The library as a campaign has it, with what may be wrong with each of its further devices.

    Where there are several sensors of a kind, effects of the first bear its name too. The axes of
    the reference of frames are the body's: no misalignment of it is looked for. A library that
    lacks errors of the first sensors is taken as it is.
    """
    given = tuple(effect.in_campaign(campaign) for effect in library)
    first = {type(e): n for n, k in zip(campaign.names, _FIRST, strict=True) for e in KINDS[k]}
    stated = campaign.reference is not None
    if not (campaign.more_sensors or campaign.actuators or stated):
        return given
    kinds = [type(record) for record in campaign.sensors.values()]
    several = {type(e) for kind in _FIRST if kinds.count(kind) > 1 for e in KINDS[kind]}
    own = [e for e in given if e.device]
    found = [
        replace(e, device=first[type(e)]) if type(e) in several else e
        for e in given
        if not e.device
    ]
    if first.keys() <= {type(e) for e in given}:
        further = [*dict(campaign.more_sensors), *(device.name for device in campaign.actuators)]
        found += [error for name in further for error in errors_of(name, campaign)]
    if campaign.more_sensors or stated:
        body = campaign.frame_reference
        turned = [e for e in found if isinstance(e, Misalignment)]
        drop = [e for e in turned if (e.device or first.get(type(e))) == body]
        found = [e for e in found if e not in drop]
    names = {e.name for e in own}
    return (*(e for e in found if e.name not in names), *own)


def with_settings(effect: Effect, settings: Mapping[str, Any]) -> Effect:
    """An effect with some of its fields as given, as text maybe."""
    if isinstance(effect, OfDevice):
        return replace(effect, settings=(*effect.settings, *settings.items()))
    hints = typing.get_type_hints(type(effect))
    known = {field.name: hints[field.name] for field in fields(effect) if field.init}
    values = {}
    for key, text in settings.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, 1) or list(known)
            has = f"perhaps {', '.join(near)}" if near else "it has none"
            raise EffectError(f"no setting {key!r}", where=effect.name, advice=has)
        try:
            values[key] = pydantic.TypeAdapter(known[key]).validate_python(text)
        except pydantic.ValidationError as error:
            raise EffectError(
                f"{text!r} is no value of {key} ({error.errors()[0]['msg']})",
                where=effect.name,
                advice=f"give it as {known[key]}, such as {effect.name}:{key}=...",
            ) from None
    return replace(effect, **values)
