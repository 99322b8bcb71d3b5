"""The forward model: a campaign, its effects and its drive, with one parameter space."""

from __future__ import annotations

from dataclasses import field, replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.body_rates import rows_read
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    InertiaPrior,
    RateSensor,
    StarTracker,
    require_key,
)
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.errors import require_kind
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.printed import Card, listed, parameter_card, shown_as
from bayes_inertia.maths.values import array_dataclass, whole_number
from bayes_inertia.physics.actuators import effects_of, noise_of_inputs
from bayes_inertia.physics.channel_noise import NOISE_OWNER, NoiseModel
from bayes_inertia.physics.channels import Channel, channels_of
from bayes_inertia.physics.declaration import check_declaration
from bayes_inertia.physics.effect import (
    BODY_HOOKS,
    LOOKING_BACK,
    WHEEL_HOOKS,
    Effect,
    guarded,
    require_effects,
    require_of_effect,
    require_rule,
)
from bayes_inertia.physics.effects.lost_commands import LostCommands
from bayes_inertia.physics.integration_plan import (
    integration_plan,
    shapes_of_input_noise,
    stored_at_most,
)
from bayes_inertia.physics.packing import Arrays, Data, NuisanceScale, pack
from bayes_inertia.physics.parameters import (
    LogNormal,
    Normal,
    Parameter,
    ParameterSpace,
    Prior,
    parameter_vectors,
    scalar,
    with_prior_scale,
)
from bayes_inertia.physics.prediction import Structure, coefficient_counts, predict_all
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.slow_tachometers import FreeMomentum, free_momentum
from bayes_inertia.physics.stated_noise import stated_noise
from bayes_inertia.physics.stochastic_effect import StochasticEffect


def _card(model: Model) -> Card:
    """What acts, and what is known before of every parameter."""
    space, effects = model.space, listed([effect.name for effect in model.effects])
    first = f"Model of {model.campaign.name}: {model.drive} drive, {effects or 'no effects'}"
    values = zip(space.names, space.units, space.mean, space.sd, strict=True)
    return parameter_card(first, "prior mean ± sd", values)


