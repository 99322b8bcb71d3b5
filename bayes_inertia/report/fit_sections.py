"""The sections of a run's report, each a function of the posterior or of its diagnosis.

On top the card: J and K with their sds, whether to use them, and what for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.errors import SettingsError, require_kind
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.settings import OPEN_VERDICTS
from bayes_inertia.physics.parameters import changes_of_J
from bayes_inertia.report.criteria import (
    criteria_of,
    exponents_of,
    names_by_determination,
    ratios_told,
    scale_factors,
)
from bayes_inertia.report.formatting import brief, drive_text, kind_of, listed, number, plain
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures.chains import draw_chains
from bayes_inertia.report.pictures.diagnosis import (
    draw_candidates,
    draw_disagreement,
    draw_misfit_by_step,
    draw_shifts,
    draw_signal,
)
from bayes_inertia.report.pictures.pairs import draw_pairs, draw_priors
from bayes_inertia.report.pictures.posterior_data import (
    n_ensembles,
    n_slews,
    time_in_slew,
    values_of,
)
from bayes_inertia.report.pictures.telemetry import draw_correction
from bayes_inertia.report.residual_sections import residuals_section, telemetry_section
from bayes_inertia.report.section import Picture, Section, captioned, packaged
from bayes_inertia.report.verdict import (
    Level,
    diagnosis_verdict,
    fit_verdict,
    level_of,
    verdict_sentence,
)
from bayes_inertia.report.words import (
    averaged_over,
    correlation_sentences,
    dirt_rows,
    phrase,
    rules_of,
)


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
    require_posterior(posterior)
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


def require_posterior(given: Any) -> None:
    """Raise `SettingsError` for what is no posterior."""
    advice = "give a Posterior: fit returns one, Posterior.load reads one"
    require_kind(given, Posterior, "posterior", advice, error=SettingsError)


def dirt_section(posterior: Posterior) -> Section | None:
    """Telemetry faults, and their treatment."""
    rows = dirt_rows(posterior.attributes.get("dirt", []))
    return Section("Dirt in the telemetry", packaged("dirt.html"), {"rows": rows}) if rows else None


def gates_section(posterior: Posterior) -> Section:
    """The gates and the state of the sampler."""
    pictures = captioned("chains", draw_chains(posterior), folded=True)
    return Section("Gates", packaged("gates.html"), {"a": posterior.attributes}, pictures)


def limits_section(posterior: Posterior) -> Section:
    """Limits of any fit of this campaign, whatever its numbers say."""
    attributes, predicted = posterior.attributes, posterior.tree["posterior_predictive"]
    context = {
        "drive": attributes["drive"],
        "effects": attributes["effects"],
        "changes": [plain(name) for name in changes_of_J(posterior.names)],
        "channels": [c for c in ("attitude", "momentum") if c in predicted],
        "angle_sensors": attributes.get("angle_sensors", ()),
        "scale_factors": [name for name in posterior.names if kind_of(name) == "K"],
        "wheels": attributes.get("wheels", 3),
        "ties": tie_sentences(posterior),
        "free_momenta": attributes.get("free_momenta", 0),
        "n_slews": n_slews(posterior),
    }
    return Section("Limits", packaged("limits.html"), context)


def tie_sentences(posterior: Posterior) -> list[str]:
    """Which devices beside wheels tie the absolute size of J, and how well each is known."""
    rows, said = posterior.summary()["parameters"], []
    for tie in posterior.attributes.get("scale_of_J", []):
        if tie["device"] == "wheels":
            continue
        text, gain = f"{tie['by']} of {tie['device']}", rows.get(f"{tie['device']}.gain")
        sd, percent = tie["relative_sd"], 100.0 * tie["relative_sd"]
        if gain is not None:
            found = f"{number(gain['mean'], gain['sd'])} ± {number(gain['sd'], gain['sd'])}"
            text += f", known to {brief(percent)} % before the fit (gain after it {found})"
        said.append(text if sd else f"{text}, taken as exact")
    return said


_TEMPLATE = """<p>These are stochastic: in each slew they are free to be what the data ask for.
What they may have done is taken from the information on J and K.
Where a band holds zero, nothing is missing there.</p>"""


def signals_section(posterior: Posterior) -> Section | None:
    """Torques and errors of free shape over time, slew by slew."""
    if "signal" not in posterior.tree:
        return None
    names = [str(name) for name in posterior.tree["signal"].data_vars]
    # Beside a torque of free shape an error of free shape is evidence for experts.
    pictures = tuple(
        replace(_picture(posterior, name), folded=name.endswith("_remainder") and k > 0)
        for k, name in enumerate(names)
    )
    return Section("Stochastic effects", _TEMPLATE, {}, pictures)


def _picture(posterior: Posterior, name: str) -> Picture:
    """One effect: mean and band over time."""
    draws = values_of(posterior, "signal", name)
    variable = posterior.tree["signal"][name]
    # Files of version 0.3 and before do not name their signals.
    title = variable.attrs.get("long_name", plain(name))
    signal = {
        "time": time_in_slew(posterior, "signal_time"),
        "mean": draws.mean((0, 1)),
        "sd": draws.std((0, 1)),
        "slews": [str(slew) for slew in values_of(posterior, "estimate", "slew")],
        "components": [str(c) for c in np.asarray(variable[f"{name}_component"])],
        "unit": variable.attrs["units"],
        "source": variable.attrs.get("quantity", plain(name)),
    }
    (picture,) = captioned("signal", draw_signal(signal, whole_band=True), title)
    return picture


def parameters_section(posterior: Posterior) -> Section:
    """The table of parameters and principal moments, prior against posterior."""
    summary = posterior.summary()
    ratios = ratios_told(summary)  # An sd of the size of J would be the prior's.
    context = {
        "s": summary,
        "ratios": ratios,
        "powers": exponents_of(ratios | summary["parameters"] | summary["derived"]),
        "prior_means": values_of(posterior, "estimate", "prior_mean").tolist(),
        "quoted": posterior.quoted_factor,
        "averaged": averaged_over(summary),
        "criteria": criteria_of(posterior.attributes),
    }
    pictures = captioned("priors", draw_priors(posterior), folded=True)
    return Section("Parameters", packaged("parameters.html"), context, pictures)


def determination_section(posterior: Posterior) -> Section:
    """Determined parameters, in words, and the pair plot."""
    summary = posterior.summary()
    ratios, rows = ratios_told(summary), summary["parameters"]
    # Where nothing ties the size of J, all that is said is said of its ratios.
    names = [f"{n}/trace" if f"{n}/trace" in ratios else n for n in posterior.names]
    rows = {n: ratios.get(n) or rows[n] for n in names} | ratios
    matrix = np.atleast_2d(np.corrcoef(posterior.sized_samples.T)).tolist()
    most = LAYOUT.most_parameters_drawn
    pictures = captioned(
        "pairs", draw_pairs(posterior, most), most, len(names), bool(ratios), folded=True
    )
    context = {
        "groups": names_by_determination(rows, criteria_of(posterior.attributes)),
        "correlations": correlation_sentences(names, matrix),
        "trusted": summary["trusted"],
    }
    title = "What this campaign determines"
    return Section(title, packaged("determination.html"), context, pictures)


def settings_section(posterior: Posterior) -> Section:
    """Settings that make the same result again."""
    return Section("Settings", packaged("settings.html"), {"rows": settings_rows(posterior)})


def settings_rows(posterior: Posterior) -> list[tuple[str, str]]:
    """Inputs and settings of a fit."""
    attributes, chains = posterior.attributes, posterior.tree["posterior"].sizes["chain"]
    diagnostics, ensembles = attributes["diagnostics"], n_ensembles(posterior)
    names = [tie["device"] for tie in attributes.get("scale_of_J", []) if tie["device"] != "wheels"]
    key = "other devices" if attributes.get("wheels") else "devices"
    devices = [(key, listed(names))] if names else []
    if reference := attributes.get("frame_reference"):
        devices.append(("reference of frames", f"{reference}: its axes are the body's"))
    walkers = attributes.get("walkers") or chains // ensembles
    versions = (f"{name} {version}" for name, version in attributes["versions"].items())
    return [
        ("campaign", attributes["campaign"]),
        ("campaign digest (SHA-256)", attributes["campaign_sha256"] or "not recorded"),
        ("slews, data", f"{n_slews(posterior)} slews, {attributes['fit']['n_data']:,} numbers"),
        ("drive", drive_text(attributes["drive"], attributes.get("wheels", 3))),
        *devices,
        ("effects fitted along", listed(attributes["effects"]) or "none"),
        ("seed", str(attributes["seed"])),
        (
            "sampler",
            f"{ensembles} ensembles of {walkers} walkers, "
            f"{diagnostics['steps']} steps, the first {diagnostics['discarded']} discarded",
        ),
        ("versions", ", ".join(versions)),
    ]


_STATUS: dict[Level, str] = {"good": "Trusted", "caution": "Use with care", "bad": "Refused"}
_TENSOR = (("Jxx", "Jxy", "Jxz"), ("Jxy", "Jyy", "Jyz"), ("Jxz", "Jyz", "Jzz"))


def result_sections(
    posterior: Posterior,
    diagnosis: Mapping[str, Any] | None = None,
    forecast: Mapping[str, Any] | None = None,
) -> list[Section]:
    """The answer, and why: one verdict, J and K, the error of the next slew; then the reasons.

    `forecast`: see `draw_correction`. It is not shown of a result that is not to be used. Returns:
    the card with at most one picture, and the reasons.
    """
    summary, bound = posterior.summary(), ""
    verdicts = {"Can it be used?": fit_verdict(summary, n_slews(posterior))}
    if diagnosis is not None:
        verdicts = {"What is missing?": diagnosis_verdict(diagnosis)} | verdicts
        if hidden := diagnosis.get("could_hide"):
            bound = phrase("diagnosis", "could_hide", hidden)
    level = level_of(summary, [v.level for v in verdicts.values()])
    rows = summary["parameters"]
    matrices = {
        "J / trace J": _tensor(ratios_told(summary), "/trace"),
        "J": _tensor(rows),
        **{k: [[rows[n]] for n in names] for k, names in scale_factors(summary).items()},
    }
    context = {
        "level": level,
        "status": _STATUS[level],
        "sentence": verdict_sentence(summary, diagnosis),
        "bound": bound,
        "matrices": matrices,
        "quoted": posterior.quoted_factor is not None,
    }
    pictures: tuple[Picture, ...] = ()
    if forecast and level != "bad":
        pictures = captioned("correction", draw_correction(forecast), forecast)
    reasons = {
        question: (verdict.title, [s for s in verdict.sentences if s != bound])
        for question, verdict in verdicts.items()
    }
    return [
        Section("Result", packaged("result.html"), context, pictures),
        Section("Why", packaged("reasons.html"), {"reasons": reasons, "folded": ()}),
    ]


def _tensor(rows: Mapping[str, Any], of: str = "") -> list[list[Any]]:
    """Rows of a summary in the places of the tensor's elements (3, 3); none without rows."""
    return [[rows[f"{name}{of}"] for name in line] for line in _TENSOR] if rows else []


