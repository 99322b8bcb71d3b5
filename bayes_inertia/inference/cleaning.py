"""Dirt seen in the residuals of a fit: outliers are left out, the noise takes its own shape.

One place decides for every fit and every diagnosis. Outliers are looked for always; level and
colour of the noise only where the residuals are not what the stated noise predicts. They are
measured from what is fast, where a missing effect is not, and believed where they are alike in all
slews, at rest and in motion. Where nothing is found, the estimate is the very object given.

A channel that was asked for Student-t noise has its outliers modelled: none is left out, and its
level and colour are taken as given. So is the level of a channel whose scale is sampled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.quantisation import quantisation_sigma, quantisation_step
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.gate_limits import REJECT_BELOW
from bayes_inertia.inference.laplace import Estimate, residual_series
from bayes_inertia.inference.noise_colour import colour_of, is_alike_everywhere
from bayes_inertia.inference.noise_level import bursts_of, noise_factors
from bayes_inertia.inference.outliers import away_from_switches, outlying_fixes, outlying_readings
from bayes_inertia.inference.treatment import DirtTreatment, treated
from bayes_inertia.physics.forward_model import Model

# Outliers hide each other; so often they are looked for again.
_ROUNDS_OF_MASKS = 3
# Readings that noise may remember. Slower residuals look like a constant torque, and are none.
_LONGEST_COLOUR = 12.0
# Rounding that adds less to the noise than this factor is left alone.
_ROUNDING_THAT_COUNTS = 1.005
# Noise beyond what is stated and rounded by this factor has another cause.
_MORE_THAN_ROUNDING = 1.15


@dataclass(frozen=True)
class CleanFit:
    """An estimate from which dirt was kept away.

    Parameters
    ----------
    estimate : Estimate
        Its model's campaign is the treated one.
    treatment : DirtTreatment
        What was done to the campaign.
    """

    estimate: Estimate
    treatment: DirtTreatment


def clean_fit(
    estimate: Estimate, *, seed: int = 0, level: bool = True, discount: bool = True
) -> CleanFit:
    """Look for dirt in an estimate's residuals, and repeat the estimate without it.

    Parameters
    ----------
    estimate : Estimate
        Of a campaign as stated.
    seed : int
        Of the optimizer's starts.
    level : bool
        Whether the level of white noise is measured too.
    discount : bool
        Whether misfit that is left discounts the slews.

    Returns
    -------
    CleanFit
        With the same estimate where nothing was found.

    Raises
    ------
    EstimateError
        If the optimizer finds no usable estimate.
    """
    first = CleanFit(estimate, DirtTreatment())
    repeat = partial(_repeated, estimate.model, seed=seed, discount=discount)
    fit = _without_outliers(first, repeat)
    for measured in (_with_colour, _with_level) if level else (_with_colour,):
        if not any(test.too_large for test in fit.estimate.tests.values()):
            break
        again = repeat(fit, measured(fit))
        fit = fit if again is fit else _without_outliers(again, repeat)
    return fit


def _repeated(
    stated: Model, fit: CleanFit, treatment: DirtTreatment, *, seed: int, discount: bool
) -> CleanFit:
    """The fit with another treatment of the campaign as stated."""
    if treatment == fit.treatment:
        return fit
    drive = stated.structure.drive
    campaign = treated(stated.campaign, treatment, drive)
    model = Model(campaign, stated.effects, drive, stated.noise)
    return CleanFit(optimizer.estimate(model, seed=seed, discount=discount), treatment)


def _without_outliers(fit: CleanFit, repeat: Callable[..., CleanFit]) -> CleanFit:
    """The fit with every outlier masked."""
    for _ in range(_ROUNDS_OF_MASKS):
        masked = _with_masks(fit.treatment.masked, _outliers(fit.estimate))
        if masked == fit.treatment.masked:
            break
        fit = repeat(fit, replace(fit.treatment, masked=masked))
    return fit


def _with_masks(old: tuple[Dirt, ...], new: tuple[Dirt, ...]) -> tuple[Dirt, ...]:
    """Masks of both, one record a channel and slew."""
    rows: dict[tuple[str, str], set[int]] = {}
    for mask in (*old, *new):
        rows.setdefault((mask.channel, mask.slew), set()).update(mask.rows)
    return tuple(
        Dirt(
            "outliers",
            channel,
            slew,
            tuple(sorted(numbers)),
            "masked",
            f"{len(numbers)} row{'s' if len(numbers) > 1 else ''} far beyond the readings "
            "before and after",
        )
        for (channel, slew), numbers in rows.items()
    )


def _outliers(estimate: Estimate) -> tuple[Dirt, ...]:
    """Outliers among an estimate's residuals."""
    slews, series = estimate.model.campaign.slews, _plain_series(estimate)
    hit = {}
    for channel in ("rate", "momentum"):
        if any(values.size for values in series[channel]):
            flags = away_from_switches(slews, outlying_readings(series[channel]))
            hit[channel] = [np.flatnonzero(flag.any(axis=1)) for flag in flags]
    fix_rows = [np.flatnonzero(slew.fixes) for slew in slews]
    fixes = [x[: len(rows)] for x, rows in zip(series["attitude"], fix_rows, strict=True)]
    bursts = [bursts_of(slew.time[rows]) for slew, rows in zip(slews, fix_rows, strict=True)]
    flags = outlying_fixes(fixes, bursts)
    hit["attitude"] = [rows[flag] for rows, flag in zip(fix_rows, flags, strict=True)]
    noise = estimate.model.noise
    return tuple(
        Dirt("outliers", channel, slew.name, tuple(rows.tolist()), "masked")
        for channel, found in hit.items()
        if not noise.of(channel).heavy
        for slew, rows in zip(slews, found, strict=True)
        if len(rows)
    )


