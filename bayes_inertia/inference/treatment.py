"""What is done to a campaign because of dirt: readings left out, noise given its measured shape.

A campaign whose stated noise is replaced by what a diagnosis measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import CorrelatedNoise, RateSensor
from bayes_inertia.campaign.sensors import CHANNELS, STREAMS, stream_named, streams_of
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.fault import Dirt, DirtKind
from bayes_inertia.inference.noise_colour import (
    Colour,
    ColourOfAxis,
    has_one_error,
    rounding_steps,
)
from bayes_inertia.maths.values import json_ready
from bayes_inertia.physics.slew_input import Drive

_SENSORS = {stream.name: stream.sensor for stream in STREAMS}


@dataclass(frozen=True)
class DirtTreatment:
    """What is done to a campaign's telemetry and to the noise it states.

    Parameters
    ----------
    masked : tuple of Dirt
        Readings that are left out, by channel, slew and rows.
    level : mapping of float
        By channel, what its stated noise is multiplied by.
    colour : mapping of Colour
        By channel, correlation and level of its noise where that is correlated in time.
    rounded : tuple of str
        Channels whose noise follows from the step to which readings are rounded.
    by_residuals : tuple of str
        Channels whose level is that of all residuals, not of fast differences alone: their tails
        are heavy, or they are louder at times.
    """

    masked: tuple[Dirt, ...] = ()
    level: Mapping[str, float] = field(default_factory=lambda: dict.fromkeys(CHANNELS, 1.0))
    colour: Mapping[str, Colour] = field(default_factory=dict)
    rounded: tuple[str, ...] = ()
    by_residuals: tuple[str, ...] = ()

    @property
    def is_nothing(self) -> bool:
        """Whether the campaign stays as it is."""
        return not (self.masked or self.colour or self.louder or self.rounded)

    @property
    def louder(self) -> dict[str, float]:
        """Channels whose noise exceeds what is stated, and the factor."""
        return {channel: factor for channel, factor in self.level.items() if factor != 1.0}

    @property
    def dirt(self) -> tuple[Dirt, ...]:
        """The treatment as a record."""
        coloured = [
            self._modelled("coloured", channel, _in_words(colour))
            for channel, colour in self.colour.items()
        ]
        louder = [
            self._modelled("noise_level", channel, self._level_in_words(channel))
            for channel in self.louder
        ]
        return (*self.masked, *coloured, *louder)

    def _modelled(self, kind: DirtKind, channel: str, says: str) -> Dirt:
        """The record of a channel's noise, which is of this kind unless it comes from rounding."""
        kind = "quantised" if channel in self.rounded else kind
        note = f"the noise of the {_SENSORS.get(channel, channel)} is {says}"
        return Dirt(kind, channel, "", (), "modelled", note)

    def _level_in_words(self, channel: str) -> str:
        """A channel's level, and what it holds beside white noise."""
        says = f"{self.level[channel]:.2f} times what is stated"
        if channel in self.rounded:
            return f"{says}, with the rounding of its readings"
        heavy = channel in self.by_residuals
        return f"{says}, with its heavy tails or what is louder at times" if heavy else says

    def json(self) -> dict[str, Any]:
        """The treatment as plain numbers.

        Returns
        -------
        dict
            That `treatment_from` reads.
        """
        colour = {
            channel: {"axes": [axis._asdict() for axis in each.axes], "spacing": each.spacing}
            for channel, each in self.colour.items()
        }
        return json_ready(self) | {"colour": colour}


def treatment_from(content: Mapping[str, Any]) -> DirtTreatment:
    """The treatment that its JSON describes.

    Examples
    --------
    >>> treatment_from(DirtTreatment().json()) == DirtTreatment()
    True
    """
    written = content["colour"] or {}
    # Files of earlier versions state that of the first rate sensor alone.
    written = {"rate": written} if "axes" in written else written
    colour = {
        channel: Colour(tuple(ColourOfAxis(**axis) for axis in each["axes"]), each["spacing"])
        for channel, each in written.items()
    }
    masked = tuple(Dirt(**{**row, "rows": tuple(row["rows"])}) for row in content["masked"])
    rounded, by_residuals = (tuple(content.get(key, ())) for key in ("rounded", "by_residuals"))
    return DirtTreatment(masked, dict(content["level"]), colour, rounded, by_residuals)


def records_of_dirt(campaign: Campaign, treatment: DirtTreatment) -> tuple[Dirt, ...]:
    """All that is wrong with a campaign's telemetry, and what was done about it.

    Returns: A fault that was first ignored and then treated stands once.
    """
    done = {(dirt.kind, dirt.channel) for dirt in treatment.dirt}
    left = [d for d in campaign.dirt if d.treated != "ignored" or (d.kind, d.channel) not in done]
    return (*left, *treatment.dirt)


def treated(campaign: Campaign, treatment: DirtTreatment, drive: Drive) -> Campaign:
    """A campaign without what is masked, its noise as it was measured, with records of both.

    `drive`: what drove the model when the noise was measured.
    """
    if treatment.is_nothing:
        return campaign
    slews = tuple(_masked(campaign, slew, treatment.masked) for slew in campaign.slews)
    steps, dirt = rounding_steps(campaign), records_of_dirt(campaign, treatment)
    shared = tuple(channel for channel in treatment.rounded if has_one_error(steps[channel]))
    campaign = replace(campaign, slews=slews, dirt=dirt, shared_errors=shared)
    for channel, colour in treatment.colour.items():
        stream = stream_named(channel, campaign)
        sensor = _with_colour(stream.hardware(campaign), colour)
        campaign = stream.with_hardware(campaign, sensor)
    return with_measured_noise(campaign, treatment.level, drive) if treatment.louder else campaign


def _masked(campaign: Campaign, slew: Slew, masks: tuple[Dirt, ...]) -> Slew:
    for mask in masks:
        stream = stream_named(mask.channel, campaign)
        if mask.slew == slew.name and (values := stream.of(slew)) is not None:
            gone = np.zeros(values.shape, dtype=bool)
            gone[list(mask.rows)] = True
            slew = stream.masked(slew, gone)
    return slew


def _with_colour(sensor: RateSensor, colour: Colour) -> RateSensor:
    sds, shares = (tuple(getattr(x, key) for x in colour.axes) for key in ("sd", "share"))
    sigma = tuple(sd * stated for sd, stated in zip(sds, sensor.sigma, strict=True))
    return replace(sensor, sigma=sigma, correlated_noise=CorrelatedNoise(shares, colour.times))


def _in_words(colour: Colour) -> str:
    axes = colour.axes
    share, sd = (max(getattr(axis, key) for axis in axes) for key in ("share", "sd"))
    longest = max(t for t, axis in zip(colour.times, axes, strict=True) if axis.share == share)
    return (
        f"correlated in time: {100.0 * share:.0f} % of its variance over {longest:.2g} s; "
        f"its sd is {sd:.2f} times what is stated"
    )


def with_measured_noise(
    campaign: Campaign, factors: Mapping[str, float], drive: Drive = "commanded"
) -> Campaign:
    """The campaign with each sensor's sigma multiplied by what a diagnosis measured of it.

    In the measured drive tachometers have no channel of their own: their noise is in that of the
    rate sensor, and grows with it.

    `drive`: what drove the model when the factors were measured. Returns: the same telemetry with
    the sigmas of its sensors multiplied.
    """
    factors = factors if drive == "commanded" else {**factors, "momentum": factors["rate"]}
    for stream in streams_of(campaign):
        campaign = stream.louder(campaign, factors.get(stream.name, 1.0))
    return campaign
