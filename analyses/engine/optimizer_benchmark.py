"""Our dogleg against optimistix, on the chart of J, from starts that are 30 % wrong.

`python -m analyses.engine.optimizer_benchmark` draws starts (30 % of the largest moment in a random
direction of J's six elements, 30 % on each of K) for one simulated campaign of three slews, with
and without tachometers. Each solver descends from each start, with the data at full weight at once
and after a descent with weakly counted data. A start succeeds where the objective ends within 0.01
of the best one known. Writes `results/engine/optimizer_benchmark.md` and `.json`. All 200 starts
take about half an hour of one core: `taskset -c 0 python -m analyses.engine.optimizer_benchmark`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from scipy.stats import binomtest

from analyses import results_of
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.descent import guess_nuisances
from bayes_inertia.inference.likelihood import Point, information_and_pull, residuals
from bayes_inertia.inference.noise_model import Whitenings, discounted, whitening
from bayes_inertia.inference.objective import (
    gradient_in_chart,
    in_chart,
    moved,
    negative_log_posterior,
    normal_equations,
    prior_equations,
    step_sizes,
    whole_gradient,
)
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.least_squares import Equations, dogleg
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import prior_residual

RESULTS = results_of(__file__)
# Steps at most. One of ours may hold several evaluations, one of optimistix holds one.
STEPS, OPTIMISTIX_STEPS = 100, 200
# Weight of the data in the first of two descents, as the optimizer of the package uses it.
WEAK = 1e-4
# A descent has found the optimum if its objective is this close to the best one known.
CLOSE = 0.01
CONFIDENCE = 0.95
DOGLEG, LEVENBERG = "optimistix Dogleg", "optimistix LevenbergMarquardt"


@dataclass
class Tally:
    """How often a solver evaluated residuals and their derivatives, and its processor time [s]."""

    residuals: int = 0
    derivatives: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class Problem:
    """One campaign's posterior, for both kinds of solver."""

    model: Model
    white: Whitenings
    free: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "free", np.arange(self.model.space.size))

    def start(self, theta: np.ndarray) -> Point:
        """The point to begin from at theta, nuisances guessed as the package does."""
        return Point(theta, np.zeros(3), guess_nuisances(self.model, theta))

    def weighted(self, weight: float) -> Problem:
        """The same posterior with the data counted `weight` times."""
        factors = np.full((self.model.n_slews, 3), weight)
        return Problem(self.model, discounted(self.white, factors))

    def objective(self, point: Point) -> float:
        """Half the sum of all whitened squares, priors included."""
        return negative_log_posterior(self.model, point, self.white)


def ours(problem: Problem, points: list[Point], tally: Tally) -> list[Point]:
    """Descents with the package's solver."""
    model, white, free = problem.model, problem.white, problem.free

    def objective(x: Point) -> float:
        tally.residuals += 1
        return problem.objective(x)

    def equations(x: Point) -> Equations[Point]:
        tally.derivatives += 1
        information, pull = information_and_pull(model, x, white, free)

        def pull_in_chart(y: Point) -> np.ndarray:
            tally.residuals += 1
            _, slope = prior_equations(model, y.theta, free)
            return gradient_in_chart(x, whole_gradient(y, slope, pull(y)))

        return Equations(*in_chart(x, *normal_equations(model, x, information)), pull_in_chart)

    def move(x: Point, step: np.ndarray) -> Point:
        return moved(model, x, step, free)

    return [
        dogleg(objective, equations, move, x, step_sizes(model, x, free), steps=STEPS)[0]
        for x in points
    ]


def to_flat(point: Point) -> np.ndarray:
    """A point as one unconstrained vector: J in its chart, K, bias, nuisances."""
    chart = np.asarray(inertia_tensor.to_chart(jnp.asarray(point.theta[:6])))
    return np.concatenate([chart, point.theta[6:], point.bias, np.ravel(point.local)])


def from_flat(flat: jax.Array, slews: int, d: int) -> Point:
    """The point of `to_flat`, for a model of d parameters."""
    theta = jnp.concatenate([inertia_tensor.from_chart(flat[:6]), flat[6:d]])
    return Point(theta, flat[d : d + 3], flat[d + 3 :].reshape(slews, -1))


