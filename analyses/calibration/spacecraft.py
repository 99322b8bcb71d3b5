"""Spacecraft of all kinds, flown by an independent simulator and described by keys alone.

    python -m analyses.calibration.spacecraft [--simulator FILE] [--seeds 10] [--kinds cubesat ...]
    python -m analyses.calibration.spacecraft --page

The simulator is no part of the repository: without its file the study is skipped. Each campaign is
fitted as `fit` does, without sampling (Laplace approximation), and J and K are quoted as `fit`
quotes them. Appends a row a campaign to `results/calibration/spacecraft.jsonl`; campaigns whose
rows are there are left out; writes `spacecraft.md`. Some ten seconds of processor time a campaign.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

from analyses import made_rows, results_of, rows_of
from analyses.data_quality.pipeline import PERFECT
from analyses.pages.table import table_lines
from bayes_inertia.app.fit_campaign import settled_estimate
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.gates import check_gates
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.observability.degeneracy import stated_degeneracies
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import InertiaChange
from bayes_inertia.physics.forward_model import Model

ROOT = Path(__file__).parents[2]
SIMULATOR = ROOT.parent / "shared" / "tools" / "other_spacecraft.py"
ROWS = results_of(__file__) / "spacecraft.jsonl"
FIRST_SEED = 101
# What an engineer knows of the flight beside the campaign's keys.
KNOWN: dict[str, tuple[Effect, ...]] = {"fuel": (InertiaChange(from_slew=5),)}
ABOUT = {
    "plain": "three wheels, three-axis gyro, star tracker",
    "wheels_mtq": "and magnetorquers",
    "thrusters": "thrusters, no wheels",
    "pyramid": "four wheels in a pyramid",
    "two_gyros": "a second gyro, turned and less precise",
    "two_trackers": "a second star tracker",
    "gyroless": "no gyro",
    "tracker_in_slew": "fixes throughout the slews",
    "gyro_2axis": "a gyro of two axes",
    "gyro_4skew": "four skewed gyro axes",
    "cubesat": "Sun sensor and magnetometer, no star tracker",
    "spinner": "nothing turns it: ratios of J",
    "panels": "large panels that vibrate, 5000 kg m²",
    "panels_fast": "and a control loop faster than its telemetry",
    "cmg": "gimballed rotors",
    "speeds_only": "wheel speeds, no torque commands",
    "speeds_slow": "wheel speeds each 10 s",
    "torque_only": "torque commands, no wheel speeds",
    "body_torque": "a known torque on the body",
    "fuel": "fuel used after slew 5, so said",
}
NORMAL_90 = 1.6449


def flown(simulator: Path, kind: str, seed: int, folder: Path) -> tuple[Campaign, dict]:
    """The campaign by its keys, and its truth."""
    made = folder / "simulated"
    command = [sys.executable, str(simulator), kind, "--seed", str(seed), "-o", str(made)]
    subprocess.run(command, check=True, capture_output=True)
    campaign = folder / "campaign"
    shutil.copytree(made / "streams", campaign / "streams")
    shutil.copy(made / "wished.toml", campaign / "campaign.toml")
    return read_campaign(campaign), json.loads((made / "truth.json").read_text())


def row_of(simulator: Path, kind: str, seed: int) -> dict:
    """One campaign flown and fitted."""
    row = {"kind": kind, "seed": seed}
    with tempfile.TemporaryDirectory() as folder:
        campaign, truth = flown(simulator, kind, seed, Path(folder))
    began = process_time()
    try:
        model = Model(campaign, KNOWN.get(kind, ()))
        estimate, _ = settled_estimate(model, seed, False, None, lambda *_: None)
        row |= _judged(estimate, truth)
    except BayesInertiaError as error:
        row["error"] = str(error)
    return row | {"seconds": process_time() - began}


def true_parameters(truth: dict) -> np.ndarray:
    """J (six elements) and K of the spacecraft, as truth.json has them."""
    J = np.array(truth["J"])[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.concatenate([J, np.atleast_1d(truth["K"])])


def _judged(estimate: Estimate, truth: dict) -> dict:
    """Gates, and how far J and K are from the truth, in the sds that are quoted."""
    quoted = quoted_parameters(estimate)
    failed = [gate["says"] for gate in check_gates(estimate, PERFECT) if not gate["passed"]]
    true = true_parameters(truth)[: len(quoted.names)]
    mean, sd = quoted.mean, quoted.sd
    untied = any(d.name == "size of J" and d.exact for d in stated_degeneracies(estimate))
    if untied:
        mean, sd, true = _as_ratios(estimate, quoted.mean, true)
    prior = estimate.model.space.sd[: len(sd)]
    return {
        "trusted": not failed,
        "failed": failed,
        "names": list(quoted.names),
        "ratios": untied,
        "z": ((mean - true) / sd).round(4).tolist(),
        "sd_over_prior": (quoted.sd / prior).tolist(),
    }


def _as_ratios(estimate: Estimate, mean: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, ...]:
    """Means, sds and truth with the elements of J over its trace."""
    trace = mean[:3].sum()
    slopes = np.eye(len(mean))
    slopes[:6, :6] /= trace
    slopes[:6, :3] -= np.outer(mean[:6], np.ones(3)) / trace**2
    covariance = estimate.covariance[: len(mean), : len(mean)] * estimate.dispersion_factor**2
    sd = np.sqrt(np.diag(slopes @ covariance @ slopes.T))
    scaled = [np.concatenate([v[:6] / v[:3].sum(), v[6:]]) for v in (mean, true)]
    return scaled[0], sd, scaled[1]


ABOUT_PAGE = """Made by `python -m analyses.calibration.spacecraft`: campaigns of an independent
simulator, described by keys of `campaign.toml` alone and fitted as `fit` does, without sampling.
z: (J and K as quoted − truth) / sd. Where nothing ties the size of J, J / trace J is compared. A
fit that is not trusted says so, and is counted here. Kinds flown with one seed share J, K and most
of their noise: their rows are not independent."""


def page(rows: list[dict]) -> str:
    """The table, a row a kind of spacecraft."""
    kinds = [(kind, [r for r in rows if r["kind"] == kind]) for kind in ABOUT]
    lines = [(kind, ABOUT[kind], *_cells(those)) for kind, those in kinds if those]
    head = ("spacecraft", "", "campaigns", "trusted", "90 % intervals hold", "rms z", "largest z")
    every = ("all", "", *_cells(rows))
    table = table_lines((*head, "processor time [s]"), [*lines, every])
    return "\n".join(["# Spacecraft of all kinds", "", ABOUT_PAGE, "", *table, ""])


def _cells(rows: list[dict]) -> tuple[str, ...]:
    """Campaigns, trusted, coverage, rms and largest z, seconds."""
    fitted = [r for r in rows if "z" in r]
    z = np.concatenate([r["z"] for r in fitted]) if fitted else np.full(1, np.nan)
    return (
        str(len(rows)),
        str(sum(r["trusted"] for r in fitted)),
        f"{100 * np.mean(np.abs(z) < NORMAL_90):.0f} % of {z.size}",
        f"{np.sqrt(np.mean(z**2)):.2f}",
        f"{np.abs(z).max():.1f}",
        f"{np.median([r['seconds'] for r in rows]):.0f}",
    )


def asked_for(study: str | None, seeds: int) -> argparse.Namespace | None:
    """Which of these spacecraft a study is asked for; none where their simulator is not here."""
    parser = argparse.ArgumentParser(description=(study or "").split("\n")[0])
    parser.add_argument("--simulator", type=Path, default=SIMULATOR)
    parser.add_argument("--seeds", type=int, default=seeds)
    parser.add_argument("--kinds", nargs="+", default=list(ABOUT), choices=list(ABOUT))
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.page or options.simulator.is_file():
        return options
    print("the simulator is not here: skipped")
    return None


def main() -> None:
    """Simulate, fit and write."""
    options = asked_for(__doc__, seeds=10)
    if options is None:
        return
    # Campaigns of one kind share compiled code.
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    cases = [{"kind": k, "seed": s} for k in options.kinds for s in seeds]
    for row in made_rows(ROWS, () if options.page else cases, partial(row_of, options.simulator)):
        z = np.abs(row.get("z", [np.nan])).max()
        print(row["kind"], row["seed"], row.get("error", f"{z:.1f}"), f"{row['seconds']:.0f} s")
        if row.get("failed"):
            print("   not trusted:", *row["failed"])
    write_atomically(ROWS.with_suffix(".md"), page(rows_of(ROWS)))


if __name__ == "__main__":
    main()
