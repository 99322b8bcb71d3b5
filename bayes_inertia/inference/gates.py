"""What must hold before the numbers of a fit are used: all gates, their limits, and their words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayes_inertia.inference.fit_context import FitContext

if TYPE_CHECKING:
    from bayes_inertia.inference.convergence import Diagnostics
    from bayes_inertia.inference.laplace import Estimate

# Nested R-hat of converged ensembles is below this (Margossian et al. 2024).
NESTED_RHAT_BELOW = 1.01
# Effective samples, bulk and tail, of the worst parameter.
ESS_AT_LEAST = 400.0
# Draws of every walker, in autocorrelation times.
AUTOCORRELATION_TIMES = 20.0
# p-value of residuals below which the model does not explain them. False alarms on perfect data:
# three channels, two tests each, in all about six per mille.
REJECT_BELOW = 1e-3
# The data have told something of a parameter once they have halved the prior variance: no gate,
# but said beside it.
OBSERVABLE_ABOVE = 0.5

_UNKNOWN_NOTE = (
    "the diagnosis found that something is missing which no candidate explains: "
    "it may shift J and K by more than any sd"
)


def criteria() -> dict[str, float]:
    """The limits, as they are kept with every result.

    Returns
    -------
    dict of float

    Examples
    --------
    >>> criteria()["nested_rhat_below"]
    1.01
    """
    return {
        "nested_rhat_below": NESTED_RHAT_BELOW,
        "effective_samples": ESS_AT_LEAST,
        "autocorrelation_times": AUTOCORRELATION_TIMES,
        "rejected_below": REJECT_BELOW,
        "observable_above": OBSERVABLE_ABOVE,
    }


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
