"""What may be wrong with one device, by kind and name: `delay[mems]`, `gain[torquers]`."""

from __future__ import annotations

import difflib
import re
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import pydantic

from bayes_inertia.campaign.actuators import Actuator
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor, StarTracker
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.actuators import KINDS as DEVICE_EFFECTS
from bayes_inertia.physics.effect import Effect, require_of_effect
from bayes_inertia.physics.effects.actuator_errors import (
    ActuatorDelay,
    ActuatorDirection,
    ActuatorEachGain,
    ActuatorError,
    ActuatorGain,
)
from bayes_inertia.physics.effects.field_errors import FieldOffset, FieldScale
from bayes_inertia.physics.effects.rate_bias import RateBias, RateBiasDrift
from bayes_inertia.physics.effects.rate_sensor_delay import DirectionDelay, RateSensorDelay
from bayes_inertia.physics.effects.rate_sensor_nonlinearity import RateSensorNonlinearity
from bayes_inertia.physics.effects.sensor_misalignment import (
    DirectionMisalignment,
    Misalignment,
    RateSensorMisalignment,
    StarTrackerMisalignment,
)
from bayes_inertia.physics.effects.star_tracker_shift import StarTrackerShift
from bayes_inertia.physics.effects.star_tracker_time_offset import StarTrackerTimeOffset

# What may be wrong with a device, by its record.
KINDS: Mapping[Any, tuple[Effect, ...]] = {
    RateSensor: (
        RateBias(),
        RateBiasDrift(),
        RateSensorMisalignment(),
        RateSensorDelay(),
        RateSensorNonlinearity(),
    ),
    StarTracker: (StarTrackerMisalignment(), StarTrackerShift(), StarTrackerTimeOffset()),
    DirectionSensor: (DirectionMisalignment(), DirectionDelay(), FieldOffset(), FieldScale()),
    Actuator: (ActuatorGain(), ActuatorDirection(), ActuatorEachGain(), ActuatorDelay()),
}
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
            what = f"no kind of effect is called {match['kind']!r}"
            require_of_effect(False, name, what, f"perhaps {', '.join(near)}")
        return cls(match["kind"], tuple((settings or {}).items()), device=match["device"])

    @property
    def name(self) -> str:  # type: ignore[override]
        """Kind and device."""
        return f"{self.error}[{self.device}]"

    def in_campaign(self, campaign: Campaign) -> Effect:
        """The effect of the device, with its settings."""
        devices = devices_of(campaign)
        what = f"no device of this campaign is called {self.device!r}"
        advice = f"devices here: {', '.join(devices)}"
        require_of_effect(self.device in devices, self, what, advice)
        known = errors_of(self.device, campaign)
        for effect in known:
            if effect.kind == self.error:
                effect = replace(effect, prior_scale=self.prior_scale)
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
    own = tuple(e for e in own if is_field or not isinstance(e, FieldOffset | FieldScale))
    return tuple(replace(e, device=device) for e in own)


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
    free = [e for e in given if not e.device]
    found = [replace(e, device=first[type(e)]) if type(e) in several else e for e in free]
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
            what = f"{text!r} is no value of {key} ({error.errors()[0]['msg']})"
            advice = f"give it as {known[key]}, such as {effect.name}:{key}=..."
            raise EffectError(what, where=effect.name, advice=advice) from None
    return replace(effect, **values)
