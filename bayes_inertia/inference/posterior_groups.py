"""Building a posterior: the groups of its tree, from an estimate and its samples."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor
from bayes_inertia.inference.gates import check_gates, groups_of_slews
from bayes_inertia.inference.laplace import Estimate, principal_sd
from bayes_inertia.inference.likelihood import of_slew
from bayes_inertia.inference.limits import LIMITS, criteria
from bayes_inertia.inference.objective import normal_prior
from bayes_inertia.inference.posterior import FORMAT, Posterior
from bayes_inertia.inference.predicted_telemetry import (
    drawn_points,
    predicted_telemetry,
    slew_log_likelihood,
    thinned_draws,
)
from bayes_inertia.inference.sampler import Chains
from bayes_inertia.inference.settings import FitContext
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.physics.actuators import ties_of_scale
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.forward_model import base_space
from bayes_inertia.physics.parameters import log_prior
from bayes_inertia.physics.prediction import Structure, with_coefficients
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.stochastic_effect import StochasticEffect
from bayes_inertia.version import versions

if TYPE_CHECKING:
    import xarray as xr

Groups = dict[str, dict[str, np.ndarray]]

_DIMENSIONS = {
    "principal_moment": ["axis"],
    "slew": ["left_out"],
    "time": ["slew", "row"],
    "signal_time": ["slew", "instant"],
}
_UNITS = {
    ("derived", "principal_moment"): "kg m^2",
    ("constant_data", "time"): "s",
    ("constant_data", "fix_time"): "s",
    ("constant_data", "signal_time"): "s",
}

_log_prior = jax.jit(log_prior)


def build_posterior(
    estimate: Estimate, chains: Chains, context: FitContext, seed: int, predict: bool = True
) -> Posterior:
    """Assemble the result of an estimate and its samples.

    `context`: where the fit comes from: what a diagnosis said before changes the gates and their
    words. `seed`: of the draws of prior, nuisances and predicted noise. `predict`: whether to
    predict the telemetry.
    """
    import xarray as xr
    from arviz_base import from_dict

    rng = np.random.default_rng([seed, 1])
    campaign, space = estimate.model.campaign, estimate.model.space
    groups = _sampled(estimate, chains, rng, [seed, 6])
    predicted, pointwise = predicted_telemetry(estimate, chains, rng) if predict else ({}, {})
    observed, constant = _observed(estimate)
    groups |= {
        "posterior_predictive": predicted,
        "log_likelihood_reading": pointwise,
        "observed_data": observed,
        "constant_data": constant,
    }
    coords, dimensions = _coordinates(campaign), _dimensions(estimate.model.channels)
    if signals := stochastic_signals(estimate, chains, np.random.default_rng([seed, 2])):
        groups["signal"] = signals
        constant["signal_time"] = signal_times(estimate)
        for effect in drawable(estimate):
            dimensions[effect.name] = ["slew", "instant", f"{effect.name}_component"]
            named, n = effect.signal_components, signals[effect.name].shape[-1]
            coords[f"{effect.name}_component"] = list(named if len(named) == n else range(1, n + 1))
    # ArviZ takes the first axis for chains, and a group without any for none.
    tree = from_dict({k: v for k, v in groups.items() if v}, dims=dimensions, coords=coords)
    if not predict:
        # The report asks what is in them.
        tree["posterior_predictive"] = tree["log_likelihood_reading"] = xr.DataTree()
    tree["estimate"] = _estimate_group(estimate)
    _write_units(tree, dict(zip(space.names, space.units, strict=True)), estimate.model.channels)
    for effect in drawable(estimate):
        tree["signal"][effect.name].attrs.update(_signal_words(effect))
    attributes = {"campaign": campaign.name, "seed": seed} | context.attributes()
    attributes |= _attributes(estimate, chains, context)
    if campaign.mission:
        attributes["mission"] = dict(campaign.mission)
    if campaign.begin_utc is not None:
        attributes["begin_utc"] = campaign.begin_utc
    tree.attrs = {"format": FORMAT, "bayes_inertia": json.dumps(attributes)}
    return Posterior(tree)


def _coordinates(campaign: Campaign) -> dict[str, Any]:
    """What stands along the axes that have names."""
    slews = [s.name for s in campaign.slews]
    wheels = [w.name for w in campaign.wheels]
    return {"slew": slews, "wheel": wheels, "axis": [1, 2, 3], "left_out": slews}


def _dimensions(channels: tuple[Channel, ...]) -> dict[str, list[str]]:
    """Names of the axes of each variable."""
    dimensions = dict(_DIMENSIONS)
    for channel in channels:
        axes = channel.axes
        dimensions |= {channel.name: [*axes], f"{channel.name}_point": [*axes[:2]]}
        dimensions[f"{axes[1]}_time"] = [*axes[:2]]
    return dimensions


def _signal_words(effect: StochasticEffect) -> dict[str, str]:
    """What the file says of an effect's signal."""
    return {
        "long_name": effect.signal_title or effect.name.replace("_", " "),
        "quantity": effect.signal_quantity or "signal",
        "units": effect.signal_unit,
    }


