"""Noise that wanders and whose size the campaign states.

What the gyro's bias does is filtered out of the readings (`inference.noise_filter`). The star
tracker's low-frequency error is an effect with nothing to estimate.
"""

from __future__ import annotations

from collections.abc import Sequence

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.rate_bias_instability import RateBiasInstability
from bayes_inertia.physics.effects.rate_random_walk import RateRandomWalk
from bayes_inertia.physics.effects.star_tracker_low_frequency import StarTrackerLowFrequency
from bayes_inertia.physics.processes import Process


def stated_noise(campaign: Campaign, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that a model takes by itself, at the size that the campaign states.

    They are integrated out. An effect of the same name among `effects` stands in their place: its
    size is estimated, around the stated one.

    `campaign`: its star tracker says what wanders, and how much. Returns: empty where the noise of
    the star tracker is white.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_noise(small_campaign(), ())
    ()
    """
    tracker = campaign.star_tracker
    if tracker is None or not tracker.low_frequency_sigma:
        return ()
    stated = StarTrackerLowFrequency(tracker.low_frequency_sigma, known=True)
    return () if stated.name in [effect.name for effect in effects] else (stated,)


def stated_reading_noise(campaign: Campaign, effects: Sequence[Effect]) -> tuple[Process, ...]:
    """How the bias of the gyro wanders by what the campaign states.

    `effects`: what a model estimates; a term of an effect's name is left to it.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_reading_noise(small_campaign(), ())
    ()
    """
    estimated = {effect.name for effect in effects}
    return tuple(x for name, x in _of_gyro(campaign).items() if name not in estimated)


def _of_gyro(campaign: Campaign) -> dict[str, Process]:
    """What is stated of the gyro's bias, by the effect that would estimate it."""
    sensor = campaign.rate_sensor
    if sensor is None:
        return {}
    stated = {
        RateRandomWalk.name: Process("rate", sensor.rate_random_walk),
        RateBiasInstability.name: Process(
            "rate", sensor.bias_instability, sensor.bias_instability_time
        ),
    }
    return {name: process for name, process in stated.items() if process.size}


def stated_terms(campaign: Campaign) -> tuple[str, ...]:
    """What a campaign states of noise that wanders.

    `campaign`: of which the rate sensor and the star tracker are looked at. Returns: names of the
    effects that would estimate it; empty where all stated noise is white.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_terms(small_campaign())
    ()
    """
    tracker = campaign.star_tracker
    wandering = tracker is not None and tracker.low_frequency_sigma
    return (*_of_gyro(campaign), *([StarTrackerLowFrequency.name] if wandering else ()))
