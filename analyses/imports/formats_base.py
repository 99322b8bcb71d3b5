"""What the writers of raw logs share: the channels of a campaign, and texts of a mapping."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

DEG = np.degrees(1.0)


@dataclass(frozen=True)
class LogChannels:
    """Readings of all slews, NaN where there is none; SI units, the package's senses."""

    time: np.ndarray  # (rows,) seconds
    rate: np.ndarray  # (rows, width) body rates, torques on the wheels, wheel momenta, quaternions
    torque: np.ndarray
    momentum: np.ndarray
    attitude: np.ndarray

    @property
    def fixed(self) -> np.ndarray:
        """Rows with a fix of the star tracker."""
        return np.isfinite(self.attitude).all(axis=1)


@dataclass(frozen=True)
class Written:
    """A raw log."""

    files: list[Path]  # the files
    streams: str  # the streams of the mapping
    what: str  # clock, units and conventions, in words


@dataclass(frozen=True)
class StreamText:
    """What the streams of a log share in the mapping."""

    file: str  # the file
    time: str  # the table `time`
    table: str = ""  # the table of the file

    def text(self, holds: str, names: Sequence[str], more: str) -> str:
        """One `[[streams]]`."""
        table = f'table = "{self.table}"\n' if self.table else ""
        time = f"time = {self.time}\n" if self.time else ""
        columns = f"names = {json.dumps(list(names))}\n" if names else ""
        files = f'files = ["{self.file}"]\n'
        return f'\n[[streams]]\nholds = "{holds}"\n{files}{table}{time}{columns}{more}\n'


def indexed(name: str, count: int) -> list[str]:
    """Columns of a matrix."""
    return [f"{name}[{i}]" for i in range(count)]


def utc_texts(time: np.ndarray, first: np.datetime64) -> np.ndarray:
    """Dates with microseconds."""
    return np.datetime_as_string(first + np.rint(time * 1e6).astype("m8[us]"), unit="us")


def gps_seconds(time: np.ndarray, first: np.datetime64) -> np.ndarray:
    """Seconds since 1980-01-06; GPS is ahead of UTC by 18 s since 2017."""
    return (first - np.datetime64("1980-01-06", "ns")) / np.timedelta64(1, "s") + 18.0 + time


def three(source: StreamText, names: Mapping[str, Sequence[str]], units: Sequence[str]) -> str:
    """Streams of rate, torque and momentum of one table."""
    rate, torque, momentum = (f'unit = "{unit}"\n' if unit else "" for unit in units)
    return (
        source.text("rate", names["rate"], f'{rate}frame = "body"')
        + source.text("wheel_torque", names["torque"], f'{torque}acts_on = "wheel"')
        + source.text("wheel_momentum", names["momentum"], f'{momentum}relative_to = "body"')
    )


QUATERNION = 'form = "quaternion"\nscalar = "last"\nmaps = "inertial_to_body"\nframe = "body"'


def plain_frame(log: LogChannels) -> pd.DataFrame:
    """All channels beside each other: rates in deg/s, mN m, mN m s, quaternions scalar last."""
    wheels = log.torque.shape[1]
    columns: dict[str, np.ndarray] = {}
    for name, values, factor in (
        ("w", log.rate, DEG),
        ("u", log.torque, 1e3),
        ("h", log.momentum, 1e3),
        ("q", log.attitude, 1.0),
    ):
        count = wheels if name in "uh" else values.shape[1]
        columns |= {f"{name}{i + 1}": factor * values[:, i] for i in range(count)}
    return pd.DataFrame(columns)


def named(frame: pd.DataFrame) -> dict[str, list[str]]:
    """Columns of a plain frame by channel."""
    keys = {"rate": "w", "torque": "u", "momentum": "h", "attitude": "q"}
    return {key: [c for c in frame.columns if c[0] == first] for key, first in keys.items()}


UNITS = ("deg/s", "mN m", "mN m s")


def free_time(first: np.datetime64) -> str:
    """The table `time` of seconds from a date."""
    epoch = f"{np.datetime_as_string(first, unit='s')}Z"
    return f'{{ names = ["t"], kind = "s", epoch = "{epoch}" }}'
