"""Distortions of the readings of a raw log, and of what the mapping says of them.

Each takes the log and a generator, and returns the distorted log with its parameters in words.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from analyses.imports.distortions_log import RawLog, Stream
from bayes_inertia.campaign.schema import UNITS

Distorted = tuple[RawLog, str]
Kind = Callable[[RawLog, np.random.Generator], Distorted]

_SENSORS = ("rate", "wheel_momentum", "attitude")
_VECTORS = ("rate", "wheel_torque", "wheel_momentum")
# Stated noise, by stream [rad/s, N m s].
_SIGMA = {"rate": 2e-5, "wheel_momentum": 5e-6}
KNOWN_OFFSETS_S = (18.0, 19.0, 32.184, 37.0, 64.184, 69.184, 3600.0)
_MARKS = {
    "0 0 0 0": ("0",) * 4,
    "-9999": ("-9999",) * 4,
    "NaN": ("NaN",) * 4,
    "0 0 0 1": ("0", "0", "0", "1"),
    "1e10": ("1e10",) * 4,
    "-1": ("-1",) * 4,
}
RPM = 2.0 * np.pi / 60.0  # [rad/s]
_SPEED_UNITS = {"rpm": RPM, "krpm": 1e3 * RPM, "Hz": 60.0 * RPM, "1/min": RPM, "rad/s": 1.0}
_SPEED_UNITS["deg/s"] = np.pi / 180.0
_SPIN_INERTIA = 0.001  # [kg m^2]


def _of(rng: np.random.Generator, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _with_column(stream: Stream, k: int, column: np.ndarray | float) -> np.ndarray:
    values = stream.values.copy()
    values[:, k] = column
    return values


def empty_column(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A column of which every cell is empty."""
    holds, k = _of(rng, _VECTORS), int(rng.integers(3))
    stream = log.streams[holds]
    return log.changed(holds, values=_with_column(stream, k, np.nan)), f"{holds} {stream.names[k]}"


