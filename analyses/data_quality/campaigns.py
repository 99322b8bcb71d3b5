"""Campaigns of `telemetry_faults.py`: three spacecraft, hidden effects, folders with their truth.

All campaigns of a spacecraft have rows of one number, so that they share compiled code.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from analyses.naming.fixed_shape_campaigns import (
    degrees_of_freedom,
    direction,
    noncentrality,
    plain_fit,
    scaled,
    unit_step,
    without_tachometers,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.score_test import score_tests
from bayes_inertia.errors import EffectError
from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, by_name
from bayes_inertia.physics.forward_model import Model

ARCSEC = np.radians(1.0 / 3600.0)  # [rad]
SPACECRAFT = ("three_wheels", "four_wheels", "no_tachometers")
# Slews that speed up and brake within two rows, with and without torque commands: what an effect
# leaves there is as short as an outlier.
PULSED = ("pulses", "pulses_no_commands")
# Of the telemetry [s]: no multiple of it but zero is exact with 32 bits.
_PERIOD = 0.48
# A hidden effect is so strong that an ideal test would miss it once in a million campaigns.
_POWER, _LEVEL = 1.0 - 1e-6, 1e-4
# Without a trace when fixes are taken at rest; of second order, so without a score.
_NOT_HIDDEN = ("star_tracker_time_offset", "flexible_mode")
HIDDEN = tuple(e.name for e in LIBRARY if e.name not in _NOT_HIDDEN)


def plan(spacecraft: str) -> Plan:
    """Five slews like the paper's, a row every 0.48 s (which 32 bits cannot count exactly)."""
    paper, momentum = paper_like_plan(), (0.05, -0.03, 0.07)
    if spacecraft == "four_wheels":
        momentum = (*momentum, 0.04)
    if spacecraft in PULSED:
        sudden = tuple(replace(s, acceleration=np.radians(1.0)) for s in paper.slews)
        paper = replace(paper, slews=sudden)
    # Rests and fixes fall on rows.
    times = {"rest_before": 19.2, "first_fix": 7.68, "fix_spacing": 0.96, "settle": 33.12}
    return replace(paper_like_plan(), telemetry_period=_PERIOD, wheel_momentum=momentum, **times)


def four_wheels() -> Mission:
    """A minisatellite of 12 kg m^2, four skewed wheels, coarser sensors, J stated as J_locked."""
    a, b = np.sqrt(1.0 / 3.0), 0.6
    axes = ((a, a, a), (-a, a, a), (-a, -a, a), (b, -0.64, 0.48))
    wheels = tuple(
        Wheel(f"w{i}", axis, 2e-3, max_torque=0.1, max_momentum=2.0, momentum_sigma=1e-5)
        for i, axis in enumerate(axes)
    )
    J = np.array([[12.0, 0.2, -0.1], [0.2, 10.0, 0.15], [-0.1, 0.15, 7.0]])
    sensor = RateSensor(sigma=(3e-5,) * 3, bias_sigma=(4e-6,) * 3)
    tracker = StarTracker((1.0, 0.0, 0.0), 8 * ARCSEC, 50 * ARCSEC)
    craft = Spacecraft(J, (1.0, 1.0, 1.0), wheels, sensor, tracker)
    return Mission(craft, InertiaPrior(J, 0.05, 0.08, includes_wheel_spin=True))


@cache
def template(spacecraft: str) -> Campaign:
    """Hardware, prior and planned slews of a spacecraft."""
    mission = four_wheels() if spacecraft == "four_wheels" else most_like_mission()
    if spacecraft in PULSED:
        strong = tuple(replace(w, max_torque=None) for w in mission.spacecraft.wheels)
        mission = replace(mission, spacecraft=replace(mission.spacecraft, wheels=strong))
    return planned_campaign(plan(spacecraft), mission)


