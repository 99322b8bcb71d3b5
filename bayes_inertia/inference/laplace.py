"""The Laplace approximation: maximum of the posterior, covariance, and what the slews support."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import CampaignError, kind_of
from bayes_inertia.inference.likelihood import Information, Point
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.marginal_posterior import CoefficientPart, Marginal, Ridge, prior_roots
from bayes_inertia.inference.noise_colour import has_one_error, rounding_steps
from bayes_inertia.inference.noise_model import (
    Whitenings,
    coefficients_of,
    densities_of,
    estimated_noise,
    with_memory,
)
from bayes_inertia.inference.objective import prior_root
from bayes_inertia.inference.residual_tests import (
    ChannelTest,
    TestedResiduals,
    channel_tests,
    effective_parameters,
    residual_series,
    scale_test,
)
from bayes_inertia.inference.slew_shares import SlewShares
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.maths.linear_algebra import inverse, inverse_root, solve
from bayes_inertia.maths.printed import Card, parameter_card, shown_as
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named


class Starts(NamedTuple):
    """How reliably the optimizer found the optimum.

    Parameters
    ----------
    agreeing : int
        Starts that ended in the optimum.
    tried : int
        Of how many.
    """

    agreeing: int
    tried: int


def _card(estimate: Estimate) -> Card:
    """The maximum with its sds, and whether the model explains the data."""
    space, total = estimate.model.space, estimate.tests["total"]
    values = zip(space.names, space.units, estimate.theta, estimate.sd, strict=True)
    found, tried = estimate.starts
    says = f"reduced χ² {total.reduced_chi2:.3f}, {found} of {tried} starts agree"
    first = f"Estimate of {estimate.model.campaign.name}: {says}"
    return parameter_card(first, "estimate ± sd", values, **{"prior sd": space.sd.tolist()})


@shown_as(_card)
@array_dataclass
class Estimate:
    """The posterior's maximum and its Laplace approximation.

    Parameters
    ----------
    model : Model
        What was fitted.
    point : Point
        The maximum.
    stated : tuple of Whitening
        The noise as the campaign states it.
    white : tuple of Whitening
        The noise as it was used (equal unless discounted).
    discount : (slews, channels) array
        Factor of each slew's and channel's information, 1 where the model explains the data. Where
        the noise is not as stated: a reading's over that of Gaussian noise of the stated sigma.
    information : Information
        Normal equations by slew and channel at `point`, with the noise as used.
    hessian : (f + n_bias + slews n_local,) squared array
        Of the negative log posterior (Gauss-Newton), theta in physical units.
    objective : float
        Half the sum of all whitened squares (losses, of other densities), priors included.
    starts : Starts
        How many of the optimizer's starts ended here, of how many.
    """

    model: Model
    point: Point
    stated: Whitenings
    white: Whitenings
    discount: np.ndarray
    information: Information
    hessian: np.ndarray
    objective: float
    starts: Starts

    @property
    def theta(self) -> np.ndarray:
        """The maximum (d,), in physical units."""
        return self.point.theta

    @property
    def discounted(self) -> bool:
        """Whether misfit made any slew count for less than its stated noise says."""
        return self.model.noise.is_stated and bool(np.any(self.discount < 1.0))

    @cached_property
    def joint_covariance(self) -> np.ndarray:
        """Covariance of (theta[free], bias, all local nuisances)."""
        return inverse(self.hessian)

    @property
    def free(self) -> np.ndarray:
        """Indices (f,) of the parameters that were fitted (all, unless some were held)."""
        return self.information.free

    @cached_property
    def prior_beyond_shifts(self) -> np.ndarray:
        """How far a former result, taken as prior, may move theta beyond what its model says.

        They go together as its parameters do: a size of J that is known badly leaves ratios that
        are known well. Returns (k, d): independent shifts of one sd, none without such a prior.
        """
        prior, names = self.model.campaign.prior, self.model.space.names
        if prior is None or prior.beyond_sd is None:
            return np.zeros((0, len(self.theta)))
        root = prior_root(self.model, self.theta)
        place = [names.index(name) for name in prior.names]
        together = np.linalg.cholesky(prior.covariance / np.outer(prior.sd, prior.sd))
        moved = (self.covariance @ root.T @ root)[:, place] * prior.beyond_sd
        return (moved @ together).T

    @property
    def effects_fitted(self) -> tuple[Effect, ...]:
        """The model's effects of which a parameter is free."""
        names = {self.model.space.names[i].split(".")[0] for i in self.free}
        return tuple(effect for effect in self.model.effects if effect.name in names)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (d, d) of theta, nuisances integrated out; zero for parameters held."""
        f = len(self.free)
        covariance = np.zeros((len(self.theta), len(self.theta)))
        covariance[np.ix_(self.free, self.free)] = self.joint_covariance[:f, :f]
        return covariance

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (d,) of the Laplace approximation."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def residual_series(self) -> dict[str, list[np.ndarray]]:
        """Residuals in stated sigmas, see the function `residual_series`."""
        return residual_series(self.model, self.point, self.stated)

    @cached_property
    def effective_parameters(self) -> np.ndarray:
        """How many parameters each channel pays for (3,): trace of the hat matrix over its rows."""
        return effective_parameters(self.model, self.point, self.information, self.joint_covariance)

    @cached_property
    def tested_residuals(self) -> TestedResiduals:
        """Residuals that are white where the model is right, in STATED sigmas."""
        model, point, white = self.model, self.point, self.stated
        standing = coefficients_of(model, estimated_noise(model, point.theta))
        if standing.any():
            # Processes are filtered out of the readings whole, their coefficients left out.
            white = with_memory(model, white, self.theta, whole=True)
            point = replace(point, local=np.where(standing, 0.0, point.local))
        elif model.structure.free_momenta:
            point, standing = self._drawn(), np.ones(point.n_local, bool)
        else:
            chi2 = self.information.chi2 / self.discount
            return TestedResiduals(self.residual_series, chi2, self.effective_parameters)
        series = residual_series(model, point, white)
        squares = [[float(np.nansum(np.square(x))) for x in slews] for slews in series.values()]
        paid = effective_parameters(
            model, point, self.information, self.joint_covariance, nuisances=~standing
        )
        return TestedResiduals(series, np.array(squares).T, paid)

    def _drawn(self) -> Point:
        """A draw of the nuisances: residuals there are white though these follow readings closely.

        What is free of the momentum takes the slow part of the noise away; a draw of the posterior,
        in place of its mean, puts as much back (given J and K: if the model is right, telemetry and
        such a draw are distributed as telemetry and truth).
        """
        bias, local, shared = self.point.bias, self.point.local, len(self.free)
        random = np.random.default_rng(LIMITS.seed_of_drawn_residuals)
        root = inverse_root(self.hessian[shared:, shared:])
        step = root.T @ random.standard_normal(len(root))
        moved = step[len(bias) :].reshape(local.shape)
        return Point(self.theta, bias + step[: len(bias)], local + moved)

    @cached_property
    def tests(self) -> dict[str, ChannelTest]:
        """Reduced chi^2 against the STATED noise and whiteness, by channel and in total.

        Where the noise is not as stated, residuals are judged by their own distribution.
        """
        return self._tests_at(np.ones_like(self.discount))

    @cached_property
    def final_tests(self) -> dict[str, ChannelTest]:
        """The same against the noise as used: stated noise times what was measured of it."""
        return self._tests_at(self.discount)

    def _tests_at(self, discount: np.ndarray) -> dict[str, ChannelTest]:
        """Tests against stated noise whose information has these factors (slews, channels)."""
        model, tested, root = self.model, self.tested_residuals, np.sqrt(discount)
        series = {
            c: [s * x for s, x in zip(root[:, i], own, strict=True)]
            for i, (c, own) in enumerate(tested.series.items())
        }
        numbers = self.information.n_data.sum(0)
        # Slews of one noise are added before they are scaled, as they always were.
        chi2 = (tested.chi2 * (discount / discount[0])).sum(0) * root[0] ** 2
        dof, largest = numbers - tested.parameters, dict(zip(series, root.max(0), strict=True))
        noises, densities = [model.noise.of(c.name) for c in model.channels], densities_of(model)
        for c, (name, own) in enumerate(zip(series, densities, strict=True)):
            if not noises[c].is_stated:
                series[name], chi2[c], dof[c] = own.judged(
                    series[name], self.theta, numbers[c], tested.parameters[c]
                )
        # Errors of coarse rounding are not white. Where the noise of a rounded channel is not as
        # stated, whiteness is the last test left: it is kept.
        steps = rounding_steps(model.campaign)
        stated = (c for c in steps if model.noise.of(c).is_stated)
        known = model.campaign.shared_errors
        rounded = [c for c in stated if c in known or has_one_error(largest[c] * steps[c])]
        tests = channel_tests(model.channels, series, chi2, dof, rounded)
        for name, noise, own in zip(series, noises, densities, strict=True):
            if noise.scale_sampled:
                scale = float(own.scale_of(self.theta))
                tests[name] = scale_test(scale, noise.scale_spread, tests[name])
        return tests

    @property
    def is_too_large(self) -> bool:
        """Whether residuals of any channel are."""
        return any(test.too_large for test in self.tests.values())

    @cached_property
    def robust_sd(self) -> np.ndarray | None:
        """Standard deviations (d,) that the slews themselves support, None for a single slew."""
        covariance = self.robust_covariance
        return None if covariance is None else np.sqrt(np.diag(covariance))

    @cached_property
    def robust_covariance(self) -> np.ndarray | None:
        """Covariance (d, d) that the slews themselves support, None for a single slew.

        Leave-one-slew-out jackknife of the estimate (to first order) plus the part that comes
        from the prior: a sandwich whose bread is the Hessian and whose meat is what slews and
        prior scatter, without belief in the noise model (MacKinnon and White 1985, HC3 clustered
        by slew). The scatter of a handful of slews can be small by luck, so that no parameter's
        variance is taken below the model's own (Angrist and Pischke 2009, section 8.1).
        """
        if self.model.n_slews < 2:
            return None
        sandwich = self._jackknife
        sd = np.sqrt(np.diag(sandwich))
        lift = np.where(sd > 0.0, np.maximum(1.0, self.sd / np.where(sd > 0.0, sd, 1.0)), 1.0)
        return sandwich * np.outer(lift, lift)

    @cached_property
    def _jackknife(self) -> np.ndarray:
        """Covariance (d, d): the scatter of fits that each leave one slew out, and the prior's."""
        n = self.model.n_slews
        left_out = np.array([self.without_slew(s) for s in range(n)])
        scatter = left_out - left_out.mean(0)
        shift = self.covariance @ prior_root(self.model, self.theta).T
        return (n - 1) / n * scatter.T @ scatter + shift @ shift.T

    @property
    def scatter_sds(self) -> dict[str, np.ndarray]:
        """Other measures (d,) of what slews support, by name; empty for a single slew."""
        if self.slew_scatter is None:
            return {}
        sds = {"hc3_sd": np.sqrt(np.diag(self._jackknife))}
        for name in ("cr2_sd", "cr2_dof"):
            sds[name] = np.zeros(len(self.theta))
            sds[name][self.free] = getattr(self.slew_scatter, name)[: len(self.free)]
        return sds

    @property
    def slew_scatter(self) -> SlewShares | None:
        """How far the slews disagree, None for a single slew."""
        return self._slew_shares if self.model.n_slews > 1 else None

    @property
    def dispersion_factor(self) -> float:
        """Factor on sds by which the slews disagree more than the model says; 1 for one slew."""
        return 1.0 if self.slew_scatter is None else self.slew_scatter.dispersion.factor

    def without_slew(self, slew: int) -> np.ndarray:
        """The maximum when one slew is left out, to first order.

        Parameters
        ----------
        slew : int
            Which slew, from 0.

        Returns
        -------
        (d,) array
            theta.
        """
        step, _ = self._slew_shares.without(slew)
        theta = self.theta.copy()
        theta[self.free] += step[: len(self.free)]
        return theta

    @cached_property
    def sd_without_slew(self) -> np.ndarray:
        """Sds (slews, d) that would remain without each slew, to first order; zero where held.

        Where one slew alone determines a parameter, the others cannot check it.
        """
        slews = range(self.model.n_slews)
        return self._sds([self._slew_shares.without(slew)[1] for slew in slews])

    @cached_property
    def sd_with_slew_again(self) -> np.ndarray:
        """Sds (slews, d) if a slew were flown once more, to first order; zero where held."""
        shares = self._slew_shares
        whole = shares.prior_matrix + shares.matrix.sum(0)
        return self._sds([whole + matrix for matrix in shares.matrix])

    def _sds(self, matrices: list[np.ndarray]) -> np.ndarray:
        """Sds (n, d) that belong to normal matrices of the shared unknowns."""
        sds = np.zeros((len(matrices), len(self.theta)))
        for row, matrix in zip(sds, matrices, strict=True):
            row[self.free] = np.sqrt(np.diag(inverse(matrix))[: len(self.free)])
        return sds

    @cached_property
    def _slew_shares(self) -> SlewShares:
        return self.linearised().shares

    def linearised(self) -> LinearisedFit:
        """The fit to first order around the maximum.

        Returns
        -------
        LinearisedFit
            A new object at each call: keep it where its rows are used more than once.
        """
        return LinearisedFit(
            self.model, self.point, self.white, self.information, self.hessian, self.discount
        )


