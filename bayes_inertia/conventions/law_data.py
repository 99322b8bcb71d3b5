"""What a law is given, and what it leaves: a linear problem whose misfit is judged.

Misfits are in standard deviations of what noise and undisclosed physics may leave (`limits`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import RATE
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import Motion, SampledSlews, without_mean
from bayes_inertia.conventions.reading import Reading, ToldTorques


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Residuals of a linear fit."""

    misfit: np.ndarray  # (S,): root mean square residual of each slew [its sigma]
    # Distance of the parameters from their priors [sd], root mean square over three of them
    departure: float
    values: np.ndarray  # (P,): parameters, in prior standard deviations
    sds: np.ndarray  # (P,): what is left of those standard deviations
    # (S, D): root mean square residual of each component of each slew [its sigma]
    by_component: np.ndarray

    @property
    def worst(self) -> float:
        """The larger of the worst slew's misfit and the departure from the priors [sd]."""
        largest = np.max(self.misfit, initial=self.departure)
        return float("inf") if np.isnan(largest) else float(largest)


@dataclass(frozen=True, eq=False)
class Told:
    """Telemetry in physical units, under a reading."""

    campaign: Campaign  # Hardware and priors
    slews: SampledSlews  # The telemetry
    reading: Reading  # Conventions, stated or supposed
    motion: Motion  # What the rates then tell of the motion
    noise: Mapping[str, np.ndarray]  # Sd of each stream's readings (columns,), in the units stated
    torques: ToldTorques  # On the body, by what is not a wheel
    # (3,): sd of the rate bias [rad/s] where it is supposed to be stale; None for the stated one
    bias_sd: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class LawData:
    """One law as a linear problem: data = regressors x + free c + error."""

    data: np.ndarray  # (S, N, D): what should vanish, or be constant
    # (S, N, D, P): what a prior standard deviation of each uncertain parameter does to it
    regressors: np.ndarray
    free: np.ndarray  # (S, N, D, Q): what is free in every slew
    sigma: np.ndarray  # (S,): what noise and undisclosed physics may leave
    mask: np.ndarray  # (S, N) of bool: which moments count
    # (S, N, D): what one second adds by which the second stream (attitude, wheels, commands) is
    # early; None where no clock is judged
    early: np.ndarray | None = None
    noise: float = 1.0  # Sd of the norm of a moment's error that the sensors' stated noise makes
    # Sd of the logarithms of the moments of inertia, which are regressors 0, 4 and 8; 0 for none
    factors: float = 0.0
    bias_from: int = -1  # Which regressor is the first of three of the rate bias; -1 for none

    def fit(self) -> LinearFit:
        """The fit of all that is uncertain.

        Factors are judged by their logarithms: a tensor a thousand times too small is as far from
        its prior as one a thousand times too large. A factor that is not positive counts as one of
        a thousandth.
        """
        fit = _fitted(self)
        if not self.factors:
            return fit
        values = np.array(fit.values)
        moments = np.maximum(1.0 - self.factors * values[:9:4], 1e-3)
        values[:9:4] = np.log(moments) / self.factors
        return replace(fit, departure=_departure(values))


def _fitted(law: LawData) -> LinearFit:
    """Fit data = regressors x + free c + error, with x from N(0, 1) and c free in every slew.

    Outlying moments lose weight in one round.
    """
    mask, sigma = law.mask, law.sigma
    count = np.maximum(mask.sum(axis=1, keepdims=True), 1)
    weight = mask / np.sqrt(count)
    fit, distance = _weighted(law, weight)
    usual = _usual(distance, mask)
    far = distance / np.maximum(LIMITS.far_moment * usual, 1e-3 * sigma)[:, None]
    trust = 1.0 / (1.0 + far**2)
    trust *= np.sqrt(count) / np.maximum(np.sqrt((trust**2 * mask).sum(1, keepdims=True)), 1e-9)
    return _weighted(law, weight * trust)[0] if trust.max(initial=0.0) > 1.1 else fit


