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
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.reading_noise import ReadingNoise

# Sets of processes that are filtered at once: compiled code has one shape. A slope along a size and
# a time needs a point and its four neighbours.
_BATCH = 5
# Numbers to filter beyond which they are filtered one after the other, to save memory.
_MOST_AT_ONCE = 1_000_000


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

    rate: Array
    others: Array
    precision: Array
    gradient: Array
    local: Array


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
        return _Rows(
            jnp.asarray(rate.reshape(*rate.shape[:1], -1, 3, rate.shape[-1])),
            jnp.asarray(sum(np.einsum("snp,snq->spq", x, x) for x in others)),
            jnp.asarray(unknowns.precision),
            jnp.asarray(unknowns.gradient),
            jnp.asarray(np.asarray(self.point.local)[:, ~self.filtered]),
        )

    def log_evidence(
        self, settings: Sequence[Sequence[ReadingNoise]], *, as_stated: bool = False
    ) -> np.ndarray:
        """The log evidence for sets of processes beside what the campaign states.

        Parameters
        ----------
        settings : sequence of sequences of ReadingNoise
            An empty set is the noise without them.
        as_stated : bool, optional
            Whether the white noise is as stated, and not as used; then no set may be empty.

        Returns
        -------
        (len(settings),) array
            Up to one constant.
        """
        spare = -len(settings) % _BATCH
        padded = [*settings, *[settings[-1]] * spare]
        values = []
        for begin in range(0, len(padded), _BATCH):
            batch = padded[begin : begin + _BATCH]
            values.append(self._of_batch(batch, 1.0 / self.level**2 if as_stated else 1.0))
        return np.concatenate(values)[: len(settings)]

    def _of_batch(self, batch: Sequence[Sequence[ReadingNoise]], white: float) -> np.ndarray:
        covariance = self.level**2 * rate_noise_covariance(self.model, self.point.theta)
        memories = rate_noise_memories(self.model, covariance, batch, white=white)
        valid = self.model.data.arrays.telemetry.rate_valid
        if memories is None:
            return np.full(len(batch), float(_of_white_noise(self._rows)))
        one_by_one = self._rows.rate.size > _MOST_AT_ONCE
        return np.asarray(_log_evidence(one_by_one, self._rows, memories, valid))


@partial(jax.jit, static_argnums=0)
def _log_evidence(one_by_one: bool, rows: _Rows, memories: Memory, valid: Array) -> Array:
    """Of each of several filters (batch,), all at once or one after the other."""

    def of_one(memory: Memory) -> Array:
        filtered = innovations(jnp.moveaxis(rows.rate, -1, 0), memory)
        norm = jnp.sum(jnp.where(valid, jnp.log(memory.scale), 0.0))
        return norm + _integral(rows, jnp.einsum("psnc,qsnc->spq", filtered, filtered))

    return jax.lax.map(of_one, memories) if one_by_one else jax.vmap(of_one)(memories)


@jax.jit
def _of_white_noise(rows: _Rows) -> Array:
    return _integral(rows, jnp.einsum("sncp,sncq->spq", rows.rate, rows.rate))


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
