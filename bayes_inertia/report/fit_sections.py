"""The sections of a run's report, each a function of the posterior."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.diagnosis_sections import diagnosis_sections
from bayes_inertia.report.dirt_wording import dirt_rows
from bayes_inertia.report.formatting import typeset
from bayes_inertia.report.parameter_sections import determination_section, parameters_section
from bayes_inertia.report.pictures.chains import draw_chains
from bayes_inertia.report.pictures.posterior_data import n_slews
from bayes_inertia.report.residual_sections import (
    residuals_section,
    telemetry_section,
)
from bayes_inertia.report.result_section import result_sections
from bayes_inertia.report.section import Picture, Section, packaged
from bayes_inertia.report.settings_section import settings_section
from bayes_inertia.report.signal_sections import signals_section


def standard_sections(
    posterior: Posterior,
    diagnosis: Mapping[str, Any] | None = None,
    forecast: Mapping[str, Any] | None = None,
) -> list[Section]:
    """The sections of the report of a fit, and of the diagnosis that it follows.

    To add a section of your own, append it to this list and hand the list to `write_report`.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.
    diagnosis : mapping or None
        The content of diagnosis.json, of a run that has one.
    forecast : mapping or None
        The error of the next slew with the old and the new J and K on board: `axis`, `angle_deg`,
        and (5 % quantile, median, 95 % quantile) [rad] of `before` and `after`.

    Returns
    -------
    list of Section
        In reading order: result, why, parameters, evidence of the diagnosis, residuals, what is
        determined, gates, limits, settings. What the fit does not have (no star tracker) is left
        out.
    """
    sections = (
        *result_sections(posterior, diagnosis, forecast),
        parameters_section(posterior),
        *(diagnosis_sections(diagnosis) if diagnosis else ()),
        residuals_section(posterior),
        telemetry_section(posterior),
        signals_section(posterior),
        dirt_section(posterior),
        determination_section(posterior),
        gates_section(posterior),
        limits_section(posterior),
        settings_section(posterior),
    )
    return [section for section in sections if section is not None]


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
    attributes = posterior.attributes
    diagnostics = attributes["diagnostics"]
    numbers = [
        ("acceptance", f"{diagnostics['acceptance']:.2f}"),
        ("posterior evaluations", f"{diagnostics['evaluations']:,}"),
        ("effective samples per evaluation", f"{diagnostics['ess_per_evaluation']:.2f}"),
        ("autocorrelation time, steps", f"{diagnostics['tau_max']:.1f}"),
    ]
    gates = [gate | {"says": typeset(gate["says"])} for gate in attributes["gates"]]
    context = {"gates": gates, "numbers": numbers}
    picture = Picture(
        draw_chains(posterior),
        "The parameter whose independent ensembles agree least. "
        "Left: mean of each ensemble's walkers (line) and the range of 90 % of them (band), "
        "step by step: bands on top of each other, without drift. "
        "Middle: how each ensemble's draws rank among all draws; the grey band holds 99 % "
        "of the steps if all ensembles sample the same distribution. Right: log posterior.",
        "Traces and rank histograms of the ensembles",
        folded=True,
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