def model_of(source: Campaign | Model | Estimate, **asked: Any) -> Model:
    """The model that a campaign makes, or that a model or an estimate is of.

    `asked`: effects, drive and noise; those that are None or empty are as the source has them.
    """
    if isinstance(source, Estimate):
        source = source.model
    asked["effects"] = effects_named(asked.get("effects", ()))
    asked = {key: value for key, value in asked.items() if value}
    if isinstance(source, Campaign):
        return Model(source, **asked)
    if not isinstance(source, Model):
        raise CampaignError(
            f"{kind_of(source)} was given",
            where="first argument",
            advice="give a Campaign (read_campaign reads one), or a Model or an Estimate of one",
        )
    own = {"effects": source.effects, "drive": source.drive, "noise": source.noise}
    return source if own | asked == own else Model(source.campaign, **own | asked)


def plain_series(estimate: Estimate) -> dict[str, list[np.ndarray]]:
    """Residuals in the sigmas of the estimate's campaign, measured correlation left in them.

    Wandering of the gyro's bias that the campaign states is taken out.

    Returns (rows, components): by channel and slew; NaN where nothing was measured.
    """
    white = with_memory(estimate.model, estimate.stated, estimate.theta, measured=False)
    return residual_series(estimate.model, estimate.point, white)


def gap_of(estimate: Estimate, slew: int, residuals: np.ndarray, channel: str) -> np.ndarray:
    """Readings less predicted ones (rows, n) from residuals in stated sigmas; 0 for a NaN."""
    place = estimate.model.structure.place(channel)
    factors = np.asarray(estimate.stated[place].factors)[slew, None, : len(residuals)]
    return estimate.model.channels[place].unwhitened(factors, np.nan_to_num(residuals)[None])[0]


