"""The limits that a fit was judged by, the sd that is printed, and how far it determines.

Which sd is quoted is decided once, in `Posterior.summary`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_inertia.maths.robust_scale import sd_of_interval
from bayes_inertia.report.formatting import common_exponents, kind_of, probability
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

    >>> [whiteness_text(p, Criteria()) for p in (None, 0.0, 0.39)]
    ['not tested', 'no (p < 10⁻¹⁰⁰)', 'yes (p = 0.4)']
    """
    if p_white is None:
        return "not tested"
    return f"{'no' if p_white < criteria.rejected_below else 'yes'} ({probability(p_white)})"


def discount_text(discount: float) -> str:
    """Weight of one channel of one slew in the estimate.

    >>> discount_text(0.96), discount_text(0.0026), discount_text(0.5)
    ('full', '1/385', '1/2.0')
    """
    if discount > 1.0 / 1.05:  # less would print as 1/1.0
        return "full"
    return f"1/{1.0 / discount:.1f}" if discount > 0.1 else f"1/{1.0 / discount:.0f}"


def sd_in_print(row: Mapping[str, Any]) -> float:
    """The sd that decides digits and widths: the quoted one, or the draws' where none is quoted.

    >>> sd_in_print({"sd": 1.0, "quoted_sd": 1.1}), sd_in_print({"sd": 1.0, "quoted_sd": None})
    (1.1, 1.0)
    """
    return row["sd"] if row["quoted_sd"] is None else row["quoted_sd"]


def ratios_told(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Rows of J over its trace and of principal ratios; none where something ties the size of J."""
    return dict(summary["ratios"]) if summary.get("scale_of_J") == [] else {}


def exponents_of(*tables: Mapping[str, Mapping[str, Any]]) -> dict[str, int]:
    """Powers of ten that rows of summaries are printed in, one for all parameters of a kind.

    `*tables`: rows of `parameters` or `derived` of one or more summaries that share a table.
    """
    rows = (named for table in tables for named in table.items())
    return common_exponents((name, r["unit"], r["mean"], sd_in_print(r)) for name, r in rows)


def contraction(row: Mapping[str, Any]) -> float:
    """Share of the prior variance that the data removed, by the sd in print.

    >>> contraction({"sd": 0.4, "quoted_sd": 0.5, "prior_sd": 1.0, "contraction": 0.84})
    0.75
    >>> contraction({"sd": 1.2, "quoted_sd": None, "prior_sd": 1.0})
    0.0
    """
    return max(0.0, 1.0 - sharpened(row) ** -2)


def sharpened(row: Mapping[str, Any]) -> float:
    """How many times smaller the sd in print is than the prior's; of logarithms where the prior is.

    >>> round(sharpened({"sd": 29.0, "quoted_sd": 58.0, "prior_sd": 7.8, "contraction": 0.75}), 9)
    1.0
    """
    left = 1.0 - row["contraction"] if "contraction" in row else (row["sd"] / row["prior_sd"]) ** 2
    return max(left, sys.float_info.epsilon) ** -0.5 * row["sd"] / sd_in_print(row)


def contraction_text(share: float, criteria: Criteria) -> str:
    """Contraction in print, rounded down: it never seems to reach a threshold that it misses.

    >>> [contraction_text(share, Criteria()) for share in (0.9999977, 0.541, 0.98765)]
    ['> 0.9999', '0.54', '0.987']
    """
    if share > 0.9999:
        return "> 0.9999"
    decimals = 2 if share < criteria.determined_above else 3 if share < 0.99 else 4
    return f"{math.floor(share * 10**decimals) / 10**decimals:.{decimals}f}"


def determination(share: float, criteria: Criteria) -> str:
    """Degree to which the campaign determines a parameter.

    >>> [determination(share, Criteria()) for share in (0.99, 0.6, 0.2)]
    ['determined', 'partly determined', 'not determined']
    """
    if share >= criteria.determined_above:
        return "determined"
    return "partly determined" if share > criteria.observable_above else "not determined"


def determination_of(row: Mapping[str, Any], criteria: Criteria) -> str:
    """Degree of determination, by the sd; none of J where nothing ties its size."""
    share = contraction(row)
    if share > criteria.observable_above and not row.get("observable", True):
        return "not determined"
    return determination(share, criteria)


def names_by_determination(rows: Mapping[str, Any], criteria: Criteria) -> dict[str, list[str]]:
    """Names of parameters by how far they are determined."""
    names: dict[str, list[str]] = {"determined": [], "partly determined": [], "not determined": []}
    for name, row in rows.items():
        names[determination_of(row, criteria)].append(name)
    return names


def relative_sd(row: Mapping[str, Any]) -> float:
    """The sd in print over the size of the mean."""
    return sd_in_print(row) / abs(row["mean"]) if row["mean"] else math.inf


def scale_factors(summary: Mapping[str, Any]) -> dict[str, list[str]]:
    """Names of the scale factors by the symbol of their rate sensor: "K", "K of mems"."""
    names: dict[str, list[str]] = {}
    for name in summary["parameters"]:
        sensor, _, parameter = name.rpartition(".")
        if kind_of(parameter) == "K" and sensor not in summary["effects"]:
            names.setdefault(f"K of {sensor}" if sensor else "K", []).append(name)
    return names


def worst_rows(summary: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """The rows of the moment, product of inertia and each sensor's K that are known worst, of those
    that are.
    """
    rows, criteria = summary["parameters"], criteria_of(summary)
    known = {n: r for n, r in rows.items() if determination_of(r, criteria) != "not determined"}
    groups = {
        "J": [name for name in known if kind_of(name) == "moment of inertia"],
        "products of inertia": [name for name in known if kind_of(name) == "product of inertia"],
        **{symbol: [n for n in ns if n in known] for symbol, ns in scale_factors(summary).items()},
    }
    size = {"products of inertia": sd_in_print}
    return {
        label: max((known[name] for name in names), key=size.get(label, relative_sd))
        for label, names in groups.items()
        if names
    }


def interval_90(row: Mapping[str, Any]) -> tuple[float, float] | None:
    """The 90 % interval that belongs to the quoted sd: the draws', widened about their median.

    These are of what may be true, and so is the quoted sd: what the model alone says is no measure.

    >>> low, high = interval_90({"q05": -3.0, "q50": 0.0, "q95": 3.58, "sd": 1.0, "quoted_sd": 4.0})
    >>> round(low, 2), round(high, 2)
    (-6.0, 7.16)
    """
    if row["quoted_sd"] is None:
        return None
    low, median, high = row["q05"], row["q50"], row["q95"]
    factor = row["quoted_sd"] / sd_of_interval(low, high) if high > low else 1.0
    return median + factor * (low - median), median + factor * (high - median)
