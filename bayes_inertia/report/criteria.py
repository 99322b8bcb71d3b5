"""The limits that a fit was judged by, read from its own summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_inertia.report.formatting import probability
from bayes_inertia.report.layout import LAYOUT


@dataclass(frozen=True)
class Criteria:
    """Criteria by which a result was trusted, and a parameter counted as determined."""

    nested_rhat_below: float = 1.01  # the ensembles agree below this nested R-hat
    effective_samples: float = 400.0  # wanted of every parameter, in the bulk and in the tails
    autocorrelation_times: float = 20.0  # how many of them the kept part of a chain must last
    # P-value below which the residuals of a channel are not what the model predicts.
    rejected_below: float = 1e-3
    prior_sd_at_most: float = 5.0  # how far J and K may lie from their prior means [prior sd]
    # P-value of all of J and K together, were the truth a draw of the prior.
    prior_p_value_above: float = 1e-6
    # Contraction of the prior variance above which the data told something of a parameter.
    observable_above: float = 0.5
    # Contraction from which the data, and not the prior, make the number.
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


def channel_verdict(fit: Mapping[str, Any], channel: str, criteria: Criteria) -> str:
    """One channel's residuals in words.

    `fit`: `fit` of summary.json: by channel `reduced_chi2`, its 99 % interval if the model is right
    (`interval_99`), and the p-value of no autocorrelation (`p_white`, None: not tested).
    `criteria`: from which p-value on the residuals are not white. Returns: "no data", "as
    predicted", "borderline", "smaller than the stated noise", "structured in time", "too large" or
    "too large and structured in time".

    Examples
    --------
    >>> fit = {"reduced_chi2": {"rate": 1.0}, "interval_99": {"rate": (0.9, 1.1)}}
    >>> channel_verdict(fit | {"p_white": {"rate": 0.5}}, "rate", Criteria())
    'as predicted'
    """
    reduced, interval = fit["reduced_chi2"][channel], fit["interval_99"][channel]
    p_white = fit["p_white"][channel]
    if reduced is None or interval is None:
        return "no data"
    coloured = p_white is not None and p_white < criteria.rejected_below
    slack = LAYOUT.interval_slack * (interval[1] - interval[0]) / 2.0
    if reduced > interval[1] + slack:
        return "too large" + (" and structured in time" if coloured else "")
    if coloured:
        return "structured in time"
    if reduced < interval[0] - slack:
        return "smaller than the stated noise"
    return "as predicted" if interval[0] <= reduced <= interval[1] else "borderline"


def whiteness_text(p_white: float | None, criteria: Criteria) -> str:
    """The test for white residuals in words.

    Examples
    --------
    >>> [whiteness_text(p, Criteria()) for p in (None, 0.0, 0.39)]
    ['not tested', 'no (p < 10⁻¹⁰⁰)', 'yes (p = 0.4)']
    """
    if p_white is None:
        return "not tested"
    return f"{'no' if p_white < criteria.rejected_below else 'yes'} ({probability(p_white)})"


def discount_text(discount: float) -> str:
    """Weight of one channel of one slew in the estimate.

    Examples
    --------
    >>> discount_text(1.0), discount_text(0.0026), discount_text(0.5)
    ('full', '1/385', '1/2.0')
    """
    if discount > 0.995:
        return "full"
    return f"1/{1.0 / discount:.1f}" if discount > 0.1 else f"1/{1.0 / discount:.0f}"
