"""The spacecraft and flights of `conventions.py`, and bodies thrown by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.flight.closed_loop import fly_slews
from bayes_inertia.flight.closed_loop_flights import closed_loop_inputs
from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_spacecraft, vary_plan
from bayes_inertia.flight.spacecraft import Controller, Spacecraft
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import SlewInput, Start, idle_slew

ARCSEC = math.pi / (180.0 * 3600.0)  # [rad]
# Multiple of the prior sd at which an ideal test finds the effect in 99 % of the campaigns of the
# MOST-like spacecraft (medians of 400 campaigns, `naming/fixed_shape.py`).
EASILY_FOUND: Mapping[str, float] = {
    "rate_bias": 0.63,
    "rate_bias_drift": 0.14,
    "rate_sensor_misalignment": 0.16,
    "rate_sensor_delay": 0.12,
    "rate_sensor_nonlinearity": 0.28,
    "star_tracker_misalignment": 0.11,
    "star_tracker_shift": 0.25,
    "star_tracker_time_offset": 0.02,
    "wheel_torque_gain": 0.002,
    "wheel_misalignment": 0.06,
    "wheel_friction": 0.0003,
    "wheel_command_lag": 0.0023,
    "constant_torque": 0.017,
    "magnetic_dipole": 0.016,
    "gravity_gradient": 0.08,
    "viscous_torque": 0.056,
    "flexible_mode": 0.8,
    "inertia_change": 0.0038,
}


@dataclass(frozen=True)
class Craft:
    """A spacecraft with the plan that it flies; angles of the slews [rad]."""

    name: str
    mission: Mission
    plan: Plan
    angles: tuple[float, float]


def _slews(
    angle: float, rate: float, acceleration: float, axes: Sequence[tuple]
) -> tuple[PlannedSlew, ...]:
    """Slews of one angle [deg], rate [deg/s] and acceleration [deg/s^2]."""
    return tuple(
        PlannedSlew(axis, *(math.radians(x) for x in (angle, rate, acceleration))) for axis in axes
    )


_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, -1.0, -1.0), (5.0, -5.0, 3.0))


def most() -> Craft:
    """The MOST-like spacecraft at 2 Hz: three wheels along the body axes."""
    plan = replace(paper_like_plan(), telemetry_period=0.5)
    return Craft("MOST-like", most_like_mission(), plan, (math.radians(20.0), math.radians(60.0)))


def cubesat(period: float) -> Craft:
    """A cubesat of 0.05 kg m^2 with a pyramid of four wheels."""
    J = np.array([[0.05, 0.0006, -0.0004], [0.0006, 0.043, 0.0005], [-0.0004, 0.0005, 0.021]])
    c = 1.0 / math.sqrt(3.0)
    axes = ((c, c, c), (-c, c, c), (-c, -c, c), (c, -c, c))
    limits = {"max_torque": 2e-3, "max_momentum": 1.5e-2, "momentum_sigma": 1e-6}
    wheels = tuple(Wheel(f"rw{i}", axis, 2.2e-5, **limits) for i, axis in enumerate(axes))
    sensor = RateSensor(
        sigma=(1e-4,) * 3, bias_sigma=(5e-5,) * 3, scale_factor_sigma=(0.01,) * 3, range=1.0
    )
    tracker = StarTracker((1.0, 0.0, 0.0), 10.0 * ARCSEC, 60.0 * ARCSEC)
    craft = Spacecraft(J, (1.0, 1.0, 1.0), wheels, sensor, tracker)
    plan = Plan(
        "cubesat with four skewed wheels",
        _slews(90.0, 2.0, 0.2, _AXES),
        wheel_momentum=(2e-3, -1e-3, 1.5e-3, -0.5e-3),
        telemetry_period=period,
        orbit=Orbit(),
    )
    name = f"cubesat, {1.0 / period:g} Hz"
    angles = (math.radians(40.0), math.radians(90.0))
    return Craft(name, Mission(craft, InertiaPrior(J, 0.05, 0.001)), plan, angles)


def big() -> Craft:
    """A satellite of 250 kg m^2: three wheels along the axes and a skewed one, no stated limits."""
    J = np.array([[250.0, 3.0, -2.0], [3.0, 200.0, 4.0], [-2.0, 4.0, 140.0]])
    c = 1.0 / math.sqrt(3.0)
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (c, c, c))
    wheels = tuple(
        Wheel(f"W{i + 1}", axis, 0.03, momentum_sigma=5e-4) for i, axis in enumerate(axes)
    )
    sensor = RateSensor(sigma=(1e-5,) * 3, bias_sigma=(2e-6,) * 3, scale_factor_sigma=(0.005,) * 3)
    tracker = StarTracker((0.0, -1.0, 0.0), 3.0 * ARCSEC, 20.0 * ARCSEC)
    craft = Spacecraft(J, (1.0, 1.0, 1.0), wheels, sensor, tracker)
    plan = Plan(
        "satellite of 250 kg m^2",
        _slews(60.0, 0.4, 0.005, _AXES),
        wheel_momentum=(3.0, -2.0, 4.0, 1.0),
        telemetry_period=1.0,
        orbit=Orbit(),
    )
    angles = (math.radians(30.0), math.radians(60.0))
    return Craft("250 kg m^2", Mission(craft, InertiaPrior(J, 0.05, 2.0)), plan, angles)


@cache
def crafts() -> tuple[Craft, ...]:
    """The spacecraft of the study."""
    return (most(), cubesat(1.0), cubesat(0.2), big())


@cache
def _template(craft: Craft) -> Campaign:
    return planned_campaign(craft.plan, craft.mission)


def effect_values(
    craft: Craft, strengths: Mapping[str, float], rng: np.random.Generator
) -> dict[str, dict[str, Any]]:
    """Values of all effects of the library: null, but for those that have a strength.

    A strength counts prior sds in a random direction. A parameter that only gives an effect its
    shape stays at its null.
    """
    values: dict[str, dict[str, Any]] = {}
    for effect in LIBRARY:
        values[effect.name] = {}
        for p in effect.parameters(_template(craft)):
            step = rng.normal(size=len(p.names))
            step = np.abs(step) if p.priors[0].lower == p.null else step
            sd = np.array([0.0 if q.logarithmic else q.sd for q in p.priors])
            drawn = p.null + strengths.get(effect.name, 0.0) * step * sd
            values[effect.name][p.name] = drawn if p.components else float(drawn[0])
    return values


def flown(
    craft: Craft,
    seed: int,
    *,
    moving_fixes: bool = False,
    strengths: Mapping[str, float] | None = None,
    mission: Mission | None = None,
    plan: Plan | None = None,
    controller: Controller | None = None,
) -> Campaign:
    """One campaign of a spacecraft: truth drawn from its prior, flown in closed loop with noise.

    `moving_fixes` gives star-tracker fixes in the whole slew. `mission` and `plan`, where given,
    are flown as they are.
    """
    rng = np.random.default_rng([seed, 14])
    effects: tuple[Effect, ...] = LIBRARY if strengths else ()
    values = effect_values(craft, strengths, rng) if strengths else {}
    if mission is None:
        drawn = draw_spacecraft(_template(craft), rng, effects, values)
        mission = Mission(drawn, craft.mission.prior)
    plan = plan or vary_plan(craft.plan, rng, craft.angles)
    planned, loop = closed_loop_inputs(plan, mission, controller, rng)
    on_host: Any = jax.tree.map(np.asarray, fly_slews(loop))
    slews = tuple(
        _telemetry(plan, i, slew, on_host, moving_fixes) for i, slew in enumerate(planned.slews)
    )
    return replace(planned, slews=slews)


def _telemetry(plan: Plan, i: int, slew: Slew, flight: Any, moving_fixes: bool) -> Slew:
    """What telemetry shows of slew i."""
    n = len(slew.time)
    rows = np.concatenate(plan.fixes(i))
    if moving_fixes:
        spacing = max(1, round(1.0 / plan.telemetry_period))
        rows = np.arange(0, n, spacing)
    fixes = np.full((n, 4), np.nan)
    fixes[rows] = flight.fixes[i, rows]
    return replace(
        slew,
        rate=flight.rate[i, :n],
        attitude=fixes,
        wheel_torque=flight.command[i, :n],
        wheel_momentum=flight.momentum[i, :n],
        magnetic_field_N=None,
        position_N=None,
    )


@jax.jit
def simulated_slew(slew: SlewInput, start: Start, inertia_B: jax.Array) -> Trajectory:
    """The trajectory of one slew that is flown open loop."""
    return simulate_slew(slew, start, inertia_B)[0]


@dataclass(frozen=True)
class ThrownBody:
    """A body with one wheel: principal moments [kg m^2] and the wheel's axis."""

    name: str
    moments: tuple[float, float, float]
    axis_B: tuple[float, float, float]
    spin_inertia: float = 1.7e-6


