"""Which stream's clock is wrong, from the lateness that each law tells.

A sensor's exposure, processing and transport make it late by a fraction of a second: the library
has effects for that (`star_tracker_time_offset`, `rate_sensor_delay`, `wheel_command_lag`), and a
lateness of that size is no wrong convention. A lateness far beyond it is a wrong clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.polynomial.legendre import legvander

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Entry
from bayes_inertia.campaign.sensors import ATTITUDE, MOMENTUM, RATE, reading_step
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.conventions.law_data import LawData, LinearFit
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, DRIVE, Misfits, worst
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import SampledSlews
from bayes_inertia.conventions.reading import (
    TORQUE,
    KeyChange,
    Mistake,
    Reading,
    Stated,
    key_changes,
    path_of,
    said_of,
    unmended,
)
from bayes_inertia.conventions.search import Remedy, alike
from bayes_inertia.faults.known_offsets import KNOWN_OFFSETS, known_offset
from bayes_inertia.faults.limits import LIMITS as FAULTS

_STREAM = {CLOSURE: "star tracker", CONSERVATION: "wheels", DRIVE: "torque commands"}
# What makes it late, and early.
_EFFECTS = {
    CLOSURE: ("star_tracker_time_offset", "star_tracker_time_offset or rate_sensor_delay"),
    CONSERVATION: ("", "rate_sensor_delay"),
    DRIVE: ("", "wheel_command_lag"),
}


def clocks(
    misfits: Misfits, reading: Reading, stated: Stated
) -> tuple[tuple[Remedy, ...], tuple[str, ...]]:
    """Streams that are late against each other.

    Returns: clocks that are wrong by more than any sensor is late, the best proposal first; remarks
    on latenesses that are physical.
    """
    # Rates that all sensors tell follow the fixes.
    laws = (CONSERVATION, DRIVE) if misfits.smoothed else (CLOSURE, CONSERVATION, DRIVE)
    told = {}
    for law in laws:
        late = lateness(misfits, reading, law)
        if late is not None and late.explains:
            is_gross = _is_gross(misfits, late)
            told[law] = with_known_offset(misfits, reading, late) if is_gross else late
    gross = {law: late for law, late in told.items() if _is_gross(misfits, late)}
    remarks = tuple(_remark(late) for law, late in told.items() if law not in gross)
    proposals = []
    for shifts, late in _proposals(misfits, gross, told, stated):
        mistake = _mistake(stated, shifts)
        moved = misfits.shifted(mistake.shifts)
        if moved is not None and worst(moved.of(reading)) < LIMITS.ordinary:
            proposals.append(Remedy(mistake, late.before, late.after))
    return tuple(proposals), remarks


def _remark(late: Lateness) -> str:
    """What a lateness that is no wrong clock may be."""
    are = "is" if late.law == CLOSURE else "are"
    said = f"the {_STREAM[late.law]} {are} {_sense(late.seconds)} against the rate: as little as "
    if effect := _EFFECTS[late.law][late.seconds > 0.0]:
        advice = "`diagnose` fits it, unless you know of a clock error"
        return f"{said}a physical effect can be ({effect}); {advice}"
    advice = "look for a clock error of either stream, and state it as `offset_s`"
    return f"{said}sensors are late, but no effect has this sense; {advice}"


def known_offsets(misfits: Misfits, reading: Reading, stated: Stated) -> tuple[Remedy, ...]:
    """Known offsets of clocks that make all laws hold, tried by name, the most common first."""
    campaign, laws = misfits.campaign, misfits.of(reading)
    before = worst(laws)
    fixes = sum(min(int(slew.fixes.sum()), LIMITS.fixes_per_slew) for slew in campaign.slews)
    turned = _turned(misfits.slews)
    fields = list(dict.fromkeys(entry.field for entry in stated.held))
    wheels = [field for field in fields if field in (TORQUE, MOMENTUM.field)]
    longest = max(slew.duration for slew in campaign.slews)
    sizes = [size for size in KNOWN_OFFSETS if size < longest]
    groups = [*([field] for field in fields), *([wheels] if len(wheels) > 1 else [])]
    found = []
    for streams, size, sign in product(groups, sizes, (-1.0, 1.0)):
        shifts = dict.fromkeys(streams, sign * size)
        moved = misfits.shifted(shifts)
        least = LIMITS.share_beside_rates * fixes if streams == [ATTITUDE.field] else 0.0
        if moved is None or moved.slews.fixes.sum() < least:
            continue
        if _turned(moved.slews) < LIMITS.motion_left * turned:
            continue
        fits = moved.of(reading)
        after = worst(fits)
        mends = after < min(LIMITS.ordinary, before / LIMITS.improvement)
        if mends and _still_tested(laws, fits, streams):
            found.append(Remedy(_mistake(stated, shifts), before, after))
    best = min((remedy.after for remedy in found), default=0.0)
    return tuple(remedy for remedy in found if remedy.after <= alike(best))


def _still_tested(
    laws: Mapping[str, LinearFit], fits: Mapping[str, LinearFit], streams: Sequence[str]
) -> bool:
    """Whether moved streams leave all laws to be tested, or but closure, which told nothing new."""
    if set(laws) <= set(fits):
        return True
    # Where no fix is left beside the rates, another law must have told of the clock.
    others = max((fit.worst for law, fit in laws.items() if law != CLOSURE), default=0.0)
    held = streams == [RATE.field] or laws[CLOSURE].worst < LIMITS.ordinary
    return set(laws) - set(fits) == {CLOSURE} and others > LIMITS.impossible and held


def _turned(slews: SampledSlews) -> float:
    """Sum of the rates of all slews [rad]."""
    return float(np.linalg.norm(slews.turn[:, -1], axis=-1).sum())


def streams_apart(campaign: Campaign, stated: Stated) -> tuple[str, ...]:
    """Streams all of whose readings lie before or after the rates, and the offset that is known."""
    said = []
    for entry in stated.held:
        pairs = [(_times(slew, entry.field), _times(slew, RATE.field)) for slew in campaign.slews]
        pairs = [(own, rates) for own, rates in pairs if len(own) and len(rates)]
        beside = (((t >= rates[0]) & (t <= rates[-1])).any() for t, rates in pairs)
        if pairs and not any(beside):
            said.append(_apart_in_words(entry, pairs))
    return tuple(said)


def _times(slew: Slew, channel: str) -> np.ndarray:
    """Times of the rows that hold a reading of a channel [s]."""
    values = getattr(slew, channel)
    return slew.time[:0] if values is None else slew.time[np.isfinite(values).any(axis=1)]


def _apart_in_words(entry: Entry, pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> str:
    """That a stream lies outside every slew, and with which known offset it would not.

    `pairs`: times of its readings and of the rates [s], slew by slew.
    """
    own, rates = pairs[0]
    away = own[0] - rates[-1] if own[0] > rates[-1] else own[-1] - rates[0]
    where = f"{abs(away):.4g} s {'after' if away > 0.0 else 'before'} the rates"
    readings = f"{sum(len(times) for times, _ in pairs)} {said_of(entry.key)[1]}"
    said = f"all {readings} lie outside every slew ({where} at the nearest)"
    key = f"{path_of(entry)}.offset_s"
    known = known_offset([(times, [(rates[0], rates[-1])]) for times, rates in pairs])
    if known is None:
        return f"{said}; state their clock's offset as {key}"
    offset = entry.columns.offset_s + known[0]
    return f"{said}; they lie beside the rates with {key} = {offset:.9g} ({known[1]})"


def _is_gross(misfits: Misfits, late: Lateness) -> bool:
    """Whether a lateness is a wrong clock, beyond what a sensor or a wheel can be late."""
    campaign = misfits.campaign
    duration = campaign.scale_of_motion()[1]
    # A wheel that lags its command makes the command look early.
    if channel_of(misfits, late.law) == TORQUE and late.seconds > 0.0:
        limit = LIMITS.late_sds * (LIMITS.lag_share * duration)
    else:
        sd = LIMITS.late_share * duration
        longest = max(LIMITS.longest_lateness, LIMITS.least_late_sds * sd)
        limit = min(LIMITS.late_sds * sd, longest)
    return abs(late.seconds) > max(limit, LIMITS.late_steps * reading_step(campaign))


def _proposals(
    misfits: Misfits,
    gross: Mapping[str, Lateness],
    told: Mapping[str, Lateness],
    stated: Stated,
) -> Iterator[tuple[dict[str, float], Lateness]]:
    """Offsets by field of `Slew` that explain what the laws say, the simplest first."""
    both = [field for field in (TORQUE, MOMENTUM.field) if stated.of(field)]
    tracker, wheels, commands = (told.get(law) for law in (CLOSURE, CONSERVATION, DRIVE))
    if tracker is not None and wheels is not None and _one(tracker.seconds, wheels.seconds):
        # Star tracker and wheels agree with each other: the gyro is late.
        if CLOSURE in gross or CONSERVATION in gross:
            yield {RATE.field: -wheels.seconds}, wheels
        return
    if wheels is None or CONSERVATION not in gross:
        alone = CLOSURE if CLOSURE in gross else DRIVE
        if alone in gross:
            yield {channel_of(misfits, alone): gross[alone].seconds}, gross[alone]
        return
    of_wheels = dict.fromkeys(both, wheels.seconds)
    if commands is not None and _one(commands.seconds, -wheels.seconds):
        of_wheels = {MOMENTUM.field: wheels.seconds}
    elif tracker is not None or misfits.smoothed or not fixes_in_motion(misfits):
        yield {RATE.field: -wheels.seconds}, wheels
    yield of_wheels, wheels


def _one(first: float, second: float) -> bool:
    return abs(first - second) < LIMITS.same_lateness * max(abs(first), abs(second))


def fixes_in_motion(misfits: Misfits) -> bool:
    """Whether at least two fixes of a slew are taken while the body turns."""
    slews = misfits.slews
    speed = np.sqrt((slews.rate**2).sum(axis=-1))
    moving = speed > FAULTS.in_motion * speed.max(axis=1, keepdims=True)
    return bool(((moving & slews.fixes).sum(axis=1) >= 2).any())


def _sense(seconds: float) -> str:
    size = f"{abs(seconds):.6g}" if abs(seconds) in KNOWN_OFFSETS else f"{abs(seconds):.2g}"
    return f"{size} s {'late' if seconds < 0.0 else 'early'}"


def _mistake(stated: Stated, shifts: Mapping[str, float]) -> Mistake:
    changes: list[KeyChange] = []
    what, moved = [], {}
    for field, seconds in shifts.items():
        for entry in stated.of(field):
            offset = entry.columns.offset_s
            # A known offset has six digits, an estimated one three.
            digits = ".6g" if abs(seconds) in KNOWN_OFFSETS else ".3g"
            mended = float(f"{offset + seconds:{digits}}")
            moved[field] = mended - offset
            changes += key_changes(entry, "offset_s", mended)
            named = "the torque commands" if field == TORQUE else said_of(entry.key)[0]
            what.append(f"the time stamps of {named}")
    seconds = next(iter(shifts.values()))
    why = KNOWN_OFFSETS.get(abs(seconds), "")
    words = f"{' and '.join(dict.fromkeys(what))} are {_sense(seconds)}{why and f' ({why})'}"
    return Mistake(tuple(changes), LIMITS.clock_rarity, unmended, words, moved)


@dataclass(frozen=True)
class Lateness:
    """Lateness of a stream, as one law measures it."""

    law: str  # Which law
    # What must be added to the time stamps of the law's second stream [s]; negative where it is
    # late
    seconds: float
    # before, after: residual of the law without and with it [sd of the sensors' stated noise]
    before: float
    after: float
    moments: int  # How many moments were compared

    @property
    def explains(self) -> bool:
        """Whether the lateness is what breaks the law, rather than one of many things.

        Nearly nothing but the stated noise is left, or a third of what was there at most; and chi^2
        falls by far more than chance lets it.
        """
        excess_before, excess_after = (max(x**2 - 1.0, 0.0) for x in (self.before, self.after))
        fall = (self.before**2 - self.after**2) * self.moments
        share = LIMITS.improvement**2
        most = excess_after * share < excess_before or self.after**2 * share < self.before**2
        return most and fall > LIMITS.late_chi2


def lateness(misfits: Misfits, reading: Reading, law: str) -> Lateness | None:
    """The shift of a stream that makes one law hold best; None where none is better than none.

    Closure shifts the star tracker, conservation the wheels, the drive the torque commands. Where
    smoothed rates follow the wheels, conservation shifts the gyro's own axes the other way.
    """
    first = misfits.law(law, reading)
    if first is None or first.early is None or not first.early.any():
        return None
    before, step = _shift(first, law)
    if before < LIMITS.notable:
        return None
    shift, best = 0.0, (0.0, before)
    for _ in range(LIMITS.clock_rounds):
        shift += step
        if abs(shift) > 0.3 * float(misfits.motion(reading).duration.min()):
            break
        after, step = _left(misfits, reading, law, shift)
        if after < best[1]:
            best = (shift, after)
        if abs(step) < LIMITS.shift_converged * abs(shift):
            break
    if not best[0]:
        return None
    # From shares of the motion to the noise that the campaign states.
    noises = np.sqrt(np.mean(first.sigma**2)) * LIMITS.sharp / max(first.noise, 1e-30)
    scale = float(noises) if first.noise > 0.0 else 1.0
    moments = int(first.mask.sum())
    return Lateness(law, best[0], before * scale, best[1] * scale, moments)


def with_known_offset(misfits: Misfits, reading: Reading, late: Lateness) -> Lateness:
    """The offset that clocks are known for, where it explains a law as well as a lateness does."""
    if abs(late.seconds) <= LIMITS.longest_delay_s:
        return late
    best = _left(misfits, reading, late.law, late.seconds)[0]
    for offset in KNOWN_OFFSETS:
        seconds = float(np.copysign(offset, late.seconds))
        left = _left(misfits, reading, late.law, seconds)[0]
        if left < LIMITS.as_good_offset * best:
            return replace(late, seconds=seconds, after=late.after * left / best)
    return late


def _left(misfits: Misfits, reading: Reading, law: str, seconds: float) -> tuple[float, float]:
    """Residual of a law whose second stream is moved, and the shift that would lower it."""
    shifts = {channel_of(misfits, law): seconds}
    if law == CONSERVATION and misfits.smoothed:
        shifts = {RATE.field: -seconds}
    moved = misfits.shifted(shifts)
    data = None if moved is None else moved.law(law, reading)
    return (np.inf, 0.0) if data is None else _shift(data, law)


def channel_of(misfits: Misfits, law: str) -> str:
    """The channel that a law holds against its first stream."""
    return {CLOSURE: ATTITUDE.field, DRIVE: TORQUE}.get(law, misfits.wheel_channel)


def _shift(data: LawData, law: str) -> tuple[float, float]:
    """Residual of the law, and the shift that would lower it, to first order."""
    if law != CLOSURE:  # Torques and friction that nobody told make momentum drift.
        slews, moments, width = data.data.shape
        drift = legvander(np.linspace(-1.0, 1.0, moments), LIMITS.slow_drift)[:, 1:]
        slow = np.einsum("nk,ij->nikj", drift, np.eye(width)).reshape(moments, width, -1)
        slow = np.broadcast_to(slow, (slews, *slow.shape))
        data = replace(data, free=np.concatenate([data.free, slow], axis=-1))
    sharp = replace(data, sigma=data.sigma * LIMITS.sharp)
    rms = float(np.sqrt(np.mean(sharp.fit().misfit ** 2)))
    early = LIMITS.lateness_prior_s * np.asarray(data.early)[..., None]
    late = replace(sharp, regressors=np.concatenate([sharp.regressors, early], axis=-1))
    return rms, float(late.fit().values[-1] * LIMITS.lateness_prior_s)
