"""What designed plans achieve: sds, gains, margins, times, and effects told apart.

    python -m analyses.design.designed_plans [--parts gains,flown,achieved,separate,times]
                                    [--campaigns 400] [--seeds 4] [--jobs 1]

writes `results/design/design.json`, `results/design/design.md` and `figures/design_*.png`.
Results are kept as they are made, each file all or nothing: a killed study goes on where it was.
A finished part is not done again; delete its file for that.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from analyses import aloud
from analyses.design.cases import (
    CRAFT,
    FIGURES,
    FLIGHTS,
    GOALS,
    LIMITS,
    MISSION,
    RESULTS,
    ROOT,
    kept,
    plan_for,
    plans,
)
from analyses.design.page import gains_picture, page, ratio_picture
from analyses.design.separation import PAIRS, told_apart
from bayes_inertia.design.comparison import (
    AchievedErrors,
    estimate_at_truth,
    expected_sd,
    fit_simulated_campaign,
)
from bayes_inertia.design.designer import design_plan, random_plans, set_up_design
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.margins import flown_margins
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.design.separating_slew import separating_slew
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.planned_motion import slew_arrays
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.flight.spacecraft import Controller
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.pictures.design import draw_comparison
from bayes_inertia.studies.plan_comparison import achieved_errors, compare_plans
from bayes_inertia.studies.work import Work

PARTS = ("gains", "flown", "achieved", "separate", "times")
RANDOM_PLANS = 10_000
SHARD = 25  # campaigns whose seeds belong together


def gains() -> dict:
    """For every goal: the number of the designed, the paper-like and the best random plan.

    10,000 random feasible plans; all numbers at the prior's mean.
    """
    return {goal: _gain(goal) for goal in GOALS}


def _gain(goal: str) -> dict:
    plan = plan_for(goal)
    problem, _, reference, _ = set_up_design(
        MISSION, parse_goal(goal), LIMITS, paper_like_plan(), 5, seed=0, draws=1
    )
    values, tried = _random_values(problem)
    designed = problem.value(problem.variables(slew_arrays(plan)))
    paper = problem.value(problem.variables(slew_arrays(reference)))
    sd, sd_paper = (estimate_at_truth(p, MISSION).sd.tolist() for p in (plan, reference))
    seeds = (1, 2) if goal == "cross_terms" else ()
    return {
        "unit": parse_goal(goal).unit,
        "designed": designed,
        "paper": paper,
        "gain": paper / designed,
        "random": {
            "feasible": RANDOM_PLANS,
            "tried": tried,
            "best": min(values),
            "median": float(np.median(values)),
        },
        "values": np.quantile(values, np.linspace(0.0, 1.0, 201)).tolist(),
        "sd": dict(zip(BASE_NAMES, sd, strict=True)),
        "sd_paper": dict(zip(BASE_NAMES, sd_paper, strict=True)),
        "seeds": [design_plan(MISSION, goal, LIMITS, seed=seed).gain for seed in seeds],
    }


def _random_values(problem: PlanProblem) -> tuple[list[float], int]:
    """The goal's number for 10,000 random feasible plans, and how many plans were tried."""
    values: list[float] = []
    tried, seed = 0, 1000
    while len(values) < RANDOM_PLANS:
        _, logarithms, smallest_margin = random_plans(problem, 5, 2000, seed)
        values += np.exp(logarithms[smallest_margin >= 0.0]).tolist()
        tried, seed = tried + 2000, seed + 1
    return values[:RANDOM_PLANS], tried


def flown() -> dict:
    """Margins of every designed plan over flights with noise.

    Each flight has its own truth; the controller believes the prior.
    """
    return {goal: _margins(plan_for(goal)) for goal in GOALS}


def _margins(plan: Plan) -> dict:
    template = planned_campaign(plan, MISSION)
    margins: dict[str, list[float]] = {}
    for i in range(FLIGHTS):
        draw = np.random.SeedSequence(77, spawn_key=(i,))
        for margin in flown_margins(draw_flight(template, plan, draw, vary=False), LIMITS):
            margins.setdefault(margin.limit, []).append(margin.left)
    return {
        limit: {
            "smallest": min(left),
            "median": float(np.median(left)),
            "broken": sum(x < 0 for x in left),
        }
        for limit, left in margins.items()
    }


@dataclass(frozen=True)
class Refit:
    """The task: a plan flown with noise and fitted."""

    plan: Plan

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> dict[str, np.ndarray]:
        """Of the published rows: campaign i of a shard has the seed of the shard."""
        shard, number = divmod(int(task_id), SHARD)
        source = np.random.SeedSequence(10_000 + shard, spawn_key=(number,))
        return fit_simulated_campaign(self.plan, MISSION, source)


def achieved(campaigns: int, jobs: int) -> dict[str, AchievedErrors]:
    """Errors of refitted campaigns by plan; rows that are there already are read."""
    ids = tuple(str(i) for i in range(SHARD * math.ceil(campaigns / SHARD)))
    results = {}
    for name, plan in plans().items():
        work = Work("campaigns", Refit(plan), ids, options={"plan": repr(plan)})
        folder = ROOT / "run_design" / name.replace(" ", "_")
        execution = aloud(jobs)
        results[name] = achieved_errors(execution.run(work, folder))
    return results


