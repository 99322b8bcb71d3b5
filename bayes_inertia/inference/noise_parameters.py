"""Which noise a model was asked for, channel by channel, as the likelihood reads it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.physics.channel_noise import NOISE_OWNER
from bayes_inertia.physics.forward_model import Model


class ChannelRule(NamedTuple):
    """One channel's noise; decides compiled code.

    Parameters
    ----------
    heavy : bool
        Whether it is Student-t.
    degrees : float or None
        Degrees of freedom where they are given; infinite for Gaussian noise.
    scale_at, degrees_at : int or None
        Where the scale and the degrees of freedom stand in theta, if they are sampled.
    """

    heavy: bool
    degrees: float | None
    scale_at: int | None
    degrees_at: int | None


NoiseRules = tuple[ChannelRule, ...]


def channel_rules(model: Model) -> NoiseRules:
    """The noise of each channel of a model."""
    place = {name: i for i, name in enumerate(model.space.names)}
    rules = []
    for channel in CHANNELS:
        noise = model.noise.of(channel)
        degrees = noise.degrees if noise.heavy else np.inf
        scale_at, degrees_at = (
            place.get(f"{NOISE_OWNER}.{channel}_{what}") for what in ("scale", "degrees")
        )
        rules.append(ChannelRule(noise.heavy, degrees, scale_at, degrees_at))
    return tuple(rules)


def noise_values(rules: NoiseRules, theta: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Scale and degrees of freedom of each channel.

    `theta` (d,). Returns `scales`: factors on the stated sigmas; 1 where they are not sampled.
    """
    scales = tuple(1.0 if rule.scale_at is None else theta[rule.scale_at] for rule in rules)
    degrees = tuple(
        rule.degrees if rule.degrees_at is None else theta[rule.degrees_at] for rule in rules
    )
    return scales, degrees
