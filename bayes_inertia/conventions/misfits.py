"""Three laws that telemetry obeys whatever J and K are, and by how much a reading breaks them.

Closure: the rate, integrated between star-tracker fixes, is the rotation between them.
Conservation: J w + G h, in axes that do not turn, is constant within a slew.
Drive: the torque commands, integrated, are the momentum that the tachometers read.

Each is linear in what is uncertain (J, K, misalignment, bias, a constant torque, gains, friction),
which is fitted with priors wide enough for anything physical. Misfits are in standard deviations
of what noise and undisclosed physics may leave (`limits`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.conventions import limits
from bayes_inertia.conventions.linear_fit import LinearFit, fitted
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.rotations import (
    accumulated,
    angle_of,
    composed,
    matrix_to_start,
    of_angle,
    turned_back,
)
from bayes_inertia.conventions.sampled_slews import SampledSlews

CLOSURE, CONSERVATION, DRIVE = "closure", "conservation", "drive"


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of all slews under one reading of rate and time.

    Parameters
    ----------
    rate_B : (S, N, 3) array
        Rate of the body [rad/s].
    path : (S, N, 4) array
        Attitude relative to that at the slew's first moment.
    to_start : (S, N, 3, 3) array
        From body axes to those of the first moment.
    by_scale : (S, N, 3, 9) array
        Rotation, in the axes of the first moment, that an error of 1 in each element of the matrix
        from readings to rates adds.
    by_bias : (S, N, 3, 3) array
        The same for a bias of 1 rad/s.
    duration : (S,) array
        Of each slew [s].
    """

    rate_B: np.ndarray
    path: np.ndarray
    to_start: np.ndarray
    by_scale: np.ndarray
    by_bias: np.ndarray
    duration: np.ndarray


@dataclass(frozen=True, eq=False)
class LawData:
    """One law as a linear problem: data = regressors x + free c + error.

    Parameters
    ----------
    data : (S, N, D) array
        What should vanish, or be constant.
    regressors : (S, N, D, P) array
        What a prior standard deviation of each uncertain parameter does to it.
    free : (S, N, D, Q) array
        What is free in every slew.
    sigma : (S,) array
        What noise and undisclosed physics may leave.
    mask : (S, N) array of bool
        Which moments count.
    early : (S, N, D) array
        What one second adds by which the second stream (attitude, wheels, commands) is early.
    noise : float
        Sd of the norm of a moment's error that the sensors' stated noise makes.
    factors : float
        Sd of the logarithms of the moments of inertia, which are regressors 0, 4 and 8; 0 for none.
    """

    data: np.ndarray
    regressors: np.ndarray
    free: np.ndarray
    sigma: np.ndarray
    mask: np.ndarray
    early: np.ndarray
    noise: float
    factors: float = 0.0

    def fit(self) -> LinearFit:
        """The fit of all that is uncertain.

        Returns
        -------
        LinearFit
            Misfits in standard deviations.
        """
        fit = fitted(self.data, self.regressors, self.free, self.sigma, self.mask)
        if not self.factors:
            return fit
        return fit.with_factors(slice(0, 9, 4), np.full(3, self.factors))


