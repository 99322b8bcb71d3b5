"""Are the stated uncertainties right? Simulation-based calibration of J and K (Talts et al. 2018).

    python -m analyses.calibration.ranks [--campaigns 400] [--seed 2026] [--jobs 1] [--out FOLDER]

Every campaign has a truth drawn from the prior, is flown in closed loop with noise, and is fitted
in full. If prior, simulator, likelihood and sampler belong together, the truth's rank among
posterior draws is uniform, and intervals contain it as often as they say. Two deliberate errors
show that the test would notice.

It writes `figures/calibration.png` and `results/calibration/calibration.{md,parquet}`. Finished
fits are kept in `run_calibration/`: a killed run goes on where it was. `bayes-inertia study
calibration` is the same question for more cases and quantities; this script keeps the published
rows.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd

from analyses import aloud
from analyses.calibration.rank_statistics import LEVELS, RANKED, RANKS
from analyses.calibration.ranks_page import picture, report
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.sampler import sample
from bayes_inertia.inference.settings import Settings
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.studies.work import Work

ROOT = Path(__file__).parents[2]
SETTINGS = Settings(ensembles=2, walkers=64, steps=24, max_steps=24, threads=1)
SHRUNK = 0.8  # sd of a deliberate error, over the right one


@dataclass(frozen=True)
class Study:
    """Campaigns of one plan.

    `number` separates its random numbers from those of other studies. `share` is its part of the
    campaigns asked for.
    """

    name: str
    number: int
    plan: Plan
    says: str
    share: float = field(default=1.0, repr=False)


def studies() -> tuple[Study, ...]:
    """Five slews with information on all axes, and two that leave parameters to the prior.

    Telemetry at 1 Hz.
    """
    five = replace(paper_like_plan(), telemetry_period=1.0)
    two = replace(
        five, slews=(PlannedSlew((1.0, 0.0, 0.0), 1.0), PlannedSlew((0.0, 1.0, 1.0), 1.0))
    )
    return (
        Study("five slews", 0, five, "about x, y, z and two diagonals"),
        Study("two slews", 1, two, "about x and the diagonal of y and z", 0.5),
    )


def fit_one(study: Study, seed: int, i: int) -> pd.DataFrame:
    """Campaign i of a study, a row a parameter: truth, mean, sd, quantiles, ranks, gates."""
    flight = draw_flight(
        planned_campaign(study.plan, most_like_mission()),
        study.plan,
        np.random.SeedSequence(seed, spawn_key=(study.number, i)),
    )
    craft = flight.spacecraft
    J = craft.inertia_B
    truth = np.array([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *craft.scale_factor])
    estimate = optimizer.estimate(Model(flight.campaign), seed=i)
    chains = sample(estimate, replace(SETTINGS, seed=seed + i))
    return _rows(
        estimate, chains.samples, truth, np.random.default_rng([seed, study.number, i])
    ).assign(
        study=study.name,
        campaign=i,
        explained=not any(test.rejected for test in estimate.tests.values()),
        nested_rhat=chains.diagnostics.nested_rhat_max,
        reduced_chi2=estimate.tests["total"].reduced_chi2,
    )


def _rows(
    estimate: Estimate, samples: np.ndarray, truth: np.ndarray, rng: np.random.Generator
) -> pd.DataFrame:
    d = len(truth)
    flat = samples.reshape(-1, d)
    # The last draws of different walkers: hardly correlated, as nearly every step proposes anew.
    ranked = samples[:, :, -1].reshape(-1, d)[:RANKED]
    mean, sd = flat.mean(0), flat.std(0, ddof=1)
    # With the nuisances held, the Laplace approximation is as wide as the Hessian's block says.
    held = rng.multivariate_normal(estimate.theta, inverse(estimate.hessian[:d, :d]), RANKED)
    columns = {
        "parameter": list(estimate.model.space.names),
        "truth": truth,
        "mean": mean,
        "sd": sd,
        "prior_sd": estimate.model.space.sd,
    }
    columns |= {
        f"q{100 * p:g}": np.quantile(flat, p, axis=0)
        for level in LEVELS
        for p in (0.5 - level / 2, 0.5 + level / 2)
    }
    for name, draws in zip(RANKS, (ranked, mean + SHRUNK * (ranked - mean), held), strict=True):
        columns[name] = (draws < truth).sum(0)
    return pd.DataFrame(columns)


@dataclass(frozen=True)
class RankedFit:
    """The task: campaign i of a study, its nine rows as lists."""

    study: Study
    seed: int

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> dict[str, list]:
        """Of the published rows: the study's number is part of the campaign's seed."""
        table = fit_one(self.study, self.seed, int(task_id))
        return {str(key): column.tolist() for key, column in table.items()}


def work_of(study: Study, campaigns: int, seed: int) -> Work:
    """The campaigns of a study as tasks."""
    ids = tuple(str(i) for i in range(math.ceil(campaigns * study.share)))
    options = {"study": repr(study), "settings": repr(SETTINGS), "ranked": RANKED}
    return Work("fits", RankedFit(study, seed), ids, seed, options)


def run(
    campaigns: int, seed: int, folder: Path, jobs: int = 1, chosen: Sequence[Study] | None = None
) -> pd.DataFrame:
    """All fits (those already in the folder are read): one row a campaign and parameter."""
    parts = []
    for study in chosen or studies():
        execution = aloud(jobs)
        work = work_of(study, campaigns, seed)
        result = execution.run(work, folder / study.name.replace(" ", "_"))
        if result.failures:
            raise RuntimeError(f"{len(result.failures)} failed: {result.failures[0].reason}")
        parts += [pd.DataFrame(row).drop(columns="task") for row in result.rows]
    return pd.concat(parts, ignore_index=True)


def main(arguments: Sequence[str] | None = None) -> pd.DataFrame:
    """Run what is missing and write figure, report and table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--campaigns",
        type=int,
        default=400,
        help="of the first study; the second gets half as many",
    )
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument(
        "--out", type=Path, default=ROOT, help="folder with figures/ and analyses/results/"
    )
    options = parser.parse_args(arguments)
    began, work = perf_counter(), options.out / "run_calibration"
    fresh = not work.exists()
    table = run(options.campaigns, options.seed, work, options.jobs)
    results, figures = options.out / "analyses" / "results" / "calibration", options.out / "figures"
    for folder in (results, figures):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomically(results / "calibration.parquet", lambda temporary: table.to_parquet(temporary))
    descriptions = {study.name: study.says for study in studies()}
    text = report(table, perf_counter() - began if fresh else None, descriptions)
    write_atomically(results / "calibration.md", text)
    write_atomically(
        figures / "calibration.png", lambda temporary: picture(table).savefig(temporary, dpi=150)
    )
    print(text)
    return table


if __name__ == "__main__":
    main()
