"""The devices of a campaign beside wheels, as effects.

They are in every model of the campaign: no candidates of a diagnosis, and known but for a gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import GimballedRotors, KnownTorque, Magnetorquer, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.actuators.device import (
    DeviceEffect,
    ThrusterTorque,
    ToldTorque,
    TorquerTorque,
)
from bayes_inertia.physics.actuators.gimballed_rotors import GimbalAngleNoise, RotorMomentum
from bayes_inertia.physics.actuators.stated_change import StatedChange
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.stochastic_effect import StochasticEffect

__all__ = ["KINDS", "DeviceEffect", "effects_of", "noise_of_inputs", "ties_of_scale"]

# Which effect a device is.
KINDS: Mapping[type, type[DeviceEffect]] = {
    KnownTorque: ToldTorque,
    Magnetorquer: TorquerTorque,
    Thruster: ThrusterTorque,
    GimballedRotors: RotorMomentum,
}


def effects_of(campaign: Campaign) -> tuple[Effect, ...]:
    """The effects that a campaign's own devices and changes are, in their order.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> effects_of(small_campaign())
    ()
    """
    devices = (KINDS[type(device)](device) for device in campaign.actuators)
    starts = [slew.start for slew in campaign.slews]
    changes = (StatedChange(x, tuple(s >= x.time for s in starts)) for x in campaign.changes)
    return (*devices, *changes)


def noise_of_inputs(campaign: Campaign, shapes: np.ndarray) -> tuple[StochasticEffect, ...]:
    """What of the noise of devices' inputs moves the attitude, integrated out at its stated size.

    `shapes` (slews, n): half periods of the shapes that it has.
    """
    noisy = [d for d in campaign.actuators if isinstance(d, GimballedRotors) and d.angle_sigma]
    counts = (tuple(len((s.inputs or {})[d.name].time) for s in campaign.slews) for d in noisy)
    numbers = tuple(map(tuple, shapes.tolist()))
    return tuple(GimbalAngleNoise(d, n, numbers) for d, n in zip(noisy, counts, strict=True))


def ties_of_scale(campaign: Campaign) -> list[dict[str, Any]]:
    """What ties the absolute size of J: whatever momentum or torque of stated size turns the body.

    Returns: of each device its name, by what it does so, and the relative prior sd of that, 0 where
    it is taken as exact; `former` of what did so in a former result, taken as prior. Empty where
    nothing does: only ratios of J are known then.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> ties_of_scale(small_campaign())
    [{'device': 'wheels', 'by': 'momentum', 'relative_sd': 0.0}]
    """
    wheels = [{"device": "wheels", "by": "momentum", "relative_sd": 0.0}]
    own = (wheels if campaign.wheels else []) + [
        {"device": e.name, "by": e.by, "relative_sd": e.record.gain_sigma}
        for e in effects_of(campaign)
        if isinstance(e, DeviceEffect)
    ]
    former = () if campaign.prior is None else campaign.prior.scale_of_J
    known = {tie["device"] for tie in own}
    return own + [{**tie, "former": True} for tie in former if tie["device"] not in known]
