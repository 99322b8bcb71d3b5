"""The effect library: one small file for each kind, and the tuple of those tried by default.

The membership of `LIBRARY` decides how many comparisons a diagnosis makes. An effect of your own
belongs in a file of your own: hand an instance to `Model` (see
`analyses/naming/outside_effect.py`).
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from contextlib import suppress

from bayes_inertia.physics.effect import Effect, require_of_effect, require_rule
from bayes_inertia.physics.effects.constant_torque import ConstantTorque
from bayes_inertia.physics.effects.each_slew import EachSlew as EachSlew
from bayes_inertia.physics.effects.flexible_mode import FlexibleMode
from bayes_inertia.physics.effects.formula import Formula
from bayes_inertia.physics.effects.gravity_gradient import GravityGradient
from bayes_inertia.physics.effects.inertia_change import InertiaChange
from bayes_inertia.physics.effects.magnetic_dipole import MagneticDipole
from bayes_inertia.physics.effects.of_device import OfDevice
from bayes_inertia.physics.effects.of_device import candidates_in as candidates_in
from bayes_inertia.physics.effects.rate_bias import RateBias, RateBiasDrift, RateBiasSlewDrift
from bayes_inertia.physics.effects.rate_noise import (
    RateBiasInstability,
    RateRandomWalk,
    RateRemainder,
)
from bayes_inertia.physics.effects.rate_sensor_delay import RateSensorDelay
from bayes_inertia.physics.effects.rate_sensor_nonlinearity import RateSensorNonlinearity
from bayes_inertia.physics.effects.sensor_misalignment import (
    RateSensorMisalignment,
    StarTrackerMisalignment,
)
from bayes_inertia.physics.effects.star_tracker_low_frequency import StarTrackerLowFrequency
from bayes_inertia.physics.effects.star_tracker_shift import StarTrackerShift
from bayes_inertia.physics.effects.star_tracker_time_offset import StarTrackerTimeOffset
from bayes_inertia.physics.effects.tachometer_noise_walk import (
    TachometerNoiseWalk,
    TachometerRemainder,
)
from bayes_inertia.physics.effects.torque_noise import (
    TorqueNoise,
    TorqueRemainder,
    WheelTorqueNoise,
    WheelTorqueRemainder,
)
from bayes_inertia.physics.effects.viscous_torque import ViscousTorque
from bayes_inertia.physics.effects.wheel_command_lag import WheelCommandLag
from bayes_inertia.physics.effects.wheel_friction import WheelFriction
from bayes_inertia.physics.effects.wheel_misalignment import WheelMisalignment
from bayes_inertia.physics.effects.wheel_torque_gain import WheelTorqueGain
from bayes_inertia.physics.stochastic_effect import StochasticEffect

LIBRARY: tuple[Effect, ...] = (
    RateBias(),
    RateBiasDrift(),
    RateSensorMisalignment(),
    RateSensorDelay(),
    RateSensorNonlinearity(),
    StarTrackerMisalignment(),
    StarTrackerShift(),
    StarTrackerTimeOffset(),
    WheelTorqueGain(),
    WheelMisalignment(),
    WheelFriction(),
    WheelCommandLag(),
    ConstantTorque(),
    MagneticDipole(),
    GravityGradient(),
    ViscousTorque(),
    FlexibleMode(),
    InertiaChange(),
)

# Effects without a fixed shape: fitted by name; a diagnosis tries them with a test of their own.
STOCHASTIC: tuple[Effect, ...] = (
    RateRandomWalk(),
    RateBiasInstability(),
    RateBiasSlewDrift(),
    StarTrackerLowFrequency(),
    TachometerNoiseWalk(),
    TorqueNoise(),
    WheelTorqueNoise(),
    RateRemainder(),
    TorqueRemainder(),
    WheelTorqueRemainder(),
    TachometerRemainder(),
)

# What stands for everything without a name, where a model is known to be incomplete.
REMAINDERS: tuple[StochasticEffect, ...] = (
    TorqueRemainder(),
    RateRemainder(),
    WheelTorqueRemainder(),
    TachometerRemainder(),
)


def by_name(names: Sequence[str]) -> tuple[Effect, ...]:
    """The effects with these names: of the library, without a fixed shape, or of one device.

    Examples
    --------
    >>> [effect.name for effect in by_name(["rate_bias"])]
    ['rate_bias']
    """
    known = {effect.name: effect for effect in (*LIBRARY, *STOCHASTIC)}
    for name in names:
        with suppress(KeyError):
            known.setdefault(name, OfDevice.of_name(name) or Formula.of_name(name))
        if name not in known:
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or list(known)
            what, advice = f"no effect of this name: {name!r}", f"perhaps {', '.join(near)}"
            require_of_effect(False, "effects", what, advice)
        require_rule(list(names).count(name) == 1, name, "once")
    return tuple(known[name] for name in names)
