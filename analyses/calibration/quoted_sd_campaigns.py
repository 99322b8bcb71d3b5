"""The campaigns of `quoted_sd.py`: clean, designed, weakly disturbed, dirty, refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from analyses.calibration.unmodelled_disturbance import disturbance
from analyses.data_quality.campaigns import acts_on, truth_in, written
from analyses.data_quality.cases import cases, dirty
from analyses.data_quality.faults import read_raw, write_raw
from analyses.design.cases import GOALS, LIMITS, MISSION, plan_for
from analyses.naming.fixed_shape import truth_of
from analyses.naming.fixed_shape_campaigns import (
    degrees_of_freedom,
    direction,
    draw,
    noncentrality,
    plain_fit,
    scaled,
    unit_step,
    without_tachometers,
)
from analyses.naming.second_simulator import replayed
from analyses.naming.unlisted_disturbances import OUTSIDE
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.designer import design_plan
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.score_test import score_tests
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.forward_model import Model

CLASSES = ("clean", "designed", "weak-library", "weak-outside", "dirty", "refused")
# Effects whose signal is of first order, so that an ideal test's power sets their size.
WEAK = tuple(e for e in LIBRARY if e.name not in ("flexible_mode", "star_tracker_time_offset"))
# An effect is as often missed as found by an ideal test at the level of one in a hundred.
_POWER, _LEVEL = 0.5, 0.01
_SHARE_OF_OUTSIDE = 0.3  # of the size at which the naming study finds something missing
_REFUSED = (*OUTSIDE, "random-torque", "fast-torque", "random-walk")
_PERIOD = 0.5  # of the telemetry [s]


@dataclass(frozen=True)
class Case:
    """A campaign with its truth: J, K (9,)."""

    campaign: Campaign
    truth: np.ndarray
    hidden: str = ""


def case_of(
    kind: str, index: int, seed: np.random.SeedSequence, tachometers: bool, work: Path
) -> Case:
    """Campaign `index` of a class."""
    if kind == "dirty":
        return _dirty(index, tachometers, work)
    if kind == "designed":
        return _designed(index, seed, tachometers)
    if kind == "weak-library":
        effects = library_of(_information(tachometers)[0])
        return _weak(effects[index % len(effects)], seed, tachometers)
    if kind == "clean":
        return _replayed("clean", 1.0, seed, tachometers)
    names = tuple(OUTSIDE) if kind == "weak-outside" else _REFUSED
    share = _SHARE_OF_OUTSIDE if kind == "weak-outside" else 1.0
    return _replayed(names[index % len(names)], share, seed, tachometers)


def _replayed(name: str, share: float, seed: np.random.SeedSequence, tachometers: bool) -> Case:
    """A flight of the second simulator, with something that the library does not hold."""
    flown, noise, path = seed.spawn(3)
    flight = draw(flown, (), {}, True)
    kind = name.removeprefix("outside_").replace("_", "-")
    missing = disturbance(kind, int(path.generate_state(1)[0]))
    missing = replace(missing, size=share * missing.size)
    campaign = replayed(flight, missing, np.random.default_rng(noise))
    return Case(campaign if tachometers else without_tachometers(campaign), truth_of(flight), kind)


def _weak(effect: Effect, seed: np.random.SeedSequence, tachometers: bool) -> Case:
    """A flight with an effect of the library that an ideal test misses as often as not."""
    flown, along = seed.spawn(2)
    campaign, matrices = _information(tachometers)
    values = direction(effect, np.random.default_rng(along), campaign)
    step = unit_step(effect, values, campaign)
    wanted = noncentrality(_POWER, degrees_of_freedom(effect, campaign), _LEVEL)
    unit = max(float(step @ matrices[effect.name] @ step), 1e-12)
    size = float(np.clip(np.sqrt(wanted / unit), 1e-9, 30.0))
    flight = draw(flown, (effect,), {effect.name: scaled(values, size)}, tachometers)
    return Case(flight.campaign, truth_of(flight), effect.name)


@lru_cache(maxsize=2)
def _information(tachometers: bool) -> tuple[Campaign, dict[str, np.ndarray]]:
    """Of every effect alone, all else fitted, in one campaign without effects."""
    campaign = draw(np.random.SeedSequence(41), (), {}, tachometers).campaign
    effects = library_of(campaign)
    moved = optimizer.move_to(plain_fit(campaign), Model(campaign, effects))
    scores = score_tests(linear_model(moved))
    return campaign, {
        name: scores.matrix[np.ix_(own, own)]
        for name, own in zip(scores.names, scores.indices, strict=True)
    }


def library_of(campaign: Campaign) -> tuple[Effect, ...]:
    """Effects that the package accepts for a campaign and whose signal is of first order."""
    return tuple(effect for effect in WEAK if acts_on(effect, campaign))


@lru_cache(maxsize=1)
def designed_plans() -> dict[str, Plan]:
    """Plans as the design command makes them, for every goal, fast and few slews among them."""
    made = {goal: plan_for(goal) for goal in GOALS}
    fast = replace(LIMITS, rate=np.radians(0.9) / (1.0 - LIMITS.rate_reserve))
    made["four slews"] = design_plan(MISSION, "cross_terms", fast, n_slews=4).plan
    return {name: replace(plan, telemetry_period=_PERIOD) for name, plan in made.items()}


def _designed(index: int, seed: np.random.SeedSequence, tachometers: bool) -> Case:
    plans = designed_plans()
    name = list(plans)[index % len(plans)]
    template = planned_campaign(plans[name], most_like_mission())
    flight = draw_flight(template, plans[name], seed, vary=False)
    campaign = flight.campaign if tachometers else without_tachometers(flight.campaign)
    return Case(campaign, truth_of(flight), name)


def _dirty(index: int, tachometers: bool, work: Path) -> Case:
    """One of the dirt study's random combinations, read as a user's folder."""
    chosen = [case for case in cases("random") if (case.origin == "no_tachometers") != tachometers]
    case = chosen[index % len(chosen)]
    clean = written(work, case.origin, case.index)
    with TemporaryDirectory() as folder:
        campaign = read_campaign(write_raw(dirty(case, read_raw(clean)), Path(folder)))
    return Case(campaign, truth_in(clean), "+".join(kind for kind, _ in case.dirt))
