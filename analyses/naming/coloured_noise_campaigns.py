"""Effects of a fixed shape beside noise that wanders as stated and outliers, for `kinds.py`.

The effect is as large as an ideal test finds in 99 % of the campaigns that have this noise, if
their outliers are left out. Flown by the package's own simulator, which knows all effects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from analyses.naming.fixed_shape_campaigns import (
    amplitude_for,
    degrees_of_freedom,
    direction,
    draw,
    noncentrality,
    scaled,
    template_campaign,
)
from analyses.naming.stochastic_campaigns import (
    LEVEL,
    POWER,
    WanderingNoise,
    wandering_noise,
    with_stated,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.physics.effects import by_name

# Readings of the rates that are far off, in each slew, and by how many of their sigmas.
_OUTLIERS, _FAR = 4, 30.0


def beside_campaign(
    name: str, seed: np.random.SeedSequence, tachometers: bool
) -> tuple[Flight, Campaign, float]:
    """A flight with an effect, its telemetry, and the effect's size in steps of one prior sd."""
    flown, path, chosen, dirt = seed.spawn(4)

    def wandering(campaign: Campaign) -> Campaign:
        # The same noise each time: a size is found with what is flown.
        return _with_wandering(campaign, np.random.default_rng(path))

    (effect,) = by_name([name])
    template = template_campaign()
    values = direction(effect, np.random.default_rng(chosen), template)
    wanted = noncentrality(POWER, degrees_of_freedom(effect, template), LEVEL)
    size = amplitude_for(effect, values, wanted, flown, tachometers, noise=wandering)
    flight = draw(flown, (effect,), {name: scaled(values, size)}, tachometers)
    campaign = _with_outliers(wandering(flight.campaign), np.random.default_rng(dirt))
    return flight, campaign, size


def _with_wandering(campaign: Campaign, rng: np.random.Generator) -> Campaign:
    """The campaign with noise that wanders, stated by it."""
    signals = wandering_noise(rng)
    slews = tuple(_wandered(slew, signals, rng) for slew in campaign.slews)
    return with_stated(replace(campaign, slews=slews), signals)


def _wandered(slew: Slew, signals: WanderingNoise, rng: np.random.Generator) -> Slew:
    error = signals.tracker_error(slew.time > 0.5 * slew.time[-1], rng)
    attitude = np.array(slew.attitude)
    fixed = np.isfinite(attitude).all(1)
    turned = Rotation.from_quat(attitude[fixed]) * Rotation.from_rotvec(error[fixed])
    attitude[fixed] = turned.as_quat()
    rate = slew.rate + signals.rate_error(slew.start + slew.time, rng)
    return replace(slew, rate=rate, attitude=attitude)


def _with_outliers(campaign: Campaign, rng: np.random.Generator) -> Campaign:
    slews = []
    for slew in campaign.slews:
        rate = np.array(slew.rate)
        rows = rng.choice(len(rate), _OUTLIERS, replace=False)
        axes = rng.integers(3, size=_OUTLIERS)
        sigma = np.array(campaign.rate_sensor.sigma)[axes]
        rate[rows, axes] += _FAR * sigma * rng.choice([-1.0, 1.0], _OUTLIERS)
        slews.append(replace(slew, rate=rate))
    return replace(campaign, slews=tuple(slews))
