"""What the residuals of a fit show, channel by channel, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.report.criteria import Criteria
from bayes_inertia.report.formatting import probability

# Just outside a 99 % interval happens once in a hundred; gates reject at one in a thousand.
# The interval is widened by this share of its half width before anything is called wrong.
_INTERVAL_SLACK = 0.28


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
    slack = _INTERVAL_SLACK * (interval[1] - interval[0]) / 2.0
    if reduced > interval[1] + slack:
        return "too large" + (" and structured in time" if coloured else "")
    if coloured:
        return "structured in time"
    if reduced < interval[0] - slack:
        return "smaller than the stated noise"
    return "as predicted" if interval[0] <= reduced <= interval[1] else "borderline"


def whiteness_text(p_white: float | None, criteria: Criteria) -> str:
    """The test for white residuals in words.

    `p_white`: its p-value; None where it could not be made. `criteria`: from which p-value on the
    residuals are not white.

    Examples
    --------
    >>> [whiteness_text(p, Criteria()) for p in (None, 0.0, 0.39)]
    ['not tested', 'no (p < 10⁻¹⁰⁰)', 'yes (p = 0.4)']
    """
    if p_white is None:
        return "not tested"
    return f"{'no' if p_white < criteria.rejected_below else 'yes'} ({probability(p_white)})"


def discount_text(discount: float) -> str:
    """How much one channel of one slew counts in the estimate.

    Examples
    --------
    >>> discount_text(1.0), discount_text(0.0026), discount_text(0.5)
    ('full', '1/385', '1/2.0')
    """
    if discount > 0.995:
        return "full"
    return f"1/{1.0 / discount:.1f}" if discount > 0.1 else f"1/{1.0 / discount:.0f}"