def _sampled(
    estimate: Estimate, chains: Chains, rng: np.random.Generator, spawn: Sequence[int]
) -> Groups:
    """Groups of the draws themselves: an ensemble is a chain, its walkers one after the other."""
    model = estimate.model
    # Walkers of one ensemble are no independent chains, and theirs are too short for R-hat: ArviZ
    # would raise alarms on perfect ensembles.
    ensembles, walkers, draws, d = chains.samples.shape
    flat = chains.samples.reshape(ensembles, walkers * draws, d)
    prior = model.draw_prior(rng, LIMITS.prior_draws)
    density = chains.log_posterior.reshape(ensembles, walkers * draws)
    of_prior = np.asarray(_log_prior(model.space.constants(), flat))
    of_slews = slew_log_likelihood(
        estimate, flat.reshape(-1, d), (density - of_prior).ravel(), np.random.default_rng(spawn)
    )
    likelihood = {} if of_slews is None else {"slew": of_slews.reshape(*density.shape, -1)}
    return {"log_likelihood": likelihood} | {
        "posterior": {name: flat[..., i] for i, name in enumerate(model.space.names)},
        "prior": {name: prior[None, :, i] for i, name in enumerate(model.space.names)},
        "derived": {"principal_moment": inertia_tensor.principal_moments(flat[..., :6])},
        "sample_stats": {"lp": density},
        "log_prior": {"theta": of_prior},
    }


def _observed(estimate: Estimate) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """What was measured, NaN where nothing was, and when."""
    telemetry, slews = estimate.model.data.arrays.telemetry, estimate.model.campaign.slews
    time = np.full((len(slews), telemetry.sample.shape[1]), np.nan)
    for i, slew in enumerate(slews):
        time[i, : len(slew.time)] = slew.time
    constant, observed = {"time": time}, {}
    for channel, readings in zip(estimate.model.channels, telemetry.readings, strict=True):
        observed[channel.name] = channel.known(readings)
        if not channel.stream.is_series:
            of_fix = np.take_along_axis(time, np.asarray(readings.row), axis=1)
            fixed = np.asarray(readings.valid).any(-1)
            constant[f"{channel.axes[1]}_time"] = np.where(fixed, of_fix, np.nan)
    return _not_empty(observed), _not_empty(constant)


def _not_empty(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: values for name, values in arrays.items() if values.size}


def _estimate_group(estimate: Estimate) -> xr.DataTree:
    """The optimizer's result, both covariances, and the residuals that it leaves."""
    import xarray as xr

    names, space = list(estimate.model.space.names), estimate.model.space
    robust = estimate.robust_covariance
    covariance = np.full((len(names), len(names)), np.nan) if robust is None else robust
    log_sd = [p.scale if p.logarithmic else np.nan for p in space.priors]
    variables: dict[str, tuple] = {
        "theta": (("parameter",), estimate.theta),
        "prior_mean": (("parameter",), space.mean),
        "prior_sd": (("parameter",), space.sd),
        # Of the logarithm, where that is normal.
        "prior_log_sd": (("parameter",), log_sd),
        "covariance": (("parameter", "parameter_2"), estimate.covariance),
        "robust_covariance": (("parameter", "parameter_2"), covariance),
        "robust_sd": (("parameter",), np.sqrt(np.diag(covariance))),
        "sd_without_slew": (("slew", "parameter"), estimate.sd_without_slew),
        "sd_with_slew_again": (("slew", "parameter"), estimate.sd_with_slew_again),
        "robust_principal_sd": (("axis",), principal_sd(estimate, covariance)),
        "discount": (("slew", "channel"), estimate.discount),
        "slew_chi2": (("slew", "channel"), estimate.information.chi2 / estimate.discount),
        "slew_n_data": (("slew", "channel"), estimate.information.n_data),
    }
    variables |= {name: (("parameter",), x) for name, x in estimate.scatter_sds.items()}
    variables |= _joint_prior(estimate)
    for channel in estimate.model.channels:
        shaped = np.nan_to_num(np.stack(estimate.residual_series[channel.name]))
        if shaped.size:
            variables[f"residual_{channel.name}"] = (channel.residual_axes, shaped)
    coords = {
        "parameter": names,
        "parameter_2": names,
        "channel": [channel.name for channel in estimate.model.channels],
        "slew": [s.name for s in estimate.model.campaign.slews],
    }
    return xr.DataTree(xr.Dataset(variables, coords=coords))


def _joint_prior(estimate: Estimate) -> dict[str, tuple]:
    """The prior as a normal one, with correlations; how far what it may be off moves this fit."""
    space, shifts = estimate.model.space, estimate.prior_beyond_shifts
    mean, sd = normal_prior(estimate.model, estimate.theta)
    variables: dict[str, tuple] = {
        "normal_prior_mean": (("parameter",), mean),
        "normal_prior_sd": (("parameter",), sd),
    }
    if space.correlation is not None:
        variables["prior_correlation"] = (("parameter", "parameter_2"), space.correlation)
    if len(shifts):
        variables["prior_beyond_shifts"] = (("known", "parameter"), shifts)
        campaign = estimate.model.campaign
        before = base_space(campaign.inertia, campaign.rate_sensor).sd
        preflight = np.concatenate([before, space.sd[len(before) :]])
        variables["preflight_sd"] = (("parameter",), preflight)
    return variables