def wheel_off(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A fourth wheel that is off: its cells are zero or empty."""
    what = [_of(rng, (0.0, np.nan)) for _ in range(2)]
    axis = (np.ones(3) / np.sqrt(3.0)).tolist()
    spare = {**log.hardware["wheels"][0], "name": "spare", "axis": axis}
    log = replace(log, hardware={**log.hardware, "wheels": [*log.hardware["wheels"], spare]})
    for holds, value in zip(("wheel_torque", "wheel_momentum"), what, strict=True):
        stream = log.streams[holds]
        values = np.column_stack([stream.values, np.full(len(stream.time), value)])
        log = log.changed(holds, values=values, names=(*stream.names, f"{stream.names[0][0]}4"))
    cells = ["empty" if np.isnan(value) else "0" for value in what]
    return log, f"commands {cells[0]}, tachometer {cells[1]}"


def one_row(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A stream of one row, or of a few."""
    holds, rows = _of(rng, tuple(log.streams)), _of(rng, (1, 1, 2, 5))
    stream = log.streams[holds]
    return log.changed(holds, **vars(stream.taking(np.arange(rows)))), f"{holds}, {rows}"


def held(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A slow sensor that is polled faster: each reading stands several times."""
    holds, factor = _of(rng, _SENSORS), int(rng.integers(2, 9))
    stream = log.streams[holds]
    if holds == "attitude":
        later = np.arange(factor) / factor
        time = (stream.time[:, None] + later).ravel()
        values = np.repeat(stream.values, factor, axis=0)
    else:
        time = stream.time
        # Each slew is a session of its own, so that no reading lasts over a pause.
        session = np.concatenate([[0], np.cumsum(np.diff(time) > 1.0)])
        first = np.searchsorted(session, session)
        values = stream.values[first + (np.arange(len(time)) - first) // factor * factor]
    return log.changed(holds, time=time, values=values, repeats=factor), f"{holds}, {factor} times"


def swapped(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Two columns in the place of each other."""
    holds = _of(rng, tuple(log.streams))
    names = list(log.streams[holds].names)
    i, k = rng.choice(len(names), 2, replace=False).tolist()
    names[i], names[k] = names[k], names[i]
    order = [log.streams[holds].names.index(name) for name in names]
    changed = log.changed(holds, values=log.streams[holds].values[:, order])
    return changed, f"{holds} {names[i]}, {names[k]}"


def one_for_two(log: RawLog, rng: np.random.Generator) -> Distorted:
    """One column for two: in the file, or by its name in the mapping."""
    holds, by_name = _of(rng, _VECTORS), bool(rng.integers(2))
    stream = log.streams[holds]
    i, k = rng.choice(3, 2, replace=False).tolist()
    if by_name:
        names = list(stream.names)
        names[k] = names[i]
        return log.stating(holds, names=names), f"{holds} {names[i]} twice in the mapping"
    copied = log.changed(holds, values=_with_column(stream, k, stream.values[:, i]))
    return copied, f"{holds} {stream.names[k]} = {stream.names[i]}"


def dead(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A column that stays at one value."""
    holds, k = _of(rng, _VECTORS), int(rng.integers(3))
    stream = log.streams[holds]
    value = _of(rng, (0.0, float(stream.values[0, k])))
    changed = log.changed(holds, values=_with_column(stream, k, value))
    return changed, f"{holds} {stream.names[k]} stays {value:.3g}"


def other_sign(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A column with the other sign."""
    holds, k = _of(rng, _VECTORS), int(rng.integers(3))
    stream = log.streams[holds]
    changed = log.changed(holds, values=_with_column(stream, k, -stream.values[:, k]))
    return changed, f"{holds} {stream.names[k]}"


def without_sign(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Tachometers of one or of all wheels without sign."""
    stream, which = log.streams["wheel_momentum"], _of(rng, (0, 1, 2, "all"))
    columns = range(3) if which == "all" else [which]
    values = stream.values.copy()
    values[:, columns] = np.abs(values[:, columns])
    return log.changed("wheel_momentum", values=values), f"wheel {which}"


def rounded(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Readings in steps of a part of their noise to thirty times of it."""
    holds = _of(rng, _SENSORS)
    stream = log.streams[holds]
    if holds == "attitude":
        digits = int(rng.integers(3, 7))
        return log.changed(
            holds, values=np.round(stream.values, digits)
        ), f"{holds}, {digits} digits"
    factor = float(10.0 ** rng.uniform(-0.5, 1.5))
    step = factor * _SIGMA[holds]
    changed = log.changed(holds, values=np.round(stream.values / step) * step)
    return changed, f"{holds}, steps of {factor:.2g} sd"


def shifted_by_scale(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A stream whose clock differs by what time scales and zones do."""
    holds, offset = _of(rng, tuple(log.streams)), _of(rng, KNOWN_OFFSETS_S) * _of(rng, (-1.0, 1.0))
    return log.changed(holds, time=log.streams[holds].time + offset), f"{holds} by {offset:g} s"


def shifted(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A stream whose clock is off by any time."""
    holds = _of(rng, tuple(log.streams))
    offset = float(10.0 ** rng.uniform(-1.3, 1.7)) * _of(rng, (-1.0, 1.0))
    return log.changed(holds, time=log.streams[holds].time + offset), f"{holds} by {offset:.3g} s"


def no_solution(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Attitudes at every row, with a mark where the tracker has no solution."""
    mark, told = _of(rng, tuple(_MARKS)), bool(rng.integers(2))
    stream = log.streams["attitude"]
    time = np.union1d(log.streams["rate"].time, stream.time)
    values = np.full((len(time), 4), np.nan)
    values[np.searchsorted(time, stream.time)] = stream.values
    log = log.changed("attitude", time=time, values=values, mark=_MARKS[mark])
    number = mark.split()[0]
    if told and len(set(mark.split())) == 1 and number != "NaN":
        return log.stating("attitude", missing=float(number)), f"{mark}, told"
    return log, mark


def marked_readings(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Some readings are a mark that the mapping may tell."""
    holds, mark = _of(rng, ("rate", "wheel_momentum")), _of(rng, ("0", "-9999", "NaN", "1e30"))
    share, told = float(rng.uniform(0.005, 0.04)), bool(rng.integers(2))
    stream = log.streams[holds]
    values = np.where(rng.random(len(stream.time))[:, None] < share, np.nan, stream.values)
    log = log.changed(holds, values=values, mark=(mark,) * len(stream.names))
    told = told and mark != "NaN"
    log = log.stating(holds, missing=float(mark)) if told else log
    return log, f"{holds}, {mark} in {share:.1%}{', told' if told else ''}"


def dropouts(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Rows that are lost, one by one or in a block."""
    holds, share = _of(rng, tuple(log.streams)), float(rng.uniform(0.02, 0.3))
    rows, block = len(log.streams[holds].time), bool(rng.integers(2))
    keep = rng.random(rows) > share
    if block:
        first = int(rng.integers(rows))
        keep = (np.arange(rows) - first) % rows >= share * rows
    log = log.changed(holds, **vars(log.streams[holds].taking(keep)))
    return log, f"{holds}, {share:.0%} {'in a block' if block else 'at random'}"


def other_unit(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Readings in another unit, which the mapping tells or not."""
    holds, told = _of(rng, _VECTORS), bool(rng.integers(2))
    stream = log.streams[holds]
    stated = stream.sense["unit"]
    unit = _of(rng, [u for u in UNITS[holds] if u != stated])
    log = log.changed(holds, values=stream.values * UNITS[holds][stated] / UNITS[holds][unit])
    return (log.stating(holds, unit=unit), f"{unit}, told") if told else (log, f"{holds} in {unit}")


def speeds(log: RawLog, rng: np.random.Generator, spin: np.ndarray | None = None) -> Distorted:
    """Tachometers in one unit of speed, stated as another or rightly."""
    stream, units = log.streams["wheel_momentum"], tuple(_SPEED_UNITS)
    unit = _of(rng, units)
    stated = unit if spin is not None or rng.integers(2) else _of(rng, units)
    values = stream.values / _SPIN_INERTIA / _SPEED_UNITS[unit]
    log = log.changed("wheel_momentum", values=values)
    log = log.stating("wheel_momentum", **{"as": "wheel_speed", "unit": stated})
    if spin is not None:
        wheels = zip(log.hardware["wheels"], spin.tolist(), strict=True)
        wrong = [{**w, "spin_inertia": float(f"{w['spin_inertia'] * f:.4g}")} for w, f in wheels]
        log = replace(log, hardware={**log.hardware, "wheels": wrong})
    same = _SPEED_UNITS[unit] == _SPEED_UNITS[stated]
    return log, f"{unit}{'' if same else f' stated as {stated}'}"


def spin_inertia(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A spin inertia that is wrong, of one wheel or of all."""
    factor, which = float(2.0 ** rng.uniform(-1.5, 1.5)), _of(rng, (0, 1, 2, "all", "all"))
    if rng.random() < 0.2:
        factor = _of(rng, (1e-3, 1e3, 10.0, 1e-4))
    wheels = np.arange(len(log.hardware["wheels"]))
    factors = np.where((which == "all") | (wheels == which), factor, 1.0)
    log, unit = speeds(log, rng, factors)
    return log, f"wheel {which} {factor:.3g} times, {unit}"


def other_sense(log: RawLog, rng: np.random.Generator) -> Distorted:
    """The other sense of torques, quaternions or tachometers is stated."""
    holds, words = _of(
        rng,
        (
            ("wheel_torque", {"acts_on": "body"}),
            ("wheel_momentum", {"relative_to": "inertial"}),
            ("attitude", {"maps": "body_to_inertial"}),
            ("attitude", {"scalar": "first"}),
        ),
    )
    return log.stating(holds, **words), ", ".join(f"{k} = {v}" for k, v in words.items())


READINGS: dict[str, Kind] = {
    "empty column": empty_column,
    "wheel off": wheel_off,
    "one row": one_row,
    "held readings": held,
    "columns swapped": swapped,
    "one column for two": one_for_two,
    "dead column": dead,
    "other sign": other_sign,
    "tachometers without sign": without_sign,
    "rounded": rounded,
    "clock of a stream off by a known time": shifted_by_scale,
    "clock of a stream off": shifted,
    "no solution": no_solution,
    "marked readings": marked_readings,
    "dropouts": dropouts,
    "other unit": other_unit,
    "wheel speeds": speeds,
    "spin inertia": spin_inertia,
    "other sense": other_sense,
}
"""Distortions of readings by name."""
