"""J and K as they are quoted, without sampling: of a fit, or after a diagnosis.

The fits of a search (`Diagnosis.base`, `Diagnosis.final`) each believe their model. What was not
detected, and where the verdict is "ambiguous" or "unknown" what cannot be told, is averaged over.
"""

from __future__ import annotations

import numpy as np
from scipy import optimize, stats

from bayes_inertia.diagnosis.model_averaging import AlternativeParameters, alternative_parameters
from bayes_inertia.diagnosis.remainder_averaging import remainder_alternatives, tried_effects
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.undetected_averaging import all_alternatives, undetected_alternatives
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior import sd_of_interval
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
        SI units; the median where several models are averaged.
    sd : (9,) array
        Of normal distributions with the same 90 % intervals.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray


def quoted_parameters(found: Estimate | Diagnosis) -> QuotedParameters:
    """J and K of a fit, or after a diagnosis, at the optimum (Laplace's approximation).

    `fit` and `diagnose_and_fit` sample the posterior of the same fits; their summaries quote the
    same.

    Parameters
    ----------
    found : Estimate or Diagnosis
        A fit whose residuals are explained, or what a diagnosis found.

    Returns
    -------
    QuotedParameters
        Averaged over what may act although it was not found, and over the set where the verdict is
        "ambiguous". Where it is "unknown" the fits hold a torque and a rate error of free shape:
        see `remainder_averaging`.

    Raises
    ------
    EstimateError
        If the optimizer finds no usable estimate.

    Examples
    --------
    It takes seconds after a fit or a diagnosis, so this is no doctest::

        quoted = quoted_parameters(diagnose(campaign))
        dict(zip(quoted.names, quoted.sd))
    """
    if isinstance(found, Estimate):
        return averaged_parameters(
            _row(found), undetected_alternatives(found), found.dispersion_factor
        )
    exchanged = alternatives_of(found)
    if found.verdict == "unknown":
        return averaged_parameters(_row(_free_shapes(found)), exchanged)
    undetected = undetected_alternatives(found.final)
    alternatives = all_alternatives(exchanged, undetected)
    return averaged_parameters(_row(found.final), alternatives, found.final.dispersion_factor)


def alternatives_of(diagnosis: Diagnosis) -> tuple[AlternativeParameters, ...]:
    """J and K given what a diagnosis could not rule out.

    Returns: one for each other effect of an ambiguous set, or, where no candidate explains the
    data, one with free shapes; empty where there is nothing to average over.
    """
    return alternative_parameters(diagnosis) or remainder_alternatives(diagnosis)


def averaged_parameters(
    first: AlternativeParameters,
    alternatives: tuple[AlternativeParameters, ...],
    dispersion_factor: float = 1.0,
) -> QuotedParameters:
    """Median of a mixture, and the sd that belongs to its 90 % interval.

    `dispersion_factor`: by which slews disagree more than the fit says.

    Examples
    --------
    >>> def row(mean, probability):
    ...     return AlternativeParameters(
    ...         "a", "", probability, ("K1",), np.full(1, mean), np.eye(1))
    >>> mixed = averaged_parameters(row(0.0, 0.0), (row(2.0, 0.5),))
    >>> mixed.mean, mixed.sd.round(2)
    (array([1.]), array([1.39]))
    """
    rows = (first, *alternatives)
    shares = np.array([1.0 - sum(r.probability for r in alternatives)])
    shares = np.append(shares, [r.probability for r in alternatives])
    means, sds = (np.array([getattr(r, key) for r in rows]) for key in ("mean", "sd"))
    low, middle, high = (
        np.array([_quantile(level, shares, m, s) for m, s in zip(means.T, sds.T, strict=True)])
        for level in (0.05, 0.5, 0.95)
    )
    return QuotedParameters(first.names, middle, dispersion_factor * sd_of_interval(low, high))


def _quantile(level: float, shares: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> float:
    """Quantile of a mixture of normal distributions, all arrays (n,)."""
    if not np.all(sd > 0.0):
        return float(mean[0])  # A parameter that is held.
    low, high = float(np.min(mean - 6.0 * sd)), float(np.max(mean + 6.0 * sd))
    return optimize.brentq(
        lambda value: float(shares @ stats.norm.cdf((value - mean) / sd)) - level, low, high
    )


def _free_shapes(diagnosis: Diagnosis) -> Estimate:
    """The fit that a diagnosis wants in full where something is missing without a name."""
    if diagnosis.why_unknown == "misfit":
        return _refitted(diagnosis.final, tried_effects(diagnosis))
    return _refitted(diagnosis.final, REMAINDERS)


def _row(fit: Estimate) -> AlternativeParameters:
    """J and K of a fit."""
    names = tuple(fit.model.space.names[:N_BASE])
    covariance = fit.covariance[:N_BASE, :N_BASE]
    return AlternativeParameters("", "", 0.0, names, fit.theta[:N_BASE], covariance)


def _refitted(final: Estimate, effects: tuple[Effect, ...]) -> Estimate:
    """The fit with these effects, each slew counted as its residuals scatter."""
    model = final.model
    return estimate(Model(model.campaign, effects, model.structure.drive), starts=1)
