"""Quantised readings: whole multiples of one step that the stated noise does not hide."""

from __future__ import annotations

import math

import numpy as np

from bayes_inertia.faults.fault import Fault, Series, Treatment
from bayes_inertia.faults.limits import LIMITS


def resolution(values: np.ndarray) -> float:
    """The smallest step between different values (n,); 0 if there are no two but for rounding."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-12 * np.abs(values).max(initial=0.0)]
    return float(steps.min()) if len(steps) else 0.0


def quantisation_step(values: np.ndarray) -> float | None:
    """The step of which all differences between readings (n,) are multiples; None if there is none.

    >>> quantisation_step(np.array([0.0, 0.5, 1.5, 0.5]))
    0.5
    >>> quantisation_step(np.random.default_rng(1).normal(size=50)) is None
    True
    """
    different = np.unique(values[np.isfinite(values)])
    step = resolution(different)
    if len(different) < LIMITS.fewest_values or step == 0.0:
        return None
    multiples = (different - different[0]) / step
    whole = np.abs(multiples - np.round(multiples)) < LIMITS.multiple_tolerance
    return step if np.mean(whole) >= LIMITS.share_of_multiples else None


def quantisation_sigma(step: float) -> float:
    """Standard deviation of the error of rounding to a step."""
    return step / math.sqrt(12.0)


def detect(series: Series) -> list[Fault]:
    """Rounding by a step larger than the stated noise, in the axis where it is worst."""
    sigma = series.sigma
    steps = {
        k: step
        for k, s in enumerate(sigma)
        if s is not None and (step := quantisation_step(series.values[:, k])) and step > s
    }
    if not steps:
        return []
    k, step = max(steps.items(), key=lambda item: item[1] / (sigma[item[0]] or np.inf))
    held = quantisation_sigma(step) <= (sigma[k] or 0.0)
    note = (
        f"readings are multiples of {step:.3g} {series.unit}, whose rounding error "
        f"{quantisation_sigma(step):.3g} the stated noise {sigma[k]:.3g} "
        f"{'holds' if held else 'does not hold'}"
    )
    treated: Treatment = "modelled" if held else "ignored"
    return [Fault("quantised", np.zeros(series.values.shape, dtype=bool), treated, note)]
