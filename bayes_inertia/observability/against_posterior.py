"""The Fisher prediction beside the emcee posterior, and a warning wherever they differ and why."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from bayes_inertia.errors import EstimateError
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.physical_draws import are_physical
from bayes_inertia.observability.result import Observability

# Differences are reported above this and above four times their Monte Carlo error.
_SD, _SHIFT, _SKEW, _KURTOSIS = 0.05, 0.1, 0.2, 0.5
_TRUNCATED = 1e-3


@dataclass(frozen=True)
class Comparison:
    """One parameter: `predicted_sd` (Fisher with priors) and `posterior_sd` (emcee), their `ratio` posterior over predicted,
    `shift` of the posterior's mean from the optimum [predicted sd], `skewness`, `kurtosis` (0 for a Gaussian), `warnings`."""

    name: str
    predicted_sd: float
    posterior_sd: float
    ratio: float
    shift: float
    skewness: float
    kurtosis: float
    warnings: tuple[str, ...]


def compare_with_posterior(found: Observability, posterior: Posterior) -> tuple[Comparison, ...]:
    """Predicted and sampled uncertainty side by side.

    Raises
    ------
    EstimateError : the posterior is of other parameters.
    """
    if list(found.names) != posterior.names:
        raise EstimateError(
            "the posterior is of other parameters",
            where=", ".join(sorted(set(found.names) ^ set(posterior.names))),
            advice="fit again",
        )
    effective = max(float(posterior.attributes["diagnostics"]["ess_bulk_min"]), 4.0)
    cut = _unphysical(found)
    return tuple(
        _compare(found, i, posterior.samples[:, i], effective, cut) for i in range(len(found.names))
    )


def as_json(rows: tuple[Comparison, ...]) -> dict[str, dict[str, Any]]:
    """{parameter: its comparison} for observability.json."""
    return {
        row.name: {
            **{k: v for k, v in asdict(row).items() if k != "name"},
            "warnings": list(row.warnings),
        }
        for row in rows
    }


def _compare(
    found: Observability, i: int, draws: np.ndarray, effective: float, cut: float
) -> Comparison:
    p = found.parameters[i]
    sd = float(draws.std(ddof=1))
    shift, ratio = float((draws.mean() - p.value) / p.sd), sd / p.sd
    skewness, kurtosis = float(stats.skew(draws)), float(stats.kurtosis(draws))
    differs = abs(np.log(ratio)) > _SD + 4.0 / np.sqrt(2.0 * effective) or abs(
        shift
    ) > _SHIFT + 4.0 / np.sqrt(effective)
    odd = abs(skewness) > _SKEW + 4.0 * np.sqrt(6.0 / effective) or abs(
        kurtosis
    ) > _KURTOSIS + 4.0 * np.sqrt(24.0 / effective)
    warnings = []
    if p.verdict in ("prior", "weakly"):
        warnings.append("prior-dominated: both numbers say mostly what was known before")
    if differs:
        warnings.append(
            f"the posterior differs from the prediction: sd {ratio:.3g} times, mean moved by {shift:+.2g} predicted sd; use the posterior's"
        )
    if cut > _TRUNCATED and p.name in inertia_tensor.ELEMENTS and (differs or odd):
        warnings.append(
            f"truncated by physics: {100 * cut:.2g} % of the predicted Gaussian are tensors that no body has"
        )
    if odd:
        warnings.append(
            f"non-Gaussian: skewness {skewness:+.2g}, excess kurtosis {kurtosis:+.2g}; quote quantiles, not an sd"
        )
    return Comparison(p.name, p.sd, sd, ratio, shift, skewness, kurtosis, tuple(warnings))


def _unphysical(found: Observability, draws: int = 20_000) -> float:
    """Part of the predicted Gaussian of J that no body can have."""
    names = list(found.names)
    index = [names.index(e) for e in inertia_tensor.ELEMENTS]
    mean = np.array([found.parameters[i].value for i in index])
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(
        mean, found.covariance[np.ix_(index, index)], draws, method="eigh"
    )
    return float(1.0 - np.mean(are_physical(drawn)))
