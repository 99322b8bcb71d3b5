"""The Fisher prediction beside the emcee posterior, and a warning wherever they differ and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from bayes_inertia.errors import EstimateError, require
from bayes_inertia.files import vocabulary
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import json_ready
from bayes_inertia.observability.limits import LIMITS
from bayes_inertia.observability.result import Observability, ParameterObservability


@dataclass(frozen=True)
class PosteriorComparison:
    """One parameter: what was predicted, and what was sampled."""

    name: str  # of the parameter
    predicted_sd: float  # Fisher, with priors, in its unit
    posterior_sd: float  # of the draws, in its unit
    ratio: float  # posterior over predicted sd
    shift: float  # of the posterior's mean from the optimum [predicted sd]
    skewness: float  # of the draws; 0 for a Gaussian
    kurtosis: float
    warnings: tuple[str, ...]  # what differs, and what to use


def compare_with_posterior(
    observability: Observability, posterior: Posterior
) -> tuple[PosteriorComparison, ...]:
    """Predicted and sampled uncertainty side by side."""
    same = list(observability.names) == posterior.names
    others = ", ".join(sorted(set(observability.names) ^ set(posterior.names)))
    what = "the posterior is of other parameters"
    require(same, others, what, "fit again", error=EstimateError)
    effective = max(float(posterior.attributes["diagnostics"]["ess_bulk_min"]), 4.0)
    unphysical = _unphysical_share(observability)
    return tuple(
        _compare(p, posterior.samples[:, i], effective, unphysical)
        for i, p in enumerate(observability.parameters)
    )


def comparison_json(comparison: tuple[PosteriorComparison, ...]) -> dict[str, dict[str, Any]]:
    """The comparison as observability.json holds it."""
    rows = [json_ready(row) for row in comparison]
    return {row.pop("name"): row for row in rows}


def _compare(
    p: ParameterObservability, draws: np.ndarray, effective: float, unphysical: float
) -> PosteriorComparison:
    sd = float(draws.std(ddof=1))
    shift, ratio = float((draws.mean() - p.value) / p.sd), sd / p.sd
    skewness, kurtosis = float(stats.skew(draws)), float(stats.kurtosis(draws))
    errors = LIMITS.monte_carlo_errors
    other_sd = abs(np.log(ratio)) > LIMITS.max_log_sd_ratio + errors / np.sqrt(2.0 * effective)
    differs = other_sd or abs(shift) > LIMITS.max_shift + errors / np.sqrt(effective)
    skewed = abs(skewness) > LIMITS.max_skewness + errors * np.sqrt(6.0 / effective)
    odd = skewed or abs(kurtosis) > LIMITS.max_kurtosis + errors * np.sqrt(24.0 / effective)
    of_J = p.name in inertia_tensor.ELEMENTS
    holds = {
        "prior": p.verdict in ("prior", "weakly"),
        "posterior": differs,
        "truncated": unphysical > LIMITS.unphysical_share_named and of_J and (differs or odd),
        "odd": odd,
    }
    told = {"ratio": ratio, "shift": shift, "skewness": skewness, "kurtosis": kurtosis}
    says, told["percent"] = vocabulary("observability")["differs"], 100 * unphysical
    warnings = tuple(says[key].format(**told) for key, so in holds.items() if so)
    return PosteriorComparison(p.name, p.sd, sd, ratio, shift, skewness, kurtosis, warnings)


def _unphysical_share(observability: Observability) -> float:
    """Part of the predicted Gaussian of J that no body can have."""
    index = [observability.names.index(e) for e in inertia_tensor.ELEMENTS]
    mean = np.array([observability.parameters[i].value for i in index])
    covariance = observability.covariance[np.ix_(index, index)]
    drawn = np.random.default_rng(0).multivariate_normal(mean, covariance, 20_000, method="eigh")
    return float(1.0 - np.mean(inertia_tensor.is_physical(drawn)))
