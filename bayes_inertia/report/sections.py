"""The standard sections of a fit's report, each a function of the posterior."""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from typing import Any

import numpy as np

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report import pictures, wording
from bayes_inertia.report.pictures.data import ensembles, worst_slews
from bayes_inertia.report.section import Picture, Section, packaged

_MOST_SLEWS = 9  # drawn; the others are in the table
_MOST_PARAMETERS = 16
_CHANNELS = {
    "rate": "rate sensor",
    "attitude": "star tracker",
    "momentum": "wheel momentum",
    "total": "all together",
}


def standard_sections(posterior: Posterior) -> list[Section]:
    """All sections in reading order: verdict, parameters, what is determined, fit, gates, limits, settings."""
    builders = (
        verdict,
        parameters,
        determination,
        fit_quality,
        telemetry,
        star_tracker,
        gates,
        limits,
        settings,
    )
    return [section for section in (build(posterior) for build in builders) if section is not None]


def _n_slews(posterior: Posterior) -> int:
    return int(posterior.tree["estimate"].sizes["slew"])


def verdict(posterior: Posterior) -> Section:
    """Can it be trusted?"""
    said = wording.verdict(posterior.summary(), _n_slews(posterior))
    return Section("Can I trust it?", packaged("verdict.html"), {"verdict": said})


def parameters(posterior: Posterior) -> Section:
    """The headline table, principal moments, prior against posterior."""
    summary = posterior.summary()
    center = posterior.tree["estimate"]["prior_mean"].values
    rows = [
        _row(name, row, float(center[i]))
        for i, (name, row) in enumerate(summary["parameters"].items())
    ]
    moments = [_moment(name, row) for name, row in summary["derived"].items()]
    picture = Picture(
        pictures.prior_posterior(posterior),
        "Posterior of each parameter (blue). Bars below: mean ± sd of the model and, where there are enough slews, ± robust sd, which is what the slews "
        "themselves support. Where the data sharpen the prior more than eightfold, the panel shows only the posterior, and the grey strip above it shows "
        "the prior over ±3 sd with the posterior's place as a blue mark; elsewhere prior and posterior share the axis.",
        "Prior and posterior densities of every parameter",
    )
    return Section(
        "Parameters",
        packaged("parameters.html"),
        {"rows": rows, "moments": moments, "averaged": wording.averaged_over(summary)},
        (picture,),
    )


def _row(name: str, row: dict[str, Any], prior_mean: float) -> dict[str, Any]:
    used = wording.quoted(row["sd"], row["robust_sd"])
    power = wording.exponent(row["mean"], used.sd)
    low, high = wording.interval_90(row["q05"], row["q50"], row["q95"], row["sd"], used)
    share = wording.contraction(used.sd, row["prior_sd"])
    return {
        "name": name,
        "meaning": wording.meaning(name),
        "prior": f"{wording.number(prior_mean, row['prior_sd'], power)} ± {wording.number(row['prior_sd'], row['prior_sd'], power)}",
        "mean": wording.number(row["mean"], used.sd, power),
        "sd": wording.number(row["sd"], row["sd"], power),
        "robust_sd": "–"
        if row["robust_sd"] is None
        else wording.number(row["robust_sd"], row["robust_sd"], power),
        "source": used.source,
        "interval": f"{wording.number(low, used.sd, power)} … {wording.number(high, used.sd, power)}",
        "contraction": wording.contraction_text(share),
        "determined": wording.determined(share),
        "unit": wording.unit_text(row["unit"], power),
    }


def _moment(name: str, row: dict[str, Any]) -> dict[str, str]:
    used = wording.quoted(row["sd"], row["robust_sd"])
    power = wording.exponent(row["mean"], used.sd)
    return {
        "name": name,
        "mean": wording.number(row["mean"], used.sd, power),
        "sd": wording.number(row["sd"], row["sd"], power),
        "robust_sd": "–"
        if row["robust_sd"] is None
        else wording.number(row["robust_sd"], row["robust_sd"], power),
        "source": used.source,
        "unit": wording.unit_text(row["unit"], power),
    }


