"""Doubtful parts of a campaign, and faults that the check comes across."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import axis_names
from bayes_inertia.campaign.sensors import MOMENTUM, RATE, SensorStream, series_of
from bayes_inertia.conventions.candidates import is_of_earth
from bayes_inertia.conventions.law_data import LinearFit, along_body
from bayes_inertia.conventions.laws import (
    CLOSURE,
    CONSERVATION,
    DIRECTION,
    DRIVE,
    Misfits,
    noise_ratios,
)
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import turn_between, without_mean
from bayes_inertia.conventions.reading import (
    FIELD,
    TORQUE,
    Mistake,
    Reading,
    Stated,
    direction_sensors,
    followed,
    path_of,
    readings_of,
)
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.limits import LIMITS as FAULTS
from bayes_inertia.maths.robust_scale import SD_OVER_MAD

LAWS_IN_WORDS: Mapping[str, str] = {
    CLOSURE: "the integrated rate against the star tracker",
    DIRECTION: "the integrated rate against the direction sensors",
    CONSERVATION: "conservation of momentum",
    DRIVE: "the commanded torque against the tachometers",
}
"""The laws by name, as messages call them."""


def doubtful_places(misfits: Misfits, reading: Reading) -> tuple[str, ...]:
    """Which laws fail, and where, as sentences without full stop."""
    fits = misfits.of(reading)
    return tuple(
        f"{LAWS_IN_WORDS[law]}: {_place(misfits, law, fit)}"
        for law, fit in fits.items()
        if fit.worst > LIMITS.impossible
    )


def _place(misfits: Misfits, law: str, fit: LinearFit) -> str:
    """The slew and axis or wheel that a law fails in most, or what would have to differ for it."""
    row = int(np.argmax(fit.misfit))
    if fit.departure > fit.misfit[row]:
        what = _parameters(misfits, law)[int(np.argmax(np.abs(fit.values)))]
        return f"it holds only with {what} far from what is stated ({fit.departure:.2g} sd)"
    if law == DRIVE:
        wheels = misfits.campaign.wheels
        slew = misfits.slews.names[row // len(wheels)]
        return f"{wheels[row % len(wheels)].name} of {slew} is off by {fit.misfit[row]:.2g} sd"
    names = np.array(misfits.slews.names)
    slew = (names[misfits.slews.with_two_fixes] if law == CLOSURE else names)[row]
    most = int(np.argmax(fit.by_component[row]))
    if law == DIRECTION:
        sensor = direction_sensors(misfits.campaign)[most // 3][0]
        return f"{slew} is off by {fit.misfit[row]:.2g} sd, most the {sensor}"
    return f"{slew} is off by {fit.misfit[row]:.2g} sd, most about {'xyz'[most]}"


def _parameters(misfits: Misfits, law: str) -> list[str]:
    """The uncertain parameters of a law in the order of its regressors, as people call them."""
    axes = [f"{a}{b}" for a in "xyz" for b in "xyz"]
    # Smoothed rates have errors of their own, but no sensor with a K.
    own = misfits.own_axes == len(misfits.campaign.gyro.axes) == 3
    rates = "the rate sensor" if misfits.own_axes else "the rates that all sensors tell"
    bias = [f"a rate bias about {a}" for a in "xyz"]
    wheels = [wheel.name for wheel in misfits.campaign.wheels]
    if law == DRIVE:
        return [f"a {w} of {wheel}" for w in ("gain", "friction") for wheel in wheels]
    if law in (CLOSURE, DIRECTION):
        of_sensors = [
            f"{what} of the {name}"
            for name, _ in direction_sensors(misfits.campaign)
            for what in (*(f"mounting or scale {a}" for a in axes), *(f"offset {a}" for a in "xyz"))
        ]
        what = "K" if own else "scale"
        return [*(f"{what} or misalignment {a} of {rates}" for a in axes), *bias, *of_sensors]
    scales = [f"K{k} of {rates}" for k in (1, 2, 3)]
    if not own:
        scales = [f"the scale about {a} of {rates}" for a in "xyz"]
    changes = [f"J{a} after {c.name}" for c in misfits.campaign.changes for a in axes]
    torques = [f"a torque about {a}" for a in "xyz"]
    # The last is one where something tells torques.
    told = "the gain of the torques that effects tell"
    return [*(f"J{a}" for a in axes), *scales, *bias, *torques, *changes, told]


@dataclass(frozen=True, eq=False)
class Factors:
    """Ratios of measured to commanded wheel momentum."""

    names: tuple[str, ...]  # Of the wheels
    # (wheels,): the factor; 1 where it is within what a gain and friction may be
    values: np.ndarray
    # Whether conservation of momentum sides with the tachometers; None where it does not tell
    commands_are_wrong: bool | None

    def words(self) -> tuple[str, ...]:
        """One sentence for all wheels with one factor; none if no factor is far from 1."""
        groups: dict[float, list[str]] = {}
        for name, value in zip(self.names, self.values, strict=True):
            if value != 1.0:
                known = (f for f in groups if abs(f / value - 1.0) < LIMITS.one_factor)
                groups.setdefault(next(known, value), []).append(name)
        return tuple(self._sentence(value, named) for value, named in groups.items())

    def _sentence(self, value: float, named: Sequence[str]) -> str:
        side = {
            None: "a unit, sign or spin inertia is wrong in one of the two",
            True: "conservation of momentum sides with the tachometers: look at the commands",
            False: "conservation of momentum sides with the commands: look at the unit of the "
            "tachometers and the spin inertia",
        }[self.commands_are_wrong]
        wheels = ", ".join(named)
        larger = "tachometers" if abs(value) > 1.0 else "commands"
        size = max(abs(value), 1.0 / abs(value))
        what = f"differ by a factor of {_rounded(size):.4g} ({larger} are larger)"
        if size < LIMITS.factor:
            what = "have opposite signs"
        elif value < 0.0:
            what += " and have opposite signs"
        return f"commands and tachometers of {wheels} {what}; {side}"

    def mistake(self, campaign: Campaign, stated: Stated) -> Mistake | None:
        """Spin inertias wrong by the factors; None where they do not turn speeds into momentum."""
        speeds = any(entry.key == "wheel_speed" for entry in stated.entries)
        if not speeds or np.all(self.values == 1.0) or np.any(self.values < 0.0):
            return None
        factors = np.array([_rounded(value) for value in self.values])
        wrong = [(w, f) for w, f in zip(campaign.wheels, factors, strict=True) if f != 1.0]
        mended = [(w, float(f"{w.spin_inertia / f:.3g}")) for w, f in wrong]
        back = np.diag(1.0 / factors)
        names = ", ".join(wheel.name for wheel, _ in wrong)
        sizes = (_rounded(max(f, 1.0 / f)) for _, f in wrong)
        said = ", ".join(dict.fromkeys(f"{size:.3g}" for size in sizes))
        return Mistake(
            stated.spin_inertias(mended),
            LIMITS.factor_rarity,
            followed(MOMENTUM.field, back),
            f"the spin inertia of {names} is wrong by a factor of {said}",
        )


def _rounded(factor: float) -> float:
    """A factor, or the whole number, or the inverse of one, that it is within 3 % of."""
    for whole in (factor, 1.0 / factor):
        near = np.round(whole)
        if near != 0.0 and abs(whole / near - 1.0) < LIMITS.one_factor:
            return float(near if whole == factor else 1.0 / near)
    return factor


def factors(misfits: Misfits, reading: Reading) -> Factors | None:
    """Ratios of tachometers to commands, wheel by wheel; None where none is far from 1."""
    slews = misfits.slews
    if slews.momentum is None or slews.impulse is None:
        return None
    seen = without_mean(reading.of(MOMENTUM.field, slews.momentum), slews.valid)
    asked = without_mean(reading.time * reading.of(TORQUE, slews.impulse), slews.valid)
    both = np.sqrt((seen**2).sum((0, 1))), np.sqrt((asked**2).sum((0, 1)))
    sense = np.sign((seen * asked).sum((0, 1)))
    busy = np.maximum(both[0] / max(both[0].max(), 1e-300), both[1] / max(both[1].max(), 1e-300))
    with np.errstate(divide="ignore", invalid="ignore"):
        rough = np.where(busy > LIMITS.idle_wheel, sense * both[0] / both[1], 1.0)
    # Where one of the two stands still but for the last digits there is no factor.
    size = np.abs(rough)
    rough = np.where(
        (size > 1.0 / LIMITS.largest_factor) & (size < LIMITS.largest_factor), rough, 1.0
    )
    fit = misfits.fit(DRIVE, followed(TORQUE, np.diag(rough))(reading))
    assert fit is not None
    wheels = len(rough)
    left = fit.misfit.reshape(-1, wheels).max(axis=0)
    gains = fit.values[:wheels] * LIMITS.gain_sd
    friction = np.abs(fit.values[wheels:])
    exact = (left < LIMITS.suspicious) & (np.abs(gains) < 0.5) & (friction < LIMITS.ordinary)
    values = rough * (1.0 + gains)
    far = np.maximum(np.abs(values), 1.0 / np.maximum(np.abs(values), 1e-300)) > LIMITS.factor
    values = np.where(exact & (far | (values < 0.0)), values, 1.0)
    if np.all(values == 1.0):
        return None
    names = tuple(wheel.name for wheel in misfits.campaign.wheels)
    return Factors(names, values, _side(misfits, reading, values))


def _side(misfits: Misfits, reading: Reading, values: np.ndarray) -> bool | None:
    """Whether conservation of momentum holds with the tachometers, or with what is commanded."""
    with_commands = followed(MOMENTUM.field, np.diag(1.0 / values))(reading)
    fits = [misfits.fit(CONSERVATION, r) for r in (reading, with_commands)]
    if any(fit is None for fit in fits):
        return None
    tachometers, commands = (fit.worst for fit in fits if fit is not None)
    if max(tachometers, commands) < LIMITS.improvement * min(tachometers, commands):
        return None
    return bool(tachometers < commands)


def broken_limits(campaign: Campaign, stated: Stated, holds: Mapping[str, bool]) -> tuple[str, ...]:
    """Limits of the hardware that readings are far beyond; laws that hold prove their units."""
    said = []
    for key, channel, unit, readings, proof in _LIMITS:
        beyond = _beyond(campaign, key, channel)
        if not beyond:
            continue
        name = max(beyond, key=lambda n: beyond[n][0] / beyond[n][1])
        largest, limit = beyond[name]
        place = stated.key(*(("rate_sensor",) if key == "range" else ("wheels", name)), key)
        more = f" (and {len(beyond) - 1} more)" if len(beyond) > 1 and key != "range" else ""
        told = [holds[law] for law in proof if law in holds]
        blame = f"the limit or the unit of {readings} is wrong"
        if told and all(told):
            blame = "the limit is wrong, for the laws of motion hold with this unit"
        said.append(
            f"{place}{more}: {limit:.3g} {unit} is exceeded {largest / limit:.2g} times by "
            f"{readings} (up to {largest:.3g} {unit}); {blame}"
        )
    return tuple(said)


def field_of_no_orbit(campaign: Campaign, stated: Stated) -> Iterator[str]:
    """A magnetic field of a size that the Earth's has in no orbit: no law need show its unit."""
    given = [x for slew in campaign.slews if (x := slew.magnetic_field_N) is not None]
    known = [rows[np.isfinite(rows).all(axis=1)] for rows in given]
    if sum(map(len, known)) and not is_of_earth(known):
        sizes, entries = np.linalg.norm(np.concatenate(known), axis=1), stated.of(FIELD)
        where = path_of(entries[0]) if entries else "magnetic_field_N"
        yield (
            f"{where}: the field is {np.median(sizes):.2g} T, where the Earth's is "
            f"{LIMITS.weakest_field:.0e} to {LIMITS.strongest_field:.0e} T; look at its unit"
        )


