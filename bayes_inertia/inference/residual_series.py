"""Whitened residuals as series over time."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.channel_rows import measured
from bayes_inertia.inference.likelihood import residuals
from bayes_inertia.inference.noise_model import Whitening
from bayes_inertia.inference.point import Point
from bayes_inertia.physics.forward_model import Model


def residual_series(model: Model, point: Point, white: Whitening) -> dict[str, list[np.ndarray]]:
    """Residuals as series over time.

    Returns (rows, components): by channel and slew; NaN where nothing was measured.
    """
    flat = residuals(model.structure, point, model.data, white)
    series = {}
    for channel, values, valid in zip(CHANNELS, flat, measured(model), strict=True):
        shaped = np.where(valid, np.asarray(values).reshape(valid.shape), np.nan)
        series[channel] = list(shaped)
    return series
