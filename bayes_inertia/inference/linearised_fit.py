"""A fit, linearised: everything that follows from the residuals and their derivatives at one point.

Around the optimum the data are r = J x + (what is asked about) + e with unit noise e and Gaussian
priors on x. With H = J^T J + prior the residuals of a perfect model have the covariance
1 - J H^-1 J^T: fitting has taken its share. What a test claims is measured against that.

Two forms of the same linear model are kept. The blocks (normal equations by slew and channel) are
cheap and serve where slews or channels are weighed. The rows (residuals with their derivatives)
serve where columns are projected off the fit; they are evaluated when first asked for.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from bayes_inertia.inference.likelihood import (
    Information,
    Point,
    Residuals,
    Sensitivities,
    unpadded_sensitivities,
)
from bayes_inertia.inference.noise_model import Whitenings, densities_of, measured, row_times
from bayes_inertia.inference.objective import block_index, normal_equations, prior_equations
from bayes_inertia.inference.slew_shares import SlewShares, eliminated
from bayes_inertia.maths.linear_algebra import inverse, inverse_root
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model


@array_dataclass
class ChannelRows:
    """One channel's measurements among the numbers of all channels.

    Parameters
    ----------
    part : slice
        Where the channel's numbers stand.
    time : (slews, rows) array
        Times of the measurements [s], the last one repeated in padding.
    valid : (slews, rows, components) array of bool
        What was measured.
    """

    part: slice
    time: np.ndarray
    valid: np.ndarray

    def shaped(self, flat: np.ndarray) -> np.ndarray:
        """Pick this channel out of the numbers of all channels.

        `flat` (slews, numbers, ...): numbers of all channels, one channel after the other. Returns
        (slews, rows, components, ...).
        """
        return flat[:, self.part].reshape(*self.valid.shape, *flat.shape[2:])


def channel_rows(model: Model) -> dict[str, ChannelRows]:
    """Where each channel's numbers are among those of all channels."""
    readings = model.data.arrays.telemetry.readings
    rows, begin, times = {}, 0, row_times(model)
    for channel, own, valid in zip(model.channels, readings, measured(model), strict=True):
        part = slice(begin, begin + valid[0].size)
        time = np.take_along_axis(times, np.asarray(own.row), axis=1)
        rows[channel.name] = ChannelRows(part, time, valid)
        begin = part.stop
    return rows


@array_dataclass
class Rows:
    """Whitened residuals "measured minus predicted" with their derivatives, channel by channel.

    Parameters
    ----------
    residual : (slews, numbers) array
        Zero where nothing was measured.
    jacobian : (slews, numbers, d + n_bias + n_local) array
        Derivatives with respect to all parameters of the model, fitted or not, the bias and the
        slew's own nuisances.
    """

    residual: np.ndarray
    jacobian: np.ndarray


