"""Columns that cannot be what they are said to be: dead, one for two, or without a sign.

A reading has noise of its own. So an axis that keeps one value to the last digit while others show
noise is dead, and two columns that agree in their noise are one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import axis_names
from bayes_inertia.campaign.sensors import MOMENTUM, RATE
from bayes_inertia.conventions.laws import Misfits, worst
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.reading import (
    TORQUE,
    Mistake,
    Reading,
    Stated,
    readings_of,
    unmended,
)
from bayes_inertia.conventions.search import Remedy
from bayes_inertia.faults.limits import LIMITS as FAULTS
from bayes_inertia.faults.noise import smooth_noise
from bayes_inertia.faults.quantisation import resolution


def faulty_columns(campaign: Campaign, stated: Stated) -> tuple[str, ...]:
    """Columns that are dead, or one for two, as sentences without full stop."""
    rates, tachometers, commands = _streams(campaign, stated)
    return (
        *_dead_rates(campaign, rates),
        *_copies(rates),
        *_dead_wheels(tachometers, commands),
        *_dead_wheels(commands, tachometers),
        *_copies(tachometers),
    )


def copied_commands(campaign: Campaign, stated: Stated) -> tuple[str, ...]:
    """Commands that are one for two wheels: wrong only where tachometers contradict them."""
    return tuple(_copies(_streams(campaign, stated)[2], 1e-9))


def _streams(campaign: Campaign, stated: Stated) -> list[_Stream]:
    """Rates, tachometers and commands."""
    wheels = [wheel.name for wheel in campaign.wheels]
    axes, sigma = axis_names(campaign.rate_sensor), MOMENTUM.sigma(campaign)
    streams = []
    for field, called, of, noise in (
        (RATE.field, "the rate about", axes, RATE.sigma(campaign)),
        (MOMENTUM.field, "the tachometer of", wheels, sigma),
        (TORQUE, "the command of", wheels, sigma),
    ):
        names = [f"{called} {a} ({stated.column(field, k, a)})" for k, a in enumerate(of)]
        streams.append(_Stream(readings_of(campaign, field), names, noise, field != TORQUE))
    return streams


@dataclass(frozen=True, eq=False)
class _Stream:
    """The readings of all slews of one stream, what its columns are called, and their noise."""

    slews: list[np.ndarray]
    names: list[str]
    sigma: Sequence[float | None]
    has_noise: bool = True  # commands have none

    @cached_property
    def values(self) -> np.ndarray:
        return np.concatenate([np.zeros((0, len(self.names))), *self.slews])

    def column(self, k: int) -> np.ndarray:
        return self.values[np.isfinite(self.values[:, k]), k]

    def dead(self, k: int) -> bool:
        """Whether a column keeps one value to the last digit in every slew."""
        column = self.column(k)
        return len(column) >= FAULTS.rows_for_noise and bool(np.all(column == column[0]))

    def noise(self, k: int) -> float:
        """Noise of a column, median of the slews; NaN where steps or smoothness hide it."""
        stated = self.sigma[k]
        noise = self.seen_noise(k)
        hidden = stated is None or noise < LIMITS.noisy * stated
        hidden = hidden or noise < resolution(self.column(k))
        return float("nan") if hidden else noise

    def seen_noise(self, k: int) -> float:
        """By how much readings differ from those beside them, median of the slews."""
        with np.errstate(invalid="ignore"):
            seen = np.array([smooth_noise(values[:, k]) for values in self.slews])
        return float(np.median(seen[np.isfinite(seen)])) if np.isfinite(seen).any() else 0.0

    def moves(self, k: int) -> bool:
        """Whether a column moves like the one that moves most, and more than noise alone."""
        columns = [self.column(i) for i in range(len(self.names))]
        spread = [np.ptp(column) if len(column) else 0.0 for column in columns]
        if not spread[k] > LIMITS.physical_share * max(spread) > 0.0:
            return False
        noise = self.seen_noise(k) if self.has_noise else 0.0
        return bool(np.std(columns[k]) > LIMITS.moves_beyond_noise * noise)


def _dead_rates(campaign: Campaign, rates: _Stream) -> Iterator[str]:
    axes = range(len(rates.names))
    dead = [k for k in axes if rates.dead(k)]
    why = "while other axes show noise"
    alive = any(np.isfinite(rates.noise(k)) for k in axes)
    if dead and len(dead) == len(axes) and _turned(campaign) > LIMITS.turned_at_rest:
        alive, why = True, "while the star tracker turns"
    for k in dead if alive else ():
        yield f"{_stays(rates, k)}, {why}: a dead axis, or the wrong column"


def _stays(stream: _Stream, k: int) -> str:
    value = stream.column(k)[0] + 0.0
    return f"{stream.names[k]} stays {value:.6g} to the last digit in every slew"


def _turned(campaign: Campaign) -> float:
    """The largest rotation between the first fix of a slew and another [rad]."""
    largest = 0.0
    for slew in campaign.slews:
        if slew.fixes.any() and slew.attitude is not None:
            q = np.asarray(slew.attitude)[slew.fixes]
            cosine = np.clip(np.abs(q @ q[0]), 0.0, 1.0)
            largest = max(largest, float(2.0 * np.arccos(cosine.min())))
    return largest


def _dead_wheels(one: _Stream, other: _Stream) -> Iterator[str]:
    """Columns of wheels that keep one value while the wheel's other stream moves."""
    noisy = any(np.isfinite(one.noise(k)) for k in range(len(one.names)))
    for k in range(len(one.names)):
        why = f"while {other.names[k]} moves"
        if not len(other.values) and noisy and one.dead(k) and one.column(k)[0]:
            # A wheel that is off reads zero; one at speed has the noise of the others.
            why = "while others show noise"
        elif not (one.dead(k) and other.moves(k)):
            continue
        yield f"{_stays(one, k)}, {why}: stuck, or the wrong column"