_LIMITS = (
    ("max_torque", TORQUE, "N m", "the torque commands", (DRIVE, CONSERVATION)),
    ("max_momentum", MOMENTUM.field, "N m s", "the wheel momentum", (DRIVE, CONSERVATION)),
    ("range", RATE.field, "rad/s", "the rates", (CLOSURE, CONSERVATION)),
)


def _beyond(campaign: Campaign, key: str, channel: str) -> dict[str, tuple[float, float]]:
    """Largest usual reading and limit, by wheel or axis, where the limit is far exceeded."""
    given = [np.abs(values) for values in readings_of(campaign, channel)]
    if not given:
        return {}
    sensor, beyond = campaign.rate_sensor, {}
    stated = [(wheel.name, getattr(wheel, key, None)) for wheel in campaign.wheels]
    if key == "range":
        stated = [(axis, sensor.range if sensor else None) for axis in axis_names(sensor)]
    for k, (name, limit) in enumerate(stated):
        column = np.concatenate([values[:, k] for values in given])
        column = column[np.isfinite(column)]
        # A few outliers are no unit: the limit must be far exceeded in a hundredth of the rows.
        largest = float(np.quantile(column, 0.99)) if len(column) else 0.0
        if limit and largest > LIMITS.far_beyond * limit:
            beyond[name] = (largest, limit)
    return beyond


