"""Four laws that telemetry obeys whatever J and K are, and its misfits to them.

Closure: the rate, integrated between star-tracker fixes, is the rotation between them.
Direction: vectors seen, turned back by the integrated rate, are where they are said to be.
Conservation: J w + G h, in axes that do not turn, is constant within a slew.
Drive: the torque commands, integrated, are the momentum that the tachometers read.

Each is linear in what is uncertain (J, K, misalignment, bias, a constant torque, gains, friction),
which is fitted with priors wide enough for anything physical.

Misfits are in standard deviations of what noise and undisclosed physics may leave (`limits`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import GimballedRotors
from bayes_inertia.campaign.body_rates import reads_motion
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.campaign.sensors import ATTITUDE, MOMENTUM, RATE, SensorStream, series_of
from bayes_inertia.conventions.direction import angles, direction, parts_of_directions
from bayes_inertia.conventions.law_data import (
    LawData,
    LinearFit,
    Told,
    bias_sd_of,
    bias_wander,
    crossed,
    deviation,
    integrated_noise,
    norm_of,
    scale_sds,
    uncertain_path,
)
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import (
    Motion,
    SampledSlews,
    angle_of,
    composed,
    motion_of,
    sampled,
    told_impulse,
    turn_between,
    turned_back,
)
from bayes_inertia.conventions.reading import TORQUE, Reading, ToldTorques, as_read, stated_reading
from bayes_inertia.faults.noise import smooth_noise


def worst(fits: dict[str, LinearFit]) -> float:
    """The worst misfit of all laws."""
    return max((fit.worst for fit in fits.values()), default=0.0)


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


CLOSURE, DIRECTION, CONSERVATION, DRIVE = "closure", "direction", "conservation", "drive"


def closure(told: Told) -> LawData | None:
    """Integrated rates against the star tracker."""
    some = told.slews.with_two_fixes
    if not some.any():
        return None
    moving, fixes = told.motion, told.slews.fixes[some]
    attitude = told.slews.seen(told.reading)[some]
    attitude = np.where(fixes[..., None], attitude, [0.0, 0.0, 0.0, 1.0])
    path = moving.path[some]
    # The attitude of the first moment that each fix implies: one and the same if all is right.
    start = composed(attitude, turned_back(path))
    first = np.argmax(fixes, axis=1)
    error, seen, integrated = (
        turn_between(q[np.arange(len(q)), first][:, None], q) for q in (start, attitude, path)
    )
    size = np.maximum(deviation(seen, fixes), deviation(integrated, fixes))
    tracker = told.campaign.star_tracker
    assert tracker is not None  # no campaign has fixes without one
    of_fix = (tracker.sigma_cross, tracker.sigma_roll, tracker.low_frequency_sigma or 0.0)
    noise = float(np.linalg.norm(of_fix))
    free = np.broadcast_to(np.eye(3), (*error.shape, 3))
    turning = np.einsum("snij,snj->sni", moving.to_start[some], moving.rate_B[some])
    early = -turning * fixes[..., None]
    sigma = _sigma(size, noise, integrated_noise(told)[some])
    data = -error * fixes[..., None]
    return LawData(data, uncertain_path(told)[some], free, sigma, fixes, early, noise, bias_from=9)


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
    torques = told.torques.under(told.reading)
    added, by_prior, carried = told_impulse(slews, moving, torques)
    stored = np.einsum("snij,snj->sni", to_start, wheels_B) + carried
    size = np.maximum(deviation(body, valid), deviation(stored, valid))
    if not told.campaign.wheels:
        size = np.maximum(size, norm_of(body, valid))
    total = body + stored
    uncertain, doubt = _uncertain_momentum(told, total, size), np.zeros(len(total))
    if torques:
        total = total - told.reading.time * added
        uncertain = np.concatenate([uncertain, LIMITS.gain_sd * added[..., None]], axis=-1)
        doubt = told.reading.time * np.sqrt(np.mean(by_prior**2, axis=1))
    free = np.broadcast_to(np.eye(3), (*total.shape, 3))
    if slews.momentum is None and told.campaign.wheels:
        # Commands tell the wheels' momentum up to a constant in body axes.
        free = np.concatenate([free, to_start], axis=-1)
    noise = _momentum_noise(told, slews.rate.shape[2])
    angle = np.minimum(norm_of(angle_of(moving.path), valid), 1.0)
    frame = LIMITS.frame_share * angle * norm_of(total, valid)
    return LawData(
        total,
        uncertain,
        free,
        _sigma(size, noise, frame, doubt),
        valid,
        early=np.einsum("snij,snj->sni", to_start, _slope(_moved_by_clock(told, wheels_B), told)),
        # Of what sensors read, be there smoothed rates beside it.
        noise=_momentum_noise(told, len(told.reading.rate_axes_B)) or noise,
        factors=max(LIMITS.inertia_sd, told.campaign.inertia.relative_sigma),
        bias_from=12,
    )


def _moved_by_clock(told: Told, wheels_B: np.ndarray) -> np.ndarray:
    """Momentum (S, N, 3) whose clock is judged: the wheels' against that of all rates.

    Where some rates are smoothed, and so follow the wheels, less that of the gyro's own axes.
    """
    reading, rate = told.reading, told.slews.rate
    own = len(reading.rate_axes_B)
    if own == rate.shape[2]:
        return wheels_B
    return -rate[..., :own] @ reading.body_rate[:, :own].T @ reading.inertia.T


def _uncertain_momentum(told: Told, total: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Momentum change (S, N, 3, P) by one sd each of J, K, bias, a torque and dated changes."""
    moving, prior, inertia = told.motion, told.campaign.inertia, told.reading.inertia
    mean = float(np.trace(inertia)) / 3.0
    moments = np.maximum(LIMITS.inertia_sd, prior.relative_sigma) * np.diag(inertia)
    product = min(max(prior.product_sigma, LIMITS.inertia_sd * mean), mean)
    sds = np.where(np.eye(3, dtype=bool), moments[:, None], product)
    by_inertia = np.einsum("snia,snb->sniab", moving.to_start, moving.rate_B)
    by_inertia = by_inertia.reshape(*by_inertia.shape[:3], 9)
    scales = np.maximum(LIMITS.frame_share, scale_sds(told))
    by_scale = crossed(moving.by_scale[..., [0, 4, 8]], total) * scales
    by_bias = crossed(moving.by_bias, total) + moving.to_start @ inertia
    unseen = told.slews.momentum is None
    share = LIMITS.unseen_friction_share if unseen else LIMITS.torque_share
    torque = share * size / np.maximum(np.abs(moving.duration), 1e-12)
    by_torque = moving.by_bias * torque[:, None, None, None]
    starts = {slew.name: slew.start for slew in told.campaign.slews}
    start = np.array([starts[name] for name in told.slews.names])[:, None, None, None]
    changed = [
        by_inertia * (start >= change.time) * change.sigma_fraction * mean
        for change in told.campaign.changes
    ]
    parts = (by_inertia * sds.ravel(), by_scale, by_bias * bias_sd_of(told), by_torque)
    return np.concatenate([*parts, *changed], axis=-1)


