"""Wrong conventions: a right campaign in, a wrong one out, with the keys that would mend it.

Which campaigns can show a wrong convention was reasoned beforehand, from the equations:

- Star tracker against gyro (rotation closes) shows everything about the quaternion and about the
  rates but a constant. Without star tracker there is no quaternion that could be wrong. Fixes at
  rest do not change within a second: a late star tracker shows in fixes during the motion only.
- J w + G h is constant in inertial axes: it shows rates against tachometers, as far as the prior
  knows J (4 %; 30 % for thrown bodies). (J, h) -> (s J, s h) changes nothing, so that thousandths
  of torque AND momentum are told from a tensor in other units by the wheels' limits alone.
- h' = u - Js g.w' shows commands against tachometers. Without commands or without tachometers
  there is nothing to compare: wrong senses of momentum do not exist without tachometers.
- J w' + w x (J w + G h) = -G u shows commands against rates.

Exactly equal, and therefore all accepted:

- torque AND momentum of all wheels negated = all axes flipped (u and h enter as G u, G h alone);
  of one wheel = this axis flipped. The format has no sign of a momentum: the mend takes several
  keys, and the first of them must be one of these.
- Columns of the gyro in another order = rows of `rate_sensor.axes` in another order; a gyro axis
  negated = this row negated = this scale factor negated.
- Axes of two wheels exchanged = their columns of torque and momentum exchanged. Without
  tachometers the columns of torque alone.
- A gyro late by tau = wheels (all they have) and star tracker early by tau. Without commands and
  star tracker: tachometers early by tau. Without tachometers and with fixes at rest a late gyro
  looks like wheels that lag, which is physics and no convention: not shown.
- With total momentum zero J w = -G h in BODY axes: without star tracker -w is -G, and for wheels
  along the axes with small products one gyro axis is one wheel axis. Nothing is equal once the
  spacecraft carries momentum (w x M_B differs), as all campaigns here do.
- A thrown body with its wheel along a principal axis may be turned by 180 degrees about that axis
  (products of inertia have a symmetric prior), and by 90 where the prior does not tell the other
  two moments apart. Turned by 180 degrees about a normal of it the wheel's axis is flipped. Its
  momentum is scaled by the spin inertia (and against J) alone.
- Thrown bodies whose gyro is mounted along a skewed direction are left out: the direction about
  the wheel's axis trades against a tensor known to 30 %.
- Relative to body or absolute momentum, J with or without wheel spin: Js is 0.05 % of J, far
  within its prior. Another inertial frame, and torque, momentum and axes all negated, change no
  equation. All these are consistent and must not be accused.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from analyses.imports.conventions_cases import (
    NO_TACHOMETERS,
    THROWS,
    Base,
    Wrong,
    exchanged_names,
    gyro_axes,
    turned_readings,
    wheel_axis,
)
from analyses.imports.conventions_folder import Mend, RawCampaign, changed, later, stated
from analyses.imports.conventions_wrong_wheels import (
    not_shown,
    of_inertia,
    of_momentum,
    of_torque,
    of_wheel_axes,
    of_wheel_order,
    of_wheel_speed,
)

DEGREE = np.pi / 180.0  # [rad]


def wrong_conventions(base: Base, rng: np.random.Generator) -> tuple[Wrong, ...]:
    """Every wrong convention that exists in a campaign.

    `base`: a right campaign. `rng`: chooses axes, wheels and mountings.
    """
    families: tuple[Callable[[Base, np.random.Generator], Iterator[Wrong]], ...] = (
        _of_quaternion,
        _of_rate_unit,
        _of_rate_axes,
        _of_rate_frame,
        _of_time,
        _of_lateness,
        of_torque,
        of_wheel_axes,
        of_wheel_order,
        of_momentum,
        of_wheel_speed,
        of_inertia,
        not_shown,
    )
    wrong = tuple(itertools.chain.from_iterable(family(base, rng) for family in families))
    return wrong if base.share is None else wrong[base.share :: 3]


def _of_quaternion(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    if not raw.has("attitude"):
        return
    names = raw.names("attitude")
    rolled = [names[3], *names[:3]]
    yield Wrong(
        "quaternion order",
        stated(raw, columns__attitude__scalar="first"),
        (Mend("columns.attitude.scalar", "last"), Mend("columns.attitude.names", rolled)),
    )
    yield Wrong(
        "quaternion direction",
        stated(raw, columns__attitude__maps="body_to_inertial"),
        (Mend("columns.attitude.maps", "inertial_to_body"),),
    )
    i, j = rng.choice(3, 2, replace=False)
    exchanged = exchanged_names(names, i, j)
    yield Wrong(
        "quaternion columns exchanged",
        stated(raw, columns__attitude__names=exchanged),
        (Mend("columns.attitude.names", names),),
    )


def _of_rate_unit(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    sigma = np.array(raw.description["rate_sensor"]["sigma"]) / DEGREE
    in_degrees = changed(raw, "rate", lambda w: w / DEGREE)
    mend = (Mend("columns.rate.unit", "deg/s"),)
    yield Wrong("rate in deg/s", in_degrees, mend)
    misread = stated(in_degrees, rate_sensor__sigma=sigma.tolist())
    yield Wrong("rate and its noise in deg/s", misread, mend, keys=2)
    yield Wrong(
        "rate in deg/h",
        changed(raw, "rate", lambda w: w * 3600.0 / DEGREE),
        (Mend("columns.rate.unit", "deg/h"),),
    )


def _turned(base: Base, axes: np.ndarray, tolerance: float = 0.02) -> tuple[Mend, ...]:
    """Axes of the rate sensor, and for throws those that the data cannot tell from them."""
    equal = [np.eye(3)]
    if base.kind == THROWS:
        turns = (90.0, 180.0, 270.0) if not base.moments_differ else (180.0,)
        vectors = [np.radians(angle) * wheel_axis(base.raw) for angle in turns]
        equal += list(Rotation.from_rotvec(vectors).as_matrix())
    return tuple(Mend("rate_sensor.axes", (axes @ turn).tolist(), tolerance) for turn in equal)


def _of_rate_axes(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw, names, axes = base.raw, base.raw.names("rate"), gyro_axes(base.raw)
    i, j = _pair_off_wheel(base, rng)
    exchanged = exchanged_names(names, i, j)
    order = [names.index(name) for name in exchanged]
    yield Wrong(
        "gyro axes swapped",
        stated(raw, columns__rate__names=exchanged),
        (Mend("columns.rate.names", names), *_turned(base, axes[order])),
    )
    k = int(rng.integers(3))
    signs = np.where(np.arange(3) == k, -1.0, 1.0)
    yield Wrong(
        "one gyro axis flipped",
        changed(raw, "rate", lambda w: w * signs),
        (
            *_turned(base, signs[:, None] * axes),
            *_exchanged_about_wheel(base),
            Mend("rate_sensor.scale_factor"),
            Mend("columns.rate.sign*"),
        ),
    )
    yield Wrong(
        "rates negated",
        changed(raw, "rate", lambda w: -w),
        (
            *_turned(base, -axes),
            Mend("rate_sensor.scale_factor"),
            Mend("columns.rate.sign*"),
        ),
    )


def _exchanged_about_wheel(base: Base) -> tuple[Mend, ...]:
    """A mirror turned by 90 degrees about the wheel exchanges the other two axes."""
    if base.moments_differ:
        return ()
    i, j = np.flatnonzero(np.abs(wheel_axis(base.raw)) < 0.5)
    return (Mend("columns.rate.names", exchanged_names(base.raw.names("rate"), i, j)),)


def _pair_off_wheel(base: Base, rng: np.random.Generator) -> tuple[int, int]:
    """Two axes; for throws the wheel's axis is one of them."""
    i, j = rng.choice(3, 2, replace=False).tolist()
    if base.kind == THROWS:
        wheel = int(np.argmax(np.abs(wheel_axis(base.raw))))
        return wheel, (wheel + int(rng.integers(1, 3))) % 3
    return i, j


