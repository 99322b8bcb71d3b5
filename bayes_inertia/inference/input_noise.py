"""Noise of a model's inputs, estimated and taken out of them (errors in variables).

A gimbal angle or a tachometer that drives the model carries its noise into the predicted rates,
and so into what every effect that is tried does to them: a rate sensor's delay follows the steps
of this noise, a change of the inertia tensor its size where the body hardly turns. Such columns go
along with the residuals, which hold the same noise, and effects are found that are not there.

The rate read at the same time tells what of a residual is the input's: its conditional mean. That
is taken out of the input and put on the readings, so that the residuals and their noise stay what
they were, while what effects do no longer depends on them. What of the noise turns the body is
among the nuisances already.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import fft, sparse
from scipy.sparse.linalg import spsolve

from bayes_inertia.campaign.actuators import GimballedRotors
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.inference.cleaning import refitted
from bayes_inertia.inference.laplace import Estimate, gap_of, plain_series
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.physics.actuators.gimballed_rotors import turning
from bayes_inertia.physics.channels.rate import RateChannel
from bayes_inertia.physics.integration_plan import shapes_of_input_noise
from bayes_inertia.physics.slew_input import Drive


class NoisyInput(NamedTuple):
    """One input of k numbers a reading.

    Parameters
    ----------
    sigma : (k,) array
        Noise of a reading.
    readings : callable
        Of a slew: times (m,) on its clock and values (m, k).
    momentum : callable
        Of values (m, k): what each number adds to the momentum (m, 3, k), per unit.
    less : callable
        A slew without errors (m, k) of these readings.
    """

    sigma: np.ndarray
    readings: Callable[[Slew], tuple[np.ndarray, np.ndarray]]
    momentum: Callable[[np.ndarray], np.ndarray]
    less: Callable[[Slew, np.ndarray], Slew]


def noisy_inputs(campaign: Campaign, drive: Drive) -> tuple[NoisyInput, ...]:
    """The inputs whose noise a campaign states, as a model with this drive takes them.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> [len(noisy_inputs(small_campaign(), drive)) for drive in ("commanded", "measured")]
    [0, 1]
    """
    devices = (d for d in campaign.actuators if isinstance(d, GimballedRotors) and d.angle_sigma)
    found = [_of_gimbals(device) for device in devices]
    sigma = np.array([wheel.momentum_sigma or 0.0 for wheel in campaign.wheels])
    if drive == "measured" and sigma.all() and len(sigma):
        found.append(_of_wheels(sigma, campaign.wheel_axes_B))
    return tuple(found)


def _of_gimbals(device: GimballedRotors) -> NoisyInput:
    """The angles of gimbals."""

    def readings(slew: Slew) -> tuple[np.ndarray, np.ndarray]:
        stream = (slew.inputs or {})[device.name]
        return stream.time, stream.values

    def momentum(angle: np.ndarray) -> np.ndarray:
        return np.swapaxes(np.asarray(device.momentum)[:, None] * turning(device, angle), -1, -2)

    def less(slew: Slew, error: np.ndarray) -> Slew:
        stream = (slew.inputs or {})[device.name]
        better = replace(stream, values=stream.values - error)
        return replace(slew, inputs={**(slew.inputs or {}), device.name: better})

    return NoisyInput(np.full(device.columns, device.angle_sigma), readings, momentum, less)


def _of_wheels(sigma: np.ndarray, axes_B: np.ndarray) -> NoisyInput:
    """Tachometers, at the rows where all wheels are read; axes (3, wheels)."""

    def read(slew: Slew) -> np.ndarray:
        return np.isfinite(np.asarray(slew.wheel_momentum)).all(axis=1)

    def readings(slew: Slew) -> tuple[np.ndarray, np.ndarray]:
        rows = read(slew)
        return slew.time[rows], np.asarray(slew.wheel_momentum)[rows]

    def momentum(values: np.ndarray) -> np.ndarray:
        return np.broadcast_to(axes_B, (len(values), *axes_B.shape))

    def less(slew: Slew, error: np.ndarray) -> Slew:
        better = np.array(slew.wheel_momentum)
        better[read(slew)] -= error
        return replace(slew, wheel_momentum=better)

    return NoisyInput(sigma, readings, momentum, less)


def with_likely_inputs(estimate: Estimate) -> Estimate:
    """The estimate with the noise of its inputs moved to the readings of the rates.

    Returns: the very object where no input has a stated noise, or its campaign has been through
    this: residuals stay, and would be taken for the same noise once more.
    """
    model = estimate.model
    inputs = noisy_inputs(model.campaign, model.structure.drive)
    done = model.campaign.has_likely_inputs
    if done or not inputs or model.structure.free_momenta:
        return estimate
    series = plain_series(estimate)
    shapes = shapes_of_input_noise(model.campaign)
    slews = tuple(_moved(estimate, s, series, inputs, own) for s, own in enumerate(shapes))
    moved = replace(model.campaign, slews=slews, has_likely_inputs=True)
    return replace(refitted(estimate, moved), starts=estimate.starts)


class _Seen(NamedTuple):
    """What one rate sensor says of a slew's inputs.

    `gap` (rows, n): readings less predicted ones, NaN where they say nothing; `noise` (n,): of a
    reading; `acting` (n rows, numbers): what the noise of all inputs does to them.
    """

    channel: RateChannel
    gap: np.ndarray
    noise: np.ndarray
    acting: sparse.csr_array


def _moved(
    estimate: Estimate,
    s: int,
    series: dict[str, list[np.ndarray]],
    inputs: tuple[NoisyInput, ...],
    shapes: np.ndarray,
) -> Slew:
    """A slew with the noise of its inputs on its readings, but for `shapes` [half periods]."""
    slew = estimate.model.campaign.slews[s]
    counts = [len(each.readings(slew)[0]) for each in inputs]
    if min(counts) <= len(shapes):
        return slew
    channels = (c for c in estimate.model.channels if isinstance(c, RateChannel))
    seen = [
        _seen(estimate, s, c, series[c.name][s], inputs)
        for c in channels
        if c.stream.of(slew) is not None
    ]
    sigma = [np.repeat(each.sigma, m) for each, m in zip(inputs, counts, strict=True)]
    ends = np.cumsum([len(of_input) for of_input in sigma])[:-1]
    mean = np.split(_conditional_mean(seen, np.concatenate(sigma)), ends)
    errors = [_others(x.reshape(-1, m), shapes) for x, m in zip(mean, counts, strict=True)]
    for each, error in zip(inputs, errors, strict=True):
        slew = each.less(slew, error.T)
    every = np.concatenate([error.ravel() for error in errors])
    for by in seen:
        shaken = (by.acting @ every).reshape(by.gap.shape[::-1]).T
        slew = by.channel.stream.with_values(slew, by.channel.stream.values(slew) + shaken)
    return slew


def _seen(
    estimate: Estimate, s: int, channel: RateChannel, z: np.ndarray, inputs: tuple[NoisyInput, ...]
) -> _Seen:
    """What a rate sensor says; `z` (rows, n): its residuals in stated sigmas."""
    campaign, slew = estimate.model.campaign, estimate.model.campaign.slews[s]
    z = z[: len(slew.time)]
    believed = np.abs(np.where(np.isfinite(z), z, np.inf)) < LIMITS.believed_residual
    gap = np.where(believed, gap_of(estimate, s, z, channel.name), np.nan)
    shake = channel.shake(campaign, estimate.theta, np.eye(3))
    parts = [_acting(each, *each.readings(slew), slew.time, shake) for each in inputs]
    noise = np.array(channel.stream.sigma(campaign), dtype=float)
    return _Seen(channel, gap, noise, sparse.hstack(parts, format="csr"))


def _acting(
    noisy: NoisyInput, time: np.ndarray, values: np.ndarray, at: np.ndarray, shake: np.ndarray
) -> sparse.csr_array:
    """Rates (axes rows) at times (rows,) per unit of an input's noise (k m): a line between."""
    right = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    share = np.clip((at - time[right - 1]) / (time[right] - time[right - 1]), 0.0, 1.0)
    rows, columns = np.tile(np.arange(len(at)), 2), np.concatenate([right - 1, right])
    line = sparse.csr_array(
        (np.concatenate([1.0 - share, share]), (rows, columns)), shape=(len(at), len(time))
    )
    rates = shake @ noisy.momentum(line @ values)
    n, k = rates.shape[1:]
    blocks = [[line.multiply(rates[:, i, j, None]) for j in range(k)] for i in range(n)]
    return sparse.block_array(blocks, format="csr")


def _conditional_mean(seen: Sequence[_Seen], sigma: np.ndarray) -> np.ndarray:
    """Noise of all inputs (numbers,) of stated sds, given the residuals of all rate sensors."""
    precision, pull = sparse.diags_array(sigma**-2.0, format="csr"), np.zeros(len(sigma))
    for by in seen:
        weight = np.where(np.isfinite(by.gap.T), by.noise[:, None] ** -2.0, 0.0).ravel()
        precision = precision + by.acting.T @ by.acting.multiply(weight[:, None])
        pull = pull + by.acting.T @ (weight * np.nan_to_num(by.gap.T).ravel())
    return np.asarray(spsolve(sparse.csc_array(precision), pull))


def _others(error: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Noise (k, m) without the shapes that are among the nuisances."""
    shapes = fft.dct(error, axis=1, norm="ortho")
    shapes[:, numbers[numbers < error.shape[1]]] = 0.0
    return fft.idct(shapes, axis=1, norm="ortho")
