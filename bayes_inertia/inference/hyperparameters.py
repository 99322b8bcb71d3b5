"""Sizes and times of stochastic effects: the evidence of the data for them, and its maximum.

The parameters of a stochastic effect fix the prior of its coefficients and nothing else. The joint
posterior of both has no useful maximum (it grows where coefficients become likely), so they are
moved by the evidence: the data's probability with everything else integrated out, to first order
around a point (MacKay 1992, "Bayesian interpolation"; type II maximum likelihood with a prior).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from scipy import linalg, optimize

from bayes_inertia.inference.coefficients import prior_roots
from bayes_inertia.inference.likelihood import Information, information_blocks
from bayes_inertia.inference.noise_model import Whitening
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.inference.point import N_BIAS, Point
from bayes_inertia.physics.forward_model import Model

# So many prior sds from its centre a parameter may move.
_FARTHEST = 8.0
# Step of the differences that give the evidence's curvature [prior sd].
_STEP = 0.02
# A posterior sd is at least this share of the prior's where differences are too rough to tell.
_LEAST_SHARE = 0.02


def without_hyperparameters(model: Model, free: np.ndarray) -> np.ndarray:
    """Parameters that change the signal of an effect, not only the prior of its coefficients.

    Parameters
    ----------
    model : Model
    free : (f,) array of int
        Indices of parameters.

    Returns
    -------
    (g,) array of int
        The very array where the model has no stochastic effect.
    """
    fixed = model.structure.hyperparameters
    return free if not fixed else free[~np.isin(free, fixed)]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data's evidence for parameters of stochastic effects, to first order around a point.

    Parameters
    ----------
    model : Model
    point : Point
        Where the derivatives were taken.
    information : Information
        There, of the parameters that are not learnt here.
    learnt : (h,) array of int
        Indices of the parameters of stochastic effects.
    """

    model: Model
    point: Point
    information: Information
    learnt: np.ndarray

    @cached_property
    def _priors(self) -> dict[str, np.ndarray]:
        """Of the learnt parameters, as `ParameterSpace.constants`."""
        constants = self.model.space.constants().items()
        return {key: np.asarray(values)[self.learnt] for key, values in constants}

    def chart(self, theta: np.ndarray) -> np.ndarray:
        """The learnt parameters (h,) in prior sds from the centre of their prior."""
        value, logarithmic = np.asarray(theta)[self.learnt], self._priors["logarithmic"]
        value = np.where(logarithmic, np.log(np.where(logarithmic, value, 1.0)), value)
        return (value - self._priors["mean"]) / self._priors["scale"]

    def theta(self, chart: np.ndarray) -> np.ndarray:
        """The point's parameters (d,) with the learnt ones where a chart says."""
        priors, theta = self._priors, np.array(self.point.theta)
        value, logarithmic = priors["mean"] + priors["scale"] * chart, priors["logarithmic"]
        value = np.where(logarithmic, np.exp(np.where(logarithmic, value, 0.0)), value)
        theta[self.learnt] = np.clip(value, priors["lower"], priors["upper"])
        return theta

    def roots(self, theta: np.ndarray) -> np.ndarray:
        """Roots (slews, n_random, n_random) of the coefficients' prior covariance."""
        contexts = self.model.data.arrays.slews.context
        return np.asarray(prior_roots(self.model.structure, jnp.asarray(theta), contexts))

    def negative_log(self) -> Callable[[np.ndarray], float]:
        """Minus the log evidence and log prior, up to a constant, as a function of the chart."""
        f, start = len(self.information.free), self.model.structure.n_start
        shared = f + N_BIAS
        slope, distance = (
            r[self.information.free] for r in prior_rows(self.model, self.point.theta)
        )
        matrix, gradient = self.information.matrix.sum(1), self.information.gradient.sum(1)
        local = np.array(self.point.local)
        back = np.zeros_like(gradient)
        back[:, shared + start :] = -local[:, start:]
        gradient = gradient + np.einsum("sij,sj->si", matrix, back)
        local[:, start:] = 0.0
        prior = np.concatenate([slope**2, np.ones(N_BIAS)])
        pull = np.concatenate([slope * distance, self.point.bias])
        before = np.linalg.inv(self.roots(self.point.theta))

        def value(chart: np.ndarray) -> float:
            turn = before @ self.roots(self.theta(chart))
            left, left_gradient, total = np.diag(prior), pull.copy(), 0.0
            for s, block in enumerate(matrix):
                whole = linalg.block_diag(np.eye(shared + start), turn[s])
                A, g = whole.T @ block @ whole, whole.T @ gradient[s]
                root = np.linalg.cholesky(A[shared:, shared:] + np.eye(local.shape[1]))
                right = np.column_stack([A[shared:, :shared], g[shared:] + local[s]])
                solved = linalg.solve_triangular(root, right, lower=True)
                left += A[:shared, :shared] - solved[:, :-1].T @ solved[:, :-1]
                left_gradient += g[:shared] - solved[:, :-1].T @ solved[:, -1]
                total += np.sum(np.log(np.diag(root))) - 0.5 * np.sum(solved[:, -1] ** 2)
            scale = 1.0 / np.sqrt(np.diag(left))
            root = np.linalg.cholesky(left * np.outer(scale, scale))
            step = linalg.solve_triangular(root, left_gradient * scale, lower=True)
            total += np.sum(np.log(np.diag(root)) - np.log(scale)) - 0.5 * step @ step
            return float(total + 0.5 * chart @ chart)

        return value


