"""What one campaign alone tells of J and K: a Gaussian with the prior taken off.

Nuisances and effects are integrated out. Summaries of campaigns multiply, because each prior is
taken off: so a series needs no telemetry of the past.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from bayes_inertia.errors import CampaignError
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.parameters import base_names

_ARRAYS = ("mean", "precision", "prior_mean", "prior_sd")


@array_dataclass
class LikelihoodSummary:
    """A Gaussian in J and K, as a precision: directions that the data leave open have none.

    Parameters
    ----------
    campaign : str
        What it came from.
    mean : (n,) array
        Jxx to Jyz [kg m^2] and the K's where the likelihood is largest.
    precision : (n, n) array
        Inverse covariance there, without the prior; positive semidefinite.
    prior_mean, prior_sd : (n,) arrays
        The prior that was taken off.
    prior_correlation : (n, n) array or None
        Of that prior; None where its parameters were independent.
    is_scale_untied : bool
        Whether nothing in the campaign ties the size of J: only its ratios are told of.
    learnt_from : tuple of str
        `Slew.digest` of its slews; empty of older files.
    """

    campaign: str
    mean: np.ndarray
    precision: np.ndarray
    prior_mean: np.ndarray
    prior_sd: np.ndarray
    prior_correlation: np.ndarray | None = None
    is_scale_untied: bool = False
    learnt_from: tuple[str, ...] = ()

    def whitened(self, first: LikelihoodSummary) -> tuple[np.ndarray, np.ndarray]:
        """The summary as data in units of another one's prior.

        Returns R (n, n) and y (n,): y - R x is white, x in prior sds from the prior mean of
        `first`.
        """
        scaled = self.precision * np.outer(first.prior_sd, first.prior_sd)
        powers, directions = np.linalg.eigh(0.5 * (scaled + scaled.T))
        root = np.sqrt(np.maximum(powers, 0.0))[:, None] * directions.T
        return root, root @ ((self.mean - first.prior_mean) / first.prior_sd)

    @property
    def told_directions(self) -> int:
        """How many directions of J and K the data tell of."""
        scaled = self.precision * np.outer(self.prior_sd, self.prior_sd)
        return int(np.sum(np.linalg.eigvalsh(scaled) > 0.5 * LIMITS.told_share))

    @property
    def names(self) -> tuple[str, ...]:
        """Jxx to Jyz and the K's."""
        return base_names(self.mean.size)

    @property
    def prior_matrix(self) -> np.ndarray:
        """Covariance (n, n) of the prior, in its sds."""
        correlation = self.prior_correlation
        return np.eye(self.mean.size) if correlation is None else correlation

    def with_prior_of(self, other: LikelihoodSummary) -> LikelihoodSummary:
        """The same data with the prior of another summary."""
        return replace(
            self,
            prior_mean=other.prior_mean,
            prior_sd=other.prior_sd,
            prior_correlation=other.prior_correlation,
        )

    def json(self) -> dict[str, Any]:
        """As it stands in a file: lists of numbers."""
        content: dict[str, Any] = {k: getattr(self, k) for k in ("campaign", "is_scale_untied")}
        content["learnt_from"] = list(self.learnt_from)
        arrays = _ARRAYS if self.prior_correlation is None else (*_ARRAYS, "prior_correlation")
        return content | {k: getattr(self, k).tolist() for k in arrays}


def summary_of(
    campaign: str,
    mean: np.ndarray,
    covariance: np.ndarray,
    prior_mean: np.ndarray,
    prior_sd: np.ndarray,
    prior_correlation: np.ndarray | None = None,
) -> LikelihoodSummary:
    """The likelihood that a Gaussian prior and a posterior imply.

    `mean` (n,); `covariance` (n, n); `prior_correlation` (n, n), None for independent parameters.

    Examples
    --------
    >>> one = np.ones(9)
    >>> told = summary_of("a", 0.5 * one, 0.5 * np.eye(9), 0.0 * one, one)
    >>> told.mean.round(6)[0], told.precision.round(6)[0, 0]
    (np.float64(1.0), np.float64(1.0))
    """
    # In units in which the prior is white.
    correlation = np.eye(len(mean)) if prior_correlation is None else prior_correlation
    root = np.linalg.cholesky(correlation)
    scaled = covariance / np.outer(prior_sd, prior_sd)
    scaled = np.linalg.solve(root, np.linalg.solve(root, scaled).T)
    distance = np.linalg.solve(root, (mean - prior_mean) / prior_sd)
    powers, directions = np.linalg.eigh(0.5 * (scaled + scaled.T))
    # The prior's precision is one in these units.
    told = 1.0 / powers - 1.0
    told = np.where(told > LIMITS.told_share, told, 0.0)
    along = directions.T @ distance
    shift = directions @ (np.where(told > 0.0, along / np.maximum(powers * told, 1e-300), 0.0))
    precision = (directions * told) @ directions.T
    precision = np.linalg.solve(root.T, np.linalg.solve(root.T, precision).T).T
    precision /= np.outer(prior_sd, prior_sd)
    at = prior_mean + prior_sd * (root @ shift)
    return LikelihoodSummary(campaign, at, precision, prior_mean, prior_sd, prior_correlation)


