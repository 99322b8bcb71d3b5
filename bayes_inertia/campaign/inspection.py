"""Faults that each stream of telemetry shows by itself: they are masked where they spoil a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import series_of, streams_of
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults import gaps, impossible, quantisation, saturated, stuck
from bayes_inertia.faults.fault import Dirt

DETECTORS = (gaps.detect, impossible.detect, saturated.detect, stuck.detect)
"""What looks at each stream of each slew, in this order."""


def with_dirt_masked(campaign: Campaign) -> Campaign:
    """The campaign without readings that cannot be real, and with records of all faults.

    Only readings are judged, not whether a model explains them. Impossible and stuck readings
    become NaN; gaps, saturated readings and quantisation are recorded. A campaign without such
    faults stays as it is, to the last digit.
    """
    slews, dirt = [], list(campaign.dirt)
    streams = sorted(streams_of(campaign), key=lambda stream: not stream.is_series)
    for slew in campaign.slews:
        for detect in DETECTORS:
            for stream in streams:
                if stream.of(slew) is None:
                    continue
                for fault in detect(stream.series(campaign, slew)):
                    dirt.append(fault.record(stream.name, slew.name))
                    slew = stream.masked(slew, fault.mask) if fault.masks else slew
        slews.append(slew)
    treated, resting = _with_resting_wheels_locked(replace(campaign, slews=tuple(slews)))
    dirt += resting + _overlaps(campaign.slews)
    return replace(treated, dirt=(*dirt, *_quantised(treated)))


def _overlaps(slews: Sequence[Slew]) -> list[Dirt]:
    """A record where slews overlap in time, which one spacecraft cannot fly."""
    ordered = sorted(slews, key=lambda slew: slew.start)
    for first, second in pairwise(ordered):
        # One may begin with the last row of the other.
        *before, end = first.start + (first.time[-2:] - first.time[0])
        if before and second.start < before[0]:
            note = f"{second.name} begins {end - second.start:.4g} s before {first.name} ends: "
            note += "what drifts through the campaign is seen at wrong times; mend start"
            return [Dirt("clock", "time", second.name, (), "ignored", note)]
    return []


def _with_resting_wheels_locked(campaign: Campaign) -> tuple[Campaign, list[Dirt]]:
    """The campaign where wheels that are off, though nobody says so, are locked; a record each."""
    wheels, dirt = list(campaign.wheels), []
    for k, wheel in enumerate(wheels):
        columns = [
            [x[:, k] for s in campaign.slews if (x := getattr(s, key)) is not None]
            for key in ("wheel_momentum", "wheel_torque")
        ]
        if wheel.state != "running" or not stuck.always_zero(*columns):
            continue
        wheels[k] = replace(wheel, state="locked")
        note = f"{wheel.name} reads exactly 0 in every row and is never commanded: taken as "
        note += 'locked; state = "locked" says so'
        dirt.append(Dirt("stuck", "momentum", "", (), "modelled", note))
    return (replace(campaign, wheels=tuple(wheels)) if dirt else campaign), dirt


def _quantised(campaign: Campaign) -> list[Dirt]:
    """Channels whose step is larger than their stated noise, by the readings of all slews."""
    dirt = []
    for stream in series_of(campaign):
        every = [stream.series(campaign, s) for s in campaign.slews if stream.of(s) is not None]
        if every:
            values = np.concatenate([series.values for series in every])
            found = quantisation.detect(replace(every[0], values=values))
            dirt += [fault.record(stream.name, "") for fault in found]
    return dirt