def _write_units(tree: xr.DataTree, units: dict[str, str], channels: tuple[Channel, ...]) -> None:
    """Write the unit of every variable that has one; `units` of the parameters."""
    for group in ("posterior", "prior"):
        for name, unit in units.items():
            tree[group][name].attrs["units"] = unit
    of_channels = {
        (group, channel.name): channel.stream.unit
        for channel in channels
        for group in ("posterior_predictive", "observed_data")
    } | {("estimate", f"residual_{channel.name}"): "stated sigma" for channel in channels}
    for (group, name), unit in (_UNITS | of_channels).items():
        if name in tree[group]:
            tree[group][name].attrs["units"] = unit


def _attributes(estimate: Estimate, chains: Chains, context: FitContext) -> dict[str, Any]:
    """What the fit says about itself."""
    model, tests, scatter = estimate.model, estimate.tests, estimate.slew_scatter
    campaign = model.campaign
    # Which sensor's axes are the body's, where more than one could be.
    several = campaign.more_sensors or campaign.reference
    frames = {"frame_reference": campaign.frame_reference} if several else {}
    return {
        "diagnostics": asdict(chains.diagnostics),
        "fit": {
            "reduced_chi2": {key: test.reduced_chi2 for key, test in tests.items()},
            "interval_99": {key: test.interval for key, test in tests.items()},
            "p_chi2": {key: test.p_chi2 for key, test in tests.items()},
            "p_white": {key: test.p_white for key, test in tests.items()},
            "n_data": int(estimate.information.n_data.sum()),
            "discounted": estimate.discounted,
            "dispersion": None if scatter is None else scatter.dispersion.json(),
            "groups": groups_of_slews(estimate),
            "starts_agreeing": list(estimate.starts),
        },
        "gates": check_gates(estimate, chains.diagnostics, context),
        "criteria": criteria(),
        "effects": [e.name for e in model.effects],
        "dirt": [dirt.json() for dirt in campaign.dirt],
        "ensembles": len(chains.samples),
        "walkers": chains.samples.shape[1],
        "includes_wheel_spin": model.structure.includes_wheel_spin,
        "drive": model.structure.drive,
        "wheels": model.structure.wheels,
        "wheel_spin_kgm2": campaign.wheel_spin.tolist(),
        "free_momenta": model.structure.free_momenta,
        "scale_of_J": ties_of_scale(campaign),
        "angle_sensors": [
            name for name, s in campaign.sensors.items() if not isinstance(s, RateSensor)
        ],
        **frames,
        "versions": versions(),
    }


def drawable(estimate: Estimate) -> tuple[StochasticEffect, ...]:
    """Effects of a fit whose signal over time can be drawn."""
    effects = estimate.model.effects
    return tuple(e for e in effects if isinstance(e, StochasticEffect) and e.signal_components)


def signal_times(estimate: Estimate) -> np.ndarray:
    """Instants at which signals are kept.

    Returns (slews, instants) [s].
    """
    slews = estimate.model.campaign.slews
    return np.stack([np.linspace(s.time[0], s.time[-1], LIMITS.instants) for s in slews])


def stochastic_signals(
    estimate: Estimate, chains: Chains, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Draws of each signal over time, from thinned draws with their nuisances.

    Returns (ensembles, draws, slews, instants, components): by effect, in its `signal_unit`; empty
    without such effects.
    """
    effects = drawable(estimate)
    if not effects:
        return {}
    model, thetas = estimate.model, thinned_draws(chains, rng)
    # Effects count from a slew's first row.
    times = signal_times(estimate) - np.array([[s.time[0]] for s in model.campaign.slews])
    each = [of_slew(k, (model.data.contexts, times)) for k in range(model.n_slews)]
    names = tuple(effect.name for effect in effects)
    drawn = []
    for point in drawn_points(estimate, thetas, rng):
        local = np.asarray(point.local)
        parts = [
            _signals(model.structure, names, point.theta, of_slew(k, local), *inputs)
            for k, inputs in enumerate(each)
        ]
        drawn.append([np.concatenate(signal) for signal in zip(*parts, strict=True)])
    shape = (len(chains.samples), -1)
    return {
        name: np.stack([signals[k] for signals in drawn]).reshape(*shape, *drawn[0][k].shape)
        for k, name in enumerate(names)
    }


@partial(KeptProgram, static=2)
def _signals(
    structure: Structure,
    names: tuple[str, ...],
    theta: Array,
    local: Array,
    contexts: SlewContext,
    times: Array,
) -> tuple[Array, ...]:
    """Signals (slews, instants, components) of these effects at one draw."""
    active = structure.active_effects(theta)

    def one(slew: SlewContext, local: Array, t: Array) -> tuple[Array, ...]:
        acting = with_coefficients(active, structure.nuisances(local).coefficients, slew)
        return tuple(e.signal(p, slew, t) for e, p in acting if e.name in names)  # type: ignore[attr-defined]

    return jax.vmap(one)(contexts, local, times)
