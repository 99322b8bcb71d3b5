"""The forward model: a campaign and its active effects -> predicted telemetry and one parameter space.

`Model` is what people build; `Structure` is its compile-time part (hashable), so that all campaigns
of one shape share compiled code, and `Data` its arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.maths.physical_draws import draw_physical
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.packing import Arrays, Reference, Telemetry, pack
from bayes_inertia.physics.parameters import (
    N_BASE,
    Normal,
    Parameter,
    ParameterSpace,
    scalar,
)
from bayes_inertia.physics.simulator import simulate
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput, Start

# Slow shapes of tachometer noise that move the attitude; the rest acts only on its own sample.
_TACHOMETER_MODES = 12


@dataclass(frozen=True)
class Structure:
    """What decides the compiled code: effects, drive, and the layout of the parameter vector."""

    effects: tuple[Effect, ...]
    drive: Drive
    layout: tuple[tuple[str, str, int | None], ...]
    includes_wheel_spin: bool
    wheels: int
    modes: int
    refined: bool

    @property
    def n_local(self) -> int:
        """Nuisances of one slew: start rate and attitude, then start momentum (commanded) or tachometer shapes (measured)."""
        return 6 + self.wheels * (self.modes if self.drive == "measured" else 1)

    def active_effects(self, theta: Array) -> ActiveEffects:
        """The effects with the parameters that a flat vector (d,) gives them."""
        out: dict[str, dict[str, Array]] = {effect.name: {} for effect in self.effects}
        start = N_BASE
        for owner, name, size in self.layout:
            stop = start + (1 if size is None else size)
            out[owner][name] = theta[start] if size is None else theta[start:stop]
            start = stop
        return ActiveEffects(self.effects, out)


class Sensors(NamedTuple):
    """Constants of the sensors: `axes` C_rate (3, 3), `bias` prior mean (3,) [rad/s]."""

    axes: Array
    bias: Array


class NuisanceScale(NamedTuple):
    """Prior sd that turns whitened nuisances into physical ones: `local` (n_local,), `bias` (3,) [rad/s]."""

    local: Array
    bias: Array


class Data(NamedTuple):
    """All arrays of a model; those under `arrays` have the slews as leading axis."""

    arrays: Arrays
    sensors: Sensors
    scale: NuisanceScale


class Prediction(NamedTuple):
    """Predicted telemetry of one slew: `rate` (n, 3) [rad/s] as the sensor reads it, `attitude` (f, 4) at the fixes, `momentum` (n, wheels) [N m s]."""

    rate: Array
    attitude: Array
    momentum: Array


@array_dataclass
class Model:
    """A campaign with the effects that act in it and the drive it is simulated with.

    Parameters
    ----------
    campaign : what was flown.
    effects : instances of `Effect`, at most one of each name.
    drive : "commanded" or "measured"; None takes commands where there are any.

    Raises
    ------
    CampaignError : the campaign lacks what the drive needs.
    EffectError : two effects of one name, or an effect that lacks environment columns.

    >>> from bayes_inertia.campaign.hardware import RateSensor
    >>> from bayes_inertia.campaign.inertia_prior import InertiaPrior
    >>> from bayes_inertia.campaign.slew import Slew
    >>> slew = Slew("a", 0.0, np.arange(3.0), rate=np.zeros((3, 3)))
    >>> Model(Campaign("c", InertiaPrior(np.eye(3), 0.1, 0.1), (), RateSensor(sigma=1e-5), None, (slew,))).space.names[:2]
    ('Jxx', 'Jyy')
    """

    campaign: Campaign
    effects: tuple[Effect, ...] = ()
    drive: Drive | None = None
    space: ParameterSpace = field(init=False, repr=False)
    structure: Structure = field(init=False, repr=False)
    data: Data = field(init=False, repr=False)

    def __post_init__(self):
        effects = tuple(self.effects)
        drive = self.drive or (
            "commanded" if self.campaign.has_commands or not self.campaign.wheels else "measured"
        )
        _check(self.campaign, effects, drive)
        space = _space(self.campaign, effects)
        structure = _structure(self.campaign, effects, drive, space)
        steps = [step for step in (e.max_step(self.campaign) for e in effects) if step is not None]
        arrays = pack(self.campaign, max_step=min(steps) if steps else None, modes=structure.modes)
        refined = arrays.slews.context.time.shape != arrays.telemetry.rate.shape[:2]
        refined = refined or bool(np.any(np.diff(arrays.telemetry.sample, axis=1) > 1))
        structure = Structure(**{**structure.__dict__, "refined": refined})
        sensor = self.campaign.rate_sensor
        sensors = Sensors(jnp.asarray(sensor.axes), jnp.asarray(sensor.bias))
        for key, value in (
            ("effects", effects),
            ("drive", drive),
            ("space", space),
            ("structure", structure),
            ("data", Data(arrays, sensors, _nuisance_scale(self.campaign, structure))),
        ):
            object.__setattr__(self, key, value)

    @property
    def n_slews(self) -> int:
        """Number of slews."""
        return len(self.campaign.slews)

    def draw_prior(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """n draws (n, d) of the prior; every J among them is physical."""
        return draw_physical(lambda n: self.space.draw(rng, n), n)


def _check(campaign: Campaign, effects: tuple[Effect, ...], drive: Drive) -> None:
    if drive not in ("commanded", "measured"):
        raise CampaignError(
            f"unknown drive {drive!r}", where="drive", advice="choose commanded or measured"
        )
    if drive == "commanded" and campaign.wheels and not campaign.has_commands:
        raise CampaignError(
            "the commanded drive needs wheel_torque columns in every slew",
            where="key columns.wheel_torque",
            advice="use the measured drive",
        )
    if drive == "measured" and not campaign.has_tachometers:
        raise CampaignError(
            "the measured drive needs wheel momentum or speed in every slew and each wheel's momentum_sigma",
            where="key columns.wheel_momentum",
            advice="add them or use the commanded drive",
        )
    names = [e.name for e in effects]
    for name in names:
        if names.count(name) > 1:
            raise EffectError("two effects of one name", where=name, advice="give each effect once")
    for effect in effects:
        for column in effect.needs:
            if any(getattr(s, column) is None for s in campaign.slews):
                raise EffectError(
                    f"needs the {column} columns of every slew",
                    where=effect.name,
                    advice="add them to the campaign or leave the effect out",
                )


def _space(campaign: Campaign, effects: tuple[Effect, ...]) -> ParameterSpace:
    prior, sensor = campaign.inertia, campaign.rate_sensor
    entries: list[tuple[str, Parameter]] = [
        ("", scalar(name, unit="kg m^2", prior=Normal(mean, sd), null=mean))
        for name, mean, sd in zip(
            inertia_tensor.ELEMENTS, prior.elements.tolist(), prior.sd.tolist(), strict=True
        )
    ]
    entries += [
        (
            "",
            scalar(
                f"K{i + 1}",
                unit="",
                prior=Normal(sensor.scale_factor[i], sensor.scale_factor_sigma[i]),
                null=1.0,
            ),
        )
        for i in range(3)
    ]
    entries += [
        (effect.name, parameter) for effect in effects for parameter in effect.parameters(campaign)
    ]
    return ParameterSpace(tuple(entries))


def _structure(
    campaign: Campaign, effects: tuple[Effect, ...], drive: Drive, space: ParameterSpace
) -> Structure:
    layout = tuple(
        (owner, p.name, len(p.components) if p.components else None)
        for owner, p in space.entries
        if owner
    )
    modes = _TACHOMETER_MODES if drive == "measured" else 0
    return Structure(
        effects,
        drive,
        layout,
        campaign.inertia.includes_wheel_spin,
        len(campaign.wheels),
        modes,
        False,
    )


def _nuisance_scale(campaign: Campaign, structure: Structure) -> NuisanceScale:
    """Start states are free: their prior is several times wider than anything the campaign contains."""
    rate, _, mass = campaign.scale_of_motion()
    noise = float(np.max(campaign.rate_sensor.sigma))
    rates = np.full(3, 10.0 * rate + 1e3 * noise)
    attitudes = np.full(3, 1.0)
    if structure.drive == "measured":
        wheels = np.repeat([w.momentum_sigma for w in campaign.wheels], structure.modes)
    else:
        wheels = np.array([w.max_momentum or 10.0 * mass * rate for w in campaign.wheels])
    local = np.concatenate([rates, attitudes, np.asarray(wheels, dtype=float)])
    return NuisanceScale(jnp.asarray(local), jnp.asarray(campaign.rate_sensor.bias_sigma))


def start_of(
    structure: Structure, scale: NuisanceScale, reference: Reference, local: Array
) -> Start:
    """Start state of one slew from its whitened nuisances (n_local,)."""
    physical = local * scale.local
    attitude = quaternion.multiply(reference.attitude, quaternion.exp(physical[3:6]))
    momentum = reference.wheel_momentum + (physical[6:] if structure.drive == "commanded" else 0.0)
    return Start(reference.rate_B + physical[:3], attitude, momentum)


def predict(
    structure: Structure,
    theta: Array,
    local: Array,
    bias: Array,
    slew: SlewInput,
    telemetry: Telemetry,
    reference: Reference,
    data: Data,
) -> Prediction:
    """Predicted telemetry of one slew.

    Parameters
    ----------
    theta : (d,) sampled parameters in physical units. local : (n_local,) and bias : (3,) whitened nuisances.
    slew, telemetry, reference : one slew of `data.arrays`.
    """
    active = structure.active_effects(theta)
    J = inertia_tensor.tensor(theta[:6])
    if structure.includes_wheel_spin:
        J = inertia_tensor.without_wheel_spin(
            J, slew.context.wheel_axes_B, slew.context.spin_inertia
        )
    if structure.drive == "measured" and structure.wheels:
        noise = (local[6:] * data.scale.local[6:]).reshape(structure.wheels, structure.modes)
        slew = slew._replace(momentum=slew.momentum - telemetry.tachometer_modes @ noise.T)
    start = start_of(structure, data.scale, reference, local)
    trajectory, own = simulate(slew, start, J, active, structure.drive)
    bias_S = data.sensors.bias + bias * data.scale.bias
    return _sense(
        structure, theta[6:9], bias_S, active, slew, telemetry, data.sensors, trajectory, own
    )


def _sense(
    structure: Structure,
    scale_factor: Array,
    bias_S: Array,
    active: ActiveEffects,
    slew: SlewInput,
    telemetry: Telemetry,
    sensors: Sensors,
    trajectory: Trajectory,
    own,
) -> Prediction:
    """What the sensors report of a trajectory: each effect's sensor hooks in order, then scale factors and sampling."""
    C = sensors.axes
    rate_S = jnp.stack(
        [sum(C[i, j] * trajectory.rate_B[:, j] for j in range(3)) + bias_S[i] for i in range(3)], -1
    )
    attitude, momentum = trajectory.attitude, trajectory.wheel_momentum
    for (effect, p), states in zip(active, own, strict=True):
        seen = trajectory._replace(own=states)
        rate_S = effect.rate_output(p, slew.context, seen, rate_S)
        attitude = effect.attitude_output(p, slew.context, seen, attitude)
        momentum = effect.momentum_output(p, slew.context, seen, momentum)
    fixes = telemetry.fix_row
    if structure.refined:
        rate_S, momentum, fixes = (
            rate_S[telemetry.sample],
            momentum[telemetry.sample],
            telemetry.sample[fixes],
        )
    return Prediction(rate_S / scale_factor, attitude[fixes], momentum)


def predict_all(
    structure: Structure, theta: Array, local: Array, bias: Array, data: Data
) -> Prediction:
    """Predictions of all slews (leading axis: slews) for theta (d,), local (slews, n_local), bias (3,)."""
    one = jax.vmap(
        lambda x, slew, telemetry, reference: predict(
            structure, theta, x, bias, slew, telemetry, reference, data
        )
    )
    return one(local, *data.arrays)
