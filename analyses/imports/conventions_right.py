"""The right campaigns of `conventions.py`, of which none may be accused.

Clean ones, ones with hidden physical effects, with dirt, with both, thrown bodies, telemetry of
others where it is at hand, and flights at the edge of what the package is made for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, product
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from analyses.imports.conventions_cases import FULL, KINDS, NO_TACHOMETERS, NO_TRACKER, THROWS
from analyses.imports.conventions_faults import DIRT
from analyses.imports.conventions_folder import (
    RawCampaign,
    changed,
    of_slews,
    raw_of,
    read_raw,
    stated,
    without,
)
from analyses.imports.conventions_random import random_craft
from analyses.imports.conventions_spacecraft import (
    EASILY_FOUND,
    THROWN_BODIES,
    Craft,
    big,
    crafts,
    cubesat,
    flown,
    most,
    simulated_slew,
    thrown,
)
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.flight.mission import Mission
from bayes_inertia.physics.slew_input import Start, idle_slew

FLOWN_KINDS = KINDS[:3]
THROW_FOLDERS = ("config_a", "config_empty", "proof_body", "device_only")
BASILISK_FOLDERS = ("clean", "clean_varied", "hidden_lag", "hidden_dipole")


@dataclass(frozen=True)
class Right:
    """A campaign whose conventions are right."""

    group: str
    name: str
    kind: str
    raw: RawCampaign


def as_kind(raw: RawCampaign, kind: str) -> RawCampaign:
    """The campaign as if it had no tachometers, or no star tracker."""
    if kind == NO_TACHOMETERS:
        return without(raw, raw.momentum_channel)
    return without(raw, "attitude") if kind == NO_TRACKER else raw


def groups(delft: Path | None, basilisk: Path | None) -> dict[str, Callable[[], Iterator[Right]]]:
    """What makes the campaigns of each group, in a fixed order; absent folders are left out."""
    return {
        "clean": _clean,
        "hidden effect": _with_effects,
        "dirt": _with_dirt,
        "effects and dirt": _with_both,
        "random spacecraft": _random,
        "throws": partial(_throws, delft),
        "another simulator": partial(_of_basilisk, basilisk),
        "edge": _at_the_edge,
    }


def _clean() -> Iterator[Right]:
    for seed, (craft, kind, moving) in enumerate(
        product(crafts(), FLOWN_KINDS, (False, True)), start=1000
    ):
        raw = as_kind(raw_of(flown(craft, seed, moving_fixes=moving)), kind)
        yield Right("clean", f"{craft.name}, moving {moving}, seed {seed}", kind, raw)


def _kind_for(effect: str, number: int) -> str:
    """A kind of campaign that has the sensor that the effect is about."""
    kinds = (FULL, NO_TACHOMETERS) if effect.startswith("star_tracker") else FLOWN_KINDS
    return kinds[number % len(kinds)]


def _with_effects() -> Iterator[Right]:
    """Each effect as strong as is easily found, 10 times as strong, and as its prior has it."""
    craft_cycle, seed = cycle(crafts()), 2000
    for number, (effect, easy) in enumerate(EASILY_FOUND.items()):
        for times, strength in (("1", easy), ("10", min(10.0 * easy, 2.0)), ("prior", 1.0)):
            craft, kind = next(craft_cycle), _kind_for(effect, number + seed)
            moving = bool(seed % 2)
            strengths = {effect: strength}
            campaign = flown(craft, seed, moving_fixes=moving, strengths=strengths)
            name = f"{effect} x {times}, {craft.name}, moving {moving}, seed {seed}"
            yield Right("hidden effect", name, kind, as_kind(raw_of(campaign), kind))
            seed += 1
        next(craft_cycle)


def _with_dirt() -> Iterator[Right]:
    seed = 3000
    for number, (name, dirty) in enumerate(DIRT.items()):
        for k, kind in enumerate(FLOWN_KINDS):
            craft = crafts()[(number + k) % len(crafts())]
            raw = raw_of(flown(craft, seed, moving_fixes=bool(number % 2)))
            rng = np.random.default_rng([seed, 1])
            raw = dirty(as_kind(raw, kind), rng)
            yield Right("dirt", f"{name}, {craft.name}, seed {seed}", kind, raw)
            seed += 1


def _with_both() -> Iterator[Right]:
    """Two effects, as strong as their priors or 10 times as easily found, and two kinds of dirt."""
    for seed in range(4000, 4030):
        rng = np.random.default_rng([seed, 2])
        effects = rng.choice(list(EASILY_FOUND), 2, replace=False).tolist()
        strengths = {e: float(rng.choice([min(10.0 * EASILY_FOUND[e], 2.0), 1.0])) for e in effects}
        dirts = rng.choice(list(DIRT), 2, replace=False).tolist()
        craft, kind = crafts()[seed % len(crafts())], FLOWN_KINDS[seed % 3]
        raw = raw_of(flown(craft, seed, moving_fixes=seed % 5 < 2, strengths=strengths))
        raw = as_kind(raw, kind)
        for dirt in dirts:
            raw = DIRT[dirt](raw, rng)
        name = f"{' + '.join(effects)}; {' + '.join(dirts)}; {craft.name}, seed {seed}"
        yield Right("effects and dirt", name, kind, raw)


def _random() -> Iterator[Right]:
    """Spacecraft drawn at random: every other one with an effect, every third with dirt."""
    for seed in range(40, 80):
        (craft, controller), rng = random_craft(seed), np.random.default_rng([seed, 4])
        kind, moving = FLOWN_KINDS[seed % 3], seed % 4 < 2
        effect = rng.choice(list(EASILY_FOUND))
        strengths = {effect: 1.0} if seed % 2 else None
        raw = raw_of(
            flown(craft, seed, moving_fixes=moving, strengths=strengths, controller=controller)
        )
        raw, dirt = as_kind(raw, kind), rng.choice(list(DIRT))
        raw = DIRT[dirt](raw, rng) if seed // 3 % 3 == 0 else raw
        name = f"{craft.name}, {effect if seed % 2 else ''}, {dirt if seed // 3 % 3 == 0 else ''}"
        yield Right("random spacecraft", name, kind, raw)


def _throws(delft: Path | None) -> Iterator[Right]:
    dirts = ("outliers", "stuck", "dropped rows", "quantised", "coloured", "understated noise")
    for body in THROWN_BODIES:
        for seed in range(5000, 5004):
            raw = raw_of(thrown(body, seed))
            yield Right("throws", f"{body.name}, seed {seed}", THROWS, raw)
        for seed, dirt in enumerate(dirts, start=5100):
            raw = DIRT[dirt](raw_of(thrown(body, seed)), np.random.default_rng([seed, 3]))
            yield Right("throws", f"{dirt}, {body.name}, seed {seed}", THROWS, raw)
    yield Right("throws", "4 kHz", THROWS, raw_of(thrown(THROWN_BODIES[0], 5200, 4, 2.5e-4)))
    one = raw_of(thrown(THROWN_BODIES[1], 5201, 1))
    yield Right("throws", "a single throw", THROWS, one)
    for name in THROW_FOLDERS if delft else ():
        yield Right("throws", f"real, {name}", THROWS, read_raw(delft / name))


def _of_basilisk(folder: Path | None) -> Iterator[Right]:
    for name, kind in product(BASILISK_FOLDERS if folder else (), FLOWN_KINDS):
        yield Right("another simulator", name, kind, as_kind(read_raw(folder / name), kind))


def _at_the_edge() -> Iterator[Right]:
    """Flights at the edge of what the package is made for."""
    makers: tuple[Callable[[], Iterator[tuple[str, str, RawCampaign]]], ...] = (
        _few_slews,
        _unusual_motion,
        _prior_far_off,
        _unusual_sensors,
        _few_channels,
        _strong_effects,
        _tumbling,
    )
    for maker in makers:
        for name, kind, raw in maker():
            yield Right("edge", name, kind, raw)


def _few_slews() -> Iterator[tuple[str, str, RawCampaign]]:
    raw = raw_of(flown(most(), 6000))
    for kind in FLOWN_KINDS:
        yield f"one slew about x, {kind}", kind, as_kind(of_slews(raw, [0]), kind)
    raw = raw_of(flown(cubesat(0.2), 6001, moving_fixes=True))
    yield "one diagonal slew", FULL, of_slews(raw, [3])
    x = most().plan.slews[0]
    plan = replace(most().plan, slews=(x, replace(x, axis_B=(-1.0, 0.0, 0.0)), x))
    for kind in FLOWN_KINDS:
        raw = as_kind(raw_of(flown(most(), 6002, plan=plan)), kind)
        yield f"a single axis, {kind}", kind, raw


def _slews_of(craft: Craft, **changes: float) -> Craft:
    """The spacecraft with other slews; angles in radians."""
    slews = tuple(replace(slew, **changes) for slew in craft.plan.slews)
    angle = changes.get("angle", slews[0].angle)
    return replace(craft, plan=replace(craft.plan, slews=slews), angles=(0.99 * angle, angle))


def _unusual_motion() -> Iterator[tuple[str, str, RawCampaign]]:
    degree = math.pi / 180.0
    cases = (
        ("very slow slews", most(), {"angle": 2 * degree, "rate": 0.02 * degree}),
        ("tiny slews", most(), {"angle": 0.3 * degree}),
        ("no motion", cubesat(1.0), {"angle": 1e-6}),
        ("half turns", cubesat(1.0), {"angle": 179.5 * degree, "rate": 4 * degree}),
        ("turns of 300 deg", cubesat(0.2), {"angle": 300 * degree, "rate": 4 * degree}),
        ("8 deg/s at 1 Hz", cubesat(1.0), {"angle": 170 * degree, "rate": 8 * degree}),
        ("smooth ramps", big(), {"profile": "smooth"}),
    )
    for seed, (name, craft, changes) in enumerate(cases, start=6100):
        spacecraft = _slews_of(craft, **changes)
        raw = raw_of(flown(spacecraft, seed, moving_fixes=name == "8 deg/s at 1 Hz"))
        for kind in FLOWN_KINDS:
            yield f"{name}, {kind}", kind, as_kind(raw, kind)
    still = replace(most(), plan=replace(most().plan, wheel_momentum=()))
    for kind in FLOWN_KINDS:
        raw = as_kind(raw_of(flown(still, 6150, moving_fixes=True)), kind)
        yield f"no momentum, {kind}", kind, raw
    spun = replace(most(), plan=replace(most().plan, wheel_momentum=(0.02, 0.25, -0.01)))
    yield "momentum bias", FULL, raw_of(flown(spun, 6151))
    identity = replace(most().plan, start_attitude=(0.0, 0.0, 0.0, 1.0))
    yield "start at the identity", FULL, raw_of(flown(most(), 6152, plan=identity))


def _prior_far_off() -> Iterator[tuple[str, str, RawCampaign]]:
    for seed, (name, factor) in enumerate((("J 50 % large", 1.5), ("J 40 % small", 0.6)), 6200):
        raw = raw_of(flown(most(), seed))
        tensor = (factor * np.array(raw.description["inertia"]["tensor"])).tolist()
        for kind in FLOWN_KINDS:
            yield f"{name}, {kind}", kind, as_kind(stated(raw, inertia__tensor=tensor), kind)
    raw = changed(raw_of(flown(cubesat(1.0), 6210)), "rate", lambda w: w * [1.2, 0.85, 1.15])
    for kind in FLOWN_KINDS:
        yield f"K 20 % off, {kind}", kind, as_kind(raw, kind)


def _unusual_sensors() -> Iterator[tuple[str, str, RawCampaign]]:
    skew = np.array([[1.0, 0.0, 0.0], [0.5, 0.8, 0.2], [-0.3, 0.4, 0.9]])
    skew /= np.linalg.norm(skew, axis=1, keepdims=True)
    mounted = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
    for seed, (name, axes) in enumerate((("skewed", skew), ("turned", mounted)), 6300):
        craft = _with_sensor(most(), replace(most().mission.spacecraft.rate_sensor, axes=axes))
        raw = raw_of(flown(craft, seed))
        for kind in FLOWN_KINDS:
            yield f"gyro with {name} axes, {kind}", kind, as_kind(raw, kind)
    arcmin = 60.0 * math.pi / (180.0 * 3600.0)
    coarse = replace(
        most().mission.spacecraft, star_tracker=StarTracker((0.0, 0.0, 1.0), arcmin, arcmin)
    )
    craft = replace(most(), mission=Mission(coarse, most().mission.prior))
    yield "coarse fixes in motion", FULL, raw_of(flown(craft, 6310, moving_fixes=True))
    weak = tuple(replace(w, max_torque=1.2e-3) for w in most().mission.spacecraft.wheels)
    craft = replace(
        most(),
        mission=Mission(replace(most().mission.spacecraft, wheels=weak), most().mission.prior),
    )
    yield "wheels saturate", FULL, raw_of(flown(craft, 6311))


def _with_sensor(craft: Craft, sensor: RateSensor) -> Craft:
    spacecraft = replace(craft.mission.spacecraft, rate_sensor=sensor)
    return replace(craft, mission=Mission(spacecraft, craft.mission.prior))


def _few_channels() -> Iterator[tuple[str, str, RawCampaign]]:
    raw = raw_of(flown(most(), 6400, moving_fixes=True))
    bare = as_kind(as_kind(raw, NO_TACHOMETERS), NO_TRACKER)
    yield "commands and gyro alone", "few channels", bare
    yield "no commands", "few channels", without(raw, "wheel_torque")
    gyro_and_tracker = without(as_kind(raw, NO_TACHOMETERS), "wheel_torque")
    yield "gyro and star tracker alone", "few channels", gyro_and_tracker
    rng = np.random.default_rng(6401)

    def rarely(w: np.ndarray) -> np.ndarray:
        w = w.copy()
        w[rng.random(len(w)) < 0.75] = np.nan
        return w

    yield "gyro at a quarter of the rows", FULL, changed(raw, "rate", rarely)


def _strong_effects() -> Iterator[tuple[str, str, RawCampaign]]:
    """Physical effects several prior sds strong: still no conventions."""
    cases = (
        ("wheel_command_lag", 2.0),
        ("wheel_friction", 10.0),
        ("wheel_torque_gain", 5.0),
        ("wheel_misalignment", 5.0),
        ("rate_sensor_misalignment", 5.0),
        ("rate_sensor_delay", 1.5),
        ("constant_torque", 5.0),
        ("inertia_change", 3.0),
    )
    for seed, ((effect, strength), kind) in enumerate(product(cases, FLOWN_KINDS), start=6500):
        craft = crafts()[seed % len(crafts())]
        campaign = flown(craft, seed, strengths={effect: strength}, moving_fixes=bool(seed % 2))
        yield f"{effect} {strength:g} sd, {craft.name}", kind, as_kind(raw_of(campaign), kind)


def _tumbling() -> Iterator[tuple[str, str, RawCampaign]]:
    """An open-loop tumble at 3 deg/s with random torques, and fixes in motion."""
    craft, rng = most().mission.spacecraft, np.random.default_rng(6600)
    time = np.arange(0.0, 120.0, 0.5)
    slews = []
    for i in range(3):
        torque = np.repeat(rng.uniform(-2e-3, 2e-3, (len(time) // 20, 3)), 20, axis=0)
        attitude = rng.normal(size=4)
        start = Start(
            jnp.asarray(np.radians(rng.uniform(-3.0, 3.0, 3))),
            jnp.asarray(attitude / np.linalg.norm(attitude)),
            jnp.asarray(rng.uniform(-0.05, 0.05, 3)),
        )
        given = idle_slew(time, 3, craft.wheel_axes_B, np.full(3, 1e-3), torque)
        path = simulated_slew(given, start, jnp.asarray(craft.inertia_B))
        noise = Rotation.from_rotvec(2.4e-5 * rng.normal(size=(len(time), 3)))
        fixes = (Rotation.from_quat(np.asarray(path.attitude)) * noise).as_quat()
        fixes[np.arange(len(time)) % 2 == 1] = np.nan
        slews.append(
            Slew(
                name=f"tumble {i + 1}",
                start=300.0 * i,
                time=time,
                rate=np.asarray(path.rate_B) + 2e-5 * rng.normal(size=(len(time), 3)),
                attitude=fixes,
                wheel_torque=torque,
                wheel_momentum=np.asarray(path.wheel_momentum)
                + 5e-6 * rng.normal(size=(len(time), 3)),
            )
        )
    template = flown(most(), 6601)
    prior = InertiaPrior(most().mission.prior.tensor, 0.04, 0.03)
    raw = raw_of(replace(template, slews=tuple(slews), inertia=prior))
    for kind in FLOWN_KINDS:
        yield f"tumbling, {kind}", kind, as_kind(raw, kind)