def dirt_of(
    campaign: Campaign, misfits: Misfits, stated: Reading, reading: Reading
) -> tuple[dict[str, Any], ...]:
    """Everything that was found: by the reader, in the noise, and in the rests ("stale_bias")."""
    by_reader = [dirt.json() for dirt in campaign.dirt]
    found = (_level(campaign, stream) for stream in series_of(campaign))
    levels = [dirt.json() for dirt in found if dirt is not None]
    return (*by_reader, *levels, *_stale_bias(misfits, stated, reading))


def _level(campaign: Campaign, stream: SensorStream) -> Dirt | None:
    ratio = noise_ratios(campaign, stream)
    off = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    if not len(off):
        return None
    worst = float(off[np.argmax(np.abs(np.log(off)))])
    if 1.0 / LIMITS.noise_ratio < worst < LIMITS.noise_ratio:
        return None
    note = f"the noise of the {stream.sensor} in smooth rows is {worst:.2g} times the stated one"
    if worst < 1.0:
        note += " (or it is filtered, and not white)"
    return Dirt("noise_level", stream.name, "", (), "ignored", note)


def _stale_bias(misfits: Misfits, stated: Reading, reading: Reading) -> list[dict[str, Any]]:
    """A rate bias far from the stated one, as the laws tell it, or star-tracker fixes at rest."""
    off = reading.bias_B - stated.bias_B
    if not off.any():
        off = _bias_at_rest(misfits, reading)
    if not off.any():
        return []
    axes = ", ".join(f"{off[k]:.2g} rad/s about {'xyz'[k]}" for k in np.flatnonzero(off))
    note = f"the rate bias is off the stated one by {axes} (body axes)"
    entry = {"kind": "stale_bias", "channel": RATE.name, "slew": "", "rows": []}
    return [{**entry, "treated": "ignored", "note": note}]


