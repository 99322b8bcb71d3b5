"""The sections of a fit's report, each a function of the posterior."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.criteria import Criteria, criteria_of
from bayes_inertia.report.dirt_wording import dirt_rows
from bayes_inertia.report.fit_verdict import fit_verdict
from bayes_inertia.report.formatting import (
    NOT_GIVEN,
    exponent,
    listed,
    number,
    typeset,
    unit_text,
)
from bayes_inertia.report.parameter_wording import averaged_over, correlation_sentences, meaning
from bayes_inertia.report.pictures.chains import draw_chains
from bayes_inertia.report.pictures.pairs import draw_pairs
from bayes_inertia.report.pictures.posterior_data import n_ensembles, n_slews, values_of
from bayes_inertia.report.pictures.priors import draw_priors
from bayes_inertia.report.residual_sections import (
    residuals_section,
    star_tracker_section,
    telemetry_section,
)
from bayes_inertia.report.section import Picture, Section, packaged
from bayes_inertia.report.signal_sections import signals_section
from bayes_inertia.report.uncertainty import (
    contraction,
    contraction_text,
    determination,
    interval_90,
    names_by_determination,
    quoted_sd,
)

_MOST_PARAMETERS_DRAWN = 16
_DRIVE_TEXT = {
    "commanded": "commanded: torque commands are the input",
    "measured": "measured: wheel momentum is the input",
}


def standard_sections(posterior: Posterior) -> list[Section]:
    """The sections of the report of a fit.

    To add a section of your own, append it to this list and hand the list to `write_report`.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    list of Section
        In reading order: verdict, parameters, what is determined, residuals, gates, limits,
        settings. What the fit does not have (no star tracker) is left out.
    """
    sections = (
        verdict_section(posterior),
        parameters_section(posterior),
        determination_section(posterior),
        residuals_section(posterior),
        telemetry_section(posterior),
        star_tracker_section(posterior),
        signals_section(posterior),
        dirt_section(posterior),
        gates_section(posterior),
        limits_section(posterior),
        settings_section(posterior),
    )
    return [section for section in sections if section is not None]


def verdict_section(posterior: Posterior) -> Section:
    """Can I trust it?

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section
        The verdict and its reasons.
    """
    verdict = fit_verdict(posterior.summary(), n_slews(posterior))
    return Section("Can I trust it?", packaged("verdict.html"), {"verdict": verdict})


def dirt_section(posterior: Posterior) -> Section | None:
    """What is wrong with the telemetry, and what was done about it.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section or None
        None where nothing is wrong.
    """
    rows = dirt_rows(posterior.attributes.get("dirt", []))
    return Section("Dirt in the telemetry", packaged("dirt.html"), {"rows": rows}) if rows else None


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
    rows = [
        _parameter_row(name, row, float(center), criteria)
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
    )
    context = {
        "rows": rows,
        "moments": [_value_cells(name, row) for name, row in summary["derived"].items()],
        "averaged": averaged_over(summary),
        "criteria": criteria,
    }
    return Section("Parameters", packaged("parameters.html"), context, (picture,))


def _value_cells(name: str, row: Mapping[str, Any]) -> dict[str, str]:
    """Mean and both sds of one row, in one power of ten."""
    quoted = quoted_sd(row["sd"], row["robust_sd"])
    power = exponent(row["mean"], quoted.sd)
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
    name: str, row: Mapping[str, Any], prior_mean: float, criteria: Criteria
) -> dict[str, str]:
    quoted = quoted_sd(row["sd"], row["robust_sd"])
    power = exponent(row["mean"], quoted.sd)
    low, high = (number(end, quoted.sd, power) for end in interval_90(row))
    prior, prior_sd = (number(x, row["prior_sd"], power) for x in (prior_mean, row["prior_sd"]))
    share = contraction(quoted.sd, row["prior_sd"])
    return _value_cells(name, row) | {
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
        f"{dashed if robust else ''} Each cell shows the range given on the left. "
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


def gates_section(posterior: Posterior) -> Section:
    """The gates and the state of the sampler.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section
        Two tables and one picture.
    """
    attributes, criteria = posterior.attributes, criteria_of(posterior.attributes)
    diagnostics = attributes["diagnostics"]
    kept = (diagnostics["steps"] - diagnostics["discarded"]) / max(diagnostics["tau_max"], 1e-9)
    rhat, effective = diagnostics["nested_rhat_max"], f"at least {criteria.effective_samples:g}"
    numbers = [
        (
            "nested R-hat, worst parameter",
            f"{rhat:.4f}",
            f"below {criteria.nested_rhat_below:g}",
        ),
        ("effective samples, bulk", f"{diagnostics['ess_bulk_min']:,.0f}", effective),
        ("effective samples, tails", f"{diagnostics['ess_tail_min']:,.0f}", effective),
        (
            "steps kept per autocorrelation time",
            f"{kept:.0f}",
            f"at least {criteria.autocorrelation_times:g}",
        ),
    ]
    for_information = [
        ("acceptance", f"{diagnostics['acceptance']:.2f}"),
        ("posterior evaluations", f"{diagnostics['evaluations']:,}"),
        ("effective samples per evaluation", f"{diagnostics['ess_per_evaluation']:.2f}"),
    ]
    numbers += [(name, value, "for information") for name, value in for_information]
    gates = [gate | {"says": typeset(gate["says"])} for gate in attributes["gates"]]
    context = {"gates": gates, "numbers": numbers}
    picture = Picture(
        draw_chains(posterior, criteria),
        "The parameter whose independent ensembles agree least. "
        "Left: mean of each ensemble's walkers (line) and the range of 90 % of them (band), "
        "step by step: bands on top of each other, without drift. "
        "Middle: how each ensemble's draws rank among all draws; the grey band holds 99 % "
        "of the steps if all ensembles sample the same distribution. Right: log posterior.",
        "Traces and rank histograms of the ensembles",
        dense=True,
    )
    return Section("Gates", packaged("gates.html"), context, (picture,))


def limits_section(posterior: Posterior) -> Section:
    """What no fit of this campaign can tell, whatever its numbers say.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section
        A list of sentences.
    """
    attributes, predicted = posterior.attributes, posterior.tree["posterior_predictive"]
    context = {
        "drive": attributes["drive"],
        "effects": attributes["effects"],
        "channels": [c for c in ("attitude", "momentum") if c in predicted],
        "wheels": attributes.get("wheels", 3),
        "n_slews": n_slews(posterior),
    }
    return Section("Limits", packaged("limits.html"), context)


def settings_section(posterior: Posterior) -> Section:
    """How to make the same result again.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section
        One table.
    """
    attributes, chains = posterior.attributes, posterior.tree["posterior"].sizes["chain"]
    diagnostics, ensembles = attributes["diagnostics"], n_ensembles(posterior)
    versions = (f"{name} {version}" for name, version in attributes["versions"].items())
    rows = [
        ("campaign", attributes["campaign"]),
        ("campaign digest (SHA-256)", attributes["campaign_sha256"] or "not recorded"),
        (
            "slews, data",
            f"{n_slews(posterior)} slews, {attributes['fit']['n_data']:,} numbers",
        ),
        ("drive", _DRIVE_TEXT[attributes["drive"]]),
        ("effects fitted along", listed(attributes["effects"]) or "none"),
        ("seed", attributes["seed"]),
        (
            "sampler",
            f"{ensembles} ensembles of {chains // ensembles} walkers, "
            f"{diagnostics['steps']} steps, the first {diagnostics['discarded']} discarded",
        ),
        ("versions", ", ".join(versions)),
    ]
    return Section("Settings", packaged("settings.html"), {"rows": rows})
