"""Campaigns of another simulator with one random effect: truths for `naming_study.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from diagnosis_campaigns import draw, template_campaign, without_tachometers
from independent import Disturbance, replayed

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.physics.effects import by_name

_GRID = np.arange(0.0, 20_000.0, 0.5)  # on which random signals are drawn [s]
_TIME = 20.0  # correlation time of what has one [s]
# Sizes in medians of the effects' priors, weak and strong: log evidence of tens and of hundreds.
SIZES: Mapping[str, tuple[float, float]] = {
    "rate_random_walk": (0.15, 0.6),
    "rate_bias_instability": (0.3, 0.8),
    "rate_bias_slew_drift": (1.0, 4.0),
    "star_tracker_low_frequency": (5.0, 12.0),
    "torque_noise": (0.15, 0.6),
    "wheel_torque_noise": (0.03, 0.15),
    "tachometer_noise_walk": (0.3, 1.0),
}
OF_TACHOMETERS = ("wheel_torque_noise", "tachometer_noise_walk")


def wiener(rng: np.random.Generator) -> np.ndarray:
    """A Wiener process (n, 3) on the grid, zero in the middle of a campaign."""
    steps = np.sqrt(np.diff(_GRID, prepend=0.0))
    path = np.cumsum(steps[:, None] * rng.normal(size=(len(_GRID), 3)), axis=0)
    return path - path[np.searchsorted(_GRID, 1000.0)]


def gauss_markov(rng: np.random.Generator) -> np.ndarray:
    """An Ornstein-Uhlenbeck process (n, 3) of sd 1 on the grid."""
    kept = np.exp(-(_GRID[1] - _GRID[0]) / _TIME)
    fresh = rng.normal(size=(len(_GRID), 3)) * np.sqrt(1.0 - kept**2)
    path = np.zeros_like(fresh)
    path[0] = rng.normal(size=3)
    for k in range(1, len(path)):
        path[k] = kept * path[k - 1] + fresh[k]
    return path


def at(path: np.ndarray, t: np.ndarray | float) -> np.ndarray:
    """A path on the grid at other times (..., 3)."""
    return np.stack([np.interp(t, _GRID, axis) for axis in path.T], -1)


@dataclass(frozen=True)
class RandomSignal(Disturbance):
    """A random signal of one kind; `path` is its process over the campaign's clock."""

    kind: str = ""
    path: np.ndarray | None = None

    def body_torque(self, t, since, rate_B):
        return self.size * at(self.path, t) if self.kind == "torque_noise" else np.zeros(3)

    def rate_error(self, t, rng):
        if self.kind in ("rate_random_walk", "rate_bias_instability"):
            return self.size * at(self.path, t)
        drift = rng.normal(size=3) if self.kind == "rate_bias_slew_drift" else np.zeros(3)
        return self.size * (t - t[0])[:, None] * drift

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


def size_of(kind: str, strength: int) -> float:
    """The size of an effect [its unit]: 0 weak, 1 strong."""
    (effect,) = by_name([kind])
    median = float(np.exp(effect.parameters(template_campaign())[0].priors[0].mean))
    return SIZES[kind][strength] * median


def random_campaign(
    kind: str, strength: int, seed: np.random.SeedSequence, tachometers: bool
) -> tuple[Flight, Campaign]:
    """A flight and its telemetry with one random effect, or none if the kind is "clean"."""
    flown, noise, path = seed.spawn(3)
    flight, rng = draw(flown, (), {}, True), np.random.default_rng(path)
    process = wiener(rng) if kind.endswith("walk") else gauss_markov(rng)
    size = size_of(kind, strength) if kind in SIZES else 0.0
    signal = RandomSignal(size, kind, process)
    known = flight.campaign.slews
    pushed = flight
    if kind == "wheel_torque_noise":
        slews = [
            replace(s, wheel_torque=s.wheel_torque + size * at(process, s.start + s.time))
            for s in known
        ]
        pushed = replace(flight, campaign=replace(flight.campaign, slews=tuple(slews)))
    campaign = replayed(pushed, signal, np.random.default_rng(noise))
    slews = [
        replace(s, wheel_torque=told.wheel_torque)
        for s, told in zip(campaign.slews, known, strict=True)
    ]
    if kind == "tachometer_noise_walk":
        slews = [
            replace(s, wheel_momentum=s.wheel_momentum + size * at(process, s.start + s.time))
            for s in slews
        ]
    campaign = replace(campaign, slews=tuple(slews))
    return flight, campaign if tachometers else without_tachometers(campaign)


def stated_campaign(seed: np.random.SeedSequence, tachometers: bool) -> tuple[Flight, Campaign]:
    """A flight whose noise wanders in every way and by as much as its campaign states."""
    flown, noise, path = seed.spawn(3)
    flight, rng = draw(flown, (), {}, True), np.random.default_rng(path)
    walk, wandering, tracker = (
        RandomSignal(size_of(kind, 1), kind, process)
        for kind, process in (
            ("rate_random_walk", wiener(rng)),
            ("rate_bias_instability", gauss_markov(rng)),
            ("star_tracker_low_frequency", None),
        )
    )
    signals = WanderingNoise(0.0, (walk, wandering, tracker))
    campaign = replayed(flight, signals, np.random.default_rng(noise))
    campaign = replace(
        campaign,
        rate_sensor=replace(
            campaign.rate_sensor,
            rate_random_walk=walk.size,
            bias_instability=wandering.size,
            bias_instability_time=_TIME,
        ),
        star_tracker=replace(campaign.star_tracker, low_frequency_sigma=tracker.size),
    )
    return flight, campaign if tachometers else without_tachometers(campaign)
