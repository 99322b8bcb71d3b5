"""Torque commands between and before their rows: the wheel electronics hold the last one."""

from __future__ import annotations

import numpy as np


def held_commands(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The channels of a slew with a torque in every row: the last command is held.

    Before the first command the torque is unknown, and the motion cannot be told: the slew begins
    at the first command.

    Parameters
    ----------
    channels : dict of str to array
        Channels (n, width) by the name of `Slew`, with "time"; NaN where no command was recorded.

    Returns
    -------
    dict of str to array
        The same from the first command on; as it is without commands, or with one in every row.

    Examples
    --------
    >>> torque = np.array([[np.nan], [0.1], [np.nan], [0.2]])
    >>> held = held_commands({"time": np.arange(4.0), "wheel_torque": torque})
    >>> held["time"].tolist(), held["wheel_torque"][:, 0].tolist()
    ([1.0, 2.0, 3.0], [0.1, 0.1, 0.2])
    """
    torque = channels.get("wheel_torque")
    if torque is None:
        return channels
    known = np.isfinite(torque).all(axis=1)
    if known.all():
        return channels
    first = int(np.argmax(known))
    last = np.maximum.accumulate(np.where(known, np.arange(len(torque)), 0))
    held = {**channels, "wheel_torque": torque[last]}
    return {name: values[first:] for name, values in held.items()}
