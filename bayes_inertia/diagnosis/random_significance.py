"""How probable is the largest of several Bayes factors where nothing is random?

Every Bayes factor has a mean of one without its signal, so that its p-value is at most one over it
(Markov's inequality). That bound is too cautious by a factor of about 20. The p-value itself is
simulated, all candidates together: with B_i the Bayes factor of candidate i among n,

    P(max B >= b) = E[ 1(max B >= b) / mean B ],

the expectation over campaigns each of which has one of the signals, drawn from its prior
(importance sampling: `mean B` is how much more probable such a campaign is with the signals than
without). A thousand campaigns are enough for any p-value, because all of them are near b or
above it. All is to first order around one fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.signal_evidence import (
    SignalDirections,
    SignalPrior,
    imitated_share,
    projected_signal,
    signal_directions,
    tried_sizes,
)
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass

_DRAWS = 1000
# Numbers of residuals that are simulated at once, to save memory.
_AT_ONCE = 1e7


@array_dataclass
class RandomSignal:
    """A candidate without a fixed shape.

    Parameters
    ----------
    columns : (slews, numbers, k) array
        Changes of the whitened residuals by the coefficients of each slew.
    prior : SignalPrior
        What it may be like.
    """

    columns: np.ndarray
    prior: SignalPrior


def p_values_of_largest(
    fit: LinearisedFit,
    signals: Sequence[RandomSignal],
    log_bayes_factors: np.ndarray,
    rng: np.random.Generator,
    draws: int = _DRAWS,
) -> np.ndarray:
    """Probability that the largest of all Bayes factors is so large where nothing is random.

    `log_bayes_factors` (m,). Returns (m,).
    """
    mixtures = [_mixture(fit, signal) for signal in signals]
    batches = int(np.ceil(draws * fit.residual.size / _AT_ONCE))
    simulated = [
        _simulated(fit, signals, mixtures, rng, len(some))
        for some in np.array_split(np.arange(draws), batches)
    ]
    evidence = np.concatenate(simulated, axis=1)
    weight = np.exp(np.log(len(signals)) - logsumexp(evidence, axis=0))
    above = evidence.max(0) >= np.asarray(log_bayes_factors)[:, None]
    return np.minimum((above * weight).sum(1) / draws, 1.0)


@array_dataclass
class _Mixture:
    """All shapes and sizes that one signal may have, with their probabilities."""

    of_slews: tuple[int, int]  # slews, and coefficients of each
    imitated: np.ndarray
    shapes: Sequence[SignalDirections]
    sizes: np.ndarray
    log_probability: np.ndarray

    def log_bayes_factor(self, gradient: np.ndarray) -> np.ndarray:
        """Of campaigns with projected gradients (slews, k, n): (n,)."""
        tables = [
            shape.of_sizes(gradient, sizes)
            for shape, sizes in zip(self.shapes, self.sizes, strict=True)
        ]
        return logsumexp(np.array(tables) + self.log_probability[..., None], axis=(0, 1))

    def coefficients(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Coefficients (slews, k, n) of n signals."""
        chosen = rng.choice(self.sizes.size, n, p=np.exp(self.log_probability).ravel())
        shape, size = np.unravel_index(chosen, self.sizes.shape)
        drawn = rng.standard_normal((*self.of_slews, n)) * self.sizes[shape, size]
        for s, directions in enumerate(self.shapes):
            drawn[..., shape == s] = directions.coefficients(drawn[..., shape == s])
        return drawn


def _mixture(fit: LinearisedFit, signal: RandomSignal) -> _Mixture:
    imitated, prior = imitated_share(fit, signal.columns), signal.prior
    matrix = projected_signal(fit, signal.columns, imitated).matrix
    shapes = [signal_directions(matrix, root) for root in prior.roots]
    sizes, weights = zip(*(tried_sizes(x.powers, prior.largest) for x in shapes), strict=True)
    probability = (prior.odds / prior.odds.sum())[:, None] * np.array(weights)
    return _Mixture(matrix.shape[:2], imitated, shapes, np.array(sizes), np.log(probability))


def _simulated(
    fit: LinearisedFit,
    signals: Sequence[RandomSignal],
    mixtures: Sequence[_Mixture],
    rng: np.random.Generator,
    n: int,
) -> np.ndarray:
    """Log Bayes factors (signals, n) in campaigns that have one of the signals each."""
    data = rng.standard_normal((*fit.residual.shape, n)) * fit.valid[..., None]
    owner = np.arange(n) % len(signals)
    for i, (signal, mixture) in enumerate(zip(signals, mixtures, strict=True)):
        own = mixture.coefficients(rng, int(np.sum(owner == i)))
        data[..., owner == i] += signal.columns @ own
    fitted = fit.inverse_root @ fit.simulated_gradient(rng, data)
    return np.stack(
        [
            mixture.log_bayes_factor(_gradient(signal, mixture, data, fitted))
            for signal, mixture in zip(signals, mixtures, strict=True)
        ]
    )


def _gradient(
    signal: RandomSignal, mixture: _Mixture, data: np.ndarray, fitted: np.ndarray
) -> np.ndarray:
    """Projected gradients (slews, k, n) of a candidate in data of which a fit explains a part."""
    along = np.swapaxes(signal.columns, 1, 2) @ data
    return along - (mixture.imitated.T @ fitted).reshape(along.shape)
