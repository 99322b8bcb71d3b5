"""Three laws that telemetry obeys whatever J and K are, and its misfits to them.

Closure: the rate, integrated between star-tracker fixes, is the rotation between them.
Conservation: J w + G h, in axes that do not turn, is constant within a slew.
Drive: the torque commands, integrated, are the momentum that the tachometers read.

Each is linear in what is uncertain (J, K, misalignment, bias, a constant torque, gains, friction),
which is fitted with priors wide enough for anything physical.

Misfits are in standard deviations of what noise and undisclosed physics may leave (`limits`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import SensorStream, series_of
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import (
    Motion,
    SampledSlews,
    angle_of,
    composed,
    motion_of,
    told_impulse,
    turned_back,
    without_mean,
)
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.faults.noise import smooth_noise


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

    def with_factors(self, which: slice, sds: np.ndarray) -> LinearFit:
        """The same fit, some of whose parameters are factors, judged by their logarithms.

        A tensor a thousand times too small is as far from its prior as one a thousand times too
        large. A factor that is not positive counts as one of a thousandth.

        `which`: the parameters; 1 - sd times value is the factor that the data would have.
        """
        values = np.array(self.values)
        values[which] = np.log(np.maximum(1.0 - sds * values[which], 1e-3)) / sds
        departure = float(np.sqrt(np.sum(values**2) / 3.0))
        return replace(self, departure=departure)

    @property
    def worst(self) -> float:
        """The larger of the worst slew's misfit and the departure from the priors [sd]."""
        largest = np.max(self.misfit, initial=self.departure)
        return float("inf") if np.isnan(largest) else float(largest)


def worst(fits: dict[str, LinearFit]) -> float:
    """The worst misfit of all laws."""
    return max((fit.worst for fit in fits.values()), default=0.0)


def fitted(
    data: np.ndarray,
    regressors: np.ndarray,
    free: np.ndarray,
    sigma: np.ndarray,
    mask: np.ndarray,
) -> LinearFit:
    """Fit data = regressors x + free c + error, with x from N(0, 1) and c free in every slew.

    Shapes and units are those of `LawData`; outlying moments lose weight in one round.
    """
    count = np.maximum(mask.sum(axis=1, keepdims=True), 1)
    weight = mask / np.sqrt(count)
    fit, distance = _weighted(data, regressors, free, sigma, weight)
    rows = zip(distance, mask, strict=True)
    usual = np.array(
        [np.quantile(d[m], LIMITS.far_moment_quantile) if m.any() else 1.0 for d, m in rows]
    )
    far = distance / np.maximum(LIMITS.far_moment * usual, 1e-3 * sigma)[:, None]
    trust = 1.0 / (1.0 + far**2)
    trust *= np.sqrt(count) / np.maximum(np.sqrt((trust**2 * mask).sum(1, keepdims=True)), 1e-9)
    if trust.max(initial=0.0) > 1.1:
        fit, _ = _weighted(data, regressors, free, sigma, weight * trust)
    return fit


def _weighted(
    data: np.ndarray,
    regressors: np.ndarray,
    free: np.ndarray,
    sigma: np.ndarray,
    weight: np.ndarray,
) -> tuple[LinearFit, np.ndarray]:
    """The fit, and the distance (S, N) of each moment from it."""
    slews, moments, width = data.shape
    flat = (slews, moments * width, -1)
    w = np.repeat(weight, width, axis=1)[..., None]
    y = data.reshape(flat) * w
    x = regressors.reshape(*flat[:2], regressors.shape[-1]) * w
    if free.shape[-1]:
        basis = np.linalg.qr(free.reshape(*flat[:2], free.shape[-1]) * w)[0]
        turned = np.swapaxes(basis, 1, 2)
        y = y - basis @ (turned @ y)
        x = x - basis @ (turned @ x)
    x, y = x / sigma[:, None, None], y / sigma[:, None, None]
    # A slew tells at most one number a component, however often it is sampled.
    normal = width * np.einsum("srp,srq->pq", x, x, optimize=True) + np.eye(x.shape[-1])
    covariance = np.linalg.inv(normal)
    values = covariance @ (width * np.einsum("srp,sro->p", x, y, optimize=True))
    residual = (y - (x @ values)[..., None])[..., 0]
    misfit = np.sqrt(np.einsum("sr,sr->s", residual, residual))
    departure = float(np.sqrt(np.sum(values**2) / 3.0))
    square = residual.reshape(data.shape) ** 2
    norm = np.sqrt(square.sum(-1)) / np.maximum(weight, 1e-12)
    sds = np.sqrt(np.diag(covariance))
    fit = LinearFit(misfit, departure, values, sds, np.sqrt(square.sum(1)))
    return fit, norm * sigma[:, None]