def _slope(values: np.ndarray, told: Told) -> np.ndarray:
    """Time derivative of values (S, N, D); zero at the repeated moments of the end."""
    steps = np.diff(told.reading.time * told.slews.time, axis=1)[..., None]
    steps = np.where(steps == 0.0, np.inf, steps)
    slopes = np.diff(values, axis=1) / steps
    ends = np.concatenate([slopes[:, :1], slopes], axis=1)
    starts = np.concatenate([slopes, slopes[:, -1:]], axis=1)
    return 0.5 * (ends + starts)


def wheel_momentum_B(told: Told) -> np.ndarray | None:
    """The wheels' momentum (S, N, 3) relative to the body, along body axes [N m s].

    From tachometers, else from commands up to a constant in each slew; None without either.
    """
    slews, reading = told.slews, told.reading
    if not reading.axes_B.shape[1]:
        return np.zeros((*slews.time.shape, 3))
    if slews.momentum is not None:
        return reading.of(MOMENTUM.field, slews.momentum) @ reading.axes_B.T
    if slews.impulse is not None:
        return reading.time * reading.of(TORQUE, slews.impulse) @ reading.axes_B.T
    return None


def _momentum_noise(told: Told, columns: int) -> float:
    """Noise of J w + G h at one moment, rotors on gimbals of noisy angles included [N m s].

    `columns`: how many columns of the rates, the first ones, count.
    """
    per_sd = told.reading.inertia @ told.reading.body_rate
    body = (per_sd * told.noise[RATE.name])[:, :columns]
    wander = [told.reading.inertia * sd for sd, _ in bias_wander(told)]
    wheels = told.reading.of(MOMENTUM.field, told.noise[MOMENTUM.name])
    rotors = [
        np.asarray(device.momentum) * device.angle_sigma
        for device in told.campaign.actuators
        if isinstance(device, GimballedRotors)
    ]
    return float(np.sqrt(sum(np.sum(np.square(part)) for part in (body, *wander, wheels, *rotors))))


