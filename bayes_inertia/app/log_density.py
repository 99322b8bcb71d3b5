"""The density that `fit` samples, for samplers of your own."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.app.fit_campaign import settled_estimate
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import SettingsError
from bayes_inertia.inference.density_marginal import density_marginal, log_posterior_with_densities
from bayes_inertia.inference.laplace import Estimate, marginal, model_of
from bayes_inertia.inference.marginal_posterior import log_posterior_of
from bayes_inertia.inference.noise_model import densities_of
from bayes_inertia.inference.sampler import log_density_at
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.maths.values import array_dataclass, whole_number
from bayes_inertia.physics.channel_noise import NoiseModel
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import log_prior, parameter_vectors
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.progress import Progress, as_callback, with_bar


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

    def __repr__(self) -> str:
        names = ", ".join(self.names)
        return f"LogDensity of {self.estimate.model.campaign.name}: {names}"

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
        if thetas.ndim > 2:
            raise SettingsError(
                f"its shape is {thetas.shape}", where="theta", advice=f"give ({d},) or (n, {d})"
            )
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
            Parameters that follow the prior; J need not be a body's (the log likelihood then is
            -inf).
        """
        return self.estimate.model.space.from_unit(self._vectors(unit))

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
    model = model_of(campaign, effects=effects, drive=drive, noise=noise)
    estimate, _ = settled_estimate(model, seed, as_stated, None, as_callback(progress))
    return LogDensity(estimate)
