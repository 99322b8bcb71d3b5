"""Roots of the prior covariance of a candidate's coefficients, at one size and one shape.

A fit takes the coefficients of two slews as independent. Some processes go on between slews (a
random walk); where candidates are weighed, these are one process over the whole campaign.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jax import Array

from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# Of the mean variance, added to it: where a walk is zero its covariance is singular.
_JITTER = 1e-9


@array_dataclass
class CandidateRoots:
    """Of one effect.

    Parameters
    ----------
    blocks : (slews, b, m, m) array
        Of each slew, where slews are independent: the diagonal blocks.
    across : (slews m, slews m) array or None
        Of one block in all slews, where these are one process.
    """

    blocks: np.ndarray
    across: np.ndarray | None = None

    @property
    def each(self) -> np.ndarray:
        """Of each slew (slews, b m, b m), where slews are independent."""
        return dense(self.blocks)

    @property
    def best(self) -> np.ndarray:
        """Of all slews (slews b m, slews b m) where they are one process, else of each."""
        if self.across is None:
            return self.each
        n, b, m, _ = self.blocks.shape
        joint = np.zeros((n, b, m, n, b, m))
        for i in range(b):
            joint[:, i, :, :, i] = self.across.reshape(n, m, n, m)
        return joint.reshape(n * b * m, n * b * m)


def candidate_roots(
    effect: StochasticEffect, p: Mapping[str, Array], slews: SlewContext, blocks: np.ndarray
) -> CandidateRoots:
    """The roots of an effect.

    Parameters
    ----------
    effect : StochasticEffect
    p : mapping of str to Array
        Its parameters.
    slews : SlewContext
        With the slews as leading axis.
    blocks : (slews, b, m, m) array
        Of each slew: diagonal blocks of `coefficient_root`.

    Returns
    -------
    CandidateRoots
    """
    across = effect.covariance_across_slews(p, slews)
    if across is None:
        return CandidateRoots(blocks)
    covariance = np.asarray(across)
    floor = _JITTER * np.trace(covariance) / len(covariance)
    return CandidateRoots(blocks, np.linalg.cholesky(covariance + floor * np.eye(len(covariance))))


def dense(blocks: np.ndarray) -> np.ndarray:
    """Block-diagonal matrices of their diagonal blocks.

    Parameters
    ----------
    blocks : (slews, b, m, m) array

    Returns
    -------
    (slews, b m, b m) array

    Examples
    --------
    >>> dense(np.ones((1, 2, 1, 1)))[0].tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    slews, b, m, _ = blocks.shape
    whole = np.zeros((slews, b, m, b, m))
    for i in range(b):
        whole[:, i, :, i] = blocks[:, i]
    return whole.reshape(slews, b * m, b * m)
