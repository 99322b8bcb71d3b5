"""The limits of all gates, in one place: when residuals, chains and parameters count as good."""

from __future__ import annotations

# Nested R-hat of converged ensembles is below this (Margossian et al. 2024).
NESTED_RHAT_BELOW = 1.01
# Effective samples, bulk and tail, of the worst parameter.
ESS_AT_LEAST = 400.0
# Draws of every walker, in autocorrelation times.
AUTOCORRELATION_TIMES = 20.0
# p-value of residuals below which the model does not explain them. False alarms on perfect data:
# three channels, two tests each, in all about six per mille.
REJECT_BELOW = 1e-3
# J and K that lie further than this from their prior means [prior sd] are no result.
PRIOR_SD_AT_MOST = 5.0
# p-value of all of J and K together, were the truth a draw of the prior; below it neither.
PRIOR_P_VALUE_ABOVE = 1e-6
# The data have told something of a parameter once they have halved the prior variance: no gate,
# but said beside it.
OBSERVABLE_ABOVE = 0.5


def criteria() -> dict[str, float]:
    """The limits, as they are kept with every result.

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
        "prior_sd_at_most": PRIOR_SD_AT_MOST,
        "prior_p_value_above": PRIOR_P_VALUE_ABOVE,
        "observable_above": OBSERVABLE_ABOVE,
    }
