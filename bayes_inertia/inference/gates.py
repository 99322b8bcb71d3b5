"""What must hold before the numbers of a fit are used: all gates, their limits, and their words."""

from __future__ import annotations

from typing import Any

from bayes_inertia.inference.convergence import Diagnostics
from bayes_inertia.inference.fit_context import FitContext
from bayes_inertia.inference.gate_limits import (
    AUTOCORRELATION_TIMES,
    ESS_AT_LEAST,
    NESTED_RHAT_BELOW,
)
from bayes_inertia.inference.laplace import Estimate

_UNKNOWN_NOTE = (
    "the diagnosis found that something is missing which no candidate explains: "
    "it may shift J and K by more than any sd"
)


def check_gates(
    estimate: Estimate, diagnostics: Diagnostics, context: FitContext | None = None
) -> list[dict[str, Any]]:
    """Judge a fit.

    Parameters
    ----------
    estimate : Estimate
        Its residuals are judged.
    diagnostics : Diagnostics
        Of the samples.
    context : FitContext, optional
        What a diagnosis said before: the noise that was taken, and whether something stayed
        unknown.

    Returns
    -------
    list of dict
        One a gate: its `name`, whether it is `passed`, and what it `says`, in plain words.
    """
    context = context or FitContext()
    gates = [_converged(diagnostics), _explained(estimate, context)]
    if context.verdict == "unknown":
        gates.append({"name": "diagnosed", "passed": False, "says": _UNKNOWN_NOTE})
    return gates


def _converged(diagnostics: Diagnostics) -> dict[str, Any]:
    """Whether the ensembles agree and are long enough."""
    passed = diagnostics.converged
    draws = diagnostics.steps - diagnostics.discarded
    length = draws / max(diagnostics.tau_max, 1.0)
    effective = min(diagnostics.ess_bulk_min, diagnostics.ess_tail_min)
    says = (
        f"the ensembles {'agree' if passed else 'have not converged'}: "
        f"nested R-hat {diagnostics.nested_rhat_max:.4f} (below {NESTED_RHAT_BELOW}), "
        f"effective samples {effective:.0f} (at least {ESS_AT_LEAST:.0f}), "
        f"chains {length:.0f} autocorrelation times long (at least {AUTOCORRELATION_TIMES:.0f})"
    )
    return {"name": "converged", "passed": passed, "says": says}


def _explained(estimate: Estimate, context: FitContext) -> dict[str, Any]:
    """Whether the residuals are what the model and the noise that was taken predict."""
    tests, noise = estimate.tests, _noise_in_words(context)
    large = [name for name, test in tests.items() if test.too_large]
    small = [name for name, test in tests.items() if test.rejected and not test.too_large]
    says = f"the residuals are what the model and {noise} predict"
    if small:
        says = (
            f"the residuals are smaller than {noise} predicts, in {', '.join(small)}: "
            "the uncertainties are too cautious"
        )
    if large:
        sizes = [f"{name} (reduced chi^2 {tests[name].reduced_chi2:.3g})" for name in large]
        robust = "use robust_sd, " if len(estimate.model.campaign.slews) > 1 else ""
        says = (
            f"the model does not explain the data: {', '.join(sizes)}; {robust}"
            "look for the missing effect with `diagnose`, and do not read sd as the uncertainty"
        )
    return {"name": "explained", "passed": not large, "says": says}


def _noise_in_words(context: FitContext) -> str:
    """The noise that the fit took."""
    factors = context.measured_noise or {}
    louder = [f"{channel} {factor:.2f}" for channel, factor in factors.items() if factor > 1.0]
    if not louder:
        return "the stated noise"
    return (
        f"the noise that was measured (times what is stated: {', '.join(louder)}; "
        "of its loudest axis)"
    )
