"""Evidence for first-order processes in the rates, the whole process filtered out of the readings.

On knots a process has few numbers and its evidence is cheap, but what it does between them says
most of its size where it is strong. Here nothing is left out: for each size and time the readings,
and all their derivatives, are filtered (`noise_filter`), and everything that was fitted is
integrated out to first order. The evidence is the density of the innovations (Schweppe 1965,
"Evaluation of likelihood functions for Gaussian signals"); sizes and times go to its peak.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.channel_rows import channel_rows
from bayes_inertia.inference.coefficients import SlewEquations, eliminated, log_integral
from bayes_inertia.inference.hyperparameters import (
    LearntParameters,
    shared_first,
    with_sizes,
    without_hyperparameters,
)
from bayes_inertia.inference.likelihood import unpadded_sensitivities
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_filter import (
    Memory,
    effects_between_knots,
    innovations,
    noise_memories,
)
from bayes_inertia.inference.noise_model import Whitenings, stated_noise_of, without_memory
from bayes_inertia.inference.point import Point
from bayes_inertia.maths.at_once import at_once
from bayes_inertia.maths.central_differences import quadratic_at
from bayes_inertia.maths.device_arrays import filled, on_device, padded_size
from bayes_inertia.maths.least_squares import dogleg
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.processes import Process


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
    white : tuple of Whitening
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
    white: Whitenings
    free: np.ndarray
    level: float
    filtered: np.ndarray

    @cached_property
    def _rows(self) -> _Rows:
        shaped = without_hyperparameters(self.model, self.free)
        white = without_memory(self.white)
        s = unpadded_sensitivities(self.model, self.point, white, shaped)
        f, unknowns = len(shaped), shared_first(self.model, self.point, shaped)
        kept = np.concatenate([np.ones(f + len(self.point.bias), bool), ~self.filtered])
        numbers = np.where(self.filtered, self.point.local, 0.0)
        order = unknowns.order[kept[unknowns.order]]
        parts = []
        for r, j in zip(s.residuals, s.jacobian, strict=True):
            columns = np.asarray(j)
            gone = np.einsum("snk,sk->sn", columns[..., f + len(self.point.bias) :], numbers)
            parts.append((np.asarray(r) - gone)[..., None])
            parts.append(columns[..., order] * unknowns.scale[order])
        others = [np.concatenate(parts[i : i + 2], -1) for i in range(0, len(parts), 2)]
        rate = others.pop(self._place)
        axes = self.white[self._place].factors.shape[-1]
        rows = _Rows(
            self._padded(rate.reshape(*rate.shape[:1], -1, axes, rate.shape[-1])),
            filled(sum(np.swapaxes(x, 1, 2) @ x for x in others), self._size, 0),
            unknowns.precision,
            unknowns.gradient,
            filled(np.asarray(self.point.local)[:, ~self.filtered], self._size, 0),
        )
        return jax.tree.map(on_device, rows)

    @property
    def _place(self) -> int:
        """Of the rates among the channels."""
        return self.model.structure.place("rate")

    @property
    def _size(self) -> int:
        return padded_size(self.model.n_slews, 1, often=True)

    def _padded(self, rows: AnyArray) -> AnyArray:
        """Numbers of all slews' rows, and of padding that tells nothing."""
        return filled(filled(rows, self._size, 0), padded_size(rows.shape[1]))

    def log_evidence(
        self, settings: Sequence[Sequence[Process]], *, as_stated: bool = False
    ) -> np.ndarray:
        """The log evidence for sets of processes beside what the campaign states.

        `as_stated`: whether the white noise is as stated, and not as used; then no set may be
        empty.
        """
        channel = self.model.channels[self._place]
        noise = self.level**2 * stated_noise_of(self.model, channel, self.point.theta)
        white = 1.0 / self.level**2 if as_stated else 1.0
        memories = noise_memories(self.model, channel, noise, settings, white=white)
        if memories is None:
            return np.full(len(settings), float(_of_white_noise(self._rows)))
        valid = self._padded(channel_rows(self.model)["rate"].valid)
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


# From standardised parameters (h,) to the processes that they stand for.
Processes = Callable[[np.ndarray], tuple[Process, ...]]


@dataclass(frozen=True, eq=False)
class EvidencePeak:
    """Where the evidence for sizes and times is largest.

    Parameters
    ----------
    at : (h,) array
        There [prior sd].
    log_evidence : float
        There, with the log prior that was asked for.
    sd : (h,) array
        How well the parameters are known [prior sd], by the curvature next to it.
    values : callable
        From parameters (n, h) to log evidence (n,).
    """

    at: np.ndarray
    log_evidence: float
    sd: np.ndarray
    values: Callable[[np.ndarray], np.ndarray]

    @cached_property
    def curvature(self) -> np.ndarray:
        """Minus its second derivatives (h, h), no less than a quarter along every direction."""
        return _lifted(-quadratic_at(self.values, self.at, LIMITS.width_step).hessian)


