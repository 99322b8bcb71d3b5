"""One call from a campaign to its posterior, and the density that it samples."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.prior import GaussianPrior, of_trusted, prior_in
from bayes_inertia.diagnosis.candidates import restarted_with_mode
from bayes_inertia.diagnosis.quoted_parameters import (
    AlternativeParameters,
    averaged_posterior,
    undetected_alternatives,
)
from bayes_inertia.errors import SettingsError, members, require, require_kind
from bayes_inertia.files import path_of
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import clean_fit, with_modelled_outliers
from bayes_inertia.inference.density_marginal import density_marginal, log_posterior_with_densities
from bayes_inertia.inference.input_noise import with_likely_inputs
from bayes_inertia.inference.laplace import Estimate, marginal, model_of
from bayes_inertia.inference.marginal_posterior import log_posterior_of
from bayes_inertia.inference.noise_model import densities_of
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.posterior_groups import build_posterior
from bayes_inertia.inference.sampler import log_density_at, sample
from bayes_inertia.inference.settings import FitContext, Settings, require_settings, usual_settings
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.maths.printed import Card, parameter_card, shown_as
from bayes_inertia.maths.values import array_dataclass, require_flags, whole_number
from bayes_inertia.physics.channel_noise import NoiseModel
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import log_prior, parameter_vectors
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.progress import Progress, as_callback, with_bar


@with_bar
@on_one_blas_thread
def fit(
    campaign: Campaign | Model | Estimate,
    *,
    effects: Sequence[Effect | str] = (),
    drive: Drive | None = None,
    seed: int | None = None,
    settings: Settings | None = None,
    chains: str | Path | None = None,
    context: FitContext | None = None,
    alternatives: Sequence[AlternativeParameters] = (),
    as_stated: bool = False,
    noise: NoiseModel | None = None,
    predict: bool = True,
    progress: Progress | bool | None = None,
) -> Posterior:
    """Estimate J, K and the parameters of active effects, and sample their posterior.

    Parameters
    ----------
    campaign : Campaign, Model or Estimate
        What was flown; a model, or the model of an estimate, brings effects, drive and noise along.
    effects : sequence of Effect or str
        Physical effects to fit along, or their names as at the command line.
    drive : {"commanded", "measured"} or None
        What drives the model; None for torque commands where the campaign has them.
    seed : int or None
        Fixes everything. None for the seed of `settings`.
    settings : Settings or None
        Of the sampler; None for the usual ones.
    chains : str or Path or None
        Folder in which the chains are kept while they grow. A killed fit goes on there.
    context : FitContext or None
        Where the campaign comes from and what a diagnosis said before.
    alternatives : sequence of AlternativeParameters
        J and K with what a diagnosis could not rule out.
    as_stated : bool
        Take telemetry and noise as they are stated: leave no outlier out, measure no noise.
    noise : NoiseModel or None
        The noise of each channel; None for Gaussian noise of the stated sigma.
    predict : bool
        False leaves out the groups `posterior_predictive` and `log_likelihood_reading`: a tenth
        of the time, where J and K are wanted and no picture of telemetry.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

    Returns
    -------
    Posterior
        Samples, prior, predictions, and whether they can be trusted.

    Raises
    ------
    CampaignError, EffectError
        As `Model`.
    EstimateError
        If the optimizer finds no usable estimate.

    Examples
    --------
    It takes a minute or so, so this is no doctest::

        posterior = fit(read_campaign("my_campaign"), seed=1)
        posterior.summary()["parameters"]["Jxy"]["sd"]
        # 0.00021
    """
    began = perf_counter()
    require_flags(as_stated=as_stated, predict=predict)
    require_kind(context, FitContext | None, "context", error=SettingsError)
    alternatives = members(alternatives, AlternativeParameters, "alternatives", error=SettingsError)
    # ArviZ takes long to import. Its plots are not needed.
    import_in_background(["arviz_stats"])
    model = model_of(campaign, effects=effects, drive=drive, noise=noise)
    settings = require_settings(settings, usual_settings(model.effects))
    if seed is not None:
        settings = replace(settings, seed=seed)
    say, context = as_callback(progress), context or FitContext()
    context = replace(context, slew_digests=context.slew_digests or model.campaign.slew_digests)
    say("fitting", 0, 0)
    estimate, context = settled_estimate(model, settings.seed, as_stated, say, context)
    samples = sample(estimate, settings, folder=chains, progress=say)
    if predict:
        say("predicting the telemetry", 0, 0)
    posterior = build_posterior(estimate, samples, context, settings.seed, predict)
    if posterior.trusted and not alternatives:
        say("bounding what could hide", 0, 0)
        # An effect too weak to be found may act: J and K, and the sd to quote, count it.
        alternatives = undetected_alternatives(estimate)
    n, space = estimate.model.n_base, estimate.model.space
    ends = space.lower[:n], space.upper[:n]
    posterior = averaged_posterior(posterior, alternatives, settings.seed, ends)
    return _with_seconds(posterior, perf_counter() - began)


def update(
    former: Posterior | str | Path, campaign: Campaign, *, inflate: float = 0.0, **options: Any
) -> Posterior:
    """Add a campaign to a former result, as if both were fitted together.

    The former posterior of J and K is the prior; rate bias, start states and effects of each
    campaign are its own. Slews that the former result holds already are refused: they would count
    twice. The command `update` does the same.

    Parameters
    ----------
    former : Posterior, str or Path
        A fit, its posterior.nc, or the folder of a finished run. Also a JSON file, as `prior_in`
        takes it.
    campaign : Campaign
        What was flown since. A prior of its own is not used.
    inflate : float, optional
        What may have changed since: sd of each element of J as a fraction of its mean moment, of
        each K as a fraction of it.
    **options
        As `fit` takes them: effects, drive, seed, settings, noise, progress, ...

    Returns
    -------
    Posterior
        Of both campaigns; its `likelihood` is that of the new one alone.

    Raises
    ------
    CampaignError
        If the former result must not be used, or holds a slew of the campaign already.
    EffectError, EstimateError
        As `fit`.

    Examples
    --------
    A fit takes a minute or so, so this is no doctest::

        both = update(fit(read_campaign("year_1"), seed=1), read_campaign("year_2"), seed=1)
        both.to_dataframe()["quoted_sd"]
    """
    advice = "give a Campaign: read_campaign reads one"
    require_kind(campaign, Campaign, "campaign", advice)
    return fit(replace(campaign, prior=known_before(former, inflate)), **options)


def known_before(former: Posterior | str | Path, inflate: float = 0.0) -> GaussianPrior:
    """J and K as a former result, or the folder or file of one, knows them, for another fit."""
    if not isinstance(former, Posterior):
        path = path_of(former, "former")
        if path.suffix != ".nc":
            return prior_in(path).inflated(inflate)
        former = Posterior.load(path)
    return of_trusted(former.as_prior, "former").inflated(inflate)


def settled_estimate(
    model: Model, seed: int, as_stated: bool, say: Progress, context: FitContext | None = None
) -> tuple[Estimate, FitContext]:
    """The estimate that is sampled, and the context with the noise that was measured."""
    context = context or FitContext()
    # A flexible mode explains nothing near its null value: it begins at the ringing that is there.
    estimate = with_likely_inputs(restarted_with_mode(optimizer.estimate(model, seed=seed)))
    if not as_stated:
        say("looking for outliers, measuring the noise", 0, 0)
        estimate, context = _cleaned(estimate, context, seed)
    if not model.noise.is_stated:
        estimate = with_modelled_outliers(estimate)
    return estimate, context


def _cleaned(estimate: Estimate, context: FitContext, seed: int) -> tuple[Estimate, FitContext]:
    """The fit without outliers, and the context with the noise that was measured."""
    clean = clean_fit(estimate, seed=seed)
    if clean.estimate is estimate:
        return estimate, context
    if clean.treatment.louder:  # than what was measured before, if it was
        before, level = context.measured_noise or {}, clean.treatment.level
        noise = {channel: before.get(channel, 1.0) * f for channel, f in level.items()}
        context = replace(context, measured_noise=noise)
    return restarted_with_mode(clean.estimate), context


def _with_seconds(posterior: Posterior, seconds: float) -> Posterior:
    attributes = posterior.attributes
    attributes["diagnostics"]["seconds"] = seconds
    posterior.tree.attrs["bayes_inertia"] = json.dumps(attributes)
    return posterior


def import_in_background(names: Sequence[str]) -> Thread:
    """Import modules one after the other, in a thread.

    Compiled code and the compiler need no interpreter lock, so this costs hardly any time.

    >>> import_in_background(["json", "no_such_module"]).join()
    """
    thread = Thread(target=_import_all, args=(tuple(names),), daemon=True)
    thread.start()
    return thread


def _import_all(names: tuple[str, ...]) -> None:
    for name in names:
        if find_spec(name.partition(".")[0]) is not None:
            import_module(name)


def _card(density: LogDensity) -> Card:
    """Its parameters, and where it is largest."""
    at, sd = density.mean, np.sqrt(np.diag(density.covariance))
    first = f"LogDensity of {density.estimate.model.campaign.name}: {', '.join(density.names)}"
    values = zip(density.names, density.units, at, sd, strict=True)
    return parameter_card(first, "largest at ± sd", values)


@shown_as(_card)
@array_dataclass
class LogDensity:
    """Log posterior density of J, K and the parameters of effects, nuisances integrated out.

    Called with theta (d,) or (n, d) it returns () or (n,), up to a constant: -inf where J is no
    body's or a prior ends. Of arrays of JAX, also inside `jit`, `grad` and `vmap`, it is a function
    of JAX; of arrays of numpy it is the compiled program that `fit` samples. Both agree to
    rounding.

    Parameters
    ----------
    estimate : Estimate
        The posterior's maximum, around which nuisances are integrated out.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> density = log_density(small_campaign())
    >>> density.names[:3], density.units[:3]
    (('Jxx', 'Jyy', 'Jzz'), ('kg m^2', 'kg m^2', 'kg m^2'))
    >>> density(density.prior_draws(5, seed=1)).shape
    (5,)
    """

    estimate: Estimate

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of theta."""
        return self.estimate.model.space.names

    @property
    def units(self) -> tuple[str, ...]:
        """Their units; empty for a pure number."""
        return self.estimate.model.space.units

    @property
    def mean(self) -> np.ndarray:
        """Where the density is largest (d,): where a sampler begins."""
        return self.estimate.theta

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (d, d) there, by Laplace's approximation: a sampler's scales."""
        return self.estimate.covariance

    def __call__(self, theta: Any) -> Any:
        """The log density.

        Parameters
        ----------
        theta : (d,) or (n, d) array
            Parameters in the order of `names`, in their units.

        Returns
        -------
        () or (n,) array
            Of numpy or of JAX, as theta is.
        """
        thetas, d = self._vectors(theta), len(self.names)
        what, advice = f"its shape is {thetas.shape}", f"give ({d},) or (n, {d})"
        require(thetas.ndim <= 2, "theta", what, advice, error=SettingsError)
        if not len(thetas):
            return thetas[:, 0]
        function: Any = self._of_jax if isinstance(theta, jax.Array) else self._compiled
        values = function(thetas[None] if thetas.ndim == 1 else thetas)
        return values[0] if thetas.ndim == 1 else values

    def log_prior(self, theta: Any) -> Any:
        """The part of the log density that the prior makes.

        Parameters
        ----------
        theta : (d,) or (n, d) array
            Parameters.

        Returns
        -------
        () or (n,) array
            Up to a constant; -inf where a prior ends. That J must be a body's is no part of it.
        """
        thetas = jnp.asarray(self._vectors(theta))
        value = log_prior(self.estimate.model.space.constants(), thetas)
        return value if isinstance(theta, jax.Array) else np.asarray(value)

    def log_likelihood(self, theta: Any) -> Any:
        """What the data make of it: the log density less the prior's part.

        Parameters
        ----------
        theta : (d,) or (n, d) array
            Parameters.

        Returns
        -------
        () or (n,) array
            Up to a constant; -inf where the density is zero.
        """
        xp: Any = jnp if isinstance(theta, jax.Array) else np
        value, prior = self(theta), self.log_prior(theta)
        return xp.where(xp.isfinite(prior), value - xp.where(xp.isfinite(prior), prior, 0.0), value)

    def prior_draws(self, n: int, seed: int = 0) -> np.ndarray:
        """Draws of the prior, every J among them a body's.

        Parameters
        ----------
        n : int
            How many.
        seed : int, optional
            Of the draws.

        Returns
        -------
        (n, d) array
            Parameters.
        """
        return self.estimate.model.draw_prior(np.random.default_rng(whole_number(seed, "seed")), n)

    def prior_transform(self, unit: np.ndarray) -> np.ndarray:
        """Points of the unit cube as parameters, for nested sampling.

        Parameters
        ----------
        unit : (d,) or (n, d) array
            Uniform between 0 and 1.

        Returns
        -------
        array of the same shape
            Parameters that follow the prior but for two ends: J need not be a body's, and of
            parameters that are correlated the ends are not kept. The log likelihood there is -inf,
            so that an evidence is less by the log of the prior's share inside.
        """
        points = parameter_vectors(unit, len(self.names), "unit")
        inside = bool(np.all((points >= 0.0) & (points <= 1.0)))
        what, advice = "a number is not between 0 and 1", "give points of the unit cube"
        require(inside, "unit", what, advice, error=SettingsError)
        return self.estimate.model.space.from_unit(points)

    def to_parameters(self, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Draws by name.

        Parameters
        ----------
        theta : (..., d) array
            Parameters, of one or more chains.

        Returns
        -------
        dict of str to array
            {name: (...)}, and under "J" the tensors (..., 3, 3) [kg m^2].
        """
        theta = np.asarray(self._vectors(theta))
        by_name = dict(zip(self.names, np.moveaxis(theta, -1, 0), strict=True))
        return by_name | {"J": np.asarray(inertia_tensor.tensor(theta[..., :6]))}

    def _vectors(self, theta: Any) -> Any:
        """theta (..., d), or `SettingsError`."""
        return parameter_vectors(theta, len(self.names))

    @cached_property
    def _compiled(self) -> Any:
        return log_density_at(self.estimate)

    @cached_property
    def _of_jax(self) -> Any:
        """The density of (n, d) as a function of JAX."""
        structure = self.estimate.model.structure
        # The first call may come while JAX traces a function of the user's.
        with jax.ensure_compile_time_eval():
            if self.estimate.model.noise.is_stated:
                one = partial(log_posterior_of, structure, marginal(self.estimate))
            else:
                given = densities_of(self.estimate.model), density_marginal(self.estimate)
                one = partial(log_posterior_with_densities, structure, *given)
        return jax.jit(jax.vmap(one))


