"""Signals over time of free shape: what unit values at knots would do to the residuals.

A signal in every slew (a torque on the body or the wheels, an error of a sensor) is given by its
values at knots, a cubic spline between. To first order it moves the residuals linearly.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline

from bayes_inertia.diagnosis.torque_response import TorqueResponse
from bayes_inertia.inference.channel_rows import ChannelRows
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects.scales import torque_scale

_MAX_KNOTS = 200
_MAX_NUMBERS = 2e7  # of one basis, so that it stays below 200 MB
_KNOTS_AT_A_TIME = 24


@array_dataclass
class SignalBasis:
    """What unit values at the knots do to the residuals.

    Parameters
    ----------
    source : str
        What the signal is.
    unit : str
        Its unit.
    time : (slews, knots) array
        Times of the knots [s].
    columns : (slews, numbers, knots * components) array
        Changes of the whitened residuals, knot by knot.
    components : int
        Of the signal.
    scale : float
        Size of one unit of the columns, in `unit`.
    """

    source: str
    unit: str
    time: np.ndarray
    columns: np.ndarray
    components: int
    scale: float


def knots(fit: LinearisedFit, components: int) -> np.ndarray:
    """Place knots evenly over each slew, not closer than its rows.

    Returns (slews, knots) [s].
    """
    time = fit.channels["rate"].time
    rows = np.array([np.count_nonzero(np.diff(t) > 0) + 1 for t in time])
    affordable = int(_MAX_NUMBERS / (fit.residual.size * components))
    k = int(np.clip(np.max(rows), 4, max(8, min(_MAX_KNOTS, affordable))))
    return np.linspace(time[:, 0], time[:, -1], k, axis=1)


def cardinal_splines(times: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Evaluate the cubic splines that are one at one knot and zero at the others.

    `time` (k,) [s]. `times` (n,): times of evaluation [s]; beyond the knots the value at the last
    one holds. Returns (n, k).

    Examples
    --------
    >>> values = cardinal_splines(np.array([0.0, 2.0]), np.arange(5.0))
    >>> values.round(9).tolist() == np.eye(5)[[0, 2]].tolist()
    True
    """
    return make_interp_spline(time, np.eye(len(time)), k=3)(np.clip(times, time[0], time[-1]))


def body_torque(fit: LinearisedFit, response: TorqueResponse) -> SignalBasis:
    """Build the basis of an external torque on the body, body axes."""
    scale = torque_scale(response.estimate.model.campaign)
    time = knots(fit, 3)

    def torque_B(shape: np.ndarray) -> np.ndarray:
        unit = np.einsum("snk,ij->snikj", shape, scale * np.eye(3))
        return unit.reshape(*shape.shape[:2], 3, -1)

    columns = _torque_columns(response, torque_B, _splines_on_grid(response, time))
    return SignalBasis("body torque", "N m", time, columns, 3, scale)


def wheel_torque(fit: LinearisedFit, response: TorqueResponse) -> SignalBasis | None:
    """Build the basis of a torque between body and wheels beyond the commanded one.

    Returns: in N m, counted on the wheel, one component a wheel; None where wheels are not
    predicted.
    """
    campaign, momentum = response.estimate.model.campaign, fit.channels["momentum"]
    if not momentum.valid.any():
        return None
    scale, wheels = torque_scale(campaign), len(campaign.wheels)
    time = knots(fit, wheels)
    splines = _splines_on_grid(response, time)

    def torque_B(shape: np.ndarray) -> np.ndarray:
        unit = np.einsum("snk,iw->snikw", shape, -scale * campaign.wheel_axes_B)
        return unit.reshape(*shape.shape[:2], 3, -1)

    columns = _torque_columns(response, torque_B, splines)
    # The wheel's own momentum takes up the torque.
    white = np.asarray(response.estimate.white.momentum)
    taken_up = scale * np.einsum(
        "snw,snk,wv->snwkv", white, _integrals_at_rows(response, splines), np.eye(wheels)
    )
    columns[:, momentum.part] += taken_up.reshape(*taken_up.shape[:1], -1, columns.shape[-1])
    return SignalBasis("wheel torque", "N m", time, columns, wheels, scale)


def _integrals_at_rows(response: TorqueResponse, splines: np.ndarray) -> np.ndarray:
    """Integrals over time (slews, rows, k) of splines (slews, n, k) on the integration grid."""
    step = np.diff(response.time, axis=1)[..., None]
    integrals = np.concatenate(
        [
            np.zeros_like(splines[:, :1]),
            np.cumsum(0.5 * (splines[:, 1:] + splines[:, :-1]) * step, axis=1),
        ],
        axis=1,
    )
    sample = np.asarray(response.estimate.model.data.arrays.telemetry.sample)
    return integrals[np.arange(len(integrals))[:, None], sample]


def rate_reading(fit: LinearisedFit, response: TorqueResponse) -> SignalBasis:
    """Build the basis of an error of the rate sensor's readings, sensor axes."""
    white = np.asarray(response.estimate.white.rate)
    scale = float(np.max(response.estimate.model.campaign.rate_sensor.sigma))
    return _reading(fit, ("rate sensor", "rad/s"), fit.channels["rate"], white, scale)


def momentum_reading(fit: LinearisedFit, response: TorqueResponse) -> SignalBasis | None:
    """Build the basis of an error of the tachometers' readings.

    Returns: in N m s, one component a wheel; None where wheels are not predicted.
    """
    momentum, white = fit.channels["momentum"], np.asarray(response.estimate.white.momentum)
    if not momentum.valid.any():
        return None
    diagonal = white[..., None] * np.eye(white.shape[-1])
    scale = max(w.momentum_sigma or 0.0 for w in response.estimate.model.campaign.wheels)
    return _reading(fit, ("tachometers", "N m s"), momentum, diagonal, scale)


def _reading(
    fit: LinearisedFit,
    source_and_unit: tuple[str, str],
    rows: ChannelRows,
    white: np.ndarray,
    scale: float,
) -> SignalBasis:
    """An error of one channel's readings, whitened by `white` (slews, rows, c, c)."""
    width = white.shape[-1]
    time = knots(fit, width)
    splines = np.stack(
        [cardinal_splines(times, t) for times, t in zip(rows.time, time, strict=True)]
    )
    readings = scale * np.einsum("snij,snk->snikj", white, splines)
    columns = np.zeros((*fit.residual.shape, time.shape[1] * width))
    columns[:, rows.part] = readings.reshape(len(time), -1, columns.shape[-1])
    return SignalBasis(*source_and_unit, time, columns, width, scale)


def _splines_on_grid(response: TorqueResponse, time: np.ndarray) -> np.ndarray:
    """Splines (slews, n, knots) on the integration grid, which counts from each slew's zero."""
    first = [slew.time[0] for slew in response.estimate.model.campaign.slews]
    return np.stack(
        [
            cardinal_splines(grid + t0, t)
            for grid, t0, t in zip(response.time, first, time, strict=True)
        ]
    )


def _torque_columns(
    response: TorqueResponse, torque_B: Callable[[np.ndarray], np.ndarray], splines: np.ndarray
) -> np.ndarray:
    """Changes of the residuals by the torques on the body that belong to splines."""
    parts = []
    for start in range(0, splines.shape[-1], _KNOTS_AT_A_TIME):
        change = response.residual_change(torque_B(splines[..., start : start + _KNOTS_AT_A_TIME]))
        # What the data gain is what the residuals of the model without it gain.
        parts.append(-np.concatenate([np.asarray(c) for c in change], axis=1))
    return np.concatenate(parts, -1)
