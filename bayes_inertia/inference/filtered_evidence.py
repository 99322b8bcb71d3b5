"""Evidence for first-order processes in the rates, the whole process filtered out of the readings.

On knots a process has few numbers and its evidence is cheap, but what it does between them says
most of its size where it is strong. Here nothing is left out: for each size and time the readings,
and all their derivatives, are filtered (`noise_filter`), and everything that was fitted is
integrated out to first order. The evidence is the density of the innovations (Schweppe 1965,
"Evaluation of likelihood functions for Gaussian signals").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.coefficients import SlewEquations, eliminated, log_integral
from bayes_inertia.inference.hyperparameters import without_hyperparameters
from bayes_inertia.inference.likelihood import unpadded_sensitivities
from bayes_inertia.inference.noise_filter import rate_noise_memories
from bayes_inertia.inference.noise_memory import Memory, innovations
from bayes_inertia.inference.noise_model import Whitening, rate_noise_covariance
from bayes_inertia.inference.point import N_BIAS, Point
from bayes_inertia.inference.shared_unknowns import shared_first
from bayes_inertia.maths.at_once import at_once
from bayes_inertia.maths.device_arrays import filled, on_device, padded_size
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.reading_noise import ReadingNoise


class _Rows(NamedTuple):
    """What is filtered, and what is not: unknowns in prior sds, those that slews share first.

    Parameters
    ----------
    rate : (slews, n, 3, 1 + p) array
        Whitened residuals of the rates where nothing is filtered, then their derivatives.
    others : (slews, 1 + p, 1 + p) array
        The same products of residuals and derivatives of all other channels.
    precision, gradient : (s,) arrays
        Of the prior of what slews share.
    local : (slews, m) array
        Nuisances of each slew.
    """

    rate: AnyArray
    others: AnyArray
    precision: AnyArray
    gradient: AnyArray
    local: AnyArray


@dataclass(frozen=True, eq=False)
class FilteredEvidence:
    """The data's evidence for what is filtered out of the rates, to first order around a point.

    Parameters
    ----------
    model : Model
    point : Point
        Where the derivatives are taken.
    white : Whitening
        The noise as used; how it remembers does not count.
    free : (f,) array of int
        Indices of the parameters that are integrated out.
    level : float
        Noise of the rates as used over noise as stated.
    filtered : (n_local,) array of bool
        Nuisances that stand for what is filtered: they are left out.
    """

    model: Model
    point: Point
    white: Whitening
    free: np.ndarray
    level: float
    filtered: np.ndarray

    @cached_property
    def _rows(self) -> _Rows:
        shaped = without_hyperparameters(self.model, self.free)
        white = self.white._replace(memory=None)
        s = unpadded_sensitivities(self.model, self.point, white, shaped)
        f, unknowns = len(shaped), shared_first(self.model, self.point, shaped)
        kept = np.concatenate([np.ones(f + N_BIAS, bool), ~self.filtered])
        numbers = np.where(self.filtered, self.point.local, 0.0)
        order = unknowns.order[kept[unknowns.order]]
        parts = []
        for r, j in zip(s.residuals, s.jacobian, strict=True):
            columns = np.asarray(j)
            gone = np.einsum("snk,sk->sn", columns[..., f + N_BIAS :], numbers)
            parts.append((np.asarray(r) - gone)[..., None])
            parts.append(columns[..., order] * unknowns.scale[order])
        rate, *others = (np.concatenate(parts[i : i + 2], -1) for i in range(0, len(parts), 2))
        rows = _Rows(
            self._padded(rate.reshape(*rate.shape[:1], -1, 3, rate.shape[-1])),
            filled(sum(np.swapaxes(x, 1, 2) @ x for x in others), self._size, 0),
            unknowns.precision,
            unknowns.gradient,
            filled(np.asarray(self.point.local)[:, ~self.filtered], self._size, 0),
        )
        return jax.tree.map(on_device, rows)

    @property
    def _size(self) -> int:
        return padded_size(self.model.n_slews, 1, often=True)

    def _padded(self, rows: AnyArray) -> AnyArray:
        """Numbers of all slews' rows, and of padding that tells nothing."""
        return filled(filled(rows, self._size, 0), padded_size(rows.shape[1]))

    def log_evidence(
        self, settings: Sequence[Sequence[ReadingNoise]], *, as_stated: bool = False
    ) -> np.ndarray:
        """The log evidence for sets of processes beside what the campaign states.

        `as_stated`: whether the white noise is as stated, and not as used; then no set may be
        empty.
        """
        covariance = self.level**2 * rate_noise_covariance(self.model, self.point.theta)
        white = 1.0 / self.level**2 if as_stated else 1.0
        memories = rate_noise_memories(self.model, covariance, settings, white=white)
        if memories is None:
            return np.full(len(settings), float(_of_white_noise(self._rows)))
        valid = self._padded(np.asarray(self.model.data.arrays.telemetry.rate_valid))
        # One filter a call: compiled code has one shape, and a batch of them is no faster.
        each = (Memory(*(self._padded(x[i]) for x in memories)) for i in range(len(settings)))
        return np.array(at_once([partial(_log_evidence, self._rows, own, valid) for own in each]))


@jax.jit
def _log_evidence(rows: _Rows, memory: Memory, valid: Array) -> Array:
    """Of one filter."""
    filtered = innovations(rows.rate, memory)
    norm = jnp.sum(jnp.where(valid, jnp.log(memory.scale), 0.0))
    return norm + _integral(rows, _products(filtered))


@jax.jit
def _of_white_noise(rows: _Rows) -> Array:
    return _integral(rows, _products(rows.rate))


def _products(rate: Array) -> Array:
    """Products (slews, p, p) of columns (slews, n, 3, p)."""
    columns = rate.reshape(rate.shape[0], -1, rate.shape[-1])
    return jnp.einsum("snp,snq->spq", columns, columns)


def _integral(rows: _Rows, of_rates: Array) -> Array:
    """Log of the integral over all unknowns, from products of residuals and derivatives."""
    products = of_rates + rows.others
    equations = SlewEquations(
        jnp.sum(products[:, 0, 0]),
        products[:, 1:, 1:],
        products[:, 1:, 0],
        rows.precision,
        rows.gradient,
        jnp.zeros(()),
        rows.local,
    )
    return log_integral(eliminated((), equations))


PROGRAMS = (_log_evidence, _of_white_noise)