def determination(posterior: Posterior) -> Section:
    """What the campaign determines, in words, and the pair plot."""
    rows, names = posterior.summary()["parameters"], posterior.names
    matrix = np.atleast_2d(np.corrcoef(posterior.samples.T)).tolist()
    robust = not posterior.trusted and any(row["robust_sd"] is not None for row in rows.values())
    dashed = (
        " Dashed orange: the same from the robust covariance, because the result is not trusted."
        if robust
        else ""
    )
    shown = (
        ""
        if len(names) <= _MOST_PARAMETERS
        else f" Only the {_MOST_PARAMETERS} most correlated of {len(names)} parameters are drawn."
    )
    picture = Picture(
        pictures.pairs(posterior, _MOST_PARAMETERS),
        "Every pair of parameters: posterior draws (shading) with the ellipse that holds 90 % of a normal distribution of the same covariance (blue)."
        f"{dashed} Each cell shows the range given on the left. Numbers: correlations, framed beyond ±0.9.{shown}",
        "Pair plot of the posterior with correlations",
        dense=True,
    )
    context = {
        "groups": wording.groups(rows),
        "correlations": wording.correlations(names, matrix),
        "listed": wording.listed,
    }
    return Section(
        "What this campaign determines", packaged("determination.html"), context, (picture,)
    )


def fit_quality(posterior: Posterior) -> Section:
    """Reduced chi^2 by channel, and by slew with the weight each slew was given."""
    fit = posterior.attributes["fit"]
    channels = [_channel(name, fit) for name in ("rate", "attitude", "momentum", "total")]
    estimate = posterior.tree["estimate"]
    discount, chi2, n = (estimate[key].values for key in ("discount", "slew_chi2", "slew_n_data"))
    used = [c for c in range(n.shape[1]) if n[:, c].sum() > 0]
    labels = [str(estimate["channel"].values[c]) for c in used]
    slews = [
        {
            "name": str(estimate["slew"].values[s]),
            "cells": [
                {
                    "ratio": _ratio(chi2[s, c] / n[s, c]),
                    "weight": wording.discount_text(float(discount[s, c])),
                }
                if n[s, c]
                else {"ratio": "–", "weight": "–"}
                for c in used
            ],
        }
        for s in worst_slews(posterior, 40)
    ]
    louder = [
        f"{_CHANNELS[channel]} {factor:.2f}"
        for channel, factor in posterior.attributes.get("noise", {}).items()
        if factor > 1.0
    ]
    context = {
        "channels": channels,
        "labels": labels,
        "slews": slews,
        "discounted": fit["discounted"],
        "n_slews": len(n),
        "noise": ", ".join(louder),
    }
    return Section("Does the model explain the data?", packaged("fit.html"), context)


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 100.0 else f"{value:.4g}"


def _channel(name: str, fit: dict[str, Any]) -> dict[str, str]:
    reduced, interval, white = (
        fit[key][name] for key in ("reduced_chi2", "interval_99", "p_white")
    )
    return {
        "name": _CHANNELS[name],
        "reduced": "–" if reduced is None else f"{reduced:.3f}",
        "interval": "–" if interval is None else f"{interval[0]:.3f} … {interval[1]:.3f}",
        "white": wording.whiteness_text(white),
        "verdict": wording.channel_verdict(reduced, interval, white),
    }


def telemetry(posterior: Posterior) -> Section | None:
    """Measured against simulated telemetry."""
    slews = worst_slews(posterior, _MOST_SLEWS)
    total = _n_slews(posterior)
    which = (
        " Lines of more than 2000 points are drawn by their lowest and highest values."
        if posterior.tree["constant_data"].sizes["row"] > 2000
        else ""
    )
    which += (
        f" The {len(slews)} of {total} slews that fit worst are drawn."
        if len(slews) < total
        else ""
    )
    found = (
        (
            pictures.rates(posterior, slews),
            "Rates: measured (dots) and simulated with the posterior's parameters (lines), with the band that should hold 90 % of the measurements, "
            "noise included; on this scale it is often no wider than the line. Below each: measured minus simulated in stated sigmas of the sensor, "
            "with guides at ±1, 2 and 3: about two in three dots belong inside the first, all but three in a thousand inside the last. "
            f"Patterns in time mean that something is missing from the model.{which}",
            "Measured and simulated rates with residuals, slew by slew",
        ),
        (
            pictures.momentum(posterior, slews),
            "Wheel momentum: measured minus simulated in stated sigmas of the tachometers, guides at ±1, 2 and 3. Torque commands are the model's input, so "
            f"a wheel's wrong gain, lag or friction would show here as a pattern.{which}",
            "Residuals of wheel momentum, slew by slew",
        ),
    )
    drawn = tuple(
        Picture(figure, caption, alt, dense=True)
        for figure, caption, alt in found
        if figure is not None
    )
    return Section("Measured against simulated", "", {}, drawn) if drawn else None


