"""What is left of a signal in the residuals after everything that is fitted has taken its share.

Around a fit the residuals are linear in its parameters and nuisances, with Gaussian priors. Projecting a
column off them gives the part that no change of the fit can imitate.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.likelihood import padded_sensitivities
from bayes_inertia.inference.objective import N_BIAS, block_index, prior_rows
from bayes_inertia.inference.optimizer import Estimate
from bayes_inertia.maths.linear_algebra import inverse_root
from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class Projection:
    """A fit's residuals and columns, ready to project others off them.

    Attributes
    ----------
    residual : (slews, numbers) whitened "measured minus predicted", all channels one after the other.
    parameters : (slews, numbers, d) derivatives with respect to all parameters of the model, fitted or not.
    fitted : (slews, numbers, s + m) derivatives with respect to the fitted parameters, the bias and the slew's own nuisances.
    shared, local : s and m.
    root : inverse root of the normal matrix of everything fitted, priors included. gradient : root times its gradient.
    """

    residual: np.ndarray
    parameters: np.ndarray
    fitted: np.ndarray
    shared: int
    local: int
    root: np.ndarray
    gradient: np.ndarray

    def taken(self, columns: np.ndarray) -> np.ndarray:
        """The share (unknowns, k) of columns (slews, numbers, k) that the fit imitates: its square is what projecting takes away."""
        total = np.zeros((len(self.root), columns.shape[-1]))
        for s, (own, other) in enumerate(zip(self.fitted, columns, strict=True)):
            total[block_index(self.shared, self.local, s)] += own.T @ other
        return self.root @ total

    def pull(self, columns: np.ndarray, taken: np.ndarray) -> np.ndarray:
        """Projected gradient (k,): towards which amplitude the residuals pull."""
        return -(np.einsum("snk,sn->k", columns, self.residual) - taken.T @ self.gradient)


def projection(at: Estimate) -> Projection:
    """The projection that belongs to an estimate."""
    model, point = at.model, at.point
    d, m = model.space.size, point.local.shape[1]
    s = padded_sensitivities(model, point.theta, point.bias, point.local, at.white, np.arange(d))
    jacobian = np.concatenate([np.asarray(j)[..., : d + N_BIAS + m] for j in s.jacobian], 1)
    residual = np.concatenate([np.asarray(r) for r in s.residuals], 1)
    fitted = jacobian[..., np.concatenate([at.free, np.arange(d, d + N_BIAS + m)])]
    shared = len(at.free) + N_BIAS
    size = shared + point.local.size
    slope, distance = (rows[at.free] for rows in prior_rows(model, point.theta))
    hessian = np.diag(np.concatenate([slope**2, np.ones(size - len(at.free))]))
    gradient = np.concatenate([slope * distance, point.bias, point.local.ravel()])
    for k, (columns, r) in enumerate(zip(fitted, residual, strict=True)):
        index = block_index(shared, m, k)
        hessian[np.ix_(index, index)] += columns.T @ columns
        gradient[index] += columns.T @ r
    root = inverse_root(hessian)
    return Projection(residual, jacobian[..., :d], fitted, shared, m, root, root @ gradient)