@shown_as(_card)
@array_dataclass
class Model:
    """A campaign with the effects that act in it and the drive it is simulated with.

    Parameters
    ----------
    campaign : Campaign
        What was flown.
    effects : tuple of Effect, optional
        What else acts, at most one effect of each name; the campaign's own devices act anyway.
    drive : "commanded", "measured" or None, optional
        What drives the model; None takes commands where there are any.
    noise : NoiseModel, optional
        The noise of each channel; Gaussian of the stated sigma unless given.

    Raises
    ------
    CampaignError
        If the campaign lacks what the drive needs, or a channel whose noise is asked about.
    EffectError
        If two effects have one name, or an effect lacks environment columns.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> Model(small_campaign()).space.names[:2]
    ('Jxx', 'Jyy')
    """

    campaign: Campaign
    effects: tuple[Effect, ...] = ()
    drive: Drive | None = None
    noise: NoiseModel = NoiseModel()
    space: ParameterSpace = field(init=False, repr=False, compare=False)
    structure: Structure = field(init=False, repr=False, compare=False)
    data: Data = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_kind(self.campaign, Campaign, "campaign", "give what `read_campaign` returns")
        campaign = self.campaign.without_locked_wheels()
        effects = tuple(effect.in_campaign(campaign) for effect in require_effects(self.effects))
        for effect in effects:
            if not type(effect).__module__.startswith("bayes_inertia."):
                # The package's own keep the contract.
                check_declaration(effect, campaign, known=True)
        advice = "give one, such as NoiseModel(rate=ChannelNoise('student_t'))"
        require_kind(self.noise, NoiseModel, "key noise", advice)
        commanded = campaign.has_commands or not campaign.wheels
        drive = self.drive or ("commanded" if commanded else "measured")
        devices = effects_of(campaign)
        _check(campaign, (*devices, *effects), drive)
        _check_noise(campaign, drive, self.noise)
        space = _space(campaign, channels_of(campaign, drive), (*devices, *effects), self.noise)
        shapes = shapes_of_input_noise(campaign)
        acting = _acting(campaign, (*devices, *effects), drive, shapes)
        free = free_momentum(campaign) if drive == "measured" else None
        half_periods = shapes if drive == "measured" else shapes[:, :0]
        structure = _structure(campaign, acting, drive, space, free, half_periods.shape[1])
        _check_combination(structure, self.noise)
        plan = integration_plan(campaign, structure.effects, drive)
        if free is not None:  # its knots are where they are
            plan = plan._replace(rows_per_step=1)
        arrays = pack(
            campaign,
            structure.channels,
            max_step=plan.spacing,
            half_periods=half_periods,
            free=free,
            rows_per_step=plan.rows_per_step,
            inputs=sorted({name for effect in structure.effects for name in effect.inputs}),
        )
        refined, rows_per_step = _is_refined(arrays), plan.rows_per_step
        structure = replace(structure, refined=refined, rows_per_step=rows_per_step)
        sensors = tuple(channel.constants(campaign) for channel in structure.channels)
        data = Data(arrays, sensors, _nuisance_scale(campaign, structure, free))
        made = {"campaign": campaign, "effects": effects, "drive": drive}
        for key, value in (made | {"space": space, "structure": structure, "data": data}).items():
            object.__setattr__(self, key, value)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What is compared with measurements."""
        return self.structure.channels

    @property
    def n_base(self) -> int:
        """Number of parameters of J and K, the first of `space`."""
        return self.structure.n_base

    @property
    def n_known(self) -> int:
        """Number of parameters that every model of the campaign has, the first of `space`.

        J and K, errors of further sensors and of devices, changes.
        """
        others = {NOISE_OWNER, *(effect.name for effect in self.effects)}
        return sum(len(p.names) for owner, p in self.space.entries if owner not in others)

    @property
    def n_bias(self) -> int:
        """Number of components of the rate bias, one a sensor axis."""
        return len(self.data.scale.bias)

    @property
    def n_slews(self) -> int:
        """Number of slews."""
        return len(self.campaign.slews)

    @property
    def expected(self) -> np.ndarray:
        """What is known at the mean of its prior, effects at their null (d,)."""
        known = self.n_known
        return np.concatenate([self.space.mean[:known], self.space.nulls[known:]])

    def draw_prior(self, rng: np.random.Generator | int | None, n: int) -> np.ndarray:
        """Draws of the prior, every J among them physical.

        Parameters
        ----------
        rng : numpy.random.Generator or int or None
            Source of randomness, or the seed of one.
        n : int
            How many draws.

        Returns
        -------
        (n, d) array
            Parameter vectors in physical units.

        Raises
        ------
        CampaignError
            If hardly any draw is physical.
        SettingsError
            If the number of draws is none.
        """
        # One generator for all parameters and rounds: the same seed in each would tie them.
        rng, n = np.random.default_rng(rng), whole_number(n, "n")
        said: dict[str, Any] = {}
        if self.campaign.prior is not None:
            said = {"where": "key prior", "advice": "check mean, ends and what is logarithmic"}
        return inertia_tensor.draw_physical(lambda count: self.space.draw(rng, count), n, **said)

    def predict(self, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Telemetry of the campaign's slews, were these the parameters; without noise.

        Each slew begins at its first readings, and the wheels are driven as recorded. Of draws of
        the prior it is the prior predictive, of a posterior's `samples` the posterior predictive of
        other slews.

        Parameters
        ----------
        theta : (n, d) array
            Parameter vectors in the order of `space.names`.

        Returns
        -------
        dict of str to (n, slews, rows, columns) array
            By channel, where anything was measured; NaN elsewhere. Attitudes stand at the fixes.
        """
        thetas = np.asarray(parameter_vectors(theta, self.space.size)).reshape(-1, self.space.size)
        advice = "give at least one parameter vector"
        require_key(len(thetas) > 0, "theta", f"its shape is {np.shape(theta)}", advice)
        local = np.zeros((self.n_slews, self.structure.n_local))
        each = [_predicted(self.structure, x, local, self.data) for x in thetas]
        readings = self.data.arrays.telemetry.readings
        return {
            channel.name: np.stack(
                [channel.known(given._replace(values=np.asarray(one))) for one in of_channel]
            )
            for channel, given, *of_channel in zip(self.channels, readings, *each, strict=True)
            if np.asarray(given.valid).any()
        }


@KeptProgram
def _predicted(structure: Structure, theta: Array, local: Array, data: Data) -> tuple[Array, ...]:
    """Predicted telemetry without a rate bias, at one theta (d,)."""
    return predict_all(structure, theta, local, jnp.zeros_like(data.scale.bias), data)