@dataclass(frozen=True, eq=False)
class Misfits:
    """The three laws, for a campaign at some sixty moments a slew; results are kept.

    Parameters
    ----------
    campaign : Campaign
        Hardware and priors.
    slews : SampledSlews
        Its telemetry.
    """

    campaign: Campaign
    slews: SampledSlews
    kept: dict = field(default_factory=dict)

    def of(self, reading: Reading) -> dict[str, LinearFit]:
        """The fit of every law that the telemetry can be held against.

        Parameters
        ----------
        reading : Reading
            Conventions, stated or supposed.

        Returns
        -------
        dict of str to LinearFit
            By the name of the law; a law without telemetry is absent.
        """
        fits = {law: self.fit(law, reading) for law in LAWS}
        return {law: fit for law, fit in fits.items() if fit is not None}

    def mends(self, reading: Reading, limit: float) -> bool:
        """Whether a reading brings every law below a limit; the cheap laws are asked first.

        Parameters
        ----------
        reading : Reading
            Conventions supposed.
        limit : float
            Largest misfit allowed [sd].

        Returns
        -------
        bool
            True if all laws hold.
        """
        return all(
            fit is None or fit.worst < limit
            for fit in (self.fit(law, reading) for law in (DRIVE, CLOSURE, CONSERVATION))
        )

    def motion(self, reading: Reading) -> Motion:
        """The motion that the rates tell.

        Parameters
        ----------
        reading : Reading
            Conventions of rate and time.

        Returns
        -------
        Motion
            Of all slews.
        """
        key = ("motion", reading.rate.tobytes(), reading.time)
        if key not in self.kept:
            self.kept[key] = motion(self, reading)
        return self.kept[key]

    def fit(self, law: str, reading: Reading) -> LinearFit | None:
        """The fit of one law; the same reading of the same channels is fitted once.

        Parameters
        ----------
        law : str
            Its name.
        reading : Reading
            Conventions, stated or supposed.

        Returns
        -------
        LinearFit or None
            None if the telemetry says nothing about it.
        """
        parts: dict[str, tuple[str, ...]] = {
            CLOSURE: ("rate", "attitude"),
            CONSERVATION: ("rate", "axes_B", "inertia", self.wheel_channel),
            DRIVE: ("torque", "momentum"),
        }
        arrays = (getattr(reading, part).tobytes() for part in parts[law])
        key = (law, reading.time, *arrays)
        if key not in self.kept:
            data = LAWS[law](self, reading)
            self.kept[key] = None if data is None else data.fit()
        return self.kept[key]

    @property
    def wheel_channel(self) -> str:
        """Which field of a reading tells the wheels' momentum."""
        return "torque" if self.slews.momentum is None else "momentum"


def motion(misfits: Misfits, reading: Reading) -> Motion:
    """The motion that the rates of a reading tell.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions of rate and time.

    Returns
    -------
    Motion
        Of all slews.
    """
    slews, bias = misfits.slews, np.asarray(misfits.campaign.rate_sensor.bias)
    shift = np.linalg.inv(misfits.campaign.rate_sensor.axes) @ bias
    steps = reading.time * np.diff(slews.time, axis=1)[..., None]
    turns = reading.time * np.diff(slews.turn, axis=1) @ reading.rate.T - shift * steps
    path = accumulated(of_angle(turns))
    start = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*path.shape[:1], 1, 4))
    path = np.concatenate([start, path], axis=1)
    to_start = matrix_to_start(path)
    middle = 0.5 * (to_start[:, 1:] + to_start[:, :-1])
    scale = np.einsum("snia,snb->sniab", middle, turns)
    return Motion(
        rate_B=slews.rate @ reading.rate.T - shift,
        path=path,
        to_start=to_start,
        by_scale=_running(scale.reshape(*scale.shape[:3], 9)),
        by_bias=_running(middle * steps[..., None]),
        duration=reading.time * (slews.time[:, -1] - slews.time[:, 0]),
    )


def _running(steps: np.ndarray) -> np.ndarray:
    """Sums along the moments (axis 1), from zero."""
    return np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)


def closure(misfits: Misfits, reading: Reading) -> LawData | None:
    """Integrated rates against the star tracker.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions.

    Returns
    -------
    LawData or None
        None if no slew has two fixes.
    """
    fixes = misfits.slews.fixes
    some = fixes.sum(axis=1) >= 2
    if not some.any():
        return None
    moving, fixes = misfits.motion(reading), fixes[some]
    attitude = np.where(fixes[..., None], misfits.slews.attitude[some], [0.0, 0.0, 0.0, 1.0])
    attitude = attitude @ reading.attitude.T
    path = moving.path[some]
    # The attitude of the first moment that each fix implies: one and the same if all is right.
    start = composed(attitude, turned_back(path))
    first = np.argmax(fixes, axis=1)
    reference = start[np.arange(len(start)), first][:, None]
    error = -angle_of(composed(turned_back(reference), start)) * fixes[..., None]
    seen = angle_of(composed(turned_back(_at(attitude, first)), attitude))
    told = angle_of(composed(turned_back(_at(path, first)), path))
    size = np.maximum(_deviation(seen, fixes), _deviation(told, fixes))
    tracker = misfits.campaign.star_tracker
    noise = 0.0 if tracker is None else np.hypot(tracker.sigma_cross, tracker.sigma_roll)
    sds = np.where(np.eye(3, dtype=bool), _scale_sd(misfits), limits.MISALIGNMENT_SD).ravel()
    bias = _bias_sd(misfits, moving)
    regressors = np.concatenate([moving.by_scale * sds, moving.by_bias * bias], axis=-1)[some]
    free = np.broadcast_to(np.eye(3), (*error.shape, 3))
    turning = np.einsum("snij,snj->sni", moving.to_start[some], moving.rate_B[some])
    early = -turning * fixes[..., None]
    return LawData(error, regressors, free, _sigma(size, noise), fixes, early, noise)