def _copies(stream: _Stream, share: float | None = None) -> Iterator[str]:
    """Columns that agree in their noise, or to a share of their range, up to a factor."""
    for i, k in combinations(range(len(stream.names)), 2):
        close = LIMITS.copied * stream.noise(i)
        rows = np.isfinite(stream.values[:, [i, k]]).all(axis=1)
        a, b = stream.values[rows][:, [i, k]].T
        size = float(np.ptp(b)) if len(b) else 0.0
        if share is not None and len(a):
            close = share * float(np.ptp(a))
        if not close > 0.0 or len(a) < FAULTS.rows_for_noise or size == 0.0:
            continue
        a, b = a - a.mean(), (b - b.mean()) / size
        slope = float((a @ b) / (b @ b))
        if not np.abs(a - slope * b).max() < close:
            continue
        slope /= size
        factor = "" if abs(slope - 1.0) < 1e-6 else f" times {slope:.4g}"
        if abs(slope + 1.0) < 1e-6:
            factor = " with the other sign"
        yield f"{stream.names[i]} is {stream.names[k]}{factor}, noise and all: one column for two"


def without_sign(misfits: Misfits, reading: Reading, before: float) -> Remedy | None:
    """Tachometers or commands that lost their sign, where signs make all laws hold."""
    slews = misfits.slews
    for field, channel, what, told in (
        ("momentum", MOMENTUM.field, "the tachometers ({}, |h|)", _signs_of_momentum),
        ("impulse", TORQUE, "the torque commands ({}, |u|)", _signs_of_commands),
    ):
        values = getattr(slews, field)
        if values is None or (channel == TORQUE and slews.momentum is None):
            continue
        suspects = _unsigned(misfits.campaign, channel)
        signed = told(misfits, reading, suspects) if suspects.any() else None
        if signed is None:
            continue
        flipped = ~np.isclose(signed, values).all(axis=(0, 1))
        changed: dict[str, Any] = {field: signed}
        after = worst(misfits.with_slews(replace(slews, **changed)).of(reading))
        if flipped.any() and after < min(LIMITS.ordinary, before / LIMITS.improvement):
            wheels = zip(misfits.campaign.wheels, flipped, strict=True)
            names = ", ".join(wheel.name for wheel, hit in wheels if hit)
            words = (
                f"{what.format(names)} have lost their sign: with signs all laws hold, so bring "
                "the columns with their signs"
            )
            return Remedy(Mistake((), LIMITS.column_rarity, unmended, words), before, after)
    return None


def _unsigned(campaign: Campaign, channel: str) -> np.ndarray:
    """Which wheels' columns hold no negative number, but positive ones."""
    values = np.concatenate(readings_of(campaign, channel))
    return (np.nanmin(values, axis=0) >= 0.0) & (np.nanmax(values, axis=0) > 0.0)


def _signs_of_momentum(
    misfits: Misfits, reading: Reading, suspects: np.ndarray
) -> np.ndarray | None:
    """Momentum (S, N, wheels) with the signs that commands tell, else conservation."""
    slews = misfits.slews
    momentum = np.asarray(slews.momentum)
    signed = np.array(momentum)
    for s in range(len(momentum)):
        tried = []
        for signs in product((1.0, -1.0), repeat=int(suspects.sum())):
            start = np.array(momentum[s, 0])
            start[suspects] *= signs
            path = _predicted(misfits, reading, s, start)
            if path is None:
                return None
            off = (np.abs(path) - np.abs(momentum[s]))[slews.valid[s]][:, suspects]
            tried.append((float((off**2).sum()), np.sign(path)))
        sense = min(tried, key=lambda pair: pair[0])[1]
        signed[s][:, suspects] *= np.where(sense == 0.0, 1.0, sense)[:, suspects]
    return signed


def _predicted(misfits: Misfits, reading: Reading, s: int, start: np.ndarray) -> np.ndarray | None:
    """Momentum (N, wheels) of a slew from its start and the commands, else the body's motion."""
    slews = misfits.slews
    if slews.impulse is not None and not _unsigned(misfits.campaign, TORQUE).any():
        return start + reading.time * reading.of(TORQUE, slews.impulse[s])
    axes_B = reading.axes_B
    if axes_B.shape[1] > LIMITS.wheels_felt:
        return None
    moving = misfits.motion(reading)
    body = moving.rate_B[s] @ reading.inertia.T
    total = body[0] + axes_B @ start
    wheels_B = np.einsum("nji,j->ni", moving.to_start[s], total) - body
    return wheels_B @ np.linalg.pinv(axes_B).T


def _signs_of_commands(misfits: Misfits, reading: Reading, suspects: np.ndarray) -> np.ndarray:
    """Impulse (S, N, wheels) of commands with the sense in which the tachometers change."""
    slews = misfits.slews
    step = np.diff(np.asarray(slews.impulse), axis=1)
    sense = np.sign(np.diff(np.asarray(slews.momentum), axis=1))
    signed = np.concatenate([np.zeros_like(step[:, :1]), np.cumsum(step * sense, axis=1)], axis=1)
    return np.where(suspects, signed, np.asarray(slews.impulse))