def _of_rate_frame(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw, names, axes = base.raw, base.raw.names("rate"), gyro_axes(base.raw)
    i = _pair_off_wheel(base, rng)[1]
    vector = np.pi / 2.0 * rng.choice([-1.0, 1.0]) * np.eye(3)[i]
    quarter = Rotation.from_rotvec(vector).as_matrix()
    mends = _turned(base, quarter @ axes)
    yield Wrong("rates in a frame turned by 90 deg", turned_readings(raw, quarter), mends)
    shift = int(rng.integers(1, 3))
    third = np.roll(np.eye(3), shift, axis=1)
    rolled = [names[int(np.argmax(third[:, k]))] for k in range(3)]
    named = (Mend("columns.rate.names", rolled),)
    mends = (*named, *_turned(base, third @ axes))
    yield Wrong("rates in a frame turned by 120 deg", turned_readings(raw, third), mends)
    if base.kind == THROWS:
        return
    skew = _skewed(rng)
    yield Wrong(
        "rates in a skewed frame", turned_readings(raw, skew), _turned(base, skew @ axes, 0.08)
    )
    mounted = stated(turned_readings(raw, skew), rate_sensor__axes=(axes.T @ skew.T).tolist())
    yield Wrong("mounting matrix transposed", mounted, _turned(base, skew @ axes, 0.08))


def _skewed(rng: np.random.Generator) -> np.ndarray:
    """A rotation by 25 to 70 degrees about a skewed axis."""
    axis = rng.uniform(0.4, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    angle = np.radians(rng.uniform(25.0, 70.0))
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()


def _of_time(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    for unit, factor in (("ms", 1e3), ("us", 1e6)):
        yield Wrong(
            f"time in {unit}",
            changed(base.raw, "time", lambda t, factor=factor: t * factor),
            (Mend("columns.time.unit", unit),),
        )


def _offset(channel: str, seconds: float, tolerance: float = 0.15) -> Mend:
    return Mend(f"columns.{channel}.offset_s", seconds, tolerance)


def _step(raw: RawCampaign) -> float:
    """Time from row to row [s]."""
    time = raw.stacked("time")[0][:, 0]
    return float(np.median(np.diff(time)))


def _of_lateness(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    if base.late == 0.0:
        return
    thrown = base.kind == THROWS
    late = 0.03 if thrown else base.late
    step = _step(raw)
    late = max(1, round(late / step)) * step
    momentum = raw.momentum_channel
    if raw.has("attitude"):
        yield Wrong(
            "star tracker late",
            later(raw, "attitude", late),
            (_offset("attitude", -late),),
            base.moving_fixes,
            "" if base.moving_fixes else "all fixes are at rest",
        )
    told = thrown or base.kind != NO_TACHOMETERS or base.moving_fixes
    mends = (_offset("rate", -late), *((_offset(momentum, late),) if thrown else ()))
    yield Wrong(
        "gyro late",
        later(raw, "rate", late),
        mends,
        told,
        "" if told else "wheels that lag look the same",
    )
    if raw.has(momentum) and not thrown:
        mends = (_offset(momentum, -late),)
        yield Wrong("tachometers late", later(raw, momentum, late), mends)
