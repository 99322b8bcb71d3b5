"""Are the stated uncertainties right? Simulation-based calibration of J and K (Talts et al. 2018).

    python analyses/calibration.py [--campaigns 400] [--seed 2026] [--jobs 1] [--out FOLDER]

Every campaign has a truth drawn from the prior, is flown in closed loop with noise, and is fitted
in full. If prior, simulator, likelihood and sampler belong together, the truth's rank among
posterior draws is uniform, and intervals contain it as often as they say. Two deliberate errors
show that the test would notice.

It writes `figures/calibration.png` and `analyses/results/calibration.{md,parquet}`. Finished fits
are kept in `run_calibration/`, each shard written all or nothing: a killed run goes on where it
was. Needs the extra `parquet`.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import joblib
import numpy as np
import pandas as pd

from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.sampler import Settings, sample
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.physics.forward_model import Model

sys.path.insert(0, str(Path(__file__).parent))

from calibration_page import picture, report
from calibration_statistics import LEVELS, RANKED, RANKS

ROOT = Path(__file__).parents[1]
SHARD = 20  # campaigns a file
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
    chains = sample(estimate, replace(SETTINGS, seed=seed + i), shared_code=True)
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


def shards(
    campaigns: int, seed: int, chosen: Sequence[Study]
) -> Iterator[tuple[Study, int, range, str]]:
    """The work: (study, seed, campaigns, file name).

    A file's name changes with everything that decides its content.
    """
    for study in chosen:
        digest = hashlib.sha256(repr((study, seed, SETTINGS, RANKED)).encode()).hexdigest()[:8]
        wanted = math.ceil(campaigns * study.share)
        for first in range(0, wanted, SHARD):
            span = range(first, min(first + SHARD, wanted))
            yield (
                study,
                seed,
                span,
                f"{study.name.replace(' ', '_')}-{digest}-{span.start:05d}-{span.stop:05d}.parquet",
            )


def do_shard(folder: Path, study: Study, seed: int, span: range, file: str) -> Path:
    """One shard, unless it is there already."""
    path = folder / file
    if not path.exists():
        table = pd.concat([fit_one(study, seed, i) for i in span], ignore_index=True)
        write_atomically(path, lambda temporary: table.to_parquet(temporary))
    return path


def run(
    campaigns: int, seed: int, folder: Path, jobs: int = 1, chosen: Sequence[Study] | None = None
) -> pd.DataFrame:
    """All fits (those already in the folder are read): one row a campaign and parameter."""
    folder.mkdir(parents=True, exist_ok=True)
    tasks = list(shards(campaigns, seed, chosen or studies()))
    files = []
    with joblib.parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
        for file in joblib.Parallel(return_as="generator")(
            joblib.delayed(do_shard)(folder, *task) for task in tasks
        ):
            files.append(file)
            print(
                f"{len(files)} of {len(tasks)} shards",
                end="\r" if len(files) < len(tasks) else "\n",
                file=sys.stderr,
            )
    return pd.concat([pd.read_parquet(file) for file in files], ignore_index=True)


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
    results, figures = options.out / "analyses" / "results", options.out / "figures"
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
