"""The quoted uncertainty in print, and how far it says that a parameter is determined.

Which one is quoted is decided once, in `Posterior.summary`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bayes_inertia.report.criteria import Criteria
from bayes_inertia.report.formatting import common_exponents


def sd_in_print(row: Mapping[str, Any]) -> float:
    """The sd that decides digits and widths: the quoted one, or the draws' where none is quoted.

    Examples
    --------
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
    values: dict[str, tuple[str, float, float]] = {}
    for rows in tables:
        for name, row in rows.items():
            sd = sd_in_print(row)
            _, mean, largest = values.get(name, ("", 0.0, 0.0))
            values[name] = (row["unit"], max(abs(row["mean"]), mean), max(sd, largest))
    return common_exponents(values)


def contraction(sd: float, prior_sd: float) -> float:
    """Share of the prior variance that the data removed.

    Examples
    --------
    >>> contraction(0.5, 1.0), contraction(1.2, 1.0)
    (0.75, 0.0)
    """
    return max(0.0, 1.0 - (sd / prior_sd) ** 2)


def contraction_text(share: float, criteria: Criteria) -> str:
    """Contraction in print, rounded down: it never seems to reach a threshold that it misses.

    Examples
    --------
    >>> [contraction_text(share, Criteria()) for share in (0.9999977, 0.541, 0.98765)]
    ['> 0.9999', '0.54', '0.987']
    """
    if share > 0.9999:
        return "> 0.9999"
    decimals = 2 if share < criteria.determined_above else 3 if share < 0.99 else 4
    return f"{math.floor(share * 10**decimals) / 10**decimals:.{decimals}f}"


def determination(share: float, criteria: Criteria) -> str:
    """Degree to which the campaign determines a parameter.

    Examples
    --------
    >>> [determination(share, Criteria()) for share in (0.99, 0.6, 0.2)]
    ['determined', 'partly determined', 'not determined']
    """
    if share >= criteria.determined_above:
        return "determined"
    return "partly determined" if share > criteria.observable_above else "not determined"


def determination_of(row: Mapping[str, Any], criteria: Criteria) -> str:
    """Degree of determination, by the sd; none of J where nothing ties its size."""
    share = contraction(sd_in_print(row), row["prior_sd"])
    if share > criteria.observable_above and not row.get("observable", True):
        return "not determined"
    return determination(share, criteria)


def names_by_determination(rows: Mapping[str, Any], criteria: Criteria) -> dict[str, list[str]]:
    """Names of parameters by how far they are determined.

    Returns: one list, which may be empty, for each answer of `determination`.
    """
    names: dict[str, list[str]] = {
        "determined": [],
        "partly determined": [],
        "not determined": [],
    }
    for name, row in rows.items():
        names[determination_of(row, criteria)].append(name)
    return names


def interval_90(row: Mapping[str, Any]) -> tuple[float, float] | None:
    """The 90 % interval that belongs to the quoted sd: the draws', widened about their median.

    Returns: in the parameter's unit; None where no sd is quoted.

    Examples
    --------
    >>> interval_90({"q05": -1.6, "q50": 0.0, "q95": 1.7, "sd": 1.0, "quoted_sd": 2.0})
    (-3.2, 3.4)
    """
    if row["quoted_sd"] is None:
        return None
    factor = row["quoted_sd"] / row["sd"] if row["sd"] > 0 else 1.0
    median = row["q50"]
    return median + factor * (row["q05"] - median), median + factor * (row["q95"] - median)
