"""Log evidence for a random signal whose size is not known to a factor, to first order.

A signal of unit size has coefficients c = T z, z standard normal; with size a the data are r = D a
T z + e beyond all that is fitted. With A = D^T P D and g = D^T P r, P projecting off the fit with
its priors, the log evidence against no signal is

    1/2 sum_i [ a^2 u_i^2 / (1 + a^2 l_i) - log(1 + a^2 l_i) ],

l the eigenvalues of T^T A T and u the gradient T^T g along its eigenvectors. It is averaged over
sizes, log-uniform from one that the campaign can just not see, and over shapes (a correlation
time) with their prior. A stated prior may be too narrow: with a small probability the size is
beyond it (`prior_sizes`). Such an average is a Bayes factor: without a signal its expectation is
one, so that it exceeds b in less than one of b campaigns (Markov's inequality).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.prior_sizes import (
    WIDEST,
    WRONG_PRIOR,
    sizes_with_weights,
    smallest_size,
)
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass

_SIZES = 32

# From sizes (n,) to what each gains in log evidence (n,).
GainOfSizes = Callable[[np.ndarray], np.ndarray]


@array_dataclass
class ProjectedSignal:
    """Coefficients of all slews, everything fitted projected off.

    Parameters
    ----------
    gradient : (slews, k) array
        g, by slew.
    matrix : (slews, k, slews, k) array
        A: what is fitted in common couples slews.
    """

    gradient: np.ndarray
    matrix: np.ndarray

    def repeated(self) -> ProjectedSignal:
        """The same if the coefficients are one draw for all slews."""
        return ProjectedSignal(
            self.gradient.sum(0, keepdims=True), self.matrix.sum((0, 2))[None, :, None]
        )


@array_dataclass
class SignalPrior:
    """What a signal may be like before the data are seen.

    Parameters
    ----------
    roots : sequence of (slews, k, k) or (slews k, slews k) arrays
        T, one for each shape: of each slew, or of all slews where these are not independent.
    odds : (shapes,) array
        Prior odds of the shapes.
    largest : float
        Largest size that the prior has, in units of T.
    """

    roots: Sequence[np.ndarray]
    odds: np.ndarray
    largest: float


@dataclass(frozen=True)
class SignalEvidence:
    """What the data say of a random signal.

    Parameters
    ----------
    log_bayes_factor : float
        Log evidence against no signal, averaged over sizes and shapes.
    size : float
        Where it is largest.
    shape : int
        Index of the shape where it is largest.
    sizes : tuple of float
        The smallest of that shape, and the largest that the prior has.
    """

    log_bayes_factor: float
    size: float
    shape: int
    sizes: tuple[float, float]

    def log_density(self, size: float) -> float:
        """Log of the prior density of a size's logarithm.

        Examples
        --------
        >>> evidence = SignalEvidence(9.0, 1.0, 0, (0.1, 10.0))
        >>> bool(evidence.log_density(9.0) > evidence.log_density(11.0))
        True
        """
        smallest, largest = self.sizes
        if size > largest:
            return float(np.log(WRONG_PRIOR / np.log(WIDEST)))
        return float(np.log((1.0 - WRONG_PRIOR) / np.log(largest / smallest)))


def projected_signal(
    fit: LinearisedFit, columns: np.ndarray, imitated: np.ndarray | None = None
) -> ProjectedSignal:
    """Project everything fitted off a signal.

    `imitated` (unknowns, slews k). `columns` (slews, numbers, k): changes of its whitened residuals
    by the coefficients of each slew.
    """
    slews, _, k = columns.shape
    gradient, matrix = np.zeros((slews, k)), np.zeros((slews, k, slews, k))
    for s, own in enumerate(columns):
        gradient[s] = own.T @ fit.residual[s]
        matrix[s, :, s] = own.T @ own
    imitated = imitated_share(fit, columns) if imitated is None else imitated
    matrix -= (imitated.T @ imitated).reshape(matrix.shape)
    fitted = (imitated.T @ fit.whitened_gradient).reshape(slews, k)
    return ProjectedSignal(fitted - gradient, matrix)


def imitated_share(fit: LinearisedFit, columns: np.ndarray) -> np.ndarray:
    """The share of each slew's columns that the fit imitates.

    `columns` (slews, numbers, k). Returns (unknowns, slews k).
    """
    slews, _, k = columns.shape
    coupled = np.zeros((len(fit.inverse_root), slews, k))
    for s, own in enumerate(columns):
        coupled[fit.index(s), s] = fit.columns[s].T @ own
    return fit.inverse_root @ coupled.reshape(len(coupled), -1)


def signal_evidence(signal: ProjectedSignal, prior: SignalPrior) -> SignalEvidence:
    """Weigh a random signal against none.

    Examples
    --------
    >>> silent = ProjectedSignal(np.array([[0.3]]), np.full((1, 1, 1, 1), 1e2))
    >>> loud = ProjectedSignal(np.array([[60.0]]), np.full((1, 1, 1, 1), 1e2))
    >>> prior = SignalPrior([np.ones((1, 1, 1))], np.ones(1), 20.0)
    >>> values = [signal_evidence(x, prior) for x in (silent, loud)]
    >>> [bool(x.log_bayes_factor > 0.0) for x in values]
    [False, True]
    """
    tables, sizes = [], []
    for root in prior.roots:
        own = signal_directions(signal.matrix, root)
        tried, likely = tried_sizes(own.powers, prior.largest)
        sizes.append(tried)
        tables.append(own.of_sizes(signal.gradient, tried) + np.log(likely))
    weights = np.log(prior.odds)[:, None]
    values = np.array(tables) + weights
    shape, size = np.unravel_index(np.argmax(values), values.shape)
    total = logsumexp(values) - logsumexp(weights)
    ends = float(sizes[shape][0]), float(prior.largest)
    return SignalEvidence(float(total), float(sizes[shape][size]), int(shape), ends)


def gain_of_one_process(
    signal: ProjectedSignal, joint: np.ndarray, each: np.ndarray
) -> GainOfSizes:
    """Log evidence that a signal of known size gains by going on between slews.

    `joint` (slews k, slews k). `each` (slews, k, k): roots of each slew's own, where slews are
    independent.

    Examples
    --------
    >>> signal = ProjectedSignal(np.array([[9.0], [9.0]]), 10.0 * np.eye(2).reshape(2, 1, 2, 1))
    >>> same, own = np.array([[1.0, 0.0], [1.0, 1e-3]]), np.ones((2, 1, 1))
    >>> bool(gain_of_one_process(signal, same, own)(np.ones(1))[0] > 0.5)
    True
    """
    together, apart = (signal_directions(signal.matrix, root) for root in (joint, each))
    own = signal.gradient
    return lambda sizes: together.of_sizes(own, sizes) - apart.of_sizes(own, sizes)


@array_dataclass
class SignalDirections:
    """Independent directions of a signal of one shape.

    Parameters
    ----------
    root : (slews, k, k) or (slews k, slews k) array
        T.
    powers : (n,) array
        Eigenvalues of T^T A T.
    vectors : (n, n) array
        Its eigenvectors, in columns.
    """

    root: np.ndarray
    powers: np.ndarray
    vectors: np.ndarray

    def of_sizes(self, gradient: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Log evidence of each size.

        `gradient` (slews, k, ...); `sizes` (n,). Returns (n, ...).
        """
        back = self.root.T if self.root.ndim == 2 else np.swapaxes(self.root, 1, 2)
        turned = _times(back, gradient)
        along = self.vectors.T @ turned.reshape(-1, *turned.shape[2:])
        variance = sizes[:, None] ** 2
        visible = variance * self.powers
        gain = (variance / (1.0 + visible)) @ along**2
        penalty = np.log1p(visible).sum(1)
        return 0.5 * (gain - penalty.reshape(-1, *[1] * (gain.ndim - 1)))

    def coefficients(self, normal: np.ndarray) -> np.ndarray:
        """Coefficients T z of a signal of unit size.

        `normal` (slews, k, ...). Returns (slews, k, ...).
        """
        return _times(self.root, normal)