def flown(
    spacecraft: str, index: int, effects: tuple[Effect, ...] = (), values: dict | None = None
) -> Flight:
    """One campaign: J, K, bias, angles and senses of its slews drawn; what else acts by values."""
    seed = np.random.SeedSequence(
        20261, spawn_key=((*SPACECRAFT, *PULSED).index(spacecraft), index)
    )
    flight = draw_flight(
        template(spacecraft), plan(spacecraft), seed, effects=effects, values=values or {}
    )
    if spacecraft == "no_tachometers":
        return replace(flight, campaign=without_tachometers(flight.campaign))
    if spacecraft == "pulses_no_commands":
        slews = tuple(replace(s, wheel_torque=None) for s in flight.campaign.slews)
        return replace(flight, campaign=replace(flight.campaign, slews=slews))
    return flight


def kept_strengths(folder: Path, spacecraft: str) -> dict[str, dict]:
    """As `strengths`, computed once a work folder."""
    path = folder / f"strengths_{spacecraft}.json"
    if not path.is_file():
        plain = {
            name: {key: np.asarray(value).tolist() for key, value in values.items()}
            for name, values in strengths(spacecraft).items()
        }
        path.write_text(json.dumps(plain, indent=1) + "\n")
    return json.loads(path.read_text())


def strengths(spacecraft: str) -> dict[str, dict]:
    """Values of every effect at which it is easily found, alone, in campaign 0 of a spacecraft."""
    campaign, rng = flown(spacecraft, 0).campaign, np.random.default_rng(7)
    effects = tuple(e for e in by_name(HIDDEN) if acts_on(e, campaign))
    everything = optimizer.move_to(plain_fit(campaign), Model(campaign, effects))
    scores = score_tests(linear_model(everything))
    values = {}
    for effect, own in zip(effects, scores.indices, strict=True):
        along = direction(effect, rng, template(spacecraft))
        step = unit_step(effect, along, campaign)
        wanted = noncentrality(_POWER, degrees_of_freedom(effect, campaign), _LEVEL)
        unit = max(float(step @ scores.matrix[np.ix_(own, own)] @ step), 1e-12)
        values[effect.name] = scaled(along, float(np.clip(np.sqrt(wanted / unit), 1e-9, 30.0)))
    return values


def can_act(name: str, spacecraft: str) -> bool:
    """Whether an effect of the library acts on a spacecraft's campaign."""
    acts_at_command = name in ("wheel_torque_gain", "wheel_command_lag", "wheel_friction")
    return not (acts_at_command and spacecraft == "pulses_no_commands")


def acts_on(effect: Effect, campaign: Campaign) -> bool:
    """Whether the package accepts the effect for the campaign."""
    try:
        Model(campaign, (effect,))
    except EffectError:
        return False
    return True


def written(folder: Path, spacecraft: str, index: int, hidden: str = "", strength: float = 1.0):
    """The folder of a campaign with its truth and true attitudes, simulated unless it is there."""
    path = folder / f"{spacecraft}_{index}{'_' + hidden if hidden else ''}_{strength:g}"
    if not (path / "truth.json").is_file():
        effects = by_name((hidden,)) if hidden else ()
        values = {
            e.name: stronger(
                e, template(spacecraft), kept_strengths(folder, spacecraft)[hidden], strength
            )
            for e in effects
        }
        flight = flown(spacecraft, index, effects, values)
        write_campaign(flight.campaign, path)
        attitude = {
            f"slew_{i + 1:02d}.csv": np.asarray(t.attitude) for i, t in enumerate(flight.truth)
        }
        np.savez(path / "attitude.npz", **attitude)
        (path / "truth.json").write_text(json.dumps({"theta": flight.mission.theta.tolist()}))
    return path


def stronger(effect: Effect, campaign: Campaign, values: dict, factor: float) -> dict:
    """An effect's values `factor` times as far from their null."""
    nulls = {p.name: p.null for p in effect.parameters(campaign) if not p.priors[0].logarithmic}
    return {
        key: nulls[key] + factor * (np.asarray(value) - nulls[key]) if key in nulls else value
        for key, value in values.items()
    }


def truth_in(folder: Path) -> np.ndarray:
    """J and K (9,) of a folder's truth.json: a simulation's, Basilisk's, a body's (no K: NaN)."""
    truth = json.loads((folder / "truth.json").read_text())
    if "theta" in truth:
        return np.array(truth["theta"])
    J = np.array(truth["J_kgm2"] if "J_kgm2" in truth else truth["J_locked_kgm2"])
    K = truth.get("K", [np.nan] * 3)
    return np.array([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *K])