def predicted_readings(estimate: Estimate, place: int, residual: np.ndarray) -> np.ndarray:
    """Predictions of a channel (slews, n, columns): what is measured less residuals (slews, n, c).

    Residuals in stated sigmas.
    """
    channel, white = estimate.model.channels[place], estimate.stated[place]
    given = estimate.model.data.arrays.telemetry.readings[place].values
    error = channel.unwhitened(np.asarray(white.factors), residual)
    return channel.moved(np.asarray(given), -error)


def marginal(estimate: Estimate) -> Marginal:
    """What the marginal log posterior needs, frozen at an estimate."""
    model, point = estimate.model, estimate.point
    d, b, free = len(point.theta), len(point.bias), len(estimate.free)
    nuisance = estimate.hessian[free:, free:]
    ridge = np.zeros((len(nuisance), d))  # What is held at a value moves no nuisance.
    ridge[:, estimate.free] = -solve(nuisance, estimate.hessian[free:, :free])
    of_slews = ridge[b:].reshape(*point.local.shape, d)
    jacobian = estimate.linearised().sensitivities.jacobian
    columns, part = tuple(on_device(j[..., d:]) for j in jacobian), None
    if model.structure.hyperparameters:
        information = sum(np.swapaxes(j, 1, 2) @ j for j in map(np.asarray, columns))
        roots = prior_roots(model.structure, estimate.theta, model.data.contexts)
        back = tuple(on_device(np.linalg.inv(root)) for root in roots)
        part = CoefficientPart(on_device(information), back)
    return Marginal(
        ridge=jax.tree.map(on_device, Ridge(point, ridge[:b], of_slews)),
        columns=columns,
        root=on_device(inverse_root(nuisance)),
        prior=model.space.constants(),
        data=model.data,
        white=estimate.white,
        coefficients=part,
    )


def principal_sd(estimate: Estimate, covariance: np.ndarray) -> np.ndarray:
    """Standard deviations of the principal moments by linear propagation: dI_i = v_i^T dJ v_i.

    `covariance` (d, d). Returns (3,) [kg m^2].
    """
    _, axes = np.linalg.eigh(inertia_tensor.tensor(estimate.theta[:6]))
    weights = np.stack(
        [inertia_tensor.elements(np.outer(v, v)) * [1, 1, 1, 2, 2, 2] for v in axes.T]
    )
    return np.sqrt(np.einsum("ij,jk,ik->i", weights, covariance[:6, :6], weights))