@with_bar
@on_one_blas_thread
def log_density(
    campaign: Campaign | Model | Estimate,
    *,
    effects: Sequence[Effect | str] = (),
    drive: Drive | None = None,
    seed: int = 0,
    as_stated: bool = False,
    noise: NoiseModel | None = None,
    progress: Progress | bool | None = None,
) -> LogDensity:
    """The density that `fit` samples with the same arguments, for a sampler of your own.

    Parameters
    ----------
    campaign : Campaign, Model or Estimate
        What was flown; a model, or the model of an estimate, brings effects, drive and noise along.
    effects : sequence of Effect or str, optional
        Physical effects to fit along, or their names.
    drive : {"commanded", "measured"}, optional
        What drives the model; None for torque commands where the campaign has them.
    seed : int, optional
        Of the optimizer's starts.
    as_stated : bool, optional
        Take telemetry and noise as they are stated: leave no outlier out, measure no noise.
    noise : NoiseModel, optional
        The noise of each channel; None for Gaussian noise of the stated sigma.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

    Returns
    -------
    LogDensity
        A function of theta, with names, units and the prior.

    Raises
    ------
    CampaignError, EffectError, EstimateError
        As `fit`.
    """
    require_flags(as_stated=as_stated)
    model = model_of(campaign, effects=effects, drive=drive, noise=noise)
    estimate, _ = settled_estimate(model, seed, as_stated, as_callback(progress))
    return LogDensity(estimate)
