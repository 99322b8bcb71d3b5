"""J and K as a diagnosis quotes them, whatever its verdict, without sampling.

The fits of a search (`Diagnosis.base`, `Diagnosis.final`) each believe their model. Where the
verdict is "ambiguous" or "unknown" no single model is believed, and the sds of any one of them are
too small.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.diagnosis.model_averaging import AlternativeParameters, alternative_parameters
from bayes_inertia.diagnosis.remainder_averaging import remainder_alternatives, tried_effects
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import REMAINDERS
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE


@array_dataclass
class QuotedParameters:
    """J and K with the uncertainty to quote.

    Parameters
    ----------
    names : tuple of str
        Of the elements of J and K.
    mean : (9,) array
        SI units.
    covariance : (9, 9) array
        Of all models that may be true, averaged.

    Examples
    --------
    >>> QuotedParameters(("K1",), np.ones(1), np.full((1, 1), 4e-6)).sd
    array([0.002])
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (9,)."""
        return np.sqrt(np.diag(self.covariance))


def quoted_parameters(diagnosis: Diagnosis) -> QuotedParameters:
    """J and K after a diagnosis, at the optimum (Laplace's approximation).

    `diagnose_and_fit` samples the posterior of the same fits, and its summary quotes the larger of
    each sd and what the scatter between slews supports; that is the sd here too.

    Parameters
    ----------
    diagnosis : Diagnosis
        What was found.

    Returns
    -------
    QuotedParameters
        Of the final fit where the verdict is "consistent" or "named", averaged over the set where
        it is "ambiguous". Where it is "unknown" the fits hold a torque and a rate error of free
        shape: see `remainder_averaging`.

    Raises
    ------
    EstimateError
        If the optimizer finds no usable estimate.

    Examples
    --------
    It takes seconds after a diagnosis of half a minute, so this is no doctest::

        quoted = quoted_parameters(diagnose(campaign))
        dict(zip(quoted.names, quoted.sd))
    """
    return averaged_parameters(_first_fit(diagnosis), alternatives_of(diagnosis))


def alternatives_of(diagnosis: Diagnosis) -> tuple[AlternativeParameters, ...]:
    """J and K given what a diagnosis could not rule out.

    Parameters
    ----------
    diagnosis : Diagnosis
        What was found.

    Returns
    -------
    tuple of AlternativeParameters
        One for each other effect of an ambiguous set, or, where no candidate explains the data,
        one with free shapes; empty where there is nothing to average over.
    """
    return alternative_parameters(diagnosis) or remainder_alternatives(diagnosis)


def averaged_parameters(
    first: AlternativeParameters, alternatives: tuple[AlternativeParameters, ...]
) -> QuotedParameters:
    """Mean and covariance of a mixture.

    Parameters
    ----------
    first : AlternativeParameters
        What has the probability that the alternatives leave.
    alternatives : tuple of AlternativeParameters
        What may be true instead.

    Returns
    -------
    QuotedParameters

    Examples
    --------
    >>> def row(mean, probability):
    ...     return AlternativeParameters(
    ...         "a", "", probability, ("K1",), np.full(1, mean), np.eye(1))
    >>> mixed = averaged_parameters(row(0.0, 0.0), (row(2.0, 0.5),))
    >>> mixed.mean, mixed.covariance
    (array([1.]), array([[2.]]))
    """
    left = 1.0 - sum(row.probability for row in alternatives)
    cases = [(left, first), *((row.probability, row) for row in alternatives)]
    mean = np.sum([share * row.mean for share, row in cases], axis=0)
    covariance = np.sum(
        [
            share * (row.covariance + np.outer(row.mean - mean, row.mean - mean))
            for share, row in cases
        ],
        axis=0,
    )
    return QuotedParameters(first.names, mean, covariance)


def _first_fit(diagnosis: Diagnosis) -> AlternativeParameters:
    """J and K of the fit that a diagnosis wants in full."""
    final = diagnosis.final
    if diagnosis.why_unknown == "misfit":
        final = _refitted(final, tried_effects(diagnosis))
    elif diagnosis.why_unknown == "imitation":
        final = _refitted(final, REMAINDERS)
    return AlternativeParameters(
        "",
        "",
        0.0,
        tuple(final.model.space.names[:N_BASE]),
        final.theta[:N_BASE],
        final.quoted_covariance[:N_BASE, :N_BASE],
    )


def _refitted(final: Estimate, effects: tuple[Effect, ...]) -> Estimate:
    """The fit with these effects, each slew counted as its residuals scatter."""
    model = final.model
    return estimate(Model(model.campaign, effects, model.structure.drive), starts=1)
