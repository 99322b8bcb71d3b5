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
    sd_in_print,
)

_MOST_PARAMETERS_DRAWN = 16


def parameters_section(posterior: Posterior) -> Section:
    """The table of parameters and principal moments, prior against posterior.

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
    powers = exponents_of(summary["parameters"] | summary["derived"])
    rows = [
        _parameter_row(name, row, powers[name], float(center), criteria)
        for (name, row), center in zip(summary["parameters"].items(), prior_mean, strict=True)
    ]
    picture = Picture(
        draw_priors(posterior),
        "Posterior of each parameter (blue). Bars below: mean ± the model's sd and, "
        "where it is wider, ± the quoted sd. "
        "Where the data sharpen the prior more than eightfold, the panel shows only the posterior, "
        "and the grey strip above it shows the prior over ±3 sd "
        "with the posterior's place as a blue mark; elsewhere prior and posterior share the axis.",
        "Prior and posterior densities of every parameter",
        folded=True,
    )
    context = {
        "rows": rows,
        "moments": [
            _value_cells(name, row, powers[name]) for name, row in summary["derived"].items()
        ],
        "trusted": posterior.trusted,
        "quoted": posterior.quoted_factor is not None,
        "factor": posterior.quoted_factor or 1.0,
        "averaged": averaged_over(summary),
        "criteria": criteria,
    }
    return Section("Parameters", packaged("parameters.html"), context, (picture,))


def _value_cells(name: str, row: Mapping[str, Any], power: int) -> dict[str, str]:
    """Mean, quoted sd and the model's sd of one row, in one power of ten."""
    quoted, sd = row["quoted_sd"], sd_in_print(row)
    interval = interval_90(row) if "q05" in row else None
    ends = [number(end, sd, power) for end in interval or ()]
    return {
        "name": name,
        "mean": number(row["mean"], sd, power),
        "interval": " … ".join(ends) or (NOT_GIVEN if "q05" in row else ""),
        "quoted_sd": NOT_GIVEN if quoted is None else number(quoted, quoted, power),
        "sd": number(row["sd"], row["sd"], power),
        "unit": unit_text(row["unit"], power),
    }


def _parameter_row(
    name: str, row: Mapping[str, Any], power: int, prior_mean: float, criteria: Criteria
) -> dict[str, str]:
    prior, prior_sd = (number(x, row["prior_sd"], power) for x in (prior_mean, row["prior_sd"]))
    share = contraction(sd_in_print(row), row["prior_sd"])
    return _value_cells(name, row, power) | {
        "meaning": meaning(name),
        "prior": f"{prior} ± {prior_sd}",
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
    only_some = (
        f" Only the {_MOST_PARAMETERS_DRAWN} most correlated of {len(names)} parameters are drawn."
    )
    picture = Picture(
        draw_pairs(posterior, _MOST_PARAMETERS_DRAWN),
        "Every pair of parameters: posterior draws (shading) with the ellipse that holds 90 % "
        "of a normal distribution of the same covariance (blue)."
        " At the left of each row: middle ± half width of "
        "its cells (3.4 sd), and the unit. "
        "Numbers: correlations, framed beyond ±0.9."
        f"{only_some if len(names) > _MOST_PARAMETERS_DRAWN else ''}",
        "Pair plot of the posterior with correlations",
        folded=True,
    )
    context = {
        "groups": names_by_determination(rows, criteria_of(posterior.attributes)),
        "correlations": correlation_sentences(names, matrix),
        "listed": listed,
    }
    title = "What this campaign determines"
    return Section(title, packaged("determination.html"), context, (picture,))