def against_achieved(errors_by_plan: dict[str, AchievedErrors]) -> dict:
    """Predicted over achieved sd of every parameter of three plans, with its Monte Carlo error."""
    results = {}
    for name, plan in plans().items():
        expected, errors = expected_sd(plan, MISSION, truths=200, seed=9), errors_by_plan[name]
        results[name] = {
            "campaigns": len(errors.errors),
            "expected": expected.tolist(),
            "achieved": errors.sd.tolist(),
            "achieved_error": errors.sd_error.tolist(),
            "stated": errors.stated_sd.tolist(),
            "ratio": (expected / errors.sd).tolist(),
            "ratio_error": (expected / errors.sd * errors.sd_error / errors.sd).tolist(),
            "peak_torque": float(errors.peak_torque.max()),
            "peak_momentum": float(errors.peak_momentum.max()),
            "reduced_chi2": float(errors.chi2.mean()),
        }
    return results


_COLD = """
import time; t0 = time.perf_counter()
import resource, json
from bayes_inertia.design.designer import design_plan
from bayes_inertia.flight.mission import most_like_mission
designed = design_plan(most_like_mission())
used = resource.getrusage(resource.RUSAGE_SELF)
wall, cpu = time.perf_counter() - t0, used.ru_utime + used.ru_stime
numbers = {"wall": wall, "cpu": cpu, "gain": designed.gain, "memory_GB": used.ru_maxrss / 1e6}
print(json.dumps(numbers))
"""


def times() -> dict:
    """Wall and processor time of a cold design, of one gradient and of a separating slew."""
    cold = subprocess.run(
        [sys.executable, "-c", _COLD], check=True, capture_output=True, text=True
    ).stdout.splitlines()[-1]
    first, gradient = _gradient_times()
    plan = replace(paper_like_plan(), telemetry_period=0.5)
    campaign = fly(plan, MISSION, 1, controller=Controller(CRAFT.inertia_B)).campaign
    plain = estimate(Model(campaign), starts=1)
    a, b = by_name(PAIRS[0])
    began = time.perf_counter()
    separating_slew(plain, a, b)
    seconds = time.perf_counter() - began
    return {
        "cold_design": json.loads(cold),
        "gradient": gradient,
        "first_gradient": first,
        "separating_slew": seconds,
        "cpu": resource.getrusage(resource.RUSAGE_SELF).ru_utime,
    }


def _gradient_times() -> tuple[float, float]:
    """Wall time [s] of the first exact gradient, compilation included, and of those after it."""
    problem, _, reference, _ = set_up_design(
        MISSION, parse_goal("cross_terms"), LIMITS, paper_like_plan(), 5, seed=0, draws=3
    )
    x = problem.variables(slew_arrays(reference))
    began = time.perf_counter()
    problem.log_value_and_gradient(x, 3)
    first = time.perf_counter() - began
    began = time.perf_counter()
    for _ in range(20):
        problem.log_value_and_gradient(x, 1)
    return first, (time.perf_counter() - began) / 20


def save(figure: Figure, name: str) -> None:
    """Write a picture without date or version."""
    FIGURES.mkdir(exist_ok=True)
    write_atomically(
        FIGURES / name,
        lambda temporary: figure.savefig(temporary, dpi=150, metadata={"Software": None}),
    )


def study_achieved(campaigns: int, jobs: int) -> None:
    """Predicted against achieved sds: the numbers and both pictures."""
    errors = achieved(campaigns, jobs)
    ratios = against_achieved(errors)
    write_atomically(RESULTS / "design_achieved.json", json.dumps(ratios, indent=1) + "\n")
    save(ratio_picture(ratios), "design_ratio.png")
    compared = {name: plan for name, plan in plans().items() if name != "for the scale factors"}
    contenders = [
        replace(contender, achieved=errors[contender.name])
        for contender in compare_plans(compared, MISSION, limits=LIMITS)
    ]
    save(draw_comparison(contenders), "design_compare.png")


def all_results() -> dict[str, dict]:
    """The parts that are done, read from their files."""
    paths = {part: RESULTS / f"design_{part}.json" for part in PARTS}
    return {part: json.loads(path.read_text()) for part, path in paths.items() if path.exists()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Do the parts asked for and renew page and pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--campaigns", type=int, default=400, help="for each of three plans")
    parser.add_argument(
        "--seeds", type=int, default=4, help="campaigns for each hidden effect and plan"
    )
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    parts = options.parts.split(",")
    RESULTS.mkdir(parents=True, exist_ok=True)
    if "gains" in parts:
        save(gains_picture(kept("gains", gains)), "design_gains.png")
    if "flown" in parts:
        kept("flown", flown)
    if "achieved" in parts:
        study_achieved(options.campaigns, options.jobs)
    if "separate" in parts:
        kept("separate", lambda: told_apart(options.seeds))
    if "times" in parts:
        kept("times", times)
    text = page(all_results())
    write_atomically(RESULTS / "design.md", text)
    print(text)


if __name__ == "__main__":
    main()