def _bias_at_rest(misfits: Misfits, reading: Reading) -> np.ndarray:
    """The rate bias (3,) that fixes at rest tell, 0 where it is not far from the stated one."""
    told = _rest_rates(misfits, reading)
    if not len(told):
        return np.zeros(3)
    bias = np.median(told, axis=0)
    spread = SD_OVER_MAD * np.median(np.abs(told - bias), axis=0) / np.sqrt(len(told))
    sensor, data = misfits.campaign.gyro, misfits.told(reading)
    noise = along_body(data, sensor.sigma) / np.sqrt(FAULTS.rows_for_noise * len(told))
    sd = np.sqrt(along_body(data, sensor.bias_sigma) ** 2 + spread**2 + noise**2)
    return np.where(np.abs(bias) > LIMITS.stale_bias_sds * sd, bias, 0.0)


def _rest_rates(misfits: Misfits, reading: Reading) -> np.ndarray:
    """Sensor's rate less the star tracker's (m, 3) between fixes of each rest [rad/s]."""
    slews, moving = misfits.slews, misfits.motion(reading)
    seen, speed = slews.seen(reading), np.sqrt((moving.rate_B**2).sum(axis=-1))
    told = []
    for k in range(len(slews.time)):
        limit = FAULTS.at_rest * speed[k].max()
        rows = np.flatnonzero(slews.fixes[k])
        for first, last in _rests(rows, speed[k] < limit):
            seconds = slews.time[k, last] - slews.time[k, first]
            turned, true = (turn_between(q[k, first], q[k, last]) for q in (moving.path, seen))
            told.append((turned - true) / (reading.time * seconds))
    return np.array(told)


def _rests(rows: np.ndarray, at_rest: np.ndarray) -> list[tuple[int, int]]:
    """First and last fix of each stretch of moments that is all at rest."""
    # Two fixes share a stretch if no moment between them moves.
    moved = np.cumsum(~at_rest)
    stretches = []
    for number in np.unique(moved[rows[at_rest[rows]]]):
        within = rows[at_rest[rows] & (moved[rows] == number)]
        if len(within) > 1:
            stretches.append((int(within[0]), int(within[-1])))
    return stretches
