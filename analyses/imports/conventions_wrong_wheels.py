"""Wrong conventions of wheels, torques, momenta and the tensor; and those that cannot show."""

from __future__ import annotations

from collections.abc import Iterator

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
from analyses.imports.conventions_folder import Mend, RawCampaign, changed, stated


def of_torque(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    if not raw.has("wheel_torque"):
        return
    yield Wrong(
        "torque sign",
        stated(raw, columns__wheel_torque__acts_on="body"),
        (Mend("columns.wheel_torque.acts_on", "wheel"),),
    )
    in_milli = changed(raw, "wheel_torque", lambda u: 1e3 * u)
    tensor = () if base.limits else (Mend("inertia*"),)
    torque_unit = Mend("columns.wheel_torque.unit", "mN m")
    alone = tensor if base.kind == NO_TACHOMETERS else ()
    yield Wrong("torque in mN m", in_milli, (torque_unit, *alone))
    if not raw.has("wheel_momentum"):
        return
    both = changed(in_milli, "wheel_momentum", lambda h: 1e3 * h)
    mends = (torque_unit, Mend("columns.wheel_momentum.unit", "mN m s"), *tensor)
    yield Wrong("torque and momentum in thousandths", both, mends, keys=2)


def _negative(wheel: dict) -> list[float]:
    return [0.0 - x for x in wheel["axis"]]


def of_wheel_axes(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    if not raw.wheels:
        return
    k = int(rng.integers(len(raw.wheels)))
    wheel = raw.wheels[k]
    mends = (Mend(f"wheels.{wheel['name']}.axis", wheel["axis"]),)
    if base.kind == THROWS:
        normals = [n for n in np.eye(3) if abs(n @ wheel_axis(raw)) < 0.5]
        turns = Rotation.from_rotvec([np.pi * n for n in normals]).as_matrix()
        axes = gyro_axes(raw)
        mends += tuple(Mend("rate_sensor.axes", (axes @ t).tolist()) for t in turns)
    yield Wrong(
        "one wheel axis flipped", stated(raw, **{f"wheels__{k}__axis": _negative(wheel)}), mends
    )
    if len(raw.wheels) < 2:
        return
    yield _swapped_wheels(base, rng)


def _swapped_wheels(base: Base, rng: np.random.Generator) -> Wrong:
    raw = base.raw
    i, j = rng.choice(len(raw.wheels), 2, replace=False).tolist()
    a, b = raw.wheels[i], raw.wheels[j]
    swapped = stated(raw, **{f"wheels__{i}__axis": b["axis"], f"wheels__{j}__axis": a["axis"]})
    torque = exchanged_names(raw.names("wheel_torque"), i, j)
    pair = 1 if base.kind == NO_TACHOMETERS else 2
    momentum = raw.momentum_channel
    mends = [
        Mend(f"wheels.{a['name']}.axis", a["axis"], needs=2),
        Mend(f"wheels.{b['name']}.axis", b["axis"], needs=2),
        Mend("columns.wheel_torque.names", torque, needs=pair),
    ]
    if raw.has(momentum):
        mends.append(
            Mend(f"columns.{momentum}.names", exchanged_names(raw.names(momentum), i, j), needs=2)
        )
    return Wrong("wheel axes swapped", swapped, tuple(mends))


def of_wheel_order(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    if len(raw.wheels) < 3 or not raw.has("wheel_torque"):
        return
    names = raw.names("wheel_torque")
    cyclic = [*names[1:], names[0]]
    alone = stated(raw, columns__wheel_torque__names=cyclic)
    mend = Mend("columns.wheel_torque.names", names)
    if not raw.has("wheel_momentum"):
        yield Wrong("wheels in cyclic order", alone, (mend, Mend("wheels.*.axis", needs=2)))
        return
    h = raw.names("wheel_momentum")
    both = stated(alone, columns__wheel_momentum__names=[*h[1:], h[0]])
    mends = (
        Mend("columns.wheel_torque.names", names, needs=2),
        Mend("columns.wheel_momentum.names", h, needs=2),
        Mend("wheels.*.axis", needs=2),
    )
    yield Wrong("wheels in cyclic order", both, mends)
    i, j = rng.choice(len(names), 2, replace=False).tolist()
    exchanged = exchanged_names(names, i, j)
    yield Wrong(
        "torque columns exchanged", stated(raw, columns__wheel_torque__names=exchanged), (mend,)
    )
    yield Wrong(
        "momentum columns exchanged",
        stated(raw, columns__wheel_momentum__names=exchanged_names(h, i, j)),
        (Mend("columns.wheel_momentum.names", h),),
    )


def of_momentum(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    if not raw.has("wheel_momentum"):
        return
    negated = changed(raw, "wheel_momentum", lambda h: -h)
    in_milli = changed(raw, "wheel_momentum", lambda h: 1e3 * h)
    unit = (Mend("columns.wheel_momentum.unit", "mN m s"),)
    if base.kind == THROWS:
        equal = (Mend("wheels.*.spin_inertia"), Mend("inertia*"))
        yield Wrong("momentum in mN m s", in_milli, unit + equal)
        return
    yield Wrong("momentum in mN m s", in_milli, unit)
    signs = (
        Mend("wheels.*.axis", needs=2),
        Mend("columns.wheel_torque.acts_on", "body", needs=2),
        Mend("columns.wheel_momentum.*"),
    )
    yield Wrong("momentum sign", negated, signs)
    both = changed(negated, "wheel_torque", lambda u: -u)
    yield Wrong("torque and momentum sign", both, (*signs, Mend("wheels.axis")))


def of_wheel_speed(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    raw = base.raw
    if not raw.has(raw.momentum_channel):
        return
    in_rpm = 60.0 / (2.0 * np.pi)
    mends = (Mend("columns.wheel_speed.unit", "rpm"),)
    if base.kind == THROWS:
        mends += (Mend("wheels.*.spin_inertia"), Mend("inertia*"))
    if raw.has("wheel_speed"):
        yield Wrong("wheel speed in rpm", changed(raw, "wheel_speed", lambda s: in_rpm * s), mends)
        return
    spin = np.array([wheel["spin_inertia"] for wheel in raw.wheels])
    speeds = changed(raw, "wheel_momentum", lambda h: in_rpm * h / spin)
    entry = {"names": raw.names("wheel_momentum"), "unit": "rad/s", "relative_to": "body"}
    speeds = stated(speeds, columns__wheel_momentum=None, columns__wheel_speed=entry)
    yield Wrong("wheel speed in rpm", speeds, mends)


def of_inertia(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    inertia = base.raw.description["inertia"]
    mends = (Mend("inertia*"),)
    if base.kind == THROWS:
        mends += (Mend("wheels.*.spin_inertia"),)
    for unit, factor in (("kg cm^2", 1e4), ("g mm^2", 1e9)):
        tensor = (factor * np.array(inertia["tensor"])).tolist()
        products = factor * inertia["product_sigma"]
        wrong = stated(base.raw, inertia__tensor=tensor, inertia__product_sigma=products)
        yield Wrong(f"inertia in {unit}", wrong, mends, keys=2)


def not_shown(base: Base, rng: np.random.Generator) -> Iterator[Wrong]:
    """Wrong conventions that change nothing the data can show: all of them are consistent."""
    raw, description = base.raw, base.raw.description
    if raw.wheels:
        yield Wrong(
            "common sign of torque, momentum and axes",
            _all_negated(raw),
            (),
            False,
            "u and h enter as G u and G h",
        )
        spin = not description["inertia"]["includes_wheel_spin"]
        other = stated(raw, inertia__includes_wheel_spin=spin)
        yield Wrong("J for J_locked", other, (), False, "within the prior of J")
    if raw.has("attitude"):
        turn = Rotation.random(random_state=int(rng.integers(2**31)))
        other = changed(raw, "attitude", lambda q: _in_inertial_frame(turn, q))
        yield Wrong("another inertial frame", other, (), False, "no equation knows it")
        signs = changed(raw, "attitude", lambda q: q * rng.choice([-1.0, 1.0], (len(q), 1)))
        yield Wrong("signs of quaternions", signs, (), False, "q and -q are one attitude")
    if raw.has("wheel_momentum") and raw.has("wheel_torque"):
        yield Wrong("absolute momentum", _absolute(raw), (), False, "Js is far within J's prior")
    if base.kind == THROWS:
        turn = Rotation.from_rotvec(np.pi * wheel_axis(raw)).as_matrix()
        why = "the tensor's prior is symmetric"
        yield Wrong(
            "gyro turned by 180 deg about the wheel", turned_readings(raw, turn), (), False, why
        )


def _all_negated(raw: RawCampaign) -> RawCampaign:
    for channel in ("wheel_torque", raw.momentum_channel):
        if raw.has(channel):
            raw = changed(raw, channel, lambda x: -x)
    axes = {f"wheels__{i}__axis": _negative(wheel) for i, wheel in enumerate(raw.wheels)}
    return stated(raw, **axes)


def _in_inertial_frame(turn: Rotation, quaternions: np.ndarray) -> np.ndarray:
    """The same attitudes from another inertial frame, (rows, 4); empty rows stay empty."""
    out, fixed = quaternions.copy(), np.isfinite(quaternions).all(axis=1)
    # scipy's rotation takes body vectors to inertial ones, so that the frame stands on the left.
    out[fixed] = (turn * Rotation.from_quat(quaternions[fixed])).as_quat()
    return out


def _absolute(raw: RawCampaign) -> RawCampaign:
    """Momentum of the wheels in inertial space, h + Js g.w."""
    G = np.array([wheel["axis"] for wheel in raw.wheels]).T
    spin = np.array([wheel["spin_inertia"] for wheel in raw.wheels])
    rate, momentum, tables = raw.names("rate"), raw.names("wheel_momentum"), {}
    for file, table in raw.tables.items():
        w = np.stack([table[name] for name in rate], axis=1) @ gyro_axes(raw)
        added = spin * (w @ G)
        tables[file] = table | {n: table[n] + added[:, i] for i, n in enumerate(momentum)}
    return RawCampaign(raw.description, tables)
