"""Noise that wanders and whose size the campaign states: effects with nothing to estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.rate_bias_instability import RateBiasInstability
from bayes_inertia.physics.effects.rate_random_walk import RateRandomWalk
from bayes_inertia.physics.effects.star_tracker_low_frequency import StarTrackerLowFrequency


def stated_noise(campaign: Campaign, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The wandering noise that a campaign states, but for what is estimated anyway.

    A model takes these by itself; they are integrated out at their stated size. An effect of the
    same name among `effects` stands in their place: its size is estimated, around the stated one.

    Parameters
    ----------
    campaign : Campaign
        Its rate sensor and star tracker say what wanders, and how much.
    effects : sequence of Effect
        What was asked for.

    Returns
    -------
    tuple of Effect
        Empty where all stated noise is white.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_noise(small_campaign(), ())
    ()
    """
    names = [effect.name for effect in effects]
    return tuple(effect for effect in _stated(campaign) if effect.name not in names)


def _stated(campaign: Campaign) -> Iterator[Effect]:
    sensor, tracker = campaign.rate_sensor, campaign.star_tracker
    if sensor.rate_random_walk:
        yield RateRandomWalk(sensor.rate_random_walk, known=True)
    if sensor.bias_instability:
        sd, time = sensor.bias_instability, sensor.bias_instability_time
        yield RateBiasInstability(sd, time, known=True)
    if tracker is not None and tracker.low_frequency_sigma:
        yield StarTrackerLowFrequency(tracker.low_frequency_sigma, known=True)
