"""Noise that wanders and whose size the campaign states.

What the gyro's bias does is filtered out of the readings (`inference.noise_model`). The star
tracker's low-frequency error is an effect with nothing to estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, StarTracker
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.rate_noise import RateBiasInstability, RateRandomWalk
from bayes_inertia.physics.effects.star_tracker_low_frequency import StarTrackerLowFrequency
from bayes_inertia.physics.processes import Process


def stated_noise(campaign: Campaign, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that a model takes by itself, at the size that the campaign states.

    They are integrated out. An effect of the same name among `effects` stands in their place: its
    size is estimated, around the stated one.

    `campaign`: its star trackers say what wanders, and how much. Returns: empty where their noise
    is white.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_noise(small_campaign(), ())
    ()
    """
    trackers = [("", campaign.star_tracker), *campaign.more_sensors]
    stated = (
        StarTrackerLowFrequency(tracker.low_frequency_sigma, known=True, device=name)
        for name, tracker in trackers
        if isinstance(tracker, StarTracker) and tracker.low_frequency_sigma
    )
    estimated = {effect.name for effect in effects}
    return tuple(each for each in stated if each.name not in estimated)


def stated_reading_noise(campaign: Campaign, effects: Sequence[Effect]) -> tuple[Process, ...]:
    """How the biases of gyros wander by what the campaign states.

    `effects`: what a model estimates of the first; a term of an effect's name is left to it.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_reading_noise(small_campaign(), ())
    ()
    """
    estimated = {effect.name for effect in effects}
    first = _of_gyro(RATE.name, campaign.rate_sensor).items()
    further = (_of_gyro(*sensor).values() for sensor in campaign.more_sensors)
    return (*(x for name, x in first if name not in estimated), *chain.from_iterable(further))


def _of_gyro(channel: str, sensor: Any) -> dict[str, Process]:
    """What is stated of a gyro's bias, by the effect that would estimate it; of others nothing."""
    if not isinstance(sensor, RateSensor):
        return {}
    time = sensor.bias_instability_time
    stated = {
        RateRandomWalk.name: Process(channel, sensor.rate_random_walk),
        RateBiasInstability.name: Process(channel, sensor.bias_instability, time),
    }
    return {name: process for name, process in stated.items() if process.size}


def stated_terms(campaign: Campaign) -> tuple[str, ...]:
    """What a campaign states of noise that wanders.

    Returns: names of the effects that would estimate it, of a further sensor with its name; empty
    where all stated noise is white.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_terms(small_campaign())
    ()
    """
    of_gyros = (
        f"{term}[{name}]" if name else term
        for name, sensor in (("", campaign.rate_sensor), *campaign.more_sensors)
        for term in _of_gyro(name, sensor)
    )
    return (*of_gyros, *(effect.name for effect in stated_noise(campaign, ())))