def _check(campaign: Campaign, effects: tuple[Effect, ...], drive: Drive) -> None:
    known = drive in ("commanded", "measured")
    require_key(known, "drive", f"unknown drive {drive!r}", "choose commanded or measured")
    told = drive == "measured" or not campaign.wheels or campaign.has_commands
    what = "the commanded drive needs wheel_torque columns in every slew"
    require_key(told, "columns.wheel_torque", what, "use the measured drive")
    turned = drive == "commanded" or bool(campaign.wheels)
    require_key(turned, "drive", "there are no wheels to drive the model", "leave the drive out")
    read = drive == "commanded" or campaign.has_tachometers
    what = "the measured drive needs wheel momentum or speed in every slew "
    what += "and each wheel's momentum_sigma"
    require_key(read, "columns.wheel_momentum", what, "add them or use the commanded drive")
    # What parameters are called after.
    names = [NOISE_OWNER, *dict(campaign.more_sensors), *(e.name for e in effects)]
    for e in effects:
        rule = "no_sensors_name" if e.name in campaign.sensors else "one_of_each"
        require_rule(names.count(e.name) == 1, e, rule)
    for effect in effects:
        missing = lacks(effect, campaign)
        require_rule(not missing, effect, "lacks", missing=missing)
        empty = isinstance(effect, StochasticEffect) and not effect.coefficient_count(campaign)
        require_rule(not empty, effect, "acts_somewhere")
        for column in effect.needs:
            known = all(getattr(s, column) is not None for s in campaign.slews)
            require_rule(known, effect, "columns", column=column)


def lacks(effect: Effect, campaign: Campaign) -> str:
    """What an effect acts on and a campaign does not have, in words; empty if it can act."""
    if campaign.rate_sensor is None and effect.acts("rate_output"):
        return "a rate sensor"
    seeing = StarTracker | DirectionSensor
    if effect.needs and not all(rows_read(campaign, s, seeing).any() for s in campaign.slews):
        return "a star tracker or directions in every slew"
    trackers = any(isinstance(sensor, StarTracker) for sensor in campaign.sensors.values())
    hooks = {hook for hook in (*BODY_HOOKS, *LOOKING_BACK) if effect.acts(hook)}
    if hooks == {"attitude_output"} and not trackers:
        return "a star tracker"
    return "wheels" if hooks and hooks <= WHEEL_HOOKS and not campaign.wheels else ""


def _check_noise(campaign: Campaign, drive: Drive, noise: NoiseModel) -> None:
    channels = {channel.name: channel for channel in channels_of(campaign, drive)}
    for name, asked in noise.channels:
        what, advice = f"no channel is called {name!r}", f"write {', '.join(channels)}"
        require_key(name in channels, f"noise.{name}", what, advice)
        what = f"no readings of the channel {name} are compared with the model"
        # Tachometers that drive the model are its input.
        used = drive == "measured" and name == "momentum"
        advice = "use the commanded drive" if used else "leave it out"
        read = asked.is_stated or channels[name].is_read(campaign)
        require_key(read, f"noise.{name}", what, advice)


def _check_combination(structure: Structure, noise: NoiseModel) -> None:
    alone = noise.is_stated or not structure.hyperparameters
    first = next((e for e in structure.effects if isinstance(e, StochasticEffect)), "")
    what = "cannot be fitted together with Student-t noise or a sampled noise scale"
    require_of_effect(alone, first, what, "leave out one of the two")


def base_space(
    inertia: InertiaPrior, sensor: RateSensor | None, known: GaussianPrior | None = None
) -> ParameterSpace:
    """J and K as they are known before flight; `known`: their joint prior, None without one."""
    elements = inertia_tensor.ELEMENTS, inertia.elements.tolist(), inertia.sd.tolist()
    entries: list[tuple[str, Parameter]] = [
        ("", scalar(name, unit="kg m^2", prior=Normal(mean, sd), null=mean))
        for name, mean, sd in zip(*elements, strict=True)
    ]
    factors = zip(sensor.scale_factor, sensor.scale_factor_sigma, strict=True) if sensor else ()
    entries += [
        ("", scalar(f"K{i}", unit="", prior=Normal(mean, sd), null=1.0))
        for i, (mean, sd) in enumerate(factors, start=1)
    ]
    space = ParameterSpace(tuple(entries))
    return space if known is None else _with_joint_prior(space, known)


def _space(
    campaign: Campaign,
    channels: tuple[Channel, ...],
    effects: tuple[Effect, ...],
    noise: NoiseModel,
) -> ParameterSpace:
    entries = [*base_space(campaign.inertia, campaign.rate_sensor).entries]
    entries += [(c.name, parameter) for c in channels for parameter in c.every_parameter(campaign)]
    for effect in effects:
        call = partial(_parameters_of, effect, campaign)
        own = guarded(effect, "parameters(campaign)", call)
        entries += [(effect.name, parameter) for parameter in own]
    entries += [(NOISE_OWNER, p) for p in noise.parameters()]
    space = ParameterSpace(tuple(entries))
    return space if campaign.prior is None else _with_joint_prior(space, campaign.prior)


def _parameters_of(effect: Effect, campaign: Campaign) -> tuple[Parameter, ...]:
    return tuple(with_prior_scale(p, effect.prior_scale) for p in effect.parameters(campaign))