def summary_from_json(content: Mapping[str, Any]) -> LikelihoodSummary:
    """The summary that `LikelihoodSummary.json` wrote."""
    arrays: dict[str, Any] = {key: np.array(content[key], dtype=float) for key in _ARRAYS}
    if content.get("prior_correlation") is not None:
        arrays["prior_correlation"] = np.array(content["prior_correlation"], dtype=float)
    arrays["is_scale_untied"] = bool(content.get("is_scale_untied", False))
    arrays["learnt_from"] = tuple(content.get("learnt_from", ()))
    return LikelihoodSummary(str(content["campaign"]), **arrays)


def require_same_parameters(summaries: Sequence[LikelihoodSummary]) -> None:
    """Raise unless all tell of the same numbers: as many K's."""
    first = summaries[0]
    for other in summaries:
        if other.names != first.names:
            told = (f"{s.campaign}: {s.names[0]} to {s.names[-1]}" for s in (first, other))
            raise CampaignError(
                f"campaigns tell of other parameters ({'; '.join(told)})",
                where=other.campaign,
                advice="give campaigns whose rate sensors have as many axes",
            )


def product(summaries: Sequence[LikelihoodSummary]) -> LikelihoodSummary:
    """What several campaigns of one spacecraft tell together, J and K being the same in all.

    The prior and the name are those of the first.
    """
    require_same_parameters(summaries)
    first = summaries[0]
    # In prior sds, so that the least squares are well scaled.
    precision = np.sum([s.precision for s in summaries], axis=0)
    pull = np.sum([s.precision @ (s.mean - first.prior_mean) for s in summaries], axis=0)
    scaled = precision * np.outer(first.prior_sd, first.prior_sd)
    shift = np.linalg.lstsq(scaled, pull * first.prior_sd, rcond=LIMITS.told_share**2)[0]
    mean = first.prior_mean + first.prior_sd * shift
    untied = all(summary.is_scale_untied for summary in summaries)
    slews = tuple(digest for summary in summaries for digest in summary.learnt_from)
    told = {"mean": mean, "precision": precision, "learnt_from": slews}
    return replace(first, is_scale_untied=untied, **told)


def p_value_of_same(summaries: Sequence[LikelihoodSummary]) -> float:
    """How often campaigns of one J and K differ as much: chi^2 of what they tell more than once."""
    whole = product(summaries)
    gaps = [summary.mean - whole.mean for summary in summaries]
    chi2 = sum(gap @ s.precision @ gap for gap, s in zip(gaps, summaries, strict=True))
    told = sum(summary.told_directions for summary in summaries) - whole.told_directions
    return float(stats.chi2.sf(chi2, told)) if told > 0 else 1.0


def with_prior(summary: LikelihoodSummary) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n,) and covariance (n, n) of the posterior that a summary and its prior make."""
    scaled = summary.precision * np.outer(summary.prior_sd, summary.prior_sd)
    covariance = np.linalg.inv(scaled + np.linalg.inv(summary.prior_matrix))
    pull = scaled @ ((summary.mean - summary.prior_mean) / summary.prior_sd)
    scale = summary.prior_sd
    return summary.prior_mean + scale * (covariance @ pull), covariance * np.outer(scale, scale)


def first_stated_prior(summaries: Sequence[LikelihoodSummary]) -> LikelihoodSummary:
    """The first summary whose prior no telemetry told, else the first of all.

    A former posterior has correlations, which a campaign does not state.
    """
    stated = (summary for summary in summaries if summary.prior_correlation is None)
    return next(stated, summaries[0])


def means_and_sds(summaries: Sequence[LikelihoodSummary]) -> tuple[np.ndarray, np.ndarray]:
    """Means and sds (summaries, n) of the posteriors that summaries and their priors make."""
    means, covariances = zip(*map(with_prior, summaries), strict=True)
    return np.array(means), np.sqrt([np.diag(covariance) for covariance in covariances])
