"""The limits that a fit was judged by, read from its own summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Criteria:
    """What had to hold for a result to be trusted, and for a parameter to count as determined.

    Parameters
    ----------
    nested_rhat_below : float
        The ensembles agree below this nested R-hat.
    effective_samples : float
        Wanted of every parameter, in the bulk and in the tails.
    autocorrelation_times : float
        How many of them the kept part of a chain must last.
    rejected_below : float
        p-value below which the residuals of a channel are not what the model predicts.
    prior_sd_at_most : float
        How far J and K may lie from their prior means [prior sd].
    prior_p_value_above : float
        p-value of all of J and K together, were the truth a draw of the prior.
    observable_above : float
        Contraction of the prior variance above which the data told something of a parameter.
    determined_above : float
        Contraction from which the data, and not the prior, make the number.
    """

    nested_rhat_below: float = 1.01
    effective_samples: float = 400.0
    autocorrelation_times: float = 20.0
    rejected_below: float = 1e-3
    prior_sd_at_most: float = 5.0
    prior_p_value_above: float = 1e-6
    observable_above: float = 0.5
    determined_above: float = 0.9


def criteria_of(summary: Mapping[str, Any]) -> Criteria:
    """The limits that stand in a summary.

    `summary`: the content of summary.json, or the attributes of a posterior. Returns: files of
    version 0.1 do not state their limits: they were the defaults here.

    Examples
    --------
    >>> criteria_of({"criteria": {"rejected_below": 1e-4}}).rejected_below
    0.0001
    """
    return Criteria(**summary.get("criteria", {}))
