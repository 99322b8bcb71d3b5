"""Wheel readings that hold the body's turning too become relative to the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.importing.logged_stream import LoggedStream
from bayes_inertia.importing.mapping import rate_sensor_axes, streams_that_hold
from bayes_inertia.importing.mapping_schema import MappingPart, MomentumStream, SpeedStream


def relative_to_body(
    streams: dict[str, LoggedStream], mapping: MappingPart
) -> dict[str, LoggedStream]:
    """Streams in which wheel momenta and speeds are relative to the body.

    The speed of a wheel in inertial space is that relative to the body plus g.w; its momentum Js
    times that. The rates come between their own readings on straight lines: this is a small term of
    a reading, not a reading.

    Parameters
    ----------
    streams : dict of str to LoggedStream
        All streams.
    mapping : MappingPart
        What they are.

    Returns
    -------
    dict of str to LoggedStream
        All streams; a note says what was taken out.
    """
    result = dict(streams)
    for holds in ("wheel_momentum", "wheel_speed"):
        taken = np.array([float(name in _inertial(mapping, holds)) for name in _names(mapping)])
        if holds not in streams or not taken.any():
            continue
        stream, rate = streams[holds], streams["rate"]
        readings = np.stack([_between(stream.time, rate, k) for k in range(3)], axis=1)
        rate_B = readings @ np.linalg.inv(np.array(rate_sensor_axes(mapping))).T
        axes = np.array([wheel.axis for wheel in mapping.wheels])
        inertias = np.array([wheel.spin_inertia for wheel in mapping.wheels])
        size = taken * (inertias if holds == "wheel_momentum" else 1.0)
        turning = rate_B @ axes.T * size
        largest = float(np.abs(turning).max())
        unit = "N m s" if holds == "wheel_momentum" else "rad/s"
        note = f"the body's turning was taken out, at most {largest:.2g} {unit}"
        result[holds] = replace(stream, values=stream.values - turning, notes=(*stream.notes, note))
    return result


def _names(mapping: MappingPart) -> list[str]:
    return [wheel.name for wheel in mapping.wheels]


def _inertial(mapping: MappingPart, holds: str) -> set[str]:
    """Wheels whose readings hold the body's turning."""
    wheels: set[str] = set()
    for stream in streams_that_hold(mapping, holds):
        if isinstance(stream, MomentumStream | SpeedStream) and stream.relative_to == "inertial":
            wheels |= set(stream.wheels or _names(mapping))
    return wheels


def _between(time: np.ndarray, rate: LoggedStream, axis: int) -> np.ndarray:
    given = np.isfinite(rate.values[:, axis])
    return np.interp(time, rate.time[given], rate.values[given, axis])