def diagnosis_sections(content: Mapping[str, Any]) -> list[Section]:
    """The evidence of a diagnosis, for the report of the fit that follows it.

    Returns: where the model disagrees, candidates, how probable each answer is, what naming
    changed, what may be true instead, what may hide still, the torque that nothing explains. What
    this diagnosis does not have is left out; its verdict stands with that of the fit.
    """
    steps = content["steps"]
    # Where a part has no name the steps are not those of the fit below.
    averaged = content.get("alternatives") and content["verdict"] not in OPEN_VERDICTS
    sections = (
        ("Where does the base model disagree?", "disagreement", _disagreement(content), True),
        ("Candidates", "candidates", _candidates(content), True),
        ("How probable each answer is", "answers", (), content.get("hypotheses")),
        ("What adding effects changes", "changes", _changes(content), steps),
        ("J and K, whichever it is", "alternatives", (), steps and averaged),
        ("What could still hide", "could_hide", (), content.get("could_hide")),
        ("What nothing explains", "unknown", _unknown(content), content["unknown"]),
    )
    return [
        Section(title, packaged(f"{template}.html"), {"d": content}, pictures)
        for title, template, pictures, told in sections
        if told
    ]


def _disagreement(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    """Where the base model disagrees with the data, before and after effects were added."""
    before, after = content["pictures"]["before"], content["pictures"]["after"]
    starts, left = content.get("slew_start", {}), content["disagreement_after"]
    figure = draw_disagreement(before, content["disagreement"], starts)
    pictures = captioned("base_disagreement", figure, len(before["slews"]))
    if after is None:
        return pictures
    figure, what = draw_disagreement(after, left, starts), phrase("diagnosis", "with_what", content)
    return (*pictures, *captioned("disagreement_left", figure, what, len(left)))


def _candidates(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    figure = draw_candidates(content["candidates"], content["threshold"], content["named"])
    false_alarms = rules_of(content)["false_alarm_probability"]
    return captioned("candidates", figure, false_alarms, folded=True)


def _changes(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    """How the misfit shrinks and J and K move."""
    steps, tried = content["steps"], content["verdict"] == "unknown"
    if not steps:
        return ()
    what = phrase("diagnosis", "with_what", content)
    return (
        *captioned("misfit_by_step", draw_misfit_by_step(steps), folded=True),
        *captioned("shifts", draw_shifts(steps), what, folded=tried),
    )


def _unknown(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    """The torque that nothing explains, and another signal that explains more."""
    if content["unknown"] is None:
        return ()
    torque, other = (content["pictures"][key] for key in ("torque", "other"))
    pictures = captioned("torque", draw_signal(torque))
    if other is not None:
        pictures += captioned("other_signal", draw_signal(other), other["source"])
    return pictures