def noise_ratios(campaign: Campaign, stream: SensorStream) -> np.ndarray:
    """Noise in smooth rows over the stated noise, one number an axis or wheel; or NaN."""
    stated = _stated(campaign, stream)
    readings = [stream.of(slew) for slew in campaign.slews]
    seen = [[smooth_noise(c) for c in v.T] for v in readings if v is not None and v.shape[1]]
    if not seen or not len(stated):
        return np.zeros(0)
    ratios = np.array(seen) / stated
    return np.array(
        [np.median(r[np.isfinite(r)]) if np.isfinite(r).any() else np.nan for r in ratios.T]
    )


def believed_noise(campaign: Campaign, stream: SensorStream) -> np.ndarray:
    """The stated noise of each axis or wheel, but never much more than the readings show.

    So a reading in a smaller unit has less noise too, and cannot drown in a noise that was stated
    in a larger one.
    """
    stated = np.nan_to_num(_stated(campaign, stream))
    ratio = noise_ratios(campaign, stream)
    if len(ratio) != len(stated):
        return stated
    seen = np.where(np.isfinite(ratio), ratio, 1.0)
    return stated * np.minimum(1.0, LIMITS.noise_believed * seen)


def _stated(campaign: Campaign, stream: SensorStream) -> np.ndarray:
    return np.array([np.nan if s is None else s for s in stream.sigma(campaign)], dtype=float)


CLOSURE, CONSERVATION, DRIVE = "closure", "conservation", "drive"


@dataclass(frozen=True, eq=False)
class Told:
    """Telemetry in physical units, under a reading."""

    campaign: Campaign  # Hardware and priors
    slews: SampledSlews  # The telemetry
    reading: Reading  # Conventions, stated or supposed
    motion: Motion  # What the rates then tell of the motion
    # Sd of the readings of "rate" (3,) and "momentum" (wheels,), in the units stated
    noise: Mapping[str, np.ndarray]
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
    # early
    early: np.ndarray
    noise: float  # Sd of the norm of a moment's error that the sensors' stated noise makes
    # Sd of the logarithms of the moments of inertia, which are regressors 0, 4 and 8; 0 for none
    factors: float = 0.0
    bias_from: int = -1  # Which regressor is the first of three of the rate bias; -1 for none

    def fit(self) -> LinearFit:
        """The fit of all that is uncertain."""
        fit = fitted(self.data, self.regressors, self.free, self.sigma, self.mask)
        if not self.factors:
            return fit
        return fit.with_factors(slice(0, 9, 4), np.full(3, self.factors))


def closure(told: Told) -> LawData | None:
    """Integrated rates against the star tracker."""
    fixes = told.slews.fixes
    some = fixes.sum(axis=1) >= 2
    if not some.any():
        return None
    moving, fixes = told.motion, fixes[some]
    attitude = told.slews.seen(told.reading)[some]
    attitude = np.where(fixes[..., None], attitude, [0.0, 0.0, 0.0, 1.0])
    path = moving.path[some]
    # The attitude of the first moment that each fix implies: one and the same if all is right.
    start = composed(attitude, turned_back(path))
    first = np.argmax(fixes, axis=1)
    reference = start[np.arange(len(start)), first][:, None]
    error = -angle_of(composed(turned_back(reference), start)) * fixes[..., None]
    seen = angle_of(composed(turned_back(_at(attitude, first)), attitude))
    integrated = angle_of(composed(turned_back(_at(path, first)), path))
    size = np.maximum(_deviation(seen, fixes), _deviation(integrated, fixes))
    tracker = told.campaign.star_tracker
    noise = 0.0 if tracker is None else np.hypot(tracker.sigma_cross, tracker.sigma_roll)
    scale_sd = np.maximum(LIMITS.scale_sd, told.campaign.gyro.scale_factor_sigma)
    sds = np.where(np.eye(3, dtype=bool), scale_sd, LIMITS.misalignment_sd).ravel()
    bias = _bias_sd(told)
    regressors = np.concatenate([moving.by_scale * sds, moving.by_bias * bias], axis=-1)[some]
    free = np.broadcast_to(np.eye(3), (*error.shape, 3))
    turning = np.einsum("snij,snj->sni", moving.to_start[some], moving.rate_B[some])
    early = -turning * fixes[..., None]
    sigma = _sigma(size, noise, _integrated_noise(told)[some])
    return LawData(error, regressors, free, sigma, fixes, early, noise, bias_from=sds.size)