def evidence_at(model: Model, point: Point, white: Whitening, free: np.ndarray) -> Evidence:
    """The evidence around a point.

    Parameters
    ----------
    model : Model
        With stochastic effects.
    point : Point
        Where.
    white : Whitening
        The noise.
    free : (f,) array of int
        Indices of the parameters that may move.

    Returns
    -------
    Evidence
    """
    shaped = without_hyperparameters(model, free)
    information = information_blocks(model, point, white, shaped)
    return Evidence(model, point, information, np.setdiff1d(free, shaped))


def most_probable(evidence: Evidence) -> tuple[Point, float]:
    """The parameters of stochastic effects that the data favour.

    Parameters
    ----------
    evidence : Evidence

    Returns
    -------
    point : Point
        With them; its coefficients are what they were, whitened anew.
    change : float
        By how much the parameters moved, the largest [prior sd].
    """
    value, begin = evidence.negative_log(), evidence.chart(evidence.point.theta)
    bounds = [(-_FARTHEST, _FARTHEST)] * len(begin)
    best = optimize.minimize(value, begin, method="L-BFGS-B", bounds=bounds)
    theta = evidence.theta(best.x)
    before, after = evidence.roots(evidence.point.theta), evidence.roots(theta)
    n = evidence.model.structure.n_start
    local = np.array(evidence.point.local)
    coefficients = before @ local[:, n:, None]
    local[:, n:] = np.linalg.solve(after, coefficients)[..., 0]
    point = replace(evidence.point, theta=theta, local=local)
    return point, float(np.abs(best.x - begin).max())


def information_with_learnt(
    model: Model, point: Point, white: Whitening, free: np.ndarray
) -> Information:
    """Normal equations in which the learnt parameters have the curvature of their evidence.

    What the evidence tells of them is shared out evenly to slews and counted as of the first
    channel; they are taken as independent of everything else, which is right to first order.

    Parameters
    ----------
    model : Model
    point : Point
        The maximum.
    white : Whitening
        The noise.
    free : (f,) array of int
        Indices of the parameters that may move.

    Returns
    -------
    Information
        As of `information_blocks` where no parameter of a stochastic effect is among them.
    """
    if len(without_hyperparameters(model, free)) == len(free):
        return information_blocks(model, point, white, free)
    evidence = evidence_at(model, point, white, free)
    plain = evidence.information
    curvature = _curvature(evidence.negative_log(), evidence.chart(point.theta))
    slope, distance = prior_rows(model, point.theta)
    to_chart = slope[evidence.learnt]
    own = np.outer(to_chart, to_chart) * (curvature - np.eye(len(to_chart)))
    p, slews = len(free) + point.n_local + N_BIAS, model.n_slews
    known = np.flatnonzero(~np.isin(np.arange(p), np.searchsorted(free, evidence.learnt)))
    learnt = np.searchsorted(free, evidence.learnt)
    matrix, gradient = np.zeros((slews, 3, p, p)), np.zeros((slews, 3, p))
    matrix[..., known[:, None], known] = plain.matrix
    gradient[..., known] = plain.gradient
    matrix[:, 0][:, learnt[:, None], learnt] = own / slews
    gradient[:, 0][:, learnt] = -to_chart * distance[evidence.learnt] / slews
    return plain._replace(matrix=matrix, gradient=gradient, free=free)


def _curvature(value: Callable[[np.ndarray], float], at: np.ndarray) -> np.ndarray:
    """Second derivatives (h, h) by differences, lifted to be positive definite."""
    n, step = len(at), _STEP
    hessian, unit = np.zeros((n, n)), np.eye(n) * step
    for i in range(n):
        for j in range(i + 1):
            corners = [
                a * b * value(at + a * unit[i] + b * unit[j]) for a in (1, -1) for b in (1, -1)
            ]
            hessian[i, j] = hessian[j, i] = sum(corners) / (4.0 * step**2)
    powers, directions = np.linalg.eigh(hessian)
    powers = np.clip(powers, 0.25, _LEAST_SHARE**-2)
    return (directions * powers) @ directions.T