def _at(quaternions: np.ndarray, first: np.ndarray) -> np.ndarray:
    return quaternions[np.arange(len(quaternions)), first][:, None]


def _scale_sd(misfits: Misfits) -> np.ndarray:
    return np.maximum(limits.SCALE_SD, misfits.campaign.rate_sensor.scale_factor_sigma)


def _bias_sd(misfits: Misfits, moving: Motion) -> np.ndarray:
    """Sd of the rate bias (3,): what is stated, or more where it may be stale [rad/s]."""
    valid = misfits.slews.valid
    rms = np.sqrt(np.mean(np.sum(moving.rate_B[valid] ** 2, axis=-1)))
    return np.maximum(misfits.campaign.rate_sensor.bias_sigma, limits.BIAS_SHARE * rms)


def _deviation(vectors: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square distance (S,) of vectors (S, N, D) from their mean, where mask is True."""
    count = np.maximum(mask.sum(axis=1), 1)[:, None]
    mean = (vectors * mask[..., None]).sum(axis=1) / count
    off = (vectors - mean[:, None]) * mask[..., None]
    return np.sqrt((off**2).sum(axis=(1, 2)) / count[:, 0])


def _sigma(size: np.ndarray, noise: float, *more: np.ndarray) -> np.ndarray:
    """Sd (S,) of what noise and undisclosed physics leave of a motion of this size."""
    idle = limits.IDLE_SHARE * size.max(initial=0.0)
    square = (limits.PHYSICAL_SHARE * size) ** 2 + idle**2 + noise**2
    return np.sqrt(square + sum(part**2 for part in more) + 1e-30)


def conservation(misfits: Misfits, reading: Reading) -> LawData | None:
    """Total momentum in axes that do not turn.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions.

    Returns
    -------
    LawData or None
        None if there are wheels of which neither momentum nor commands are known.
    """
    slews, moving = misfits.slews, misfits.motion(reading)
    to_start, rate, valid = moving.to_start, moving.rate_B, slews.valid
    tachometer = slews.momentum is not None
    wheels_B = _wheel_momentum(slews, reading)
    if wheels_B is None:
        return None
    body = np.einsum("snij,snj->sni", to_start, rate @ reading.inertia.T)
    stored = np.einsum("snij,snj->sni", to_start, wheels_B)
    size = np.maximum(_deviation(body, valid), _deviation(stored, valid))
    if not misfits.campaign.wheels:
        size = np.maximum(size, _norm(body, valid))
    total = body + stored
    prior = misfits.campaign.inertia
    elements = np.maximum(limits.INERTIA_SD, prior.relative_sigma) * np.diag(reading.inertia)
    mean = float(np.trace(reading.inertia)) / 3.0
    product = min(max(prior.product_sigma, limits.INERTIA_SD * mean), mean)
    sds = np.where(np.eye(3, dtype=bool), elements[:, None], product)
    by_inertia = np.einsum("snia,snb->sniab", to_start, rate) * sds
    share = limits.TORQUE_SHARE if tachometer else limits.UNSEEN_FRICTION_SHARE
    torque = share * size / np.maximum(np.abs(moving.duration), 1e-12)
    scales = np.maximum(limits.FRAME_SHARE, misfits.campaign.rate_sensor.scale_factor_sigma)
    bias = _bias_sd(misfits, moving)
    by_bias = _crossed(moving.by_bias, total) + to_start @ reading.inertia
    regressors = [
        by_inertia.reshape(*by_inertia.shape[:3], 9),
        _crossed(moving.by_scale[..., [0, 4, 8]], total) * scales,
        by_bias * bias,
        moving.by_bias * torque[:, None, None, None],
    ]
    free = np.broadcast_to(np.eye(3), (*total.shape, 3))
    if not tachometer and misfits.campaign.wheels:
        free = np.concatenate([free, to_start], axis=-1)
    noise = _momentum_noise(misfits, reading)
    angle = np.minimum(_norm(_turned(moving), valid), 1.0)
    frame = limits.FRAME_SHARE * angle * _norm(total, valid)
    return LawData(
        total,
        np.concatenate(regressors, axis=-1),
        free,
        _sigma(size, noise, frame),
        valid,
        early=np.einsum("snij,snj->sni", to_start, _slope(wheels_B, slews, reading)),
        noise=noise,
        factors=max(limits.INERTIA_SD, prior.relative_sigma),
    )


def _slope(values: np.ndarray, slews: SampledSlews, reading: Reading) -> np.ndarray:
    """Time derivative of values (S, N, D); zero at the repeated moments of the end."""
    steps = np.diff(reading.time * slews.time, axis=1)[..., None]
    steps = np.where(steps == 0.0, np.inf, steps)
    slopes = np.diff(values, axis=1) / steps
    ends = np.concatenate([slopes[:, :1], slopes], axis=1)
    starts = np.concatenate([slopes, slopes[:, -1:]], axis=1)
    return 0.5 * (ends + starts)


def _turned(moving: Motion) -> np.ndarray:
    return angle_of(moving.path)


def _norm(vectors: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square length (S,) of vectors (S, N, D) where mask is True."""
    count = np.maximum(mask.sum(axis=1), 1)
    return np.sqrt(((vectors * mask[..., None]) ** 2).sum(axis=(1, 2)) / count)


def _crossed(angles: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """What small rotations (S, N, 3, P) do to vectors (S, N, 3)."""
    return np.cross(angles, vectors[..., None], axis=2)


def _wheel_momentum(slews: SampledSlews, reading: Reading) -> np.ndarray | None:
    """G h (S, N, 3) [N m s] from tachometers, else from commands up to a constant in body axes."""
    if not reading.axes_B.shape[1]:
        return np.zeros(slews.rate.shape)
    if slews.momentum is not None:
        return slews.momentum @ (reading.axes_B @ reading.momentum).T
    if slews.impulse is not None:
        return reading.time * slews.impulse @ (reading.axes_B @ reading.torque).T
    return None


def _momentum_noise(misfits: Misfits, reading: Reading) -> float:
    """Noise of J w + G h at one moment [N m s], as far as it is stated."""
    rate = np.asarray(misfits.campaign.rate_sensor.sigma)
    wheels = [wheel.momentum_sigma or 0.0 for wheel in misfits.campaign.wheels]
    body = reading.inertia @ reading.rate @ np.diag(rate)
    return float(np.sqrt((body**2).sum() + np.square(wheels).sum()))


def drive(misfits: Misfits, reading: Reading) -> LawData | None:
    """Commanded torque against the tachometers.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions.

    Returns
    -------
    LawData or None
        None without commands or tachometers. Each wheel of each slew counts as a slew.
    """
    slews = misfits.slews
    if slews.momentum is None or slews.impulse is None:
        return None
    h = slews.momentum @ reading.momentum.T
    given = reading.time * slews.impulse @ reading.torque.T
    count, moments, wheels = h.shape
    seen, told = (np.swapaxes(x, 1, 2).reshape(count * wheels, moments, 1) for x in (h, given))
    valid = np.repeat(slews.valid, wheels, axis=0)
    size = np.maximum(_deviation(seen, valid), _deviation(told, valid))
    since = slews.time - slews.time[:, :1]
    share = np.repeat(since / np.maximum(since[:, -1:], 1e-12), wheels, axis=0)[..., None]
    which = np.tile(np.eye(wheels), (count, 1))[:, None, None, :]
    regressors = [
        limits.GAIN_SD * told[..., None] * which,
        limits.UNSEEN_FRICTION_SHARE * (share * size[:, None, None])[..., None] * which,
    ]
    free = np.ones((*seen.shape, 1))
    noise = max((wheel.momentum_sigma or 0.0 for wheel in misfits.campaign.wheels), default=0.0)
    slope = np.swapaxes(_slope(h, slews, reading), 1, 2).reshape(seen.shape)
    return LawData(
        seen - told,
        np.concatenate(regressors, axis=-1),
        free,
        _sigma(size, noise),
        valid,
        early=-slope,
        noise=noise,
    )


LAWS: Mapping[str, Callable[[Misfits, Reading], LawData | None]] = MappingProxyType(
    {CLOSURE: closure, CONSERVATION: conservation, DRIVE: drive}
)
"""The laws by name."""