def _integrated_noise(told: Told) -> np.ndarray:
    """Angle (S,) that the noise of the rates adds up to over a slew [rad]."""
    # As stated, whatever the reading: in a larger unit of rate or time all would drown in it.
    slews, rate = told.slews, float(np.linalg.norm(told.noise["rate"]))
    steps = {slew.name: float(np.median(slew.rate_steps)) for slew in told.campaign.slews}
    step = np.array([steps[name] for name in slews.names])
    return rate * np.sqrt(step * np.ptp(slews.time, axis=1))


def _at(quaternions: np.ndarray, first: np.ndarray) -> np.ndarray:
    return quaternions[np.arange(len(quaternions)), first][:, None]


def _bias_sd(told: Told) -> np.ndarray:
    """Sd of the rate bias (3,): what is stated, or more where it may be stale [rad/s]."""
    if told.bias_sd is not None:
        return told.bias_sd
    valid = told.slews.valid
    rms = np.sqrt(np.mean(np.sum(told.motion.rate_B[valid] ** 2, axis=-1)))
    # A reading in a smaller unit must not drown in a bias that is stated in the larger one.
    stated = np.minimum(told.campaign.gyro.bias_sigma, rms)
    return np.maximum(stated, LIMITS.bias_share * rms)


def _deviation(vectors: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square distance (S,) of vectors (S, N, D) from their mean, where mask is True."""
    return _norm(without_mean(vectors, mask), mask)


def _sigma(size: np.ndarray, noise: float, *more: np.ndarray) -> np.ndarray:
    """Sd (S,) of what noise and undisclosed physics leave of a motion of this size."""
    idle = LIMITS.idle_share * size.max(initial=0.0)
    square = (LIMITS.physical_share * size) ** 2 + idle**2 + noise**2
    return np.sqrt(square + sum(part**2 for part in more) + 1e-30)


def conservation(told: Told) -> LawData | None:
    """Total momentum in axes that do not turn, rotors and what told torques gave it included."""
    slews, moving = told.slews, told.motion
    to_start, valid = moving.to_start, slews.valid
    wheels_B = wheel_momentum_B(told)
    if wheels_B is None:
        return None
    body = np.einsum("snij,snj->sni", to_start, moving.rate_B @ told.reading.inertia.T)
    torques = told.reading.torques.by_slew
    given = told_impulse(slews, moving, torques)
    stored = np.einsum("snij,snj->sni", to_start, wheels_B) + given[2]
    size = np.maximum(_deviation(body, valid), _deviation(stored, valid))
    if not told.campaign.wheels:
        size = np.maximum(size, _norm(body, valid))
    total = body + stored
    uncertain, doubt = _uncertain_momentum(told, total, size), np.zeros(len(total))
    if torques:
        added, by_prior, _ = given
        total = total - told.reading.time * added
        uncertain = np.concatenate([uncertain, LIMITS.gain_sd * added[..., None]], axis=-1)
        doubt = told.reading.time * np.sqrt(np.mean(by_prior**2, axis=1))
    free = np.broadcast_to(np.eye(3), (*total.shape, 3))
    if slews.momentum is None and told.campaign.wheels:
        # Commands tell the wheels' momentum up to a constant in body axes.
        free = np.concatenate([free, to_start], axis=-1)
    noise = _momentum_noise(told)
    angle = np.minimum(_norm(angle_of(moving.path), valid), 1.0)
    frame = LIMITS.frame_share * angle * _norm(total, valid)
    return LawData(
        total,
        uncertain,
        free,
        _sigma(size, noise, frame, doubt),
        valid,
        early=np.einsum("snij,snj->sni", to_start, _slope(wheels_B, told)),
        noise=noise,
        factors=max(LIMITS.inertia_sd, told.campaign.inertia.relative_sigma),
        bias_from=12,
    )


def _uncertain_momentum(told: Told, total: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Momentum change (S, N, 3, 18) by J, K, bias and a constant torque of one sd each."""
    moving, prior, inertia = told.motion, told.campaign.inertia, told.reading.inertia
    mean = float(np.trace(inertia)) / 3.0
    moments = np.maximum(LIMITS.inertia_sd, prior.relative_sigma) * np.diag(inertia)
    product = min(max(prior.product_sigma, LIMITS.inertia_sd * mean), mean)
    sds = np.where(np.eye(3, dtype=bool), moments[:, None], product)
    by_inertia = np.einsum("snia,snb->sniab", moving.to_start, moving.rate_B) * sds
    scales = np.maximum(LIMITS.frame_share, told.campaign.gyro.scale_factor_sigma)
    by_scale = _crossed(moving.by_scale[..., [0, 4, 8]], total) * scales
    by_bias = _crossed(moving.by_bias, total) + moving.to_start @ inertia
    unseen = told.slews.momentum is None
    share = LIMITS.unseen_friction_share if unseen else LIMITS.torque_share
    torque = share * size / np.maximum(np.abs(moving.duration), 1e-12)
    by_torque = moving.by_bias * torque[:, None, None, None]
    elements = by_inertia.reshape(*by_inertia.shape[:3], 9)
    return np.concatenate([elements, by_scale, by_bias * _bias_sd(told), by_torque], axis=-1)


def _slope(values: np.ndarray, told: Told) -> np.ndarray:
    """Time derivative of values (S, N, D); zero at the repeated moments of the end."""
    steps = np.diff(told.reading.time * told.slews.time, axis=1)[..., None]
    steps = np.where(steps == 0.0, np.inf, steps)
    slopes = np.diff(values, axis=1) / steps
    ends = np.concatenate([slopes[:, :1], slopes], axis=1)
    starts = np.concatenate([slopes, slopes[:, -1:]], axis=1)
    return 0.5 * (ends + starts)


def _norm(vectors: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square length (S,) of vectors (S, N, D) where mask is True."""
    count = np.maximum(mask.sum(axis=1), 1)
    return np.sqrt(((vectors * mask[..., None]) ** 2).sum(axis=(1, 2)) / count)


def _crossed(angles: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Changes of vectors (S, N, 3) by small rotations (S, N, 3, P)."""
    return np.cross(angles, vectors[..., None], axis=2)


def wheel_momentum_B(told: Told) -> np.ndarray | None:
    """The wheels' momentum (S, N, 3) relative to the body, along body axes [N m s].

    From tachometers, else from commands up to a constant in each slew; None without either.
    """
    slews, reading = told.slews, told.reading
    if not reading.axes_B.shape[1]:
        return np.zeros(slews.rate.shape)
    if slews.momentum is not None:
        return slews.momentum @ (reading.axes_B @ reading.momentum).T
    if slews.impulse is not None:
        return reading.time * slews.impulse @ (reading.axes_B @ reading.torque).T
    return None


def _momentum_noise(told: Told) -> float:
    """Noise of J w + G h at one moment [N m s]."""
    body = told.reading.inertia @ told.reading.rate @ np.diag(told.noise["rate"])
    wheels = told.reading.momentum @ told.noise["momentum"]
    return float(np.sqrt((body**2).sum() + (wheels**2).sum()))


def drive(told: Told) -> LawData | None:
    """Commanded torque against the tachometers; each wheel of each slew counts as a slew."""
    slews, reading = told.slews, told.reading
    if slews.momentum is None or slews.impulse is None:
        return None
    h = slews.momentum @ reading.momentum.T
    impulse = reading.time * slews.impulse @ reading.torque.T
    count, _, wheels = h.shape
    seen, commanded = _each_wheel(h), _each_wheel(impulse)
    valid = np.repeat(slews.valid, wheels, axis=0)
    size = np.maximum(_deviation(seen, valid), _deviation(commanded, valid))
    since = slews.time - slews.time[:, :1]
    share = np.repeat(since / np.maximum(since[:, -1:], 1e-12), wheels, axis=0)[..., None]
    which = np.tile(np.eye(wheels), (count, 1))[:, None, None, :]
    regressors = [
        LIMITS.gain_sd * commanded[..., None] * which,
        LIMITS.unseen_friction_share * (share * size[:, None, None])[..., None] * which,
    ]
    noise = float(np.abs(reading.momentum @ told.noise["momentum"]).max(initial=0.0))
    return LawData(
        seen - commanded,
        np.concatenate(regressors, axis=-1),
        np.ones((*seen.shape, 1)),
        _sigma(size, noise),
        valid,
        early=-_each_wheel(_slope(h, told)),
        noise=noise,
    )


def _each_wheel(values: np.ndarray) -> np.ndarray:
    """Values (S, N, wheels) as (S wheels, N, 1)."""
    slews, moments, wheels = values.shape
    return np.swapaxes(values, 1, 2).reshape(slews * wheels, moments, 1)


LAWS: Mapping[str, Callable[[Told], LawData | None]] = {
    CLOSURE: closure,
    CONSERVATION: conservation,
    DRIVE: drive,
}
"""The laws by name."""


@dataclass(frozen=True, eq=False)
class Misfits:
    """The three laws, for a campaign at some sixty moments a slew; results are kept."""

    campaign: Campaign  # Hardware and priors
    slews: SampledSlews  # Its telemetry
    # Whether the rates are smoothed from all sensors: their noise does not show
    smoothed: bool = False
    kept: dict = field(default_factory=dict)

    def with_slews(self, slews: SampledSlews) -> Misfits:
        """The same laws for other telemetry of the campaign."""
        return Misfits(self.campaign, slews, self.smoothed)

    def of(self, reading: Reading) -> dict[str, LinearFit]:
        """The fit of every law that the telemetry can be held against, by its name."""
        fits = {law: self.fit(law, reading) for law in LAWS}
        return {law: fit for law, fit in fits.items() if fit is not None}

    def mends(self, reading: Reading, limit: float) -> bool:
        """Whether a reading brings every law below a limit [sd]; the cheap laws are asked first."""
        return all(
            fit is None or fit.worst < limit
            for fit in (self.fit(law, reading) for law in (DRIVE, CLOSURE, CONSERVATION))
        )

    def motion(self, reading: Reading) -> Motion:
        """The motion that the rates tell."""
        key = ("motion", reading.rate.tobytes(), reading.time, reading.bias_B.tobytes())
        if key not in self.kept:
            self.kept[key] = motion_of(self.slews, reading)
        return self.kept[key]

    def law(self, law: str, reading: Reading, bias_sd: np.ndarray | None = None) -> LawData | None:
        """One law as a linear problem; `bias_sd` (3,) [rad/s] where the rate bias may be stale."""
        return LAWS[law](replace(self.told(reading), bias_sd=bias_sd))

    def told(self, reading: Reading) -> Told:
        """Telemetry in physical units, under a reading."""
        if "noise" not in self.kept:
            series = series_of(self.campaign)
            believed = {s.name: believed_noise(self.campaign, s) for s in series}
            if self.smoothed:
                believed[RATE.name] = np.array(RATE.sigma(self.campaign))
            self.kept["noise"] = believed
        noise = self.kept["noise"]
        motion = self.motion(reading)
        return Told(self.campaign, self.slews, reading, motion, noise)

    def fit(self, law: str, reading: Reading) -> LinearFit | None:
        """The fit of one law; the same reading of the same channels is fitted once."""
        arrays = (getattr(reading, part).tobytes() for part in self.parts_of(law))
        key = (law, reading.time, *arrays)
        if key not in self.kept:
            data = self.law(law, reading)
            self.kept[key] = None if data is None else data.fit()
        return self.kept[key]

    def parts_of(self, law: str) -> tuple[str, ...]:
        """Which fields of a reading, besides time, a law depends on."""
        parts: dict[str, tuple[str, ...]] = {
            CLOSURE: ("rate", "bias_B", "attitude"),
            CONSERVATION: ("rate", "bias_B", "axes_B", "inertia", "torques", self.wheel_channel),
            DRIVE: ("torque", "momentum"),
        }
        return parts[law]

    @property
    def wheel_channel(self) -> str:
        """Which field of a reading tells the wheels' momentum."""
        return "torque" if self.slews.momentum is None else "momentum"