def drive(told: Told) -> LawData | None:
    """Commanded torque against the tachometers; each wheel of each slew counts as a slew."""
    slews, reading = told.slews, told.reading
    if slews.momentum is None or slews.impulse is None:
        return None
    h = reading.of(MOMENTUM.field, slews.momentum)
    impulse = reading.time * reading.of(TORQUE, slews.impulse)
    count, _, wheels = h.shape
    seen, commanded = _each_wheel(h), _each_wheel(impulse)
    valid = np.repeat(slews.valid, wheels, axis=0)
    size = np.maximum(deviation(seen, valid), deviation(commanded, valid))
    since = slews.time - slews.time[:, :1]
    share = np.repeat(since / np.maximum(since[:, -1:], 1e-12), wheels, axis=0)[..., None]
    which = np.tile(np.eye(wheels), (count, 1))[:, None, None, :]
    regressors = [
        LIMITS.gain_sd * commanded[..., None] * which,
        LIMITS.unseen_friction_share * (share * size[:, None, None])[..., None] * which,
    ]
    read = reading.of(MOMENTUM.field, told.noise[MOMENTUM.name])
    noise = float(np.abs(read).max(initial=0.0))
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
    DIRECTION: direction,
    CONSERVATION: conservation,
    DRIVE: drive,
}
"""The laws by name."""


RATES = (RATE.field, "rate_axes_B", "bias_B")
"""Parts of a reading that the motion depends on, beside time."""


@dataclass(frozen=True, eq=False)
class Misfits:
    """The laws, for a campaign at some sixty moments a slew; results are kept."""

    campaign: Campaign  # Hardware and priors
    slews: SampledSlews  # Its telemetry
    # How many axes of the rate sensor, the last ones, are smoothed from all sensors: their noise
    # does not show
    smoothed: int = 0
    told_torques: ToldTorques | None = None  # Those of the campaign; None for none
    written: Campaign | None = None  # The campaign without smoothed rates
    shifts: Mapping[str, float] = field(default_factory=dict)  # As of `sampled`
    kept: dict = field(default_factory=dict)
    not_asked: frozenset[str] = frozenset()  # Laws that physics breaks

    def with_slews(self, slews: SampledSlews) -> Misfits:
        """The same laws for other telemetry of the campaign."""
        return replace(self, slews=slews, kept={})

    def shifted(self, shifts: Mapping[str, float]) -> Misfits | None:
        """The same laws with other clocks: what is added to stamps of channels of `Slew` [s]."""
        slews = sampled(self.campaign, shifts, self.smoothed)
        return None if slews is None else replace(self.with_slews(slews), shifts=shifts)

    def of(self, reading: Reading) -> dict[str, LinearFit]:
        """The fit of every law that the telemetry can be held against, by its name."""
        fits = {law: self.fit(law, reading) for law in LAWS}
        return {law: fit for law, fit in fits.items() if fit is not None}

    def mends(self, reading: Reading, limit: float) -> bool:
        """Whether a reading brings every law below a limit [sd]; the cheap laws are asked first."""
        return self.may_mend(reading, limit) and all(
            fit is None or fit.worst < limit
            for fit in (self.fit(law, reading) for law in (DRIVE, CLOSURE, DIRECTION, CONSERVATION))
        )

    def may_mend(self, reading: Reading, limit: float) -> bool:
        """Whether the angles between vectors leave it open, where rates would be smoothed again."""
        parts = parts_of_directions(self.campaign)
        if not {*parts} & {*self.followed} & {*reading.matrices}:
            return True
        told = replace(self.told(self.stated()), reading=reading)
        data = self.kept_for("angles", parts, reading, partial(angles, told))
        return data is None or data.fit().worst < limit

    def kept_for(
        self, what: str, fields: Sequence[str], reading: Reading, make: Callable, *more: bytes
    ) -> Any:
        """What is made of time and some parts of a reading, and of nothing else; made once."""
        key = (what, reading.time, *more, *reading.key(*fields))
        if key not in self.kept:
            self.kept[key] = make()
        return self.kept[key]

    def motion(self, reading: Reading) -> Motion:
        """The motion that the rates tell."""
        slews, parts = self.under(reading).slews, (*RATES, *self.followed)
        return self.kept_for("motion", parts, reading, partial(motion_of, slews, reading))

    @cached_property
    def followed(self) -> tuple[str, ...]:
        """Parts of a reading that smoothed rates follow: of fixes, or of vectors without them."""
        if not self.smoothed:
            return ()
        fixed = all(slew.fixes.any() for slew in self.campaign.slews)
        return (ATTITUDE.field, *(() if fixed else parts_of_directions(self.campaign)))

    def under(self, reading: Reading) -> Misfits:
        """The same with rates smoothed from fixes and vectors as a reading has them."""
        if not {*self.followed} & {*reading.matrices}:
            return self

        def smoothed() -> Misfits:
            assert self.written is not None
            campaign = _smoothed(as_read(self.written, reading, self.noise), self.own_axes)
            slews = sampled(campaign, self.shifts, self.smoothed)
            assert slews is not None
            return self.with_slews(replace(self.slews, rate=slews.rate, turn=slews.turn))

        return self.kept_for("smoothed", self.followed, reading, smoothed)

    def law(self, law: str, reading: Reading, bias_sd: np.ndarray | None = None) -> LawData | None:
        """One law as a linear problem; `bias_sd` (3,) [rad/s] where the rate bias may be stale."""
        return LAWS[law](replace(self.told(reading), bias_sd=bias_sd))

    def stated(self) -> Reading:
        """The reading that the campaign states."""
        return stated_reading(self.campaign, self.smoothed)

    @cached_property
    def torques(self) -> ToldTorques:
        """On the body, by what is not a wheel."""
        return self.told_torques or ToldTorques(self.campaign)

    @property
    def own_axes(self) -> int:
        """How many axes of the rate sensor are its own."""
        return len(self.campaign.gyro.axes) - self.smoothed

    @cached_property
    def noise(self) -> Mapping[str, np.ndarray]:
        """Believed sd of the readings of each stream, in the units stated."""
        series = series_of(self.campaign)
        believed = {s.name: believed_noise(self.campaign, s) for s in series}
        if self.smoothed:
            believed[RATE.name][-self.smoothed :] = self.campaign.gyro.sigma[-self.smoothed :]
        return believed

    def told(self, reading: Reading) -> Told:
        """Telemetry in physical units, under a reading."""
        seen, motion = self.under(reading), self.motion(reading)
        return Told(self.campaign, seen.slews, reading, motion, self.noise, self.torques)

    def fit(self, law: str, reading: Reading) -> LinearFit | None:
        """The fit of one law; the same reading of the same channels is fitted once."""
        if law in self.not_asked:
            return None

        def fit() -> LinearFit | None:
            data = self.law(law, reading)
            return None if data is None else data.fit()

        return self.kept_for(law, self.parts_of(law), reading, fit)

    def parts_of(self, law: str) -> tuple[str, ...]:
        """Which parts of a reading, besides time, a law depends on."""
        rates = (*RATES, *self.followed)
        parts: dict[str, tuple[str, ...]] = {
            CLOSURE: (*rates, ATTITUDE.field),
            DIRECTION: (*rates, ATTITUDE.field, *parts_of_directions(self.campaign)),
            CONSERVATION: (*rates, "axes_B", "inertia", *self.torques.parts, self.wheel_channel),
            DRIVE: (TORQUE, MOMENTUM.field),
        }
        return parts[law]

    @property
    def wheel_channel(self) -> str:
        """Which field of `Slew` tells the wheels' momentum."""
        return TORQUE if self.slews.momentum is None else MOMENTUM.field


