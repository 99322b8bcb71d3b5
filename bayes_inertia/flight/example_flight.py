"""Telemetry for a description that has none: its own devices fly it, at a truth that is drawn.

The forward model is the spacecraft, so whatever a description may hold flies: wheels, thrusters,
torquers or nothing. J, K and all else that the description leaves in doubt are one draw of its
prior; commands are those that would make each slew, were J at its mean. The loop is open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.actuators import Magnetorquer, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Description, Entry
from bayes_inertia.campaign.format_2 import SlewPart
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.schema import UNITS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import INPUTS, MORE
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.planned_telemetry import (
    model_readings,
    with_effect_values,
    with_noisy_inputs,
    with_readings,
)
from bayes_inertia.flight.spacecraft import body_tensor, require_shape, spin_tensor
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_input import Start
from bayes_inertia.tables.table import Table


def example_flight(
    description: str, label: str, seed: int
) -> tuple[dict[str, Table], dict[str, Any]]:
    """Fly the slews of a description, which knows no tables yet.

    `label`: the description, as messages name it. Returns what its devices told, tables by file;
    and the truth: J, K and every other parameter as they were.
    """
    parsed = parse_description(description, label)
    rng = np.random.default_rng(seed)
    planned, starts = _planned(parsed, rng)
    model = Model(planned)
    theta = model.draw_prior(rng, 1)[0]
    bias = rng.standard_normal(model.n_bias)
    readings = model_readings(model, theta, bias, starts, rng)
    tables: dict[str, Table] = {}
    for k, part in enumerate(parsed.slews):
        told = _told_beside(planned.slews[k]) | {name: given[k] for name, given in readings.items()}
        for entry in parsed.entries:
            _add_columns(tables, parsed, part, entry, *told[entry.field])
    return tables, _truth(model, theta, bias, seed)


def flown_again(
    campaign: Campaign,
    effects: tuple[Effect, ...],
    values: Mapping[str, Mapping[str, Any]],
    seed: int,
    *,
    draw: bool,
) -> tuple[Campaign, dict[str, Any]]:
    """A campaign's slews once more, turned by what its own devices did; and the truth.

    J and K are at the mean of the prior, or with `draw` one draw of it. Slews begin as they did.
    """
    require_shape(effects)
    campaign = campaign.without_locked_wheels()
    rng, model = np.random.default_rng(seed), Model(campaign, effects)
    theta = np.array(model.space.mean)
    theta[model.n_base :] = model.space.nulls[model.n_base :]
    if draw:
        theta[: model.n_base] = model.draw_prior(rng, 1)[0][: model.n_base]
    theta = with_effect_values(model, theta, effects, values)
    bias = rng.standard_normal(model.n_bias)
    readings = model_readings(model, theta, bias, model.data.arrays.reference, rng)
    slews = [
        with_noisy_inputs(with_readings(slew, k, readings), campaign, rng)
        for k, slew in enumerate(campaign.slews)
    ]
    return replace(campaign, slews=tuple(slews)), _truth(model, theta, bias, seed)


def _truth(model: Model, theta: np.ndarray, bias: np.ndarray, seed: int) -> dict[str, Any]:
    campaign = model.campaign
    J = body_tensor(theta[:6], campaign.inertia, campaign.wheels)
    return {
        "J_kgm2": J.tolist(),
        "J_locked_kgm2": (J + spin_tensor(campaign.wheels)).tolist(),
        "K": theta[6 : model.n_base].tolist(),
        "b_radps": (bias * np.asarray(model.data.scale.bias)).tolist(),
        "parameters": dict(zip(model.space.names, theta.tolist(), strict=True)),
        "seed": seed,
    }


def _planned(parsed: Description, rng: np.random.Generator) -> tuple[Campaign, Start]:
    """The campaign as it is meant, and how each slew begins."""
    begin = [part.start for part in parsed.slews]
    gaps = np.diff([*begin, 2.0 * begin[-1] - begin[-2]])
    first = Rotation.random(len(begin), rng=rng)
    slews, rates = [], []
    for part, gap, attitude in zip(parsed.slews, gaps, first, strict=True):
        slew, rate_B = _planned_slew(parsed, part, NUMERICS.example_flown_share * gap, attitude)
        slews.append(slew)
        rates.append(rate_B)
    campaign = Campaign(
        parsed.name,
        parsed.inertia,
        parsed.wheels,
        parsed.rate_sensor,
        parsed.star_tracker,
        tuple(slews),
        more_sensors=parsed.more_sensors,
        actuators=parsed.actuators,
    )
    still: Any = np.zeros((len(begin), len(parsed.wheels)))
    return campaign, Start(np.array(rates), first.as_quat(), still)  # type: ignore[arg-type]


def _planned_slew(
    parsed: Description, part: SlewPart, duration: float, first: Rotation
) -> tuple[Slew, np.ndarray]:
    """A slew that begins at an attitude, and its rate then (3,) [rad/s]."""
    assert part.axis is not None
    assert part.angle_deg is not None
    axis: Any = np.array(part.axis)
    angle = float(np.deg2rad(part.angle_deg))
    rows, rest = NUMERICS.example_rows, NUMERICS.example_rest
    step, row, half = duration / rows, np.arange(rows + 1), rows // 2
    sense = np.zeros(rows + 1)
    if parsed.wheels or parsed.actuators:
        sense[rest:half], sense[half : rows - rest] = 1.0, -1.0
        acceleration = angle / ((half - rest) * step) ** 2
        rate = acceleration * step * np.append(0.0, np.cumsum(sense)[:-1])
    else:  # It spins as it is.
        acceleration, rate = 0.0, np.full(rows + 1, angle / duration)
    turned = np.append(0.0, np.cumsum(0.5 * step * (rate[1:] + rate[:-1])))
    attitude = first * Rotation.from_rotvec(turned[:, None] * axis)
    time = row * step
    field_N = Orbit().environment(part.start + time).magnetic_field_N
    torque_B = acceleration * sense[:, None] * (parsed.inertia.tensor @ axis)
    slew = Slew(part.name, part.start, time, magnetic_field_N=field_N, axis_B=axis, angle=angle)
    slew = replace(slew, inputs=_inputs(parsed, slew, attitude, torque_B) or None)
    slew = _with_readings(parsed, slew, attitude, rate[:, None] * axis, torque_B)
    return slew, rate[0] * axis


def _inputs(
    parsed: Description, slew: Slew, attitude: Rotation, torque_B: np.ndarray
) -> dict[str, InputStream]:
    """What devices beside wheels are told, to give a torque (n, 3) [N m]."""
    between: dict[str, Any] = {
        entry.field: getattr(entry.columns, "between", "hold") for entry in parsed.entries
    }
    rows = np.arange(0, NUMERICS.example_rows, NUMERICS.example_every["input"])
    time, wanted_B = slew.time[rows], torque_B[rows]
    inputs = {}
    for device in parsed.actuators:
        form = between[INPUTS + device.name]
        if isinstance(device, Magnetorquer):
            field_B = attitude[rows].inv().apply(np.asarray(slew.magnetic_field_N)[rows])
            dipole_B = np.cross(field_B, wanted_B) / np.sum(field_B**2, axis=1, keepdims=True)
            values = dipole_B @ np.linalg.pinv(np.asarray(device.axes_B))
        else:
            assert isinstance(device, Thruster), f"no example flies {device}"
            levels = [nnls(np.asarray(device.torque_B).T, torque)[0] for torque in wanted_B]
            values = np.clip(levels, 0.0, 1.0) * (time[1] if form == "on_time" else 1.0)
        inputs[device.name] = InputStream(time, _rounded(values), form)
    return inputs


def _with_readings(
    parsed: Description, slew: Slew, attitude: Rotation, rate_B: np.ndarray, torque_B: np.ndarray
) -> Slew:
    """The slew with readings where there will be some, of about their size, and its commands."""
    to_wheels = -np.linalg.pinv(np.array([w.axis_B for w in parsed.wheels]).reshape(-1, 3))
    momentum_B = rate_B @ parsed.inertia.tensor
    sensors = dict(parsed.more_sensors)
    more: dict[str, np.ndarray] = {}
    fields: dict[str, Any] = {}
    for entry in parsed.entries:
        name = entry.field.removeprefix(MORE)
        sensor: Any = sensors.get(name, parsed.rate_sensor)
        if entry.key == "wheel_torque":  # which is held, and so known in every row
            fields[name] = _rounded(torque_B @ to_wheels)
            continue
        if entry.key == "rate":
            values = rate_B @ sensor.axes.T
        elif entry.key == "attitude":
            values = attitude.as_quat()
        elif entry.key == "direction":
            seen_N = slew.magnetic_field_N if sensor.is_field else sensor.reference_N
            values = attitude.inv().apply(seen_N)
        elif entry.key in ("wheel_momentum", "wheel_speed"):
            values = momentum_B @ to_wheels
        else:
            continue
        every = NUMERICS.example_every.get(entry.key, 1)
        values[np.arange(NUMERICS.example_rows + 1) % every > 0] = np.nan
        (more if name != entry.field else fields)[name] = values
    return replace(slew, **fields, more=more or None)


def _rounded(values: np.ndarray) -> np.ndarray:
    """Numbers as the tables will hold them."""
    return np.vectorize(lambda x: float(f"{x:.{NUMERICS.example_digits}g}"), otypes=[float])(values)


def _told_beside(slew: Slew) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Times and values of what is no reading: commands, inputs of devices, environment."""
    told = {INPUTS + name: (x.time, x.values) for name, x in (slew.inputs or {}).items()}
    for field in ("wheel_torque", "magnetic_field_N"):
        values, every = getattr(slew, field), NUMERICS.example_every[field]
        if values is not None:
            told[field] = slew.time[::every], values[::every]
    return told


def _add_columns(
    tables: dict[str, Table],
    parsed: Description,
    part: SlewPart,
    entry: Entry,
    time: np.ndarray,
    values: np.ndarray,
) -> None:
    """Put an entry into its table, in the units of the description."""
    file, clock = part.file_of(entry.columns) or "", parsed.clock(entry)
    unit = getattr(entry.columns, "unit", None)
    quantity = "magnetic_field" if entry.key == "direction" else entry.key
    if entry.key == "wheel_speed":
        values = values / [wheel.spin_inertia for wheel in parsed.wheels]
    values = values[:, list(entry.wheels)] if entry.wheels else values
    values = values / (UNITS[quantity][unit] if unit else 1.0)
    columns = dict(zip(entry.columns.names, _rounded(values).T, strict=True))
    table = tables.get(file)
    if table is None:
        columns = {clock.names[0]: _rounded(time / UNITS["time"][clock.unit]), **columns}
        tables[file] = Table.of(file, columns)
    else:
        tables[file] = table.changed(columns)
