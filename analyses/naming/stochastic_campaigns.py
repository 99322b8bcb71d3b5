"""Campaigns of another simulator with one random effect: for `kinds.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from scipy.signal import lfilter

from analyses.naming.fixed_shape import LEVEL
from analyses.naming.fixed_shape_campaigns import (
    draw,
    plain_fit,
    template_campaign,
    without_tachometers,
)
from analyses.naming.ideal_power import eigenvalues, ideal_size
from analyses.naming.sample_paths import at_times
from analyses.naming.second_simulator import Disturbance, replayed
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.random_signals import STOCHASTIC_CANDIDATES
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.physics.effects import by_name

_SPACING = 0.05  # of the times at which random signals are drawn [s]
_GRID = np.arange(0.0, 20_000.0, _SPACING)
_TIME = 20.0  # correlation time of what has one [s]
_MIDDLE = 1000.0  # where walks are zero: about the middle of a campaign [s]
POWER = 0.99  # of the ideal test
# Sizes in medians of the effects' priors at which noise wanders as stated: easily found.
STATED: Mapping[str, float] = {
    "rate_random_walk": 0.6,
    "rate_bias_instability": 0.8,
    "star_tracker_low_frequency": 12.0,
}
RANDOM = tuple(effect.name for effect in STOCHASTIC_CANDIDATES)
OF_TACHOMETERS = ("wheel_torque_noise", "tachometer_noise_walk")


at = partial(at_times, spacing=_SPACING)


def wiener(rng: np.random.Generator) -> np.ndarray:
    """A Wiener process (n, 3) on the grid, zero about the middle of a campaign."""
    steps = np.sqrt(np.diff(_GRID, prepend=0.0))
    path = np.cumsum(steps[:, None] * rng.normal(size=(len(_GRID), 3)), axis=0)
    return path - path[np.searchsorted(_GRID, _MIDDLE)]


def gauss_markov(rng: np.random.Generator, time: float = _TIME) -> np.ndarray:
    """An Ornstein-Uhlenbeck process (n, 3) of sd 1 on the grid; `time`: of its correlation [s]."""
    kept = np.exp(-(_GRID[1] - _GRID[0]) / time)
    fresh = rng.normal(size=(len(_GRID), 3)) * np.sqrt(1.0 - kept**2)
    fresh[0] = rng.normal(size=3)
    return lfilter([1.0], [1.0, -kept], fresh, axis=0)


@dataclass(frozen=True)
class RandomSignal(Disturbance):
    """A random signal of one kind; `path` is its process over the campaign's clock.

    `alike`: what goes on between slews begins at zero in each of them; a drift is that of each.
    """

    kind: str = ""
    path: np.ndarray | None = None
    alike: bool = False

    def along(self, t: np.ndarray) -> np.ndarray:
        """The process (n, 3) in a slew."""
        path = at(self.path, t)
        return self.size * (path - path[0] if self.alike else path)

    def body_torque(self, t, since, rate_B):
        return self.size * at(self.path, t) if self.kind == "torque_noise" else np.zeros(3)

    def rate_error(self, t, rng):
        if self.kind in ("rate_random_walk", "rate_bias_instability"):
            return self.along(t)
        if self.kind != "rate_bias_slew_drift":
            return np.zeros((len(t), 3))
        drift = rng.normal(size=3)
        return self.size * (t - t[0])[:, None] * (self.path[0] if self.alike else drift)

    def tracker_error(self, late, rng):
        if self.kind != "star_tracker_low_frequency":
            return np.zeros((len(late), 3))
        before, after = rng.normal(size=(2, 3))
        return self.size * np.where(late[:, None], after, before)


@dataclass(frozen=True)
class WanderingNoise(Disturbance):
    """Several random signals of the sensors at once."""

    parts: tuple[RandomSignal, ...] = ()

    def rate_error(self, t, rng):
        return np.sum([part.rate_error(t, rng) for part in self.parts], axis=0)

    def tracker_error(self, late, rng):
        return np.sum([part.tracker_error(late, rng) for part in self.parts], axis=0)


def median_size(kind: str) -> float:
    """The median of the prior of an effect's size [its unit]."""
    (effect,) = by_name([kind])
    return float(np.exp(effect.parameters(template_campaign())[0].priors[0].mean))


def powers_of(kind: str, campaign: Campaign) -> np.ndarray:
    """Information of a random effect as large as its median, by its own directions."""
    (effect,) = by_name([kind])
    return eigenvalues(plain_fit(campaign), effect, _TIME, _MIDDLE)


