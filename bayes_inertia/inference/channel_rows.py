"""Which numbers of a campaign's residuals belong to which channel, row and component."""

from __future__ import annotations

import numpy as np

from bayes_inertia.maths.device_arrays import repeated
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
    times, telemetry = row_times(model), model.data.arrays.telemetry
    rows, begin = {}, 0
    for channel, readings, valid in zip(
        model.structure.channels, telemetry.readings, measured(model), strict=True
    ):
        part = slice(begin, begin + valid[0].size)
        time = np.take_along_axis(times, np.asarray(readings.row), axis=1)
        rows[channel.name] = ChannelRows(part, time, valid)
        begin = part.stop
    return rows


def row_times(model: Model) -> np.ndarray:
    """Times of the rows of telemetry.

    Returns (slews, n): on each slew's own clock [s], the last one repeated in padding.
    """
    n = model.data.arrays.telemetry.sample.shape[1]
    return np.stack([repeated(slew.time, n, 0) for slew in model.campaign.slews])


def measured(model: Model) -> tuple[np.ndarray, ...]:
    """What the model compares with measurements, by channel (slews, rows, components)."""
    pairs = zip(model.structure.channels, model.data.arrays.telemetry.readings, strict=True)
    return tuple(np.asarray(x.valid, bool)[..., : None if c.compared else 0] for c, x in pairs)