def misfits_of(campaign: Campaign, torques: ToldTorques | None = None) -> Misfits | None:
    """The laws for a campaign; None if no slew has enough rates.

    The rate sensor's own axes count unless noise that shows drowns them; where they do not span
    space, smoothed rates of the body stand beside them.
    """
    written, own, smoothed = campaign, campaign.rate_sensor, 0
    if own is not None:
        # In a larger unit than stated a good sensor has less noise than is stated, and less motion.
        believed = zip(believed_noise(campaign, RATE).tolist(), own.sigma, strict=True)
        quiet = replace(own, sigma=tuple(seen or stated for seen, stated in believed))
    if own is None or not reads_motion(replace(campaign, rate_sensor=quiet)):
        campaign, smoothed = _smoothed(campaign, 0), 3
    elif len(own.axes) < 3:
        campaign, smoothed = _smoothed(campaign, len(own.axes)), 3
    slews = sampled(campaign)
    return None if slews is None else Misfits(campaign, slews, smoothed, torques, written)


def _smoothed(campaign: Campaign, own_axes: int) -> Campaign:
    """A campaign with body rates that all sensors tell, beside so many axes of the rate sensor."""
    smoothed = campaign.with_body_rates
    if not own_axes:
        return smoothed
    own, more = campaign.gyro, smoothed.gyro
    numbers = ("sigma", "scale_factor", "scale_factor_sigma", "bias", "bias_sigma")
    joined: dict[str, Any] = {key: getattr(own, key) + getattr(more, key) for key in numbers}
    if (noise := own.correlated_noise) is not None:
        white = CorrelatedNoise(noise.share + (0.0,) * 3, noise.time + (1.0,) * 3)
        joined["correlated_noise"] = white
    sensor = replace(own, axes=np.concatenate([own.axes, more.axes]), **joined)
    rates = zip(campaign.slews, smoothed.slews, strict=True)
    slews = tuple(replace(s, rate=np.hstack([s.rate, o.rate])) for s, o in rates)  # type: ignore
    return replace(campaign, rate_sensor=sensor, slews=slews)