def star_tracker(posterior: Posterior) -> Section | None:
    """Attitude misfit, if there were fixes."""
    figure = pictures.attitude(posterior)
    if figure is None:
        return None
    caption = (
        "Measured minus predicted attitude as small rotations about the body axes: small marks are single fixes, large ones the mean of a slew's fixes with "
        "its standard error. Right: after the slew, where errors of J and K would have grown into angles. Below: the same "
        "in stated sigmas of the star tracker, with guides at ±1, 2 and 3."
    )
    return Section(
        "Attitude before and after each slew",
        "",
        {},
        (Picture(figure, caption, "Attitude misfit before and after each slew"),),
    )


def gates(posterior: Posterior) -> Section:
    """The gates and the state of the sampler."""
    about = posterior.attributes
    found = about["diagnostics"]
    numbers = [
        ("nested R-hat, worst parameter", f"{found['nested_rhat_max']:.4f}", "below 1.01"),
        ("effective samples, bulk", f"{found['ess_bulk_min']:,.0f}", "at least 400"),
        ("effective samples, tails", f"{found['ess_tail_min']:,.0f}", "at least 400"),
        (
            "steps kept per autocorrelation time",
            f"{(found['steps'] - found['discarded']) / max(found['tau_max'], 1e-9):.0f}",
            "at least 20",
        ),
        ("acceptance", f"{found['acceptance']:.2f}", "for information"),
        ("posterior evaluations", f"{found['evaluations']:,}", "for information"),
        (
            "effective samples per evaluation",
            f"{found['ess_per_evaluation']:.2f}",
            "for information",
        ),
    ]
    picture = Picture(
        pictures.chains(posterior),
        "The parameter whose independent ensembles agree least. Left: mean of each ensemble's walkers (line) and the range of 90 % of them (band), step by "
        "step: bands on top of each other, without drift. Middle: how each ensemble's draws rank among all draws; the grey band holds 99 % of the steps "
        "if all ensembles sample the same distribution. Right: log posterior.",
        "Traces and rank histograms of the ensembles",
        dense=True,
    )
    return Section(
        "Gates",
        packaged("gates.html"),
        {
            "gates": [gate | {"says": wording.printed(gate["says"])} for gate in about["gates"]],
            "numbers": numbers,
        },
        (picture,),
    )


def limits(posterior: Posterior) -> Section:
    """What no fit of this campaign can tell."""
    about = posterior.attributes
    channels = [c for c in ("attitude", "momentum") if c in posterior.tree["posterior_predictive"]]
    said = wording.limits(
        drive=about["drive"],
        effects=about["effects"],
        channels=channels,
        wheels=about.get("wheels", 3),
        n_slews=_n_slews(posterior),
    )
    return Section(
        "Limits", "<ul>{% for text in said %}<li>{{ text }}</li>{% endfor %}</ul>", {"said": said}
    )


def settings(posterior: Posterior) -> Section:
    """How to make the same result again."""
    about, chains = posterior.attributes, posterior.tree["posterior"].sizes["chain"]
    found, n = about["diagnostics"], ensembles(posterior)
    rows = [
        ("campaign", about["campaign"]),
        ("campaign digest (SHA-256)", about["campaign_sha256"] or "not recorded"),
        ("slews, data", f"{_n_slews(posterior)} slews, {about['fit']['n_data']:,} numbers"),
        (
            "drive",
            {
                "commanded": "commanded: torque commands are the input",
                "measured": "measured: wheel momentum is the input",
            }[about["drive"]],
        ),
        ("effects fitted along", wording.listed(about["effects"]) or "none"),
        ("seed", about["seed"]),
        (
            "sampler",
            f"{n} ensembles of {chains // n} walkers, {found['steps']} steps, the first {found['discarded']} discarded",
        ),
        ("time", f"{found['seconds']:.0f} s"),
        ("versions", ", ".join(f"{name} {version}" for name, version in about["versions"].items())),
    ]
    return Section("Settings", packaged("settings.html"), {"rows": rows})
