"""The sections of a fit on its parameters: the tables, and what the campaign determines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.criteria import Criteria, criteria_of
from bayes_inertia.report.formatting import NOT_GIVEN, listed, number, unit_text
from bayes_inertia.report.parameter_wording import averaged_over, correlation_sentences, meaning
from bayes_inertia.report.pictures.pairs import draw_pairs
from bayes_inertia.report.pictures.posterior_data import values_of
from bayes_inertia.report.pictures.priors import draw_priors
from bayes_inertia.report.section import Picture, Section, packaged
from bayes_inertia.report.uncertainty import (
    contraction,
    contraction_text,
    determination,
    exponents_of,
    interval_90,
    names_by_determination,
    quoted_sd,
)

_MOST_PARAMETERS_DRAWN = 16


def parameters_section(posterior: Posterior) -> Section:
    """The headline table, the principal moments, prior against posterior.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section
        With one picture.
    """
    summary, criteria = posterior.summary(), criteria_of(posterior.attributes)
    prior_mean = values_of(posterior, "estimate", "prior_mean")
    powers = exponents_of(summary["parameters"])
    rows = [
        _parameter_row(name, row, powers[name], float(center), criteria)
        for (name, row), center in zip(summary["parameters"].items(), prior_mean, strict=True)
    ]
    picture = Picture(
        draw_priors(posterior),
        "Posterior of each parameter (blue). Bars below: mean ± sd of the model and, "
        "where there are enough slews, ± robust sd, which is what the slews themselves support. "
        "Where the data sharpen the prior more than eightfold, the panel shows only the posterior, "
        "and the grey strip above it shows the prior over ±3 sd "
        "with the posterior's place as a blue mark; elsewhere prior and posterior share the axis.",
        "Prior and posterior densities of every parameter",
        dense=True,
    )
    derived = summary["derived"]
    moments = exponents_of(derived)
    context = {
        "rows": rows,
        "moments": [_value_cells(name, row, moments[name]) for name, row in derived.items()],
        "averaged": averaged_over(summary),
        "criteria": criteria,
    }
    return Section("Parameters", packaged("parameters.html"), context, (picture,))


def _value_cells(name: str, row: Mapping[str, Any], power: int) -> dict[str, str]:
    """Mean and both sds of one row, in one power of ten."""
    quoted = quoted_sd(row["sd"], row["robust_sd"])
    robust = row["robust_sd"]
    return {
        "name": name,
        "mean": number(row["mean"], quoted.sd, power),
        "sd": number(row["sd"], row["sd"], power),
        "robust_sd": NOT_GIVEN if robust is None else number(robust, robust, power),
        "source": quoted.source,
        "unit": unit_text(row["unit"], power),
    }


def _parameter_row(
    name: str, row: Mapping[str, Any], power: int, prior_mean: float, criteria: Criteria
) -> dict[str, str]:
    quoted = quoted_sd(row["sd"], row["robust_sd"])
    low, high = (number(end, quoted.sd, power) for end in interval_90(row))
    prior, prior_sd = (number(x, row["prior_sd"], power) for x in (prior_mean, row["prior_sd"]))
    share = contraction(quoted.sd, row["prior_sd"])
    return _value_cells(name, row, power) | {
        "meaning": meaning(name),
        "prior": f"{prior} ± {prior_sd}",
        "interval": f"{low} … {high}",
        "contraction": contraction_text(share, criteria),
        "determined": determination(share, criteria),
    }


def determination_section(posterior: Posterior) -> Section:
    """What the campaign determines, in words, and the pair plot.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section
        With one picture.
    """
    rows, names = posterior.summary()["parameters"], posterior.names
    matrix = np.atleast_2d(np.corrcoef(posterior.samples.T)).tolist()
    robust = not posterior.trusted and any(row["robust_sd"] is not None for row in rows.values())
    dashed = (
        " Dashed orange: the same from the robust covariance, because the result is not trusted."
    )
    only_some = (
        f" Only the {_MOST_PARAMETERS_DRAWN} most correlated of {len(names)} parameters are drawn."
    )
    picture = Picture(
        draw_pairs(posterior, _MOST_PARAMETERS_DRAWN),
        "Every pair of parameters: posterior draws (shading) with the ellipse that holds 90 % "
        "of a normal distribution of the same covariance (blue)."
        f"{dashed if robust else ''} At the left of each row: middle ± half width of "
        "its cells (3.4 sd), and the unit. "
        "Numbers: correlations, framed beyond ±0.9."
        f"{only_some if len(names) > _MOST_PARAMETERS_DRAWN else ''}",
        "Pair plot of the posterior with correlations",
        dense=True,
    )
    context = {
        "groups": names_by_determination(rows, criteria_of(posterior.attributes)),
        "correlations": correlation_sentences(names, matrix),
        "listed": listed,
    }
    title = "What this campaign determines"
    return Section(title, packaged("determination.html"), context, (picture,))
