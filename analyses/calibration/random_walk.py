"""Is the posterior of J and K calibrated when the rate bias walks?

    python -m analyses.calibration.random_walk --each 20 [--work FOLDER]
    python -m analyses.calibration.random_walk --page

Campaigns of another simulator (`second_simulator.py`) whose gyro has Farrenkopf's rate random walk,
drawn reading by reading, at four sizes. Each is fitted with white noise, with the walk as
`campaign.toml` states it, and with its size estimated; at the optimum (Laplace approximation).
Ranks of the truth in the nine posteriors of J and K are held against the uniform distribution.
Writes `results/calibration/random_walk.jsonl` and, with --page, `random_walk.md`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from scipy import stats

from analyses import results_of
from analyses.calibration.unmodelled_disturbance import RandomWalk
from analyses.naming.fixed_shape import truth_of
from analyses.naming.fixed_shape_campaigns import draw
from analyses.naming.second_simulator import replayed
from analyses.pages.table import table_lines
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import RateRandomWalk
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.work import Row, Work

RESULTS = results_of(__file__) / "random_walk.jsonl"
# Densities [rad/s^1.5]; within a slew of 100 s the walks reach 0.15, 0.5, 1.5 and 5 times the noise
# of one reading.
DENSITIES = (3e-7, 1e-6, 3e-6, 1e-5)
_METHODS = {
    "white": "white noise",
    "stated": "walk as stated in campaign.toml",
    "estimated": "size of the walk estimated",
}


@dataclass(frozen=True)
class WalkFits:
    """The task: one campaign, fitted three times. Ids are "density/index"."""

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its row."""
        density = float(task_id.partition("/")[0])
        flown, noise = seed.spawn(2)
        flight = draw(flown, (), {}, True)
        campaign = replayed(flight, RandomWalk(density), np.random.default_rng(noise))
        sensor = replace(campaign.rate_sensor, rate_random_walk=density)
        stated = replace(campaign, rate_sensor=sensor)
        truth = truth_of(flight)
        fits: dict[str, tuple[Campaign, tuple[Effect, ...]]] = {
            "white": (campaign, ()),
            "stated": (stated, ()),
            "estimated": (campaign, (RateRandomWalk(),)),
        }
        row: dict = {"density": density}
        for name, (given, effects) in fits.items():
            row[name] = _fitted(Model(given, effects), truth)
        return {"line": json.dumps(row)}


def _fitted(model: Model, truth: np.ndarray) -> dict:
    """Errors and sds of J and K with the noise as stated: misfit discounts nothing."""
    began = process_time()
    estimate = optimizer.estimate(model, discount=False)
    correlation = estimate.covariance[:9, :9] / np.outer(estimate.sd[:9], estimate.sd[:9])
    return {
        "error": (estimate.theta[:9] - truth).tolist(),
        "sd": estimate.sd[:9].tolist(),
        "chi2": estimate.tests["total"].reduced_chi2,
        "correlation": np.round(correlation, 3).tolist(),
        "size": estimate.theta[9:].tolist(),
        "seconds": process_time() - began,
    }


def write_page(rows_file: Path) -> None:
    """Write random_walk.md beside the rows."""
    rows = [json.loads(line) for line in rows_file.read_text().splitlines()]
    lines = [
        "# A gyro whose bias walks",
        "",
        "Made by `python -m analyses.calibration.random_walk`. Five slews of another "
        "simulator at 2 Hz",
        "whose gyro has Farrenkopf's rate random walk; noise of one reading 2e-5 rad/s. Fits at",
        "the optimum (Laplace approximation), noise as stated, no discount. z: error over sd of",
        "the nine J and K. Largest gap: of the ranks' ECDF from the uniform one; in brackets the",
        "gap below which 95 % of calibrated studies of this size stay (drawn with the correlations",
        "of the posteriors).",
        "",
    ]
    head = ["rate noise in the fit", "rms z", "90 % hold", "largest gap (band)", "reduced chi²"]
    for density in DENSITIES:
        of_size = [row for row in rows if row["density"] == density]
        if not of_size:
            continue
        lines += [f"## {density:g} rad/s^1.5, {len(of_size)} campaigns", ""]
        lines += [*table_lines(head, [_cells(name, of_size) for name in _METHODS]), ""]
        ratios = np.array([row["estimated"]["size"][0] for row in of_size]) / density
        low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
        lines += [f"Estimated size over the true one: {middle:.2f} ({low:.2f} to {high:.2f}).", ""]
    lines += [
        "The simulated walks begin at zero in each slew; the effect expects an offset as large as",
        "the walk since the middle. That is likely why small sizes are estimated too low.",
        "",
    ]
    seconds = {n: np.median([row[n]["seconds"] for row in rows]) for n in _METHODS}
    cost = ", ".join(f"{_METHODS[n]} {value:.1f} s" for n, value in seconds.items())
    lines += [f"Processor time, medians on a busy machine: {cost}."]
    write_atomically(rows_file.with_name("random_walk.md"), "\n".join(lines) + "\n")


def _cells(name: str, rows: list[dict]) -> list[str]:
    """One line of a table."""
    z = np.array([np.divide(row[name]["error"], row[name]["sd"]) for row in rows])
    held = 100.0 * np.mean(np.abs(z) < stats.norm.isf(0.05))
    chi2 = np.median([row[name]["chi2"] for row in rows])
    gap = largest_gap(z)
    band = band_of_gap(np.array([row[name]["correlation"] for row in rows]))
    return [
        _METHODS[name],
        f"{np.sqrt(np.mean(z**2)):.2f}",
        f"{held:.0f} %",
        f"{gap:.2f} ({band:.2f})",
        f"{chi2:.2f}",
    ]


def largest_gap(z: np.ndarray) -> float:
    """Largest difference between the ECDF of the ranks of z (n, 9) and the uniform distribution.

    >>> round(largest_gap(stats.norm.ppf((np.arange(90) + 0.5) / 90).reshape(10, 9)), 2)
    0.01
    """
    return float(stats.kstest(stats.norm.cdf(z).ravel(), "uniform").statistic)


def band_of_gap(correlations: np.ndarray, draws: int = 500) -> float:
    """The gap below which 95 % of calibrated studies stay, of posteriors' correlations (n, 9, 9).

    >>> one = np.eye(9)[None]
    >>> band_of_gap(np.repeat(one, 10, axis=0)) > band_of_gap(np.repeat(one, 100, axis=0))
    True
    """
    rng = np.random.default_rng(0)
    powers, directions = np.linalg.eigh(correlations)
    roots = directions * np.sqrt(np.maximum(powers, 0.0))[:, None]
    noise = rng.normal(size=(draws, len(roots), 9, 1))
    return float(np.quantile([largest_gap((roots @ each)[..., 0]) for each in noise], 0.95))


def main() -> None:
    """Simulate and fit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--each", type=int, default=0, help="campaigns of each size")
    parser.add_argument("--work", type=Path, default=Path("random_walk_run"))
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.each:
        ids = tuple(f"{density:g}/{i}" for i in range(options.each) for density in DENSITIES)
        rows = Execution(notice=print).run(Work("campaigns", WalkFits(), ids), options.work).rows
        write_atomically(RESULTS, "".join(f"{row['line']}\n" for row in rows))
    if options.page:
        write_page(RESULTS)


if __name__ == "__main__":
    main()
