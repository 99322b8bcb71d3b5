"""A benchmark that remembers: samplers, evaluations, starts and workers, in ratios.

    python -m analyses.engine.benchmark [--parts samplers evaluation starts throughput] [--quick]
    python -m analyses.engine.benchmark --check

adds a row of ratios, never of times, to `results/engine/benchmark_history.csv`, and writes
`figures/benchmark.png` and `results/engine/benchmark.{md,json}`, within ten minutes of an idle
core. `--check` compares the last two rows and ends with 1 if a ratio became worse by more than
20 %. Needs the extras `benchmark` and `cluster`.

Samplers: this package's and five others on one posterior, five simulated slews of a MOST-like
spacecraft with telemetry at 2 Hz, J and K. Times are processor seconds of one core: other work on
the machine does not enter. Compiling is not in them, nor is the optimizer, which gives every
sampler its start and scale. Effective samples are those of the worst parameter: the smaller of
ArviZ's bulk count and emcee's draws over autocorrelation time. The other parts are in
`benchmark_parts.py`.
"""

from __future__ import annotations

import argparse
import datetime
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

from analyses.engine.benchmark_history import append_row, read_history, worse_ratios
from analyses.engine.benchmark_page import claims, history_page, picture, report, sampler_ratios
from analyses.engine.benchmark_samplers import (
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
from bayes_inertia.version import __version__

ROOT = Path(__file__).parents[2]
HISTORY = "benchmark_history.csv"
PARTS = ("samplers", "evaluation", "starts", "throughput")


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
    """Write the samplers' numbers, page and picture under `out`; returns the page."""
    folder, figures = out / "analyses" / "results" / "engine", out / "figures"
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
    write_atomically(
        figures / "benchmark.png", lambda temporary: picture(results).savefig(temporary, dpi=150)
    )
    return write_page(out)


def write_page(out: Path) -> str:
    """The page of the samplers that ran last, and of all rows of the table."""
    folder = out / "analyses" / "results" / "engine"
    content = json.loads((folder / "benchmark.json").read_text())
    results = [Result(**row) for row in content["results"]]
    text = report(results, content["seed"])
    text += history_page(read_history(folder / HISTORY))
    write_atomically(folder / "benchmark.md", text)
    return text


def other_ratios(parts: Sequence[str]) -> dict[str, float]:
    """Ratios of the parts that are no samplers."""
    ratios: dict[str, float] = {}
    if set(parts) == {"samplers"}:
        return ratios
    # Only here: the kernel needs numba, the throughput dask.
    from analyses.engine import benchmark_parts

    if "evaluation" in parts:
        with one_core():
            ratios |= benchmark_parts.evaluation_ratios()
    if "starts" in parts:
        ratios |= benchmark_parts.start_ratios()
    if "throughput" in parts:
        ratios |= benchmark_parts.throughput_ratios()
    return ratios


def check(out: Path) -> None:
    """End with 1 if the last row of the table is worse than the one before."""
    complaints = worse_ratios(read_history(out / "analyses" / "results" / "engine" / HISTORY))
    print("\n".join(complaints) or "no ratio became worse by more than 20 %")
    raise SystemExit(1 if complaints else 0)


def main(arguments: Sequence[str] | None = None) -> list[Result]:
    """Measure, and write figure, page and numbers; or check the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--check", action="store_true", help="compare the last two rows")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="samplers with hardly any samples, and no row: whether it runs, not how fast",
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT, help="folder with figures/ and analyses/results/"
    )
    options = parser.parse_args(arguments)
    if options.check:
        check(options.out)
    parts = ("samplers",) if options.quick else options.parts
    results: list[Result] = []
    if "samplers" in parts:
        began = process_time()
        results = run(QUICK if options.quick else Effort(), options.seed)
        write(results, options.seed, process_time() - began, options.out)
    if not options.quick:
        ratios = (sampler_ratios(results) if results else {}) | other_ratios(parts)
        table = options.out / "analyses" / "results" / "engine" / HISTORY
        append_row(table, __version__, datetime.date.today().isoformat(), ratios)
    print(write_page(options.out))
    return results


if __name__ == "__main__":
    main()