def _times(root: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A root, of each slew or of all slews together, times values (slews, k, ...)."""
    if root.ndim == 2:
        return (root @ values.reshape(len(root), -1)).reshape(values.shape)
    slews, k = values.shape[:2]
    return (root @ values.reshape(slews, k, -1)).reshape(values.shape)


def signal_directions(matrix: np.ndarray, root: np.ndarray) -> SignalDirections:
    """Find the independent directions of a signal.

    `matrix` (slews, k, slews, k); `root` (slews k, slews k).
    """
    slews, k = matrix.shape[:2]
    if root.ndim == 2:
        turned = root.T @ matrix.reshape(slews * k, -1) @ root
    else:
        half = np.stack([matrix[:, :, s].reshape(-1, k) @ own for s, own in enumerate(root)], 1)
        half = half.reshape(slews, k, slews * k)
        turned = np.concatenate([own.T @ rows for own, rows in zip(root, half, strict=True)])
    powers, vectors = np.linalg.eigh(turned)
    return SignalDirections(root, np.maximum(powers, 0.0), vectors)


def tried_sizes(powers: np.ndarray, largest: float) -> tuple[np.ndarray, np.ndarray]:
    """Sizes over which evidence is averaged, from one that the campaign can just not see.

    `powers` (n,). Returns `sizes, weights` (m,).
    """
    return sizes_with_weights(smallest_size(powers, largest), largest, _SIZES)