def _plain_series(estimate: Estimate) -> dict[str, list[np.ndarray]]:
    """Residuals in sigmas, those of correlated noise as they are."""
    white = estimate.stated._replace(memory=None)
    return residual_series(estimate.model, estimate.point, white)


def _with_colour(fit: CleanFit) -> DirtTreatment:
    """The treatment with correlated noise of the rate sensor, if that is what there is."""
    tests, noise = fit.estimate.tests["rate"], fit.estimate.model.noise.rate
    if noise.heavy or tests.p_white is None or tests.p_white >= REJECT_BELOW:
        return fit.treatment
    slews = fit.estimate.model.campaign.slews
    colour = colour_of(slews, _plain_series(fit.estimate)["rate"])
    if colour is not None and max(colour.times) > _LONGEST_COLOUR * colour.spacing:
        return fit.treatment
    return replace(fit.treatment, colour=colour)


def _with_level(fit: CleanFit) -> DirtTreatment:
    """The treatment with the measured level of each channel's noise, where that is noise."""
    estimate = fit.estimate
    series, slews = estimate.residual_series, estimate.model.campaign.slews
    rounding = _factors_of_rounding(estimate)
    level, rounded = dict(fit.treatment.level), set(fit.treatment.rounded)
    for channel, factor in noise_factors(estimate).items():
        if not estimate.model.noise.of(channel).is_stated:
            continue
        by_rounding = rounding.get(channel, 1.0) if estimate.tests[channel].too_large else 1.0
        alike = factor > 1.0 and (
            channel == "attitude" or is_alike_everywhere(slews, series[channel])
        )
        if by_rounding > _ROUNDING_THAT_COUNTS and factor < _MORE_THAN_ROUNDING * by_rounding:
            level[channel] *= max(by_rounding, factor)
            rounded.add(channel)
        elif alike:
            level[channel] *= factor
    return replace(fit.treatment, level=level, rounded=tuple(sorted(rounded)))


def _factors_of_rounding(estimate: Estimate) -> dict[str, float]:
    """What rounding of the readings adds to the noise of rates and tachometers, as factors."""
    campaign = estimate.model.campaign
    sigmas = {
        "rate": campaign.rate_sensor.sigma,
        "wheel_momentum": tuple(wheel.momentum_sigma for wheel in campaign.wheels),
    }
    factors = {}
    for key, sigma in sigmas.items():
        readings = [getattr(s, key) for s in campaign.slews if getattr(s, key) is not None]
        steps = [
            (quantisation_step(np.concatenate([x[:, k] for x in readings])) or 0.0) / one
            for k, one in enumerate(sigma)
            if one is not None and readings
        ]
        worst = quantisation_sigma(max(steps, default=0.0))
        factors["momentum" if key == "wheel_momentum" else key] = float(np.hypot(1.0, worst))
    return factors
