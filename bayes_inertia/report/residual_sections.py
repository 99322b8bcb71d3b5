"""The sections of a fit's report that set the model against the data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.criteria import Criteria, criteria_of
from bayes_inertia.report.formatting import CHANNEL_NAMES, NOT_GIVEN
from bayes_inertia.report.pictures.attitude import draw_attitude
from bayes_inertia.report.pictures.posterior_data import n_slews, values_of, worst_slews
from bayes_inertia.report.pictures.telemetry import MOST_DOTS, draw_momentum, draw_rates
from bayes_inertia.report.residual_data import explorer_data, residual_channels
from bayes_inertia.report.residual_wording import channel_verdict, discount_text, whiteness_text
from bayes_inertia.report.section import Picture, Section, packaged

_MOST_SLEWS_DRAWN = 9
_MOST_SLEWS_LISTED = 40


def residuals_section(posterior: Posterior) -> Section:
    """Reduced chi^2 by channel, and by slew with the weight that each slew was given.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section
        Two tables.
    """
    fit, criteria = posterior.attributes["fit"], criteria_of(posterior.attributes)
    n_data = values_of(posterior, "estimate", "slew_n_data")
    names = values_of(posterior, "estimate", "slew")
    labels = values_of(posterior, "estimate", "channel")
    measured = [c for c in range(n_data.shape[1]) if n_data[:, c].sum() > 0]
    noise = posterior.attributes.get("noise", {})
    context = {
        "channels": [_channel_row(name, fit, criteria) for name in (*CHANNELS, "total")],
        "labels": [str(labels[c]) for c in measured],
        "slews": [
            {
                "name": str(names[s]),
                "cells": [_slew_cell(posterior, s, c) for c in measured],
            }
            for s in worst_slews(posterior, _MOST_SLEWS_LISTED)
        ],
        "discounted": fit["discounted"],
        "n_slews": len(n_data),
        "noise": ", ".join(
            f"{CHANNEL_NAMES[channel]} {factor:.2f}"
            for channel, factor in noise.items()
            if factor > 1.0
        ),
    }
    return Section("Does the model explain the data?", packaged("residuals.html"), context)


def _slew_cell(posterior: Posterior, slew: int, channel: int) -> dict[str, str]:
    """Mean square of one slew's residuals in one channel, and the weight they were given."""
    n_data, chi2, discount = (
        values_of(posterior, "estimate", name)[slew, channel]
        for name in ("slew_n_data", "slew_chi2", "discount")
    )
    if not n_data:
        return {"ratio": NOT_GIVEN, "weight": NOT_GIVEN}
    ratio = chi2 / n_data
    return {
        "ratio": f"{ratio:.2f}" if ratio < 100.0 else f"{ratio:.4g}",
        "weight": discount_text(float(discount)),
    }


def _channel_row(channel: str, fit: Mapping[str, Any], criteria: Criteria) -> dict[str, str]:
    reduced, interval = fit["reduced_chi2"][channel], fit["interval_99"][channel]
    return {
        "name": CHANNEL_NAMES[channel],
        "reduced": NOT_GIVEN if reduced is None else f"{reduced:.3f}",
        "interval": NOT_GIVEN if interval is None else f"{interval[0]:.3f} … {interval[1]:.3f}",
        "white": whiteness_text(fit["p_white"][channel], criteria),
        "verdict": channel_verdict(fit, channel, criteria),
    }


def telemetry_section(posterior: Posterior) -> Section | None:
    """Measured against simulated telemetry: residuals to choose, enlarge and read, and pictures.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section or None
        None where nothing was predicted.
    """
    pictures = [
        *_series_pictures(posterior),
        *_star_tracker_picture(posterior),
    ]
    if not pictures:
        return None
    return Section(
        "Measured against simulated",
        packaged("residual_explorer.html"),
        {"data": explorer_data(residual_channels(posterior))},
        tuple(pictures),
        packaged("residual_explorer.js"),
    )


def _series_pictures(posterior: Posterior) -> list[Picture]:
    """Rates and wheel momentum over time, measured and simulated."""
    slews, total = worst_slews(posterior, _MOST_SLEWS_DRAWN), n_slews(posterior)
    which, pictures = "", []
    if posterior.tree["constant_data"].sizes["row"] > MOST_DOTS:
        which += (
            f" Of more than {MOST_DOTS} rows, lines and bands show the lowest and highest values, "
            "residuals evenly spaced rows and the lowest and highest of each stretch."
        )
    if len(slews) < total:
        which += f" The {len(slews)} of {total} slews that fit worst are drawn."
    if (figure := draw_rates(posterior, slews)) is not None:
        caption = (
            "Rates: measured (dots) and simulated with the posterior's parameters (lines), "
            "with the band that should hold 90 % of the measurements, noise included; "
            "on this scale it is often no wider than the line. "
            "Below each: measured minus simulated in stated sigmas of the sensor, "
            "with guides at ±1, 2 and 3: about two in three dots belong inside the first, "
            "all but three in a thousand inside the last. "
            f"Patterns in time mean that something is missing from the model.{which}"
        )
        alt = "Measured and simulated rates with residuals, slew by slew"
        pictures.append(Picture(figure, caption, alt))
    if (figure := draw_momentum(posterior, slews)) is not None:
        caption = (
            "Wheel momentum: measured minus simulated in stated sigmas of the tachometers, "
            "guides at ±1, 2 and 3. Torque commands are the model's input, so a wheel's wrong "
            f"gain, lag or friction would show here as a pattern.{which}"
        )
        alt = "Residuals of wheel momentum, slew by slew"
        pictures.append(Picture(figure, caption, alt, instead_of_script=True))
    return pictures


def _star_tracker_picture(posterior: Posterior) -> list[Picture]:
    """Measured against predicted attitude; nothing without star-tracker fixes."""
    figure = draw_attitude(posterior)
    if figure is None:
        return []
    caption = (
        "Measured minus predicted attitude as small rotations about the body axes: "
        "small marks are single fixes, "
        "large ones the mean of a slew's fixes with its standard error. "
        "Right: after the slew, where errors of J and K would have grown into angles. "
        "Below: the same in stated sigmas of the star tracker, with guides at ±1, 2 and 3."
    )
    return [Picture(figure, caption, "Attitude misfit before and after each slew", folded=True)]
