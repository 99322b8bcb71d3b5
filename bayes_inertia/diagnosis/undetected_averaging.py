"""J and K if one more effect acts that was too weak to be found: Bayesian model averaging.

A fit without an effect believes that there is none. Each candidate that was not named may be there
all the same: its evidence, to first order, says how probable that still is, and its amplitude has a
posterior of its own, which moves J and K and widens them. Averaged over nothing and every single
candidate, in proportion to evidence and prior odds, the uncertainty of J and K counts what a
diagnosis cannot exclude (Hoeting et al. 1999, Bayesian model averaging: a tutorial).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.diagnosis.blind_spots import scored_undetected, shift_per_amplitude
from bayes_inertia.diagnosis.model_averaging import AlternativeParameters
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.score_test import ScoreTests
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.physics.parameters import N_BASE


def undetected_alternatives(diagnosis: Diagnosis) -> tuple[AlternativeParameters, ...]:
    """J and K with each candidate that was not named, to first order, and how probable it is.

    Beforehand it is as likely as not that one of them acts, each as likely as the others, with
    amplitudes of the prior. A flexible mode, whose signal is of second order, is left out.

    Parameters
    ----------
    diagnosis : Diagnosis
        What was found.

    Returns
    -------
    tuple of AlternativeParameters
        One for each candidate, in place of nothing (`instead_of` is empty); none where the verdict
        is "unknown": there what is missing is fitted along without a name.
    """
    scored = scored_undetected(diagnosis)
    if scored is None:
        return ()
    estimate, (fit, tests) = diagnosis.final, scored
    names = tests.names
    odds = np.exp([tests.log_bayes_factor(k) for k in range(len(names))]) / len(names)
    space, rows = estimate.model.space, []
    for k, probability in enumerate(odds / (1.0 + odds.sum())):
        part = space.slice_of(names[k])
        moved = shift_per_amplitude(fit, estimate.free, fit.parameters[..., part] * space.sd[part])
        rows.append(_alternative(estimate, tests, k, moved, float(probability)))
    return tuple(rows)


def _alternative(
    estimate: Estimate, tests: ScoreTests, k: int, moved: np.ndarray, probability: float
) -> AlternativeParameters:
    """J and K with candidate k; `moved` (9, n) is the shift by a unit of it that is left out."""
    index = tests.indices[k]
    information = tests.matrix[np.ix_(index, index)] + np.eye(len(index))
    amplitude = tests.amplitude(k)
    if tests.one_sided[k]:
        amplitude = np.maximum(amplitude, 0.0)
    return AlternativeParameters(
        tests.names[k],
        "",
        probability,
        tuple(estimate.model.space.names[:N_BASE]),
        estimate.theta[:N_BASE] - moved @ amplitude,
        estimate.covariance[:N_BASE, :N_BASE] + moved @ np.linalg.solve(information, moved.T),
    )


def all_alternatives(
    exchanged: Sequence[AlternativeParameters], undetected: Sequence[AlternativeParameters]
) -> tuple[AlternativeParameters, ...]:
    """Effects of ambiguous sets and undetected ones, with probabilities that belong together.

    Parameters
    ----------
    exchanged, undetected : sequence of AlternativeParameters
        Each with probabilities beside the effects named alone.

    Returns
    -------
    tuple of AlternativeParameters
        What is missing from 1 in the sum belongs to the effects named.

    Examples
    --------
    >>> row = AlternativeParameters("a", "", 0.5, ("K1",), np.ones(1), np.eye(1))
    >>> [round(a.probability, 3) for a in all_alternatives((row,), (row,))]
    [0.333, 0.333]
    """
    if not (exchanged and undetected):
        return (*exchanged, *undetected)
    odds = [
        row.probability / (1.0 - sum(other.probability for other in group))
        for group in (exchanged, undetected)
        for row in group
    ]
    rows = (*exchanged, *undetected)
    return tuple(
        replace(row, probability=o / (1.0 + sum(odds))) for row, o in zip(rows, odds, strict=True)
    )
