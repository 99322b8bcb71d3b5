"""Limits by which parameters are called determined, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Fields by the file that reads them."""

    # `against_posterior.py`
    # A difference is reported above its limit plus four times its Monte Carlo error.
    max_log_sd_ratio: float = 0.05
    max_shift: float = 0.1  # [predicted sd]
    max_skewness: float = 0.2
    max_kurtosis: float = 0.5
    monte_carlo_errors: float = 4.0
    # Part of the predicted Gaussian that no body can have, above which it is named.
    unphysical_share_named: float = 1e-3

    # `analysis.py`
    max_partners: int = 3  # correlated parameters that are listed

    # `degeneracy.py`
    # A direction with less than this part of the typical information counts as exactly degenerate.
    exact_below: float = 1e-6
    # An axis counts as not turned about when its rms rate is below this part of the main axis's, or
    # below the noise.
    min_turned_rate_ratio: float = 0.02

    # `result.py`
    told_share: float = 0.005  # of what is known, from which a slew is named: less prints as 0 %
    # Contraction of the prior variance: below, the answer is the prior; above, the data's.
    prior_below: float = 0.05
    determined_above: float = 0.9
    windows_per_slew: int = 24  # of each slew, in which information is summed

    # `sentences.py`
    # ratio of sds from which the worth of the commands is mentioned
    mentioned_sd_ratio: float = 1.2
    lost_variance_inflation: float = 1.21  # variance inflation from which something is called lost
    most_groups: int = 3
    carried: float = 0.5  # share of what is known from which one slew is said to carry a parameter


LIMITS = Limits()
