"""Which numbers of a campaign's residuals belong to which channel, row and component."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model


@array_dataclass
class ChannelRows:
    """One channel's measurements among the numbers of all channels.

    Parameters
    ----------
    part : slice
        Where the channel's numbers stand.
    time : (slews, rows) array
        Times of the measurements [s], the last one repeated in padding.
    valid : (slews, rows, components) array of bool
        What was measured.
    """

    part: slice
    time: np.ndarray
    valid: np.ndarray

    def shaped(self, flat: np.ndarray) -> np.ndarray:
        """Pick this channel out of the numbers of all channels.

        `flat` (slews, numbers, ...): numbers of all channels, one channel after the other. Returns
        (slews, rows, components, ...).
        """
        return flat[:, self.part].reshape(*self.valid.shape, *flat.shape[2:])


def channel_rows(model: Model) -> dict[str, ChannelRows]:
    """Where each channel's numbers are among those of all channels."""
    time = row_times(model)
    fix_time = np.take_along_axis(time, np.asarray(model.data.arrays.telemetry.fix_row), axis=1)
    rows, begin = {}, 0
    for channel, valid in zip(CHANNELS, measured(model), strict=True):
        part = slice(begin, begin + valid[0].size)
        rows[channel] = ChannelRows(part, fix_time if channel == "attitude" else time, valid)
        begin = part.stop
    return rows


def row_times(model: Model) -> np.ndarray:
    """Times of the rows of telemetry.

    Returns (slews, n): on each slew's own clock [s], the last one repeated in padding.
    """
    n = model.data.arrays.telemetry.rate.shape[1]
    return np.stack([np.pad(s.time, (0, n - len(s.time)), "edge") for s in model.campaign.slews])


def measured(model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the model compares with measurements, by channel.

    `model`: in the measured drive tachometers are an input and no channel. Returns `rate, attitude,
    momentum` (slews, rows, components).
    """
    telemetry = model.data.arrays.telemetry
    wheels = 0 if model.structure.drive == "measured" else None
    return (
        np.asarray(telemetry.rate_valid, bool),
        np.repeat(np.asarray(telemetry.fix_valid, bool)[..., None], 3, -1),
        np.asarray(telemetry.momentum_valid, bool)[..., :wheels],
    )
