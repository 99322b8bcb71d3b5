"""Campaigns drawn from the prior that a diagnosis assumes: truths for `kinds.py`.

Nothing is hidden in half of them, one thing in 45 %, two in 4.5 %, more in the rest. One thing is
any effect of the library, fixed shape or random, or a disturbance from outside the library: all
alike probable. Sizes are what the evidence is averaged over: log-uniform from what these slews can
just not see up to the stated prior (disturbances from outside: from a thirtieth of those of the
other studies to these). Several at once are effects of a fixed shape, which one simulator knows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from analyses.naming.fixed_shape import NAMES
from analyses.naming.fixed_shape_campaigns import (
    amplitude_for,
    direction,
    draw,
    scaled,
    template_campaign,
    without_tachometers,
)
from analyses.naming.second_simulator import replayed
from analyses.naming.stochastic_campaigns import (
    OF_TACHOMETERS,
    RANDOM,
    median_size,
    powers_of,
    random_campaign,
)
from analyses.naming.unlisted_disturbances import KINDS, outside
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.hypothesis_table import (
    log_prior_of_set,
    smallest_size,
)
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.physics.effects import by_name

_AT_MOST = 3  # hidden at once
_OUTSIDE_SHARE = 1.0 / 30.0  # the smallest disturbance from outside over that of other studies


class DrawnCampaign(NamedTuple):
    """A flight, its telemetry, what is hidden in it, and how large each is.

    Sizes are prior sds of a direction (fixed shape), in the effect's unit (random), or shares of
    those of other studies (outside the library); none where only a test tells them.
    """

    flight: Flight
    campaign: Campaign
    hidden: tuple[str, ...]
    sizes: tuple[float, ...] = ()


def prior_campaign(seed: np.random.SeedSequence, tachometers: bool) -> DrawnCampaign:
    """Draw a campaign from the prior.

    `seed`: of everything in it. `tachometers`: whether it has them.
    """
    flown, chosen = seed.spawn(2)
    rng = np.random.default_rng(chosen)
    of_wheels = () if tachometers else OF_TACHOMETERS
    members = (*NAMES, *(name for name in RANDOM if name not in of_wheels), "no name")
    count = number_of_hidden(rng, len(members))
    picked = tuple(rng.permutation(members if count < 2 else NAMES)[:count].tolist())
    if picked == ("no name",):
        return _from_outside(flown, rng, tachometers)
    if count == 1 and picked[0] in RANDOM:
        size_of_prior = _SizeOfPrior(rng)
        flight, campaign, size = random_campaign(picked[0], size_of_prior, flown, tachometers)
        return DrawnCampaign(flight, campaign, picked, (size,))
    return _with_shapes(picked, flown, rng, tachometers)


def number_of_hidden(rng: np.random.Generator, members: int) -> int:
    """How many things are hidden, as probable as the prior of sets says.

    >>> counts = [number_of_hidden(np.random.default_rng(i), 25) for i in range(400)]
    >>> 0.43 < np.mean(np.array(counts) == 0) < 0.57, max(counts) <= 3
    (True, True)
    """
    sets = np.cumprod([1.0, *((members - k) / (k + 1) for k in range(_AT_MOST))])
    each = np.exp([log_prior_of_set(size, members) for size in range(_AT_MOST + 1)])
    return int(rng.choice(_AT_MOST + 1, p=sets * each / np.sum(sets * each)))


@dataclass(frozen=True)
class _SizeOfPrior:
    """A random effect's size, from its prior."""

    rng: np.random.Generator

    def of(self, kind: str, campaign: Campaign) -> float:
        """The size of an effect in such campaigns [its unit]."""
        (effect,) = by_name([kind])
        (prior,) = effect.parameters(template_campaign())[0].priors
        largest = np.exp(LIMITS.largest_random_size * prior.scale)
        smallest = smallest_size(powers_of(kind, campaign), largest)
        return _log_uniform(smallest, largest, self.rng) * median_size(kind)


def _with_shapes(
    names: tuple[str, ...],
    seed: np.random.SeedSequence,
    rng: np.random.Generator,
    tachometers: bool,
) -> DrawnCampaign:
    effects = by_name(names)
    values, sizes = {}, []
    for effect in effects:
        step = direction(effect, rng, template_campaign())
        invisible = amplitude_for(effect, step, LIMITS.invisible**2, seed, tachometers)
        sizes.append(_log_uniform(min(invisible, LIMITS.largest_start), 1.0, rng))
        values[effect.name] = scaled(step, sizes[-1])
    flight = draw(seed, effects, values, tachometers)
    return DrawnCampaign(flight, flight.campaign, names, tuple(sizes))


def _from_outside(
    seed: np.random.SeedSequence, rng: np.random.Generator, tachometers: bool
) -> DrawnCampaign:
    kind = str(rng.choice(KINDS))
    share = _log_uniform(_OUTSIDE_SHARE, 1.0, rng)
    disturbance = outside(kind, rng)
    disturbance = replace(disturbance, size=share * disturbance.size)
    flight = draw(seed, (), {}, True)
    campaign = replayed(flight, disturbance, rng)
    campaign = campaign if tachometers else without_tachometers(campaign)
    return DrawnCampaign(flight, campaign, (kind,), (share,))


def _log_uniform(least: float, largest: float, rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(least), np.log(largest))))
