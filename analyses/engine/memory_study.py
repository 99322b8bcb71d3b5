"""Does memory stay flat, and is the next campaign quick?

    python -m analyses.engine.memory_study [--fits 100] [--diagnoses 30] [--slews 50]
        [--steps 2304] [--commands 1]

Each fit and each diagnosis is of another small simulated campaign: another spacecraft, and other
slews and rows, so that no shape recurs. Each series runs in a process of its own, and so does one
fit of many slews at 10 Hz, of which the peak counts, and one posterior with
as many draws as a fit takes at most (drawn around the estimate instead of sampled: what is held and
written is the same). The memory of a process
is what is resident (Linux: RSS), after each tenth of its tasks, and its peak so far. The commands
`fit` and `diagnose` are run for two campaigns of other lengths and numbers of slews, with a folder
of compiled code that is empty at first. It writes
results/engine/memory.json and memory.md; a series of length 0 keeps what was measured before.
A fit takes 3 s of processor time, a diagnosis 8 s, the large fit two minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
import psutil

from analyses import results_of
from bayes_inertia.app.compiled_code import VARIABLE
from bayes_inertia.app.diagnosed_fit import investigate
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.gates import diagnose_chains
from bayes_inertia.inference.posterior_groups import build_posterior
from bayes_inertia.inference.sampler import Chains
from bayes_inertia.inference.settings import FitContext, Settings
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.version import __version__

RESULTS = results_of(__file__)
SHORT = Settings(ensembles=2, walkers=64, steps=24, max_steps=24, threads=1)
# As many ensembles as usual, by which telemetry-sized groups of the posterior are counted. The
# draws of a usual chain are 3 MB.
LARGE = replace(SHORT, ensembles=4)
MEBIBYTE = 2**20
_SMALL_PERIOD, _LARGE_PERIOD = 1.0, 0.1  # [s] between rows.
# Of small campaigns [s]: rows from 160 to 540, that is three sizes of compiled programs.
_SHORTEST, _LONGER, _LENGTHS = 160.0, 20.0, 19
_POINTS = 10  # of a series.
KINDS = ("fits", "diagnoses", "slews", "steps", "commands")


def small_plan(k: int) -> Plan:
    """A plan of another shape for each k below 76: slews, rows and fixes."""
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.3, 1.0), (1.0, 1.0, 1.0))
    duration = _SHORTEST + _LONGER * (k % _LENGTHS)
    slews = (PlannedSlew(axis, 0.6 + 0.1 * i, duration=duration) for i, axis in enumerate(axes))
    base = replace(paper_like_plan(), telemetry_period=_SMALL_PERIOD)
    return replace(base, slews=tuple(slews)[: 1 + (k + 1) % len(axes)])


def large_plan(slews: int) -> Plan:
    """A plan of so many slews at 10 Hz about all axes."""
    axes = np.random.default_rng(0).normal(size=(slews, 3))
    planned = tuple(PlannedSlew(tuple(axis.tolist()), 0.6) for axis in axes)
    return replace(paper_like_plan(), slews=planned, telemetry_period=_LARGE_PERIOD)


def flown(plan: Plan, seed: int) -> Campaign:
    """A campaign of another spacecraft."""
    template = planned_campaign(plan, most_like_mission())
    return draw_flight(template, plan, seed, vary=False).campaign


def resident() -> int:
    """What this process holds [bytes]."""
    return psutil.Process().memory_info().rss


def peak() -> int:
    """The most that this process ever held [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def series(kind: str, count: int) -> dict:
    """The memory of this process while it does so many tasks of a kind."""
    began = process_time()
    points = [(0, resident() // MEBIBYTE, peak() // MEBIBYTE)]
    for k in range(count):
        campaign = flown(small_plan(k), k)
        if kind == "fits":
            fit(campaign, settings=replace(SHORT, seed=k))
        else:
            investigate(campaign, seed=k)
        if (k + 1) % max(1, count // _POINTS) == 0:
            points.append((k + 1, resident() // MEBIBYTE, peak() // MEBIBYTE))
            print(kind, *points[-1], file=sys.stderr, flush=True)
    return {"count": count, "points": points, "seconds": round(process_time() - began)}


def peak_of_large_fit(slews: int) -> dict:
    """The peak of this process over one fit of many slews at 10 Hz, its file included."""
    began = process_time()
    campaign = flown(large_plan(slews), 0)
    posterior = fit(campaign, settings=LARGE)
    with TemporaryDirectory() as folder:
        file = posterior.save(Path(folder) / "posterior.nc").stat().st_size
    return {
        "count": slews,
        "rows": sum(len(s.time) for s in campaign.slews),
        "peak": peak() // MEBIBYTE,
        "file": file // MEBIBYTE,
        "seconds": round(process_time() - began),
    }


def peak_of_many_draws(steps: int) -> dict:
    """The peak of this process over a posterior of so many steps of the usual ensembles."""
    began, usual = process_time(), Settings()
    estimate = optimizer.estimate(Model(flown(small_plan(1), 0)))
    before = resident()
    shape = (usual.ensembles, usual.walkers, steps)
    rng = np.random.default_rng(0)
    samples = rng.multivariate_normal(estimate.theta, estimate.covariance, size=shape)
    told = diagnose_chains(
        samples,
        tau=1.0,
        evaluations=samples[..., 0].size,
        seconds=1.0,
        acceptance=1.0,
        discarded=0,
    )
    posterior = build_posterior(estimate, Chains(samples, rng.random(shape), told), FitContext(), 0)
    with TemporaryDirectory() as folder:
        file = posterior.save(Path(folder) / "posterior.nc").stat().st_size
    return {
        "count": steps,
        "draws": samples[..., 0].size,
        "peak": peak() // MEBIBYTE,
        "before": before // MEBIBYTE,
        "file": file // MEBIBYTE,
        "seconds": round(process_time() - began),
    }


def times_of_commands(_: int) -> dict:
    """Processor time [s] of each command: the first campaign, and one of another length."""
    first = paper_like_plan()
    other = replace(first, slews=first.slews[:-1], rest_before=16.0, settle=30.0)
    seconds = {}
    with TemporaryDirectory() as folder:
        own = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
        environment = own | {VARIABLE: str(Path(folder) / "compiled")}
        for k, plan in enumerate((first, other)):
            write_campaign(flown(plan, k), Path(folder) / str(k))
        for command in ("fit", "diagnose"):
            for k in range(2):
                words = [command, str(k), "-o", f"{command}_{k}", "--quiet"]
                program = [str(Path(sys.executable).with_name("bayes-inertia")), *words]
                before = resource.getrusage(resource.RUSAGE_CHILDREN)
                subprocess.run(program, cwd=folder, env=environment, check=True)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                took = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
                seconds.setdefault(command, []).append(round(took, 1))
                print(*words, seconds, file=sys.stderr, flush=True)
    return {"count": 1, "seconds": seconds}


def page(results: dict) -> str:
    """What was measured, as a page."""
    options = " ".join(f"--{kind} {done['count']}" for kind, done in results.items())
    command = f"`python -m analyses.engine.memory_study {options}`"
    lines = ["# Memory of one process", "", f"Version {__version__}; {command}.", ""]
    for kind in ("fits", "diagnoses"):
        if kind not in results:
            continue
        points = results[kind]["points"]
        later = [size for _, size, _ in points[len(points) // 2 :]]
        lines += [
            f"## {results[kind]['count']} {kind} in one process",
            "",
            "Each of another spacecraft, of other slews and of another length.",
            "",
            "| after | resident [MiB] | peak so far [MiB] |",
            "|---:|---:|---:|",
            *(f"| {count} | {size} | {most} |" for count, size, most in points),
            "",
            f"Over the second half it stays between {min(later)} and {max(later)} MiB. "
            f"Processor time: {results[kind]['seconds']} s.",
            "",
        ]
    if "slews" in results:
        large = results["slews"]
        lines += [
            f"## One fit of {large['count']} slews at 10 Hz",
            "",
            f"{large['rows']} rows, four ensembles of {LARGE.steps} steps. The process' peak, "
            f"writing posterior.nc ({large['file']} MiB) included: {large['peak']} MiB. "
            f"Processor time: {large['seconds']} s.",
            "",
        ]
    if "steps" in results:
        many = results["steps"]
        lines += [
            "## As many draws as a fit takes at most",
            "",
            f"{many['draws']:,} draws of nine parameters ({many['count']} steps of the usual "
            f"ensembles; a usual fit takes 45). The process' peak, convergence and writing "
            f"posterior.nc ({many['file']} MiB) included: {many['peak']} MiB, of which "
            f"{many['before']} MiB were there before the draws. So draws are held in memory; "
            "streaming them would gain the difference at most.",
            "",
        ]
    if "commands" in results:
        lines += [
            "## The next campaign",
            "",
            "Processor time of a command with an empty folder of compiled code, and then with a "
            "campaign of other slews and of another length. The diagnosis finds what the fit left.",
            "",
            "| command | first campaign [s] | next one [s] |",
            "|---|---:|---:|",
            *(
                f"| `{command}` | {first} | {following} |"
                for command, (first, following) in results["commands"]["seconds"].items()
            ),
            "",
        ]
    return "\n".join(lines)


def main() -> None:
    """Run what is asked for, each series in a process of its own, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fits", type=int, default=100)
    parser.add_argument("--diagnoses", type=int, default=30)
    parser.add_argument("--slews", type=int, default=50)
    parser.add_argument("--steps", type=int, default=Settings().max_steps)
    parser.add_argument("--commands", type=int, default=1)
    parser.add_argument("--only", choices=KINDS, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    if given.only:
        count = getattr(given, given.only)
        single = {
            "slews": peak_of_large_fit,
            "steps": peak_of_many_draws,
            "commands": times_of_commands,
        }
        done = single[given.only](count) if given.only in single else series(given.only, count)
        print(json.dumps(done))
        return
    file = given.out / "memory.json"
    results = json.loads(file.read_text()) if file.exists() else {}
    for kind in KINDS:
        if count := getattr(given, kind):
            command = [sys.executable, "-m", __spec__.name, "--only", kind, f"--{kind}", str(count)]
            printed = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
            results[kind] = json.loads(printed)
            write_atomically(file, json.dumps(results, indent=1) + "\n")
    write_atomically(given.out / "memory.md", page(results))


if __name__ == "__main__":
    main()