def _with_joint_prior(space: ParameterSpace, prior: GaussianPrior) -> ParameterSpace:
    """The space with J and K as a joint prior has them; their correlations where it has any."""
    elements = space.names[: space.n_base]
    unknown = [name for name in prior.names if name not in elements]
    what = f"{next(iter(unknown), '')!r} is no element of J or scale factor of this campaign"
    require_key(not unknown, "prior.names", what, f"choose among {', '.join(elements)}")
    place = [space.names.index(name) for name in prior.names]
    entries = list(space.entries)
    ends = [
        np.full(len(place), end) if given is None else given
        for given, end in ((prior.lower, -np.inf), (prior.upper, np.inf))
    ]
    for at, name, mean, sd, low, high in zip(
        place, prior.names, prior.mean, prior.sd, *ends, strict=True
    ):
        kind: Prior = Normal(float(mean), float(sd), float(low), float(high))
        if name in prior.logarithmic:
            kind = LogNormal(float(np.exp(mean)), float(sd), max(float(low), 0.0), float(high))
        owner, parameter = entries[at]
        # The null of a scale factor is one, whatever is known of it.
        centre = float(np.exp(mean)) if kind.logarithmic else float(mean)
        null = parameter.null if name.startswith("K") else centre
        entries[at] = owner, replace(parameter, priors=(kind,), null=null)
    scaled = prior.covariance / np.outer(prior.sd, prior.sd)
    if np.array_equal(scaled, np.diag(np.diag(scaled))):
        return ParameterSpace(tuple(entries))
    correlation = np.eye(space.size)
    correlation[np.ix_(place, place)] = scaled
    return ParameterSpace(tuple(entries), correlation)


def _structure(
    campaign: Campaign,
    effects: tuple[Effect, ...],
    drive: Drive,
    space: ParameterSpace,
    free: FreeMomentum | None,
    shapes: int,
) -> Structure:
    layout = tuple(
        (owner, p.name, len(p.components) if p.components else None)
        for owner, p in space.entries
        if owner not in ("", NOISE_OWNER)
    )
    # Compiled code does not depend on how wide priors are.
    free_momenta = 0 if free is None else free.columns
    effects = tuple(e if e.prior_scale == 1.0 else replace(e, prior_scale=1.0) for e in effects)
    return Structure(
        effects,
        drive,
        layout,
        campaign.inertia.includes_wheel_spin,
        len(campaign.wheels),
        shapes=free_momenta + shapes,
        refined=False,
        coefficients=coefficient_counts(campaign, effects),
        channels=channels_of(campaign, drive),
        free_momenta=free_momenta,
    )


def _acting(
    campaign: Campaign, effects: tuple[Effect, ...], drive: Drive, shapes: np.ndarray
) -> tuple[Effect, ...]:
    """The effects, stated noise that wanders, and lost commands where commands drive the model."""
    effects = (*effects, *noise_of_inputs(campaign, shapes), *stated_noise(campaign, effects))
    lost = drive == "commanded" and any(s.lost_command is not None for s in campaign.slews)
    return (*effects, LostCommands()) if lost else effects


def _is_refined(arrays: Arrays) -> bool:
    """Whether the integration grid is finer than the telemetry's rows."""
    if arrays.slews.context.time.shape != arrays.telemetry.sample.shape:
        return True
    return bool(np.any(np.diff(arrays.telemetry.sample, axis=1) > 1))


def _nuisance_scale(
    campaign: Campaign, structure: Structure, free: FreeMomentum | None
) -> NuisanceScale:
    """Prior sds of the nuisances.

    Start states are free: their prior is several times wider than anything the campaign contains.
    """
    rate, _, moment = campaign.scale_of_motion()
    sensor, smoothed = campaign.rate_sensor, campaign.with_body_rates is not campaign
    noise = campaign.body_rates.noise if smoothed else float(np.max(campaign.gyro.sigma))
    rates = np.full(3, 10.0 * rate + 1e3 * noise)
    attitudes = np.full(3, 1.0)
    if structure.drive == "measured":
        wheels = np.repeat([w.momentum_sigma for w in campaign.wheels], structure.shapes)
        if free is not None:
            sds = wheels.reshape(-1, structure.shapes)
            sds[:, -free.columns :] = free.sd[:, None]
            wheels = sds.ravel()
    else:
        read, usual = campaign.has_tachometers, 10.0 * moment * rate
        wheels = np.array([stored_at_most(w, usual, read=read) for w in campaign.wheels])
    local = np.concatenate([rates, attitudes, np.asarray(wheels, dtype=float)])
    return NuisanceScale(on_device(local), on_device(np.array(sensor.bias_sigma if sensor else ())))