@partial(jax.jit, static_argnums=(0, 1))
def optimistix_solve(solver, structure, flat, data, white, constants):
    """Minimise from one start; the end point, all steps and the accepted ones."""

    def all_residuals(z, _):
        point = from_flat(z, len(white[0].factors), len(constants["mean"]))
        channels = [r.ravel() for r in residuals(structure, point, data, white)]
        priors = [prior_residual(constants, point.theta), point.bias, point.local.ravel()]
        return jnp.concatenate([*channels, *priors])

    solution = optx.least_squares(
        all_residuals, solver, flat, max_steps=OPTIMISTIX_STEPS, throw=False
    )
    state = solution.state
    return solution.value, state.num_steps, state.num_accepted_steps


def with_optimistix(solver: optx.AbstractLeastSquaresSolver) -> Callable:
    """Descents with one of optimistix' solvers, called like `ours`."""

    def descend(problem: Problem, points: list[Point], tally: Tally) -> list[Point]:
        model, ends = problem.model, []
        constants = model.space.constants()
        for point in points:
            flat, steps, accepted = optimistix_solve(
                solver, model.structure, to_flat(point), model.data, problem.white, constants
            )
            tally.residuals += int(steps)
            tally.derivatives += int(accepted) + 1
            reached = from_flat(flat, model.n_slews, model.space.size)
            finite = bool(np.all(np.isfinite(flat)))
            ends.append(jax.tree.map(np.asarray, reached) if finite else point)
        return ends

    return descend


def solvers() -> dict[str, Callable]:
    """All solvers, by name."""
    tolerance = {"rtol": 1e-8, "atol": 1e-8}
    return {
        "this package": ours,
        LEVENBERG: with_optimistix(optx.LevenbergMarquardt(**tolerance)),
        DOGLEG: with_optimistix(optx.Dogleg(**tolerance)),
    }


def campaign_model(tachometers: bool) -> Model:
    """Three slews like the paper's at one reading in two seconds."""
    five = paper_like_plan()
    plan = replace(five, slews=five.slews[:3], telemetry_period=2.0, fix_spacing=2.0)
    template = planned_campaign(plan, most_like_mission())
    campaign = draw_flight(template, plan, 20261).campaign
    if not tachometers:
        slews = tuple(replace(slew, wheel_momentum=None) for slew in campaign.slews)
        wheels = tuple(replace(wheel, momentum_sigma=None) for wheel in campaign.wheels)
        campaign = replace(campaign, slews=slews, wheels=wheels)
    return Model(campaign)


def starts(best: np.ndarray, n: int, seed: int) -> list[np.ndarray]:
    """n starts that are 30 % wrong, every J physical."""
    rng, drawn = np.random.default_rng(seed), []
    while len(drawn) < n:
        theta = best.copy()
        direction = rng.normal(size=6)
        theta[:6] += 0.3 * best[0] * direction / np.linalg.norm(direction)
        theta[6:9] *= 1.0 + 0.3 * rng.choice([-1.0, 1.0], 3)
        if bool(inertia_tensor.is_physical(jnp.asarray(theta[:6]))):
            drawn.append(theta)
    return drawn


def descents(problem: Problem, solver: Callable, begins: list[np.ndarray], gently: bool) -> dict:
    """Descend from every start; objectives reached and what it cost."""
    points = [problem.start(theta) for theta in begins]
    solver(problem, points[:1], Tally())  # compiled before it is timed
    tally, began = Tally(), time.process_time()
    if gently:
        weak = solver(problem.weighted(WEAK), points, tally)
        points = [_guessed_again(problem.model, point) for point in weak]
    reached = [problem.objective(point) for point in solver(problem, points, tally)]
    tally.seconds = time.process_time() - began
    n = len(begins)
    costs = {
        "residuals": tally.residuals / n,
        "derivatives": tally.derivatives / n,
        "seconds": tally.seconds / n,
    }
    return {"reached": [float(x) for x in reached], **costs}


def _guessed_again(model: Model, point: Point) -> Point:
    """The point with nuisances guessed at its theta, where anything must be guessed."""
    guess = guess_nuisances(model, np.asarray(point.theta))
    return replace(point, local=guess) if np.any(guess) else point


