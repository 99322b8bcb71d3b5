"""Sizes and times of first-order processes in the rates, by evidence that filters all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayes_inertia.inference.effect_noise import effects_between_knots
from bayes_inertia.inference.filtered_evidence import FilteredEvidence
from bayes_inertia.inference.hyperparameters import with_sizes
from bayes_inertia.inference.learnt_parameters import LearntParameters
from bayes_inertia.inference.noise_model import Whitening, rate_noise_covariance
from bayes_inertia.inference.point import Point
from bayes_inertia.maths.central_differences import quadratic_at
from bayes_inertia.maths.least_squares import dogleg
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.reading_noise import ReadingNoise

# Step of the differences on the way to the peak, and of those that tell its width [prior sd].
_STEP, _WIDE_STEP = 0.01, 0.1
_FARTHEST = 8.0  # prior sds from the centre
# Of the log evidence: less decides nothing.
_TOLERANCE = 1e-3
# A move counts in prior sds, or in fifths of a parameter's own sd where these are larger.
_OWN_SHARE = 0.2
# Least curvature along every direction [prior sd^-2]: a fourth of the prior's.
_LEAST_CURVATURE = 0.25

# From standardised parameters (h,) to the processes that they stand for.
Processes = Callable[[np.ndarray], tuple[ReadingNoise, ...]]


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
        return _lifted(-quadratic_at(self.values, self.at, _WIDE_STEP).hessian)


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
        near = quadratic_at(values, x, _STEP, value=-known[x.tobytes()])
        curvature = _lifted(-near.hessian)
        return curvature, -near.gradient

    at, lowest = dogleg(
        negative,
        equations,
        lambda x, step: np.clip(x + step, -_FARTHEST, _FARTHEST),
        np.asarray(begin, float),
        np.ones(len(begin)),
        tolerance=_TOLERANCE,
    )
    return EvidencePeak(at, -lowest, np.sqrt(np.diag(np.linalg.inv(curvature))), values)


def _lifted(curvature: np.ndarray) -> np.ndarray:
    """The nearest matrix without a direction that is flatter than a peak may be."""
    powers, directions = np.linalg.eigh(curvature)
    return (directions * np.maximum(powers, _LEAST_CURVATURE)) @ directions.T


def filtered_parameters(model: Model, theta: np.ndarray) -> np.ndarray:
    """Parameters of effects whose processes are filtered between their knots.

    `theta` (d,). Returns (h,).
    """
    slices = [model.space.slice_of(each.effect) for each in effects_between_knots(model, theta)]
    return np.concatenate([np.zeros(0, int), *(np.arange(s.start, s.stop) for s in slices)])


def with_filtered_sizes(
    model: Model, point: Point, white: Whitening, free: np.ndarray
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

    def processes(x: np.ndarray) -> tuple[ReadingNoise, ...]:
        at = effects_between_knots(model, parameters.put(point.theta, x))
        return tuple(each.noise._replace(knots=0) for each in at)

    begin = parameters.standardised(point.theta)
    level = noise_level_used(model, point, white)
    evidence = FilteredEvidence(model, point, white, free, level, filtered)
    peak = evidence_peak(evidence, processes, begin, np.ones(len(learnt)))
    change = float(np.max(np.abs(peak.at - begin) / np.maximum(peak.sd / _OWN_SHARE, 1.0)))
    return with_sizes(model, point, parameters.put(point.theta, peak.at)), change


def noise_level_used(model: Model, point: Point, white: Whitening) -> float:
    """Noise of the rates as used over noise as stated, over all slews."""
    used = np.square(np.asarray(white.rate)).sum((2, 3))
    stated = np.trace(np.linalg.inv(rate_noise_covariance(model, point.theta)))
    measured = used > 0.0
    return float(np.sqrt(stated / used[measured].mean())) if measured.any() else 1.0
