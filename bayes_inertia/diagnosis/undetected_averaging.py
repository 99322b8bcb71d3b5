"""J and K if one more effect acts that was too weak to be found: Bayesian model averaging.

A fit without an effect believes that there is none. Each candidate that was not named may be there
all the same: its evidence, to first order, says how probable that still is, and its amplitude has a
posterior of its own, which moves J and K and widens them. Averaged over nothing and every single
candidate, in proportion to evidence and prior odds, the uncertainty of J and K counts what a
campaign cannot exclude (Hoeting et al. 1999, Bayesian model averaging: a tutorial). Against truth,
no other uncertainty holds as often as it says at so little width (`analyses/results/quoted_sd.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.diagnosis.blind_spots import shift_per_amplitude
from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.diagnosis.model_averaging import AlternativeParameters
from bayes_inertia.diagnosis.score_test import ScoreTests, score_tests, unfitted
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE


def undetected_alternatives(
    estimate: Estimate, library: Sequence[Effect] = LIBRARY
) -> tuple[AlternativeParameters, ...]:
    """J and K with each candidate that is not fitted, to first order, and how probable it is.

    Beforehand it is as likely as not that one of them acts, each as likely as the others, with
    amplitudes of the prior, in the directions that the campaign can see. What it cannot see, such
    as a gain that all wheels share, is a condition of the result and no part of its uncertainty.
    A flexible mode, whose signal is of second order, is left out.

    Returns: one for each candidate that the campaign can see, in place of nothing (`instead_of` is
    empty).
    """
    held = _with_candidates(estimate, library)
    fit, names, space = held.linearised(), unfitted(held), held.model.space
    tests = score_tests(held, names, fit=fit)
    odds = np.exp([tests.log_bayes_factor(k) for k in range(len(names))]) / max(len(names), 1)
    rows = []
    for k, probability in enumerate(odds / (1.0 + odds.sum())):
        if tests.dof(k):
            part = space.slice_of(names[k])
            columns = fit.parameters[..., part] * space.sd[part]
            moved = shift_per_amplitude(fit, held.free, columns)
            rows.append(_alternative(held, tests, k, moved, float(probability)))
    return tuple(rows)


def _with_candidates(estimate: Estimate, library: Sequence[Effect]) -> Estimate:
    """The fit in a model that holds all candidates of the library at their null."""
    model = estimate.model
    known = {effect.name for effect in model.effects}
    usable = candidate_effects(model.campaign, library).linear
    others = tuple(effect for effect in usable if effect.name not in known)
    if not others:
        return estimate
    drive, effects = model.structure.drive, (*model.effects, *others)
    return move_to(estimate, Model(model.campaign, effects, drive, model.noise))


def _alternative(
    estimate: Estimate, tests: ScoreTests, k: int, moved: np.ndarray, probability: float
) -> AlternativeParameters:
    """J and K with candidate k; `moved` (9, n) is the shift by a unit of it that is left out."""
    powers, directions = tests.visible(k)
    gradient = tests.gradient[tests.indices[k]]
    if tests.one_sided[k]:
        gradient = np.maximum(gradient, 0.0)
    moved, information = moved @ directions, powers + 1.0
    return AlternativeParameters(
        tests.names[k],
        "",
        probability,
        tuple(estimate.model.space.names[:N_BASE]),
        estimate.theta[:N_BASE] - moved @ (gradient @ directions / information),
        estimate.covariance[:N_BASE, :N_BASE] + moved / information @ moved.T,
    )


def all_alternatives(
    exchanged: Sequence[AlternativeParameters], undetected: Sequence[AlternativeParameters]
) -> tuple[AlternativeParameters, ...]:
    """Effects of ambiguous sets and undetected ones, with probabilities that belong together.

    Returns: what is missing from 1 in the sum belongs to the effects named.

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
