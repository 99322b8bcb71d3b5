"""How many effective samples a second? This package's sampler and five others on one posterior.

    python analyses/benchmark.py [--quick] [--seed 2026] [--out FOLDER]

writes `figures/benchmark.png` and `analyses/results/benchmark.{md,json}` within five minutes of an
idle core. Needs the extra `benchmark`.

The campaign: five simulated slews of a MOST-like spacecraft with telemetry at 2 Hz. The posterior:
J and K, nine parameters. Everything runs on one core.

Times are processor seconds of this process: other work on the machine does not enter. Compiling is
not in them, nor is the optimizer, which gives every sampler its start and scale. Effective samples
are those of the worst parameter: the smaller of ArviZ's bulk count and emcee's draws over
autocorrelation time.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from time import process_time

import emcee
import numpy as np
from threadpoolctl import threadpool_limits

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import marginal
from bayes_inertia.inference.marginal_posterior import log_density_of
from bayes_inertia.physics.forward_model import Model

sys.path.insert(0, str(Path(__file__).parent))

from benchmark_page import claims, picture, report
from benchmark_samplers import (
    DE,
    QUICK,
    STRETCH,
    WALKERS,
    Effort,
    Result,
    run_by_hand,
    run_emcee,
    run_nuts,
    run_ours,
)

ROOT = Path(__file__).parents[1]


def the_campaign(effort: Effort, seed: int) -> tuple[Campaign, np.ndarray]:
    """The campaign and its true (J, K)."""
    plan = paper_like_plan()
    plan = replace(plan, slews=plan.slews[: effort.slews], telemetry_period=effort.period)
    flight = draw_flight(planned_campaign(plan, most_like_mission()), plan, seed, vary=False)
    J = flight.spacecraft.inertia_B
    return flight.campaign, np.array(
        [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *flight.spacecraft.scale_factor]
    )


@contextmanager
def one_core() -> Iterator[None]:
    """Everything within runs on one core, where the system lets a process choose."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        with threadpool_limits(1):
            yield
    finally:
        os.sched_setaffinity(0, allowed)


def run(effort: Effort, seed: int) -> list[Result]:
    """All samplers on one posterior (NUTS where blackjax is installed)."""
    with one_core():
        campaign, truth = the_campaign(effort, seed)
        estimate = optimizer.estimate(Model(campaign))
        results = [_said(run_ours(estimate, effort, seed))]
        log_density = log_density_of(
            estimate.model.structure, marginal(estimate), batch=WALKERS // 2
        )
        for name, move, steps in (
            (STRETCH, emcee.moves.StretchMove(), effort.stretch),
            (DE, emcee.moves.DEMove(), effort.de),
        ):
            results.append(_said(run_emcee(estimate, log_density, name, move, steps, seed)))
        if find_spec("blackjax"):
            results.append(_said(run_nuts(estimate, effort, seed)))
        results += run_by_hand(estimate, campaign, truth, effort, results[1])
    return results


def _said(result: Result) -> Result:
    rate = result.per_second(warmup=False)
    print(
        f"{result.name}: {result.milliseconds:.3f} ms, {rate:.3g} effective samples a second",
        file=sys.stderr,
    )
    return result


def write(results: Sequence[Result], seed: int, seconds: float, out: Path) -> str:
    """Write numbers, page and picture under `out`; returns the page."""
    folder, figures = out / "analyses" / "results", out / "figures"
    for path in (folder, figures):
        path.mkdir(parents=True, exist_ok=True)
    packages = ("jax", "emcee", "blackjax", "scipy", "numpy", "arviz")
    content = {
        "seed": seed,
        "processor_seconds": seconds,
        "versions": {name: metadata.version(name) for name in packages if find_spec(name)},
        "results": [asdict(result) for result in results],
        "claims": claims(results),
    }
    write_atomically(folder / "benchmark.json", json.dumps(content, indent=1) + "\n")
    text = report(results, seed, seconds)
    write_atomically(folder / "benchmark.md", text)
    write_atomically(
        figures / "benchmark.png", lambda temporary: picture(results).savefig(temporary, dpi=150)
    )
    return text


def main(arguments: Sequence[str] | None = None) -> list[Result]:
    """Run all samplers; write figure, report and numbers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument(
        "--quick", action="store_true", help="hardly any samples: whether it runs, not how fast"
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT, help="folder with figures/ and analyses/results/"
    )
    options = parser.parse_args(arguments)
    began = process_time()
    results = run(QUICK if options.quick else Effort(), options.seed)
    print(write(results, options.seed, process_time() - began, options.out))
    return results


if __name__ == "__main__":
    main()