THROWN_BODIES = (
    ThrownBody("plate", (1.5e-3, 3.8e-4, 1.8e-3), (0.0, 0.0, -1.0)),
    ThrownBody("block", (9e-4, 1.4e-3, 6.5e-4), (1.0, 0.0, 0.0), 3e-6),
)


def thrown(
    body: ThrownBody, seed: int, throws: int = 6, period: float = 1e-3, duration: float = 0.5
) -> Campaign:
    """Throws of a body whose wheel spins up and is braked in free flight: no tracker, no commands.

    True moments are drawn to 15 % about those stated with 30 %.
    """
    rng = np.random.default_rng([seed, 15])
    moments = np.array(body.moments)
    J = np.diag(moments * (1.0 + 0.15 * rng.uniform(-1.0, 1.0, 3)))
    product_sigma = 0.1 * float(moments.min())
    i, j = np.triu_indices(3, 1)
    J[i, j] = J[j, i] = 0.3 * product_sigma * rng.normal(size=3)
    axis = np.array(body.axis_B)
    time = np.arange(0.0, duration, period)
    slews = []
    for k in range(throws):
        path = _free_flight(body, J, axis, time, rng)
        bias = 0.01 * rng.normal(size=3)
        slews.append(
            Slew(
                name=f"throw {k + 1}",
                start=60.0 * k,
                time=time,
                rate=np.asarray(path.rate_B) + bias + 0.0153 * rng.normal(size=(len(time), 3)),
                wheel_momentum=np.asarray(path.wheel_momentum)
                + 9.6e-6 * rng.normal(size=(len(time), 1)),
            )
        )
    wheel = Wheel("flywheel", body.axis_B, body.spin_inertia, momentum_sigma=9.6e-6)
    sensor = RateSensor(
        sigma=(0.0153,) * 3, range=34.9, scale_factor_sigma=(0.005,) * 3, bias_sigma=(0.01,) * 3
    )
    prior = InertiaPrior(np.diag(moments), 0.3, product_sigma, True)
    return Campaign(f"thrown {body.name}", prior, (wheel,), sensor, None, tuple(slews))


def _free_flight(
    body: ThrownBody, J: np.ndarray, axis: np.ndarray, time: np.ndarray, rng: np.random.Generator
) -> Any:
    """One throw: the wheel is accelerated for a third of the flight and braked for another."""
    peak = rng.uniform(1.5e-3, 3.5e-3)  # [N m s]
    third = time[-1] / 3.0
    torque = peak / third * ((time < third).astype(float) - (time > 2.0 * third))
    rate = rng.uniform(4.0, 9.0, 3) * rng.choice([-1.0, 1.0], 3)
    start = Start(
        jnp.asarray(rate), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.asarray([3e-4 * rng.uniform()])
    )
    slew = idle_slew(
        time,
        wheel_axes_B=axis[:, None],
        spin_inertia=np.array([body.spin_inertia]),
        torque=torque[:, None],
    )
    without_wheel = J - body.spin_inertia * np.outer(axis, axis)
    return simulated_slew(slew, start, jnp.asarray(without_wheel))