def share_and_interval(row: dict) -> str:
    """The share of successes with its exact binomial interval, in per cent."""
    interval = binomtest(row["successes"], row["starts"]).proportion_ci(CONFIDENCE)
    share = row["successes"] / row["starts"]
    return f"{share:.1%} ({interval.low:.1%} to {interval.high:.1%})"


def page(rows: list[dict]) -> str:
    """The table of all rows as a page."""
    fastest = min(row["seconds"] for row in rows)
    lines = [
        "# Least-squares solvers: this package's and optimistix's",
        "",
        "`python -m analyses.engine.optimizer_benchmark`. Starts are 30 % wrong in J and in "
        "K. A start",
        f"succeeds where the objective ends within {CLOSE} of the best one known. Evaluations are",
        "means a start; optimistix evaluates residuals at each step, derivatives where it was",
        f"accepted, for {OPTIMISTIX_STEPS} steps at most. Processor time a start is a ratio to the",
        "fastest row, on one core, without compilation. Behind the share of successes stands its",
        f"exact binomial interval of {CONFIDENCE:.0%}. With `--no-levenberg` the rows of",
        "optimistix LevenbergMarquardt are those of an earlier run, their time scaled as Dogleg's.",
        "",
        "| tachometers | first descent | solver | success | share "
        "| residuals | derivatives | time |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(
            f"| {'yes' if row['tachometers'] else 'no'} "
            f"| {'data counted weakly' if row['gently'] else 'full weight'} | {row['solver']} "
            f"| {row['successes']} of {row['starts']} | {share_and_interval(row)} "
            f"| {row['residuals']:.1f} "
            f"| {row['derivatives']:.1f} | {row['seconds'] / fastest:.1f} |"
        )
    return "\n".join([*lines, ""])


def with_earlier_levenberg(rows: list[dict], earlier: list[dict]) -> list[dict]:
    """Rows with those of an earlier run for the slowest solver, its times scaled as Dogleg's."""
    kept = []
    for row in rows:
        kept.append(row)
        if row["solver"] != DOGLEG:
            continue
        same = [r for r in earlier if all(r[k] == row[k] for k in ("tachometers", "gently"))]
        levenberg, dogleg_row = (
            next(r for r in same if r["solver"] == name) for name in (LEVENBERG, DOGLEG)
        )
        scale = row["seconds"] / dogleg_row["seconds"]
        kept.insert(-1, levenberg | {"seconds": levenberg["seconds"] * scale})
    return kept


def compare(tachometers: bool, n: int, levenberg: bool) -> list[dict]:
    """The rows of all solvers from n starts, with tachometers or without."""
    model = campaign_model(tachometers)
    problem = Problem(model, whitening(model, model.space.mean))
    (best,) = ours(problem, [problem.start(model.space.mean)], Tally())
    begins, rows = starts(np.asarray(best.theta), n, 41), []
    for gently in (False, True):
        for name, solver in solvers().items():
            if name == LEVENBERG and not levenberg:
                continue
            row = descents(problem, solver, begins, gently)
            rows.append({"tachometers": tachometers, "gently": gently, "solver": name, **row})
            print(name, gently, tachometers, f"{row['seconds']:.3f} s a start", flush=True)
    lowest = min(problem.objective(best), *(min(row["reached"]) for row in rows))
    for row in rows:
        reached = np.array(row.pop("reached"))
        row |= {"starts": len(reached), "successes": int(np.sum(reached < lowest + CLOSE))}
    return rows


def main() -> None:
    """Run all solvers and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument(
        "--levenberg", action=argparse.BooleanOptionalAction, default=True, help="run it too"
    )
    parser.add_argument("-o", "--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    rows = [
        row
        for tachometers in (True, False)
        for row in compare(tachometers, arguments.starts, arguments.levenberg)
    ]
    stored = arguments.out / "optimizer_benchmark.json"
    if not arguments.levenberg:
        rows = with_earlier_levenberg(rows, json.loads(stored.read_text()))
    stored.write_text(json.dumps(rows, indent=1) + "\n")
    arguments.out.joinpath("optimizer_benchmark.md").write_text(page(rows))
    print(page(rows))


if __name__ == "__main__":
    main()
