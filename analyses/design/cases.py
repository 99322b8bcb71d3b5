"""Spacecraft, limits, goals and plans of `designed_plans.py`, and the folder of its results."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from analyses import results_of
from bayes_inertia.design.designer import design_plan
from bayes_inertia.design.limits import Limits
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan
from bayes_inertia.flight.spacecraft import (
    Spacecraft,
    most_like_prior,
    most_like_spacecraft,
)

ROOT = Path(__file__).resolve().parents[2]
RESULTS, FIGURES = results_of(__file__), ROOT / "figures"
PRIOR = most_like_prior()
CRAFT = replace(most_like_spacecraft(), inertia_B=PRIOR.tensor, scale_factor=(1.0, 1.0, 1.0))
MISSION = Mission(CRAFT, PRIOR)
# The planned rate is the paper-like slews' 1 deg/s, the time that of the five of them.
LIMITS = Limits(rate=math.radians(1.0) / (1.0 - Limits().rate_reserve), total_time=1855.0)
GOALS = ("cross_terms", "inertia", "scale_factors", "correction_slew")
FLIGHTS = 100
PAPER = "five slews like the paper's"


def kept(name: str, compute: Callable[[], dict]) -> dict:
    """A result from its file; computed and written where there is none."""
    path = RESULTS / f"design_{name}.json"
    if not path.exists():
        write_atomically(path, json.dumps(compute(), indent=1) + "\n")
    return json.loads(path.read_text())


def plan_for(goal: str, craft: Spacecraft = CRAFT, limits: Limits = LIMITS, tag: str = "") -> Plan:
    """The plan designed for a goal: from its file, or designed now."""
    path = RESULTS / f"plan_{goal.replace(':', '_').replace(',', '_')}{tag}.toml"
    if not path.exists():
        write_plan(design_plan(Mission(craft, PRIOR), goal, limits).plan, path)
    return read_plan(path)


def plans() -> dict[str, Plan]:
    """The three plans whose sds are checked."""
    return {
        PAPER: paper_like_plan(),
        "for the cross terms": plan_for("cross_terms"),
        "for the scale factors": plan_for("scale_factors"),
    }