def evidence_peak(
    evidence: FilteredEvidence,
    processes: Processes,
    begin: np.ndarray,
    prior_precision: np.ndarray,
    *,
    as_stated: bool = False,
    between_slews: Callable[[np.ndarray], np.ndarray] | None = None,
) -> EvidencePeak:
    """Climb to the largest evidence.

    `begin` (h,) [prior sd]. `processes`: from parameters (h,) in prior sds to the processes.
    `prior_precision` (h,): 1 where a parameter has its prior, 0 where the prior is flat in its
    logarithm. `between_slews`: from parameters (n, h) to log evidence (n,) that the filter, which
    begins anew in every slew, does not count.
    """

    def values(points: np.ndarray) -> np.ndarray:
        found = evidence.log_evidence([processes(x) for x in points], as_stated=as_stated)
        if between_slews is not None:
            found = found + between_slews(points)
        return found - 0.5 * np.sum(prior_precision * points**2, axis=1)

    known: dict[bytes, float] = {}
    curvature = np.eye(len(begin))

    def negative(x: np.ndarray) -> float:
        known[x.tobytes()] = -float(values(x[None])[0])
        return known[x.tobytes()]

    def equations(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal curvature
        near = quadratic_at(values, x, LIMITS.peak_step, value=-known[x.tobytes()])
        curvature = _lifted(-near.hessian)
        return curvature, -near.gradient

    at, lowest = dogleg(
        negative,
        equations,
        lambda x, step: np.clip(x + step, -LIMITS.farthest_sd, LIMITS.farthest_sd),
        np.asarray(begin, float),
        np.ones(len(begin)),
        tolerance=LIMITS.evidence_tolerance,
    )
    return EvidencePeak(at, -lowest, np.sqrt(np.diag(np.linalg.inv(curvature))), values)


def _lifted(curvature: np.ndarray) -> np.ndarray:
    """The nearest matrix without a direction that is flatter than a peak may be."""
    powers, directions = np.linalg.eigh(curvature)
    return (directions * np.maximum(powers, LIMITS.least_evidence_curvature)) @ directions.T


def filtered_parameters(model: Model, theta: np.ndarray) -> np.ndarray:
    """Parameters of effects whose processes are filtered between their knots.

    `theta` (d,). Returns (h,).
    """
    slices = [model.space.slice_of(each.effect) for each in effects_between_knots(model, theta)]
    return np.concatenate([np.zeros(0, int), *(np.arange(s.start, s.stop) for s in slices)])


def with_filtered_sizes(
    model: Model, point: Point, white: Whitenings, free: np.ndarray
) -> tuple[Point, float]:
    """The point with the sizes and times that the whole processes favour.

    `free` (f,). Returns `point`: its coefficients are what they were, whitened anew; `change`: by
    how much the parameters moved, the largest [prior sd, or a fifth of its own sd where that is
    larger]; 0 without such effects.
    """
    learnt = np.intersect1d(filtered_parameters(model, point.theta), free)
    if not len(learnt):
        return point, 0.0
    parameters = LearntParameters(model, learnt)
    filtered = np.zeros(point.n_local, bool)
    for each in effects_between_knots(model, point.theta):
        filtered[each.coefficients] = True

    def processes(x: np.ndarray) -> tuple[Process, ...]:
        at = effects_between_knots(model, parameters.put(point.theta, x))
        return tuple(each.noise._replace(knots=0) for each in at)

    begin = parameters.standardised(point.theta)
    level = noise_level_used(model, point, white)
    evidence = FilteredEvidence(model, point, white, free, level, filtered)
    peak = evidence_peak(evidence, processes, begin, np.ones(len(learnt)))
    change = float(np.max(np.abs(peak.at - begin) / np.maximum(peak.sd / LIMITS.own_share, 1.0)))
    return with_sizes(model, point, parameters.put(point.theta, peak.at)), change


def noise_level_used(model: Model, point: Point, white: Whitenings) -> float:
    """Noise of the rates as used over noise as stated, over all slews."""
    place = model.structure.place("rate")
    used = np.square(np.asarray(white[place].factors)).sum((2, 3))
    noise = stated_noise_of(model, model.channels[place], point.theta)
    stated = np.trace(np.linalg.inv(noise))
    measured = used > 0.0
    return float(np.sqrt(stated / used[measured].mean())) if measured.any() else 1.0