def _usual(distance: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The quantile (S,) of each slew's distances (S, N) that stands for all; 1 without any."""
    # One sort for all slews: a call of `np.quantile` for each takes a sixth of a check.
    last = np.maximum(mask.sum(axis=1) - 1, 0)
    beyond = np.where(mask.any(axis=1, keepdims=True), np.inf, 1.0)
    ordered = np.sort(np.where(mask, distance, beyond), axis=1)
    below = np.floor(LIMITS.far_moment_quantile * last).astype(int)
    low, high = (
        np.take_along_axis(ordered, k[:, None], 1)[:, 0]
        for k in (below, np.minimum(below + 1, last))
    )
    share = LIMITS.far_moment_quantile * last - below
    return low + share * (high - low)


def _weighted(law: LawData, weight: np.ndarray) -> tuple[LinearFit, np.ndarray]:
    """The fit, and the distance (S, N) of each moment from it."""
    data, regressors, free = law.data, law.regressors, law.free
    slews, moments, width = data.shape
    flat = (slews, moments * width, -1)
    w = np.repeat(weight, width, axis=1)[..., None]
    sigma = law.sigma[:, None, None]
    y = data.reshape(flat) * w
    x = regressors.reshape(*flat[:2], regressors.shape[-1]) * w
    if free.shape[-1]:
        basis, sizes = np.linalg.qr(free.reshape(*flat[:2], free.shape[-1]) * w)
        # One direction that does not move leaves the turn about itself untold.
        sizes = np.abs(np.diagonal(sizes, axis1=1, axis2=2))
        basis = basis * (sizes > 1e-9 * sizes.max(axis=1, keepdims=True))[:, None]
        turned = np.swapaxes(basis, 1, 2)
        y = y - basis @ (turned @ y)
        x = x - basis @ (turned @ x)
    x, y = x / sigma, y / sigma
    # A slew tells at most one number a component, however often it is sampled.
    every = x.reshape(-1, x.shape[-1])
    normal = width * every.T @ every + np.eye(x.shape[-1])
    covariance = np.linalg.inv(normal)
    values = covariance @ (width * every.T @ y.ravel())
    residual = (y - (x @ values)[..., None])[..., 0]
    misfit = np.sqrt(np.einsum("sr,sr->s", residual, residual))
    square = residual.reshape(data.shape) ** 2
    norm = np.sqrt(square.sum(-1)) / np.maximum(weight, 1e-12)
    sds = np.sqrt(np.diag(covariance))
    fit = LinearFit(misfit, _departure(values), values, sds, np.sqrt(square.sum(1)))
    return fit, norm * law.sigma[:, None]


def _departure(values: np.ndarray) -> float:
    """Root mean square, over three of them, of parameters in sds of their priors."""
    return float(np.sqrt(np.sum(values**2) / 3.0))


def integrated_noise(told: Told) -> np.ndarray:
    """Angle (S,) that the noise of the rates adds up to over a slew [rad]."""
    # As stated, whatever the reading: in a larger unit of rate or time all would drown in it.
    slews, rate = told.slews, told.noise[RATE.name]
    steps = {slew.name: slew.rate_step for slew in told.campaign.slews}
    step = np.array([steps[name] for name in slews.names])
    duration = np.ptp(slews.time, axis=1)
    square = np.linalg.norm(rate) ** 2 * step * duration
    lasting: list[tuple[Any, Any]] = list(bias_wander(told))
    if (noise := told.campaign.gyro.correlated_noise) is not None:
        lasting.append((rate * np.sqrt(noise.share), noise.time))
    for sd, time in lasting:
        alike = np.minimum(duration[:, None], 2.0 * np.broadcast_to(time, max(3, np.size(time))))
        square = square + duration * (np.square(sd) * alike).sum(axis=1)
    return np.sqrt(square)


def bias_wander(told: Told) -> tuple[tuple[float, float], ...]:
    """Sd of each stated wandering of a rate bias [rad/s], and how long it lasts [s]."""
    sensor, (begin, end) = told.campaign.gyro, told.campaign.span
    # One bias is estimated for all slews.
    walk = (sensor.rate_random_walk or 0.0) * (end - begin) ** 0.5
    # What is stated in a larger unit must not drown the motion.
    most = LIMITS.stale_share * rms_rate(told)
    return (
        (min(walk, most), np.inf),
        (min(sensor.bias_instability or 0.0, most), sensor.bias_instability_time or 0.0),
    )


def bias_sd_of(told: Told) -> np.ndarray:
    """Sd of the rate bias (3,): what is stated, or more where it may be stale [rad/s]."""
    if told.bias_sd is not None:
        return told.bias_sd
    # A reading in a smaller unit must not drown in a bias that is stated in the larger one.
    rms = rms_rate(told)
    stated = np.minimum(along_body(told, told.campaign.gyro.bias_sigma), rms)
    return np.maximum(stated, LIMITS.bias_share * rms)


def along_body(told: Told, sds: Sequence[float]) -> np.ndarray:
    """Sds (3,) along body axes of what has independent sds along the axes of the rate sensor."""
    return np.sqrt(told.reading.axes_to_body**2 @ np.square(sds))


def scale_sds(told: Told) -> np.ndarray:
    """Sds (3,) of the scale about body axes, of those of the axes of the rate sensor at most."""
    to_body = told.reading.axes_to_body
    axes = np.concatenate([told.reading.rate_axes_B, np.eye(3)])[: to_body.shape[1]]
    return np.abs(to_body * axes.T) @ np.asarray(told.campaign.gyro.scale_factor_sigma)


def rms_rate(told: Told) -> float:
    """Root mean square rate of the campaign [rad/s]."""
    rate_B = told.motion.rate_B[told.slews.valid]
    return float(np.sqrt(np.mean(np.sum(rate_B**2, axis=-1))))


def deviation(vectors: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square distance (S,) of vectors (S, N, D) from their mean, where mask is True."""
    return norm_of(without_mean(vectors, mask), mask)


def norm_of(vectors: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square length (S,) of vectors (S, N, D) where mask is True."""
    count = np.maximum(mask.sum(axis=1), 1)
    return np.sqrt(((vectors * mask[..., None]) ** 2).sum(axis=(1, 2)) / count)


def crossed(angles: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Changes of vectors (S, N, 3) by small rotations (S, N, 3, P)."""
    return np.cross(angles, vectors[..., None], axis=2)


def uncertain_path(told: Told) -> np.ndarray:
    """Rotation (S, N, 3, 12), in the axes of the first moment, by K, misalignment and bias."""
    moving = told.motion
    scale_sd = np.maximum(LIMITS.scale_sd, scale_sds(told))
    sds = np.where(np.eye(3, dtype=bool), scale_sd, LIMITS.misalignment_sd).ravel()
    return np.concatenate([moving.by_scale * sds, moving.by_bias * bias_sd_of(told)], axis=-1)
