"""The Laplace approximation: the posterior's maximum, its covariance, and what the slews themselves support."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.likelihood import (
    Information,
    Marginal,
    Residuals,
    Whitening,
    residuals,
)
from bayes_inertia.inference.linearised_fit import LinearisedFit, measured
from bayes_inertia.inference.objective import N_BIAS, block_index, prior_rows
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.residual_tests import ChannelTest, channel_tests
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.linear_algebra import inverse, inverse_root, solve
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model


class Starts(NamedTuple):
    """How many of the optimizer's starts ended in the optimum, of how many."""

    agreeing: int
    tried: int


@array_dataclass
class Estimate:
    """The posterior's maximum and its Laplace approximation.

    Attributes
    ----------
    model, point : what was fitted, and the maximum.
    stated, white : the noise as the campaign states it, and as it was used (equal unless discounted).
    discount : (slews, 3) factor of each slew's and channel's information, 1 where the model explains the data.
    information : normal equations by slew and channel at `point`, with the noise as used.
    hessian : (free + 3 + slews n_local,) squared, of the negative log posterior (Gauss-Newton), theta in physical units.
    objective : half the sum of all whitened squares, priors included.
    starts : how many of the optimizer's starts ended here, of how many.
    """

    model: Model
    point: Point
    stated: Whitening
    white: Whitening
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
        return bool(np.any(self.discount < 1.0))

    @cached_property
    def joint_covariance(self) -> np.ndarray:
        """Covariance of (theta[free], bias, all local nuisances)."""
        return inverse(self.hessian)

    @property
    def free(self) -> np.ndarray:
        """Indices of the parameters that were fitted (all, unless some were held)."""
        return self.information.free

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (d, d) of theta with the nuisances integrated out; zero for parameters that were held."""
        out = np.zeros((len(self.theta), len(self.theta)))
        out[np.ix_(self.free, self.free)] = self.joint_covariance[
            : len(self.free), : len(self.free)
        ]
        return out

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (d,) of the Laplace approximation."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def residual_series(self) -> dict[str, list[np.ndarray]]:
        """{channel: [(rows, components) a slew]} of residuals in stated sigmas, NaN where nothing was measured."""
        return residual_series(self.model, self.point, self.stated)

    @cached_property
    def effective_parameters(self) -> np.ndarray:
        """How many parameters each channel pays for (3,): trace of the hat matrix over its rows."""
        total = np.zeros(3)
        for s, block in enumerate(self.information.matrix):
            index = block_index(len(self.free) + N_BIAS, self.point.local.shape[1], s)
            total += np.einsum("cpq,qp->c", block, self.joint_covariance[np.ix_(index, index)])
        return total

    @cached_property
    def tests(self) -> dict[str, ChannelTest]:
        """Reduced chi^2 against the STATED noise and whiteness, by channel and in total."""
        chi2 = (self.information.chi2 / self.discount).sum(0)
        return channel_tests(
            self.residual_series, chi2, self.information.n_data.sum(0) - self.effective_parameters
        )

    @cached_property
    def robust_sd(self) -> np.ndarray | None:
        """Standard deviations (d,) that the slews themselves support, None for a single slew."""
        covariance = self.robust_covariance
        return None if covariance is None else np.sqrt(np.diag(covariance))

    @cached_property
    def robust_covariance(self) -> np.ndarray | None:
        """Covariance (d, d) that the slews themselves support, None for a single slew.

        Leave-one-slew-out jackknife of the estimate (to first order) plus the part that comes from
        the prior: a sandwich whose bread is the Hessian and whose meat is what slews and prior
        scatter, without belief in the noise model (MacKinnon and White 1985, HC3 clustered by slew).
        The scatter of a handful of slews can be small by luck, so that no parameter's variance is
        taken below the model's own (Angrist and Pischke 2009, section 8.1).
        """
        if self.model.n_slews < 2:
            return None
        left_out = np.array([self.without_slew(s) for s in range(self.model.n_slews)])
        n = len(left_out)
        scatter = left_out - left_out.mean(0)
        slope, _ = prior_rows(self.model, self.theta)
        shift = self.covariance * slope
        sandwich = (n - 1) / n * scatter.T @ scatter + shift @ shift.T
        own = np.sqrt(np.diag(sandwich))
        lift = np.where(own > 0.0, np.maximum(1.0, self.sd / np.where(own > 0.0, own, 1.0)), 1.0)
        return sandwich * np.outer(lift, lift)

    def without_slew(self, s: int) -> np.ndarray:
        """theta (d,) when slew s is left out, to first order."""
        step, _ = self.linearised().without_slew(s)
        theta = self.theta.copy()
        theta[self.free] += step[: len(self.free)]
        return theta

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


def residual_series(model: Model, point: Point, white: Whitening) -> dict[str, list[np.ndarray]]:
    """Residuals as series over time.

    Parameters
    ----------
    model : Model
    point : Point
    white : Whitening
        The noise in whose sigmas they are counted.

    Returns
    -------
    dict of list of (rows, components) arrays
        By channel and slew; NaN where nothing was measured.
    """
    r = residuals(model.structure, point, model.data, white)
    return {
        c: [
            np.where(v, x, np.nan) for v, x in zip(ok, np.asarray(a).reshape(ok.shape), strict=True)
        ]
        for c, a, ok in zip(CHANNELS, r, measured(model), strict=True)
    }


def marginal(estimate: Estimate) -> Marginal:
    """What the marginal log posterior needs, frozen at an estimate.

    Parameters
    ----------
    estimate : Estimate
        Of all parameters (none held).

    Returns
    -------
    Marginal
    """
    model, point = estimate.model, estimate.point
    d = len(point.theta)
    nuisance = estimate.hessian[d:, d:]
    ridge = -solve(nuisance, estimate.hessian[d:, :d])
    jacobian = estimate.linearised().sensitivities.jacobian
    return Marginal(
        optimum=Point(*(jnp.asarray(x) for x in (point.theta, point.bias, point.local))),
        ridge_bias=jnp.asarray(ridge[:N_BIAS]),
        ridge_local=jnp.asarray(ridge[N_BIAS:].reshape(*point.local.shape, d)),
        columns=Residuals(*(j[..., d:] for j in jacobian)),
        root=jnp.asarray(inverse_root(nuisance)),
        prior=model.space.constants(),
        data=model.data,
        white=estimate.white,
    )


def principal_sd(estimate: Estimate, covariance: np.ndarray) -> np.ndarray:
    """Standard deviations of the principal moments by linear propagation: dI_i = v_i^T dJ v_i."""
    _, axes = np.linalg.eigh(np.asarray(inertia_tensor.tensor(jnp.asarray(estimate.theta[:6]))))
    weights = np.stack(
        [np.asarray(inertia_tensor.elements(np.outer(v, v))) * [1, 1, 1, 2, 2, 2] for v in axes.T]
    )
    return np.sqrt(np.einsum("ij,jk,ik->i", weights, covariance[:6, :6], weights))