class RandomDraw(Protocol):
    """What a random effect is in a campaign."""

    def signal(self, kind: str, campaign: Campaign, rng: np.random.Generator) -> RandomSignal:
        """The effect's signal in such a campaign, of a size in its unit."""


@dataclass(frozen=True)
class SizeOfTest:
    """A random effect's size: so many times that which an ideal test finds with a power."""

    power: float = POWER
    times: float = 1.0

    def signal(self, kind: str, campaign: Campaign, rng: np.random.Generator) -> RandomSignal:
        """Of a correlation time of 20 s, if it has one; the kind "clean" has no size."""
        process, size = process_of(kind, rng), 0.0
        if kind in RANDOM:
            size = ideal_size(powers_of(kind, campaign), self.power, LEVEL) * median_size(kind)
        return RandomSignal(self.times * size, kind, process)


def process_of(kind: str, rng: np.random.Generator, time: float = _TIME) -> np.ndarray:
    """The process (n, 3) of a random effect on the grid; `time`: of its correlation [s]."""
    return wiener(rng) if kind.endswith("walk") else gauss_markov(rng, time)


def straight_between(campaign: Campaign, values: np.ndarray) -> np.ndarray:
    """A process (n, 3) on the grid: in each slew straight between values (slews, knots, 3)."""
    path = np.zeros((len(_GRID), 3))
    for slew, own in zip(campaign.slews, values, strict=True):
        begin, end = slew.start + slew.time[[0, -1]]
        first, last = np.searchsorted(_GRID, [begin, end])
        inside, knots = slice(max(first - 1, 0), last + 1), np.linspace(begin, end, len(own))
        path[inside] = np.stack([np.interp(_GRID[inside], knots, x) for x in own.T], -1)
    return path


def random_campaign(
    kind: str, drawn: RandomDraw, seed: np.random.SeedSequence, tachometers: bool
) -> tuple[Flight, Campaign, float]:
    """A flight, its telemetry with one random effect, and the effect's size [its unit]."""
    flown, noise, path = seed.spawn(3)
    flight, rng = draw(flown, (), {}, True), np.random.default_rng(path)
    of_test = flight.campaign if tachometers else without_tachometers(flight.campaign)
    signal = drawn.signal(kind, of_test, rng)
    known, pushed = flight.campaign.slews, flight
    if kind == "wheel_torque_noise":
        slews = [
            replace(s, wheel_torque=s.wheel_torque + signal.along(s.start + s.time)) for s in known
        ]
        pushed = replace(flight, campaign=replace(flight.campaign, slews=tuple(slews)))
    campaign = replayed(pushed, signal, np.random.default_rng(noise))
    slews = [
        replace(s, wheel_torque=told.wheel_torque)
        for s, told in zip(campaign.slews, known, strict=True)
    ]
    if kind == "tachometer_noise_walk":
        slews = [
            replace(s, wheel_momentum=s.wheel_momentum + signal.along(s.start + s.time))
            for s in slews
        ]
    campaign = replace(campaign, slews=tuple(slews))
    return flight, campaign if tachometers else without_tachometers(campaign), signal.size


def wandering_noise(rng: np.random.Generator) -> WanderingNoise:
    """Random signals of rate sensor and star tracker, of the sizes of `STATED`."""
    processes = {
        "rate_random_walk": wiener(rng),
        "rate_bias_instability": gauss_markov(rng),
        "star_tracker_low_frequency": None,
    }
    parts = (
        RandomSignal(STATED[kind] * median_size(kind), kind, process)
        for kind, process in processes.items()
    )
    return WanderingNoise(0.0, tuple(parts))


def with_stated(campaign: Campaign, signals: WanderingNoise) -> Campaign:
    """The campaign that states such noise."""
    size = {part.kind: part.size for part in signals.parts}
    return replace(
        campaign,
        rate_sensor=replace(
            campaign.rate_sensor,
            rate_random_walk=size["rate_random_walk"],
            bias_instability=size["rate_bias_instability"],
            bias_instability_time=_TIME,
        ),
        star_tracker=replace(
            campaign.star_tracker, low_frequency_sigma=size["star_tracker_low_frequency"]
        ),
    )


def stated_campaign(seed: np.random.SeedSequence, tachometers: bool) -> tuple[Flight, Campaign]:
    """A flight whose noise wanders in every way and by as much as its campaign states."""
    flown, noise, path = seed.spawn(3)
    flight, signals = draw(flown, (), {}, True), wandering_noise(np.random.default_rng(path))
    campaign = with_stated(replayed(flight, signals, np.random.default_rng(noise)), signals)
    return flight, campaign if tachometers else without_tachometers(campaign)
