"""Faults that each stream of telemetry shows by itself: they are masked where they spoil a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.dirt import Dirt, Treatment
from bayes_inertia.campaign.gaps import gap_records
from bayes_inertia.campaign.quantisation import quantisation_sigma, quantisation_step
from bayes_inertia.campaign.sensors import SensorStream, series_of, streams_of
from bayes_inertia.campaign.slew import Slew


def with_dirt_masked(campaign: Campaign) -> Campaign:
    """The campaign without readings that cannot be real, and with records of all faults.

    Only readings are judged, not whether a model explains them. Impossible and stuck readings
    become NaN; gaps, saturated readings and quantisation are recorded. A campaign without such
    faults stays as it is, to the last digit.

    Examples
    --------
    >>> from bayes_inertia.campaign.hardware import RateSensor
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
        dirt += gap_records(slew, series_of(campaign))
        masked, records = _without_impossible(slew, campaign)
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


def _series_first(campaign: Campaign) -> list[SensorStream]:
    return sorted(streams_of(campaign), key=lambda stream: not stream.is_series)


def _without_impossible(slew: Slew, campaign: Campaign) -> tuple[Slew, list[Dirt]]:
    dirt = []
    for stream in _series_first(campaign):
        values = stream.of(slew)
        if values is None or not (mask := stream.impossible(campaign, values)).any():
            continue
        worst = float(np.nanmax(np.abs(np.where(mask, values, np.nan))))
        note = f"readings up to {worst:.3g}, which nothing can reach"
        dirt.append(Dirt("outliers", stream.name, slew.name, _rows(mask), "masked", note))
        slew = stream.masked(slew, mask)
    return slew, dirt


def _saturated(campaign: Campaign, slew: Slew) -> list[Dirt]:
    dirt = []
    for stream in series_of(campaign):
        values = stream.of(slew)
        if values is None:
            continue
        mask = np.isfinite(values) & ~stream.valid(campaign, slew)
        if mask.any():
            limit = f"{stream.hardware(campaign).range:.4g} {stream.unit}"
            note = f"readings at the sensor's range of {limit}"
            dirt.append(Dirt("saturated", stream.name, slew.name, _rows(mask), "masked", note))
    return dirt


def _without_stuck(slew: Slew, campaign: Campaign) -> tuple[Slew, list[Dirt]]:
    dirt, before = [], slew
    for stream in _series_first(campaign):
        if stream.of(slew) is None or not (mask := stream.stuck(campaign, before)).any():
            continue
        rows = _rows(mask)
        note = f"{len(rows)} rows with the same value to the last digit"
        dirt.append(Dirt("stuck", stream.name, slew.name, rows, "masked", note))
        slew = stream.masked(slew, mask)
    return slew, dirt


def _quantised(campaign: Campaign) -> list[Dirt]:
    """Channels whose step is larger than their stated noise."""
    dirt = []
    for stream in series_of(campaign):
        values = [x for slew in campaign.slews if (x := stream.of(slew)) is not None]
        sigma = stream.sigma(campaign)
        steps = {
            k: step
            for k, s in enumerate(sigma)
            if values and s is not None and (step := _step(values, k)) is not None and step > s
        }
        if steps:
            k, step = max(steps.items(), key=lambda item: item[1] / (sigma[item[0]] or np.inf))
            held = quantisation_sigma(step) <= (sigma[k] or 0.0)
            note = (
                f"readings are multiples of {step:.3g} {stream.unit}, whose rounding error "
                f"{quantisation_sigma(step):.3g} the stated noise {sigma[k]:.3g} "
                f"{'holds' if held else 'does not hold'}"
            )
            treated: Treatment = "modelled" if held else "ignored"
            dirt.append(Dirt("quantised", stream.name, "", (), treated, note))
    return dirt


def _step(values: list[np.ndarray], k: int) -> float | None:
    return quantisation_step(np.concatenate([array[:, k] for array in values]))
