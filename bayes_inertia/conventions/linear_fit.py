"""One robust linear fit with priors, of all slews at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

# Moments further off than this many times what most of their slew are off are trusted less. Most: a
# motion that fills a sixth of the slew must not count as an outlier of its rests.
_FAR, _MOST = 2.0, 0.85


@dataclass(frozen=True, eq=False)
class LinearFit:
    """What a linear fit leaves.

    Parameters
    ----------
    misfit : (S,) array
        Root mean square residual of each slew [its sigma].
    departure : float
        Distance of the parameters from their priors [sd], root mean square over three of them.
    values : (P,) array
        Parameters, in prior standard deviations.
    sds : (P,) array
        What is left of those standard deviations.
    by_component : (S, D) array
        Root mean square residual of each component of each slew [its sigma].
    """

    misfit: np.ndarray
    departure: float
    values: np.ndarray
    sds: np.ndarray
    by_component: np.ndarray

    def with_factors(self, which: slice, sds: np.ndarray) -> LinearFit:
        """The same fit, some of whose parameters are factors, judged by their logarithms.

        A tensor a thousand times too small is as far from its prior as one a thousand times too
        large. A factor that is not positive counts as one of a thousandth.

        `which`: the parameters; 1 - sd times value is the factor that the data would have.
        """
        values = np.array(self.values)
        values[which] = np.log(np.maximum(1.0 - sds * values[which], 1e-3)) / sds
        departure = float(np.sqrt(np.sum(values**2) / 3.0))
        return replace(self, departure=departure)

    @property
    def worst(self) -> float:
        """The larger of the worst slew's misfit and the departure from the priors [sd].

        Infinite where numbers overflow.
        """
        largest = np.max(self.misfit, initial=self.departure)
        return float("inf") if np.isnan(largest) else float(largest)


def worst(fits: dict[str, LinearFit]) -> float:
    """The worst misfit of all laws."""
    return max((fit.worst for fit in fits.values()), default=0.0)


def fitted(
    data: np.ndarray,
    regressors: np.ndarray,
    free: np.ndarray,
    sigma: np.ndarray,
    mask: np.ndarray,
) -> LinearFit:
    """Fit data = regressors x + free c + error, with x from N(0, 1) and c free in every slew.

    `data` (S, N, D); `free` (S, N, D, Q); `mask` (S, N). `regressors` (S, N, D, P): what a prior
    standard deviation of each parameter does to them. `sigma` (S,): standard deviation of the norm
    of a moment's error. Returns: after one round in which outlying moments lose weight.
    """
    count = np.maximum(mask.sum(axis=1, keepdims=True), 1)
    weight = mask / np.sqrt(count)
    fit, distance = _weighted(data, regressors, free, sigma, weight)
    rows = zip(distance, mask, strict=True)
    usual = np.array([np.quantile(d[m], _MOST) if m.any() else 1.0 for d, m in rows])
    far = distance / np.maximum(_FAR * usual, 1e-3 * sigma)[:, None]
    trust = 1.0 / (1.0 + far**2)
    trust *= np.sqrt(count) / np.maximum(np.sqrt((trust**2 * mask).sum(1, keepdims=True)), 1e-9)
    if trust.max(initial=0.0) > 1.1:
        fit, _ = _weighted(data, regressors, free, sigma, weight * trust)
    return fit


def _weighted(
    data: np.ndarray,
    regressors: np.ndarray,
    free: np.ndarray,
    sigma: np.ndarray,
    weight: np.ndarray,
) -> tuple[LinearFit, np.ndarray]:
    """The fit, and the distance (S, N) of each moment from it."""
    slews, moments, width = data.shape
    flat = (slews, moments * width, -1)
    w = np.repeat(weight, width, axis=1)[..., None]
    y = data.reshape(flat) * w
    x = regressors.reshape(*flat[:2], regressors.shape[-1]) * w
    if free.shape[-1]:
        basis = np.linalg.qr(free.reshape(*flat[:2], free.shape[-1]) * w)[0]
        turned = np.swapaxes(basis, 1, 2)
        y = y - basis @ (turned @ y)
        x = x - basis @ (turned @ x)
    x, y = x / sigma[:, None, None], y / sigma[:, None, None]
    # A slew tells at most one number a component, however often it is sampled.
    normal = width * np.einsum("srp,srq->pq", x, x, optimize=True) + np.eye(x.shape[-1])
    covariance = np.linalg.inv(normal)
    values = covariance @ (width * np.einsum("srp,sro->p", x, y, optimize=True))
    residual = (y - (x @ values)[..., None])[..., 0]
    misfit = np.sqrt(np.einsum("sr,sr->s", residual, residual))
    departure = float(np.sqrt(np.sum(values**2) / 3.0))
    square = residual.reshape(data.shape) ** 2
    norm = np.sqrt(square.sum(-1)) / np.maximum(weight, 1e-12)
    sds = np.sqrt(np.diag(covariance))
    fit = LinearFit(misfit, departure, values, sds, np.sqrt(square.sum(1)))
    return fit, norm * sigma[:, None]
