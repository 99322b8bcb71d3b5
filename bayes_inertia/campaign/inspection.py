"""Faults that each stream of telemetry shows by itself: they are masked where they spoil a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.dirt import Dirt, Treatment
from bayes_inertia.campaign.gaps import gap_records
from bayes_inertia.campaign.hardware import RateSensor, Wheel
from bayes_inertia.campaign.impossible import impossible_momentum, impossible_rates
from bayes_inertia.campaign.quantisation import quantisation_sigma, quantisation_step
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.stuck import stuck_fixes, stuck_readings


def with_dirt_masked(campaign: Campaign) -> Campaign:
    """The campaign without readings that cannot be real, and with records of all faults.

    Only readings are judged, not whether a model explains them. Impossible and stuck readings
    become NaN; gaps, saturated readings and quantisation are recorded. A campaign without such
    faults stays as it is, to the last digit.

    Examples
    --------
    >>> from bayes_inertia.campaign.inertia_prior import InertiaPrior
    >>> rate = np.random.default_rng(1).normal(scale=1e-5, size=(90, 3))
    >>> rate[40:60] = rate[40]
    >>> slew = Slew("a", 0.0, np.arange(90.0), rate=rate)
    >>> prior, sensor = InertiaPrior(np.eye(3), 0.1, 0.1), RateSensor(sigma=1e-5)
    >>> dirty = Campaign("c", prior, (), sensor, None, (slew,))
    >>> [(d.kind, len(d.rows)) for d in with_dirt_masked(dirty).dirt]
    [('stuck', 20)]
    """
    slews: list[Slew] = []
    dirt = list(campaign.dirt)
    for slew in campaign.slews:
        dirt += gap_records(slew)
        masked, records = _without_impossible(slew, campaign.wheels)
        saturated = _saturated(campaign, masked)
        dirt += records + saturated
        masked, records = _without_stuck(masked, campaign)
        dirt += records
        slews.append(masked)
    treated = replace(campaign, slews=tuple(slews))
    return replace(treated, dirt=(*dirt, *_quantised(treated)))


def _rows(mask: np.ndarray) -> tuple[int, ...]:
    rows = mask if mask.ndim == 1 else mask.any(axis=1)
    return tuple(np.flatnonzero(rows).tolist())


def _masked(slew: Slew, channel: str, mask: np.ndarray) -> Slew:
    if not mask.any():
        return slew
    values = np.where(mask, np.nan, getattr(slew, channel))
    if channel == "rate":
        return replace(slew, rate=values)
    if channel == "wheel_momentum":
        return replace(slew, wheel_momentum=values)
    return replace(slew, attitude=values)


def _without_impossible(slew: Slew, wheels: tuple[Wheel, ...]) -> tuple[Slew, list[Dirt]]:
    dirt = []
    for channel, name, judge in (
        ("rate", "rate", impossible_rates),
        ("wheel_momentum", "momentum", lambda h: impossible_momentum(h, wheels)),
    ):
        values = getattr(slew, channel)
        mask = np.zeros((0, 0), dtype=bool) if values is None else judge(values)
        if mask.any():
            worst = float(np.nanmax(np.abs(np.where(mask, values, np.nan))))
            note = f"readings up to {worst:.3g}, which nothing can reach"
            dirt.append(Dirt("outliers", name, slew.name, _rows(mask), "masked", note))
            slew = _masked(slew, channel, mask)
    return slew, dirt


def _saturated(campaign: Campaign, slew: Slew) -> list[Dirt]:
    mask = np.isfinite(np.asarray(slew.rate)) & ~campaign.valid_readings(slew)
    if not mask.any():
        return []
    note = f"readings at the sensor's range of {campaign.rate_sensor.range:.4g} rad/s"
    return [Dirt("saturated", "rate", slew.name, _rows(mask), "masked", note)]


def _without_stuck(slew: Slew, campaign: Campaign) -> tuple[Slew, list[Dirt]]:
    dirt = []
    valid = campaign.valid_readings(slew)
    rates = np.where(valid, np.asarray(slew.rate), np.nan)
    masks = {"rate": stuck_readings(rates, campaign.rate_sensor.sigma)}
    if slew.wheel_momentum is not None:
        sigma = [wheel.momentum_sigma for wheel in campaign.wheels]
        masks["wheel_momentum"] = stuck_readings(slew.wheel_momentum, sigma)
    if slew.attitude is not None:
        masks["attitude"] = np.repeat(stuck_fixes(slew.attitude)[:, None], 4, axis=1)
    for channel, mask in masks.items():
        if mask.any():
            rows = _rows(mask)
            note = f"{len(rows)} rows with the same value to the last digit"
            name = "momentum" if channel == "wheel_momentum" else channel
            dirt.append(Dirt("stuck", name, slew.name, rows, "masked", note))
            slew = _masked(slew, channel, mask)
    return slew, dirt


def _quantised(campaign: Campaign) -> list[Dirt]:
    """Channels whose step is larger than their stated noise."""
    sensor: RateSensor = campaign.rate_sensor
    rates = [np.asarray(slew.rate) for slew in campaign.slews]
    momenta = [s.wheel_momentum for s in campaign.slews if s.wheel_momentum is not None]
    channels = {
        "rate": (rates, sensor.sigma, "rad/s"),
        "momentum": (momenta, [w.momentum_sigma for w in campaign.wheels], "N m s"),
    }
    dirt = []
    for channel, (values, sigma, unit) in channels.items():
        steps = {
            k: step
            for k, s in enumerate(sigma)
            if values and s is not None and (step := _step(values, k)) is not None and step > s
        }
        if steps:
            k, step = max(steps.items(), key=lambda item: item[1] / (sigma[item[0]] or np.inf))
            held = quantisation_sigma(step) <= (sigma[k] or 0.0)
            note = (
                f"readings are multiples of {step:.3g} {unit}, whose rounding error "
                f"{quantisation_sigma(step):.3g} the stated noise {sigma[k]:.3g} "
                f"{'holds' if held else 'does not hold'}"
            )
            treated: Treatment = "modelled" if held else "ignored"
            dirt.append(Dirt("quantised", channel, "", (), treated, note))
    return dirt


def _step(values: list[np.ndarray], k: int) -> float | None:
    return quantisation_step(np.concatenate([array[:, k] for array in values]))