@array_dataclass
class LinearisedFit:
    """A fit to first order around a point.

    Parameters
    ----------
    model : Model
        What was fitted.
    point : Point
        Where the derivatives are taken.
    white : tuple of Whitening
        The noise as used.
    information : Information
        Normal equations by slew and channel; its `free` are the f parameters that were fitted.
    hessian : (f + n_bias + slews n_local,) squared array
        Normal matrix of everything fitted, priors included.
    discount : (slews, channels) array
        Factor of each slew's and channel's information: noise as stated over noise as used,
        squared.
    given_rows : Rows, optional
        The rows, where they are known.
    """

    model: Model
    point: Point
    white: Whitenings
    information: Information
    hessian: np.ndarray
    discount: np.ndarray
    given_rows: Rows | None = None

    @property
    def free(self) -> np.ndarray:
        """Indices (f,) of the parameters that were fitted."""
        return self.information.free

    def without(self, parameters: np.ndarray) -> LinearisedFit:
        """The same rows where some parameters are not projected off; the object, if none are."""
        others = self.free[~np.isin(self.free, parameters)]
        if len(others) == len(self.free):
            return self
        information = self.information._replace(free=others)
        return replace(self, information=information, given_rows=self.rows)

    @property
    def n_shared(self) -> int:
        """Unknowns that all slews share: the fitted parameters and the bias."""
        return len(self.free) + len(self.point.bias)

    @property
    def n_local(self) -> int:
        """Nuisances of one slew."""
        return self.point.n_local

    def index(self, slew: int) -> np.ndarray:
        """Where the unknowns of one slew stand in the joint vector.

        Returns (n_shared + n_local,) [free].
        """
        return block_index(self.n_shared, self.n_local, slew)

    @cached_property
    def prior_precision(self) -> np.ndarray:
        """Prior precision (n_shared, n_shared) of the shared unknowns."""
        precision, _ = prior_equations(self.model, self.point.theta, self.free)
        return block_diag(precision, np.eye(len(self.point.bias)))

    def normal_equations(self, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Hessian and gradient of everything fitted, priors included.

        `weights` (slews, channels): multiplies the information of each slew and channel; 0 leaves
        it out. Returns `hessian` (unknowns, unknowns); `gradient` (unknowns,).
        """
        return normal_equations(self.model, self.point, self.information, weights)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (unknowns, unknowns) of everything fitted, given the data."""
        return inverse(self.hessian)

    def covariance_of(self, slew: int) -> np.ndarray:
        """Covariance of what one slew depends on."""
        index = self.index(slew)
        return self.covariance[np.ix_(index, index)]

    @cached_property
    def shares(self) -> SlewShares:
        """What each slew tells of the shared unknowns."""
        _, slope = prior_equations(self.model, self.point.theta, self.free)
        gradient = np.concatenate([slope, self.point.bias])
        parts = eliminated(self.information, self.point.local, self.n_shared)
        return SlewShares(parts.matrix, parts.gradient, self.prior_precision, gradient)

    @cached_property
    def sensitivities(self) -> Sensitivities:
        """Residuals and derivatives by channel, for all parameters of the model."""
        every = np.arange(self.model.space.size)
        return unpadded_sensitivities(self.model, self.point, self.white, every)

    @cached_property
    def rows(self) -> Rows:
        """Residuals and derivatives of all channels, one after the other."""
        if self.given_rows is not None:
            return self.given_rows
        s = self.sensitivities
        residuals = s.residuals if self.model.noise.is_stated else self._pulling(s.residuals)
        return Rows(np.concatenate(residuals, 1), np.concatenate(s.jacobian, 1))

    def _pulling(self, residuals: Residuals) -> list[np.ndarray]:
        """Residuals by channel as they pull where the noise is not as stated.

        The columns times these are the slope of the log density: an outlier of heavy noise pulls
        little. Those of Gaussian noise stay what they are.
        """
        theta, pulls = self.point.theta, []
        each = zip(densities_of(self.model), residuals, measured(self.model), strict=True)
        for c, (density, r, valid) in enumerate(each):
            root = np.sqrt(self.discount[:, c, None])
            of_stated = density.pull(r / root, valid.reshape(np.shape(r)), theta)
            pulls.append(of_stated.slope / root)
        return pulls

    @property
    def residual(self) -> np.ndarray:
        """Whitened residuals (slews, numbers) at the point."""
        return self.rows.residual

    @property
    def parameters(self) -> np.ndarray:
        """Derivatives (slews, numbers, d) with respect to all parameters, fitted or not."""
        return self.rows.jacobian[..., : self.model.space.size]

    @cached_property
    def columns(self) -> np.ndarray:
        """Derivatives (slews, numbers, n_shared + n_local) with respect to everything fitted."""
        return np.ascontiguousarray(self._columns_to_project)

    @cached_property
    def _columns_to_project(self) -> np.ndarray:
        """As `columns`, each column together in memory: sums over numbers round by that order."""
        d = self.model.space.size
        bias_and_local = np.arange(d, d + len(self.point.bias) + self.n_local)
        return self.rows.jacobian[..., np.concatenate([self.free, bias_and_local])]

    @property
    def shared(self) -> np.ndarray:
        """Columns (slews, numbers, n_shared) of the fitted parameters and the bias."""
        # Not from `columns`: in this memory layout sums round as before.
        return self._columns_to_project[..., : self.n_shared]

    @property
    def local(self) -> np.ndarray:
        """Columns (slews, numbers, n_local) of each slew's own nuisances (prior sd 1)."""
        return self.rows.jacobian[..., self.model.space.size + len(self.point.bias) :]

    @cached_property
    def settled_residual(self) -> np.ndarray:
        """Residuals (slews, numbers) of the optimum, orthogonal to columns and prior.

        The optimizer may have stopped short of it, at the end of a long narrow valley. One more
        step to first order is taken.
        """
        return self._fitted_again(self.residual, self.normal_equations()[1])

    def unfitted(self, signal: np.ndarray) -> np.ndarray:
        """What a signal leaves in the residuals once everything is fitted again, to first order.

        `signal` (slews, numbers). Returns (slews, numbers).
        """
        return self._fitted_again(signal, self._pulled(np.zeros(len(self.covariance)), signal))

    def _fitted_again(self, data: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """What is left of data (slews, numbers, ...) after the step that a gradient asks for."""
        step = self.covariance @ gradient
        return np.stack([x - self.columns[s] @ step[self.index(s)] for s, x in enumerate(data)])

    def replicates(self, rng: np.random.Generator, n: int, noise: np.ndarray) -> np.ndarray:
        """Residuals that fits of a perfect model would leave.

        `rng`: source of the noise, and of true values from their priors. `noise` (slews, numbers):
        standard deviation of the noise in units of the noise as used. Returns (slews, numbers, n).
        """
        e = rng.standard_normal((*self.residual.shape, n)) * (noise * self.valid)[..., None]
        return self._fitted_again(e, self.simulated_gradient(rng, e))

    def simulated_gradient(self, rng: np.random.Generator, data: np.ndarray) -> np.ndarray:
        """Gradient from which a fit of simulated data begins, true values drawn from their priors.

        The true values themselves are not drawn: under wide priors they are so large that what fits
        leave of them is rounding. Noise of the priors' own precision tells the same.

        `data` (slews, numbers, n): whitened data of n campaigns, beyond what the true values make
        of them. Returns (unknowns, n).
        """
        slews, _, n = data.shape
        gradient = rng.standard_normal((self.n_shared + slews * self.n_local, n))
        shared = self.prior_precision
        independent = self.model.space.whitening is None
        root = np.diag(np.sqrt(np.diag(shared))) if independent else np.linalg.cholesky(shared)
        gradient[: self.n_shared] = root @ gradient[: self.n_shared]
        return self._pulled(gradient, data)

    def _pulled(self, gradient: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """The gradient (unknowns, ...) with what changes (slews, numbers, ...) add to it."""
        for s, change in enumerate(changes):
            gradient[self.index(s)] += self.columns[s].T @ change
        return gradient

    @cached_property
    def _row_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """As `normal_equations`, from the rows: they round like what is projected off them."""
        theta, bias, local = self.point.theta, self.point.bias, self.point.local
        _, slope = prior_equations(self.model, theta, self.free)
        hessian = block_diag(self.prior_precision, np.eye(local.size))
        gradient = np.concatenate([slope, bias, local.ravel()])
        for s, (columns, r) in enumerate(zip(self._columns_to_project, self.residual, strict=True)):
            index = self.index(s)
            hessian[np.ix_(index, index)] += columns.T @ columns
            gradient[index] += columns.T @ r
        return hessian, gradient

    @cached_property
    def inverse_root(self) -> np.ndarray:
        """Lower triangular R (unknowns, unknowns): R^T R inverts the rows' normal matrix."""
        return inverse_root(self._row_equations[0])

    @cached_property
    def whitened_gradient(self) -> np.ndarray:
        """R times the gradient (unknowns,) of the rows, priors included."""
        return self.inverse_root @ self._row_equations[1]

    def imitated(self, columns: np.ndarray) -> np.ndarray:
        """The share of columns that the fit imitates: its square is what projecting takes away.

        `columns` (slews, numbers, k): changes of the whitened residuals by what is not fitted.
        Returns (unknowns, k).
        """
        total = np.zeros((len(self.inverse_root), columns.shape[-1]))
        for s, (fitted, change) in enumerate(zip(self._columns_to_project, columns, strict=True)):
            total[self.index(s)] += fitted.T @ change
        return self.inverse_root @ total

    def projected(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations of amplitudes that are not fitted, everything fitted projected off.

        `columns` (slews, numbers, k): changes of the whitened residuals by units of these. Returns
        `matrix` (k, k) and `gradient` (k,).
        """
        imitated = self.imitated(columns)
        whole = np.einsum("snj,snk->jk", columns, columns, optimize=True)
        along = np.einsum("snk,sn->k", columns, self.residual)
        gradient = -(along - imitated.T @ self.whitened_gradient)
        return whole - imitated.T @ imitated, gradient

    @property
    def valid(self) -> np.ndarray:
        """Whether a number was measured, (slews, numbers)."""
        return np.concatenate(
            [rows.valid.reshape(len(self.residual), -1) for rows in self.channels.values()], 1
        )

    @cached_property
    def weight(self) -> np.ndarray:
        """Square root of the discount (slews, numbers): noise as stated over noise as used."""
        sizes = [rows.valid[0].size for rows in self.channels.values()]
        return np.repeat(np.sqrt(self.discount), sizes, axis=1)

    @cached_property
    def channels(self) -> dict[str, ChannelRows]:
        """Where each channel's numbers are."""
        return channel_rows(self.model)
