"""The same telemetry in the hands of what else there is.

    python -m analyses.calibration.other_methods --each 20 [--work FOLDER]
    python -m analyses.calibration.other_methods --page

Campaigns of another simulator (`second_simulator.py`), clean and with something missing from the
model, are given to least squares on Euler's equation, to an extended Kalman filter
(`other_estimators.py`) and to this package's estimate (Laplace approximation). Errors of J and K,
and how often 90 % intervals hold the truth. Writes `results/calibration/other_methods.jsonl` and,
with --page, the page.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from analyses import results_of
from analyses.calibration.other_estimators import kalman_filter, least_squares
from analyses.calibration.unmodelled_disturbance import disturbance
from analyses.naming.fixed_shape import truth_of
from analyses.naming.fixed_shape_campaigns import draw
from analyses.naming.second_simulator import replayed
from analyses.pages.table import table_lines
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.work import Row, Work

RESULTS = results_of(__file__) / "other_methods.jsonl"
KINDS = ("clean", "random-torque", "rate-squared", "deadband")
REMAINDERS = ("torque_remainder", "rate_remainder")
# Half width of a 90 % interval [sd].
_HALF_WIDTH = 1.6449
_METHODS = {
    "least squares": "least squares on Euler's equation, rates differentiated; K as stated",
    "filter": "extended Kalman filter with J, K and bias in its state",
    "package": "`bayes_inertia`, as it quotes a fit",
    "remainder": "`bayes_inertia` with `--remainder both`",
}


@dataclass(frozen=True)
class AllMethods:
    """The task: one campaign in the hands of each. Ids are "kind/index"."""

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its row."""
        kind, _, _ = task_id.partition("/")
        flown, noise, path = seed.spawn(3)
        flight = draw(flown, (), {}, True)
        missing = disturbance(kind, int(path.generate_state(1)[0]))
        campaign = replayed(flight, missing, np.random.default_rng(noise))
        truth = truth_of(flight)
        row: dict = {"kind": kind, "truth": truth.tolist()}
        for name, method in _estimators().items():
            began = process_time()
            estimate, sd = method(campaign)
            row[name] = {
                "error": (estimate - truth).tolist(),
                "sd": np.asarray(sd).tolist(),
                "seconds": process_time() - began,
            }
        return {"line": json.dumps(row)}


def _estimators() -> dict:
    return {
        "least squares": least_squares,
        "filter": kalman_filter,
        "package": _package,
        "remainder": _with_remainders,
    }


def _package(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """The estimate, and the larger of the model's sd and of the one that slews support."""
    estimate = optimizer.estimate(Model(campaign))
    robust = estimate.robust_sd
    sd = estimate.sd[:9] if robust is None else np.maximum(estimate.sd[:9], robust[:9])
    return estimate.theta[:9], sd


def _with_remainders(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    estimate = optimizer.estimate(Model(campaign, by_name(REMAINDERS)))
    return estimate.theta[:9], estimate.sd[:9]


def write_page(rows_file: Path) -> None:
    """Write `other_methods.md` beside the rows."""
    rows = [json.loads(line) for line in rows_file.read_text().splitlines()]
    lines = [
        "# Least squares, a Kalman filter and this package on the same telemetry",
        "",
        "Made by `python -m analyses.calibration.other_methods`. Five slews of another "
        "simulator at 2 Hz, with",
        "tachometers and star tracker; J and K differ from the stated ones by their prior sds.",
        "Errors are root mean squares: moments in % of the moment, products of inertia in",
        "10⁻³ kg m², K in 10⁻³. Coverage: how often the nine 90 % intervals of J and K hold the",
        "truth. Least squares have no interval of K. Seconds of processor time, medians, on a busy",
        "machine.",
        "",
    ]
    for kind in KINDS:
        of_kind = [row for row in rows if row["kind"] == kind]
        if of_kind:
            lines += _table(kind, of_kind)
    lines += [
        "Written from their equations in `other_estimators.py`, not with their own programs:",
        "[satellite-inertia-id](https://github.com/elharirymatteo/satellite-inertia-id) (batch",
        "least squares; a filter with the diagonal of J) and TU Delft's",
        "[inertiaEstimation](https://github.com/tudelft/inertiaEstimation) read simulations and",
        "logs of their own. TU Delft's own numbers for the thrown bodies stand in",
        "[throws.md](../naming/throws.md). The filter runs once and has no process noise: "
        "noise that is",
        "tuned would widen its intervals, where one knows how much.",
        "[Kalibr](https://github.com/ethz-asl/kalibr) calibrates cameras against rate sensors with",
        "a target in view; it has no J.",
    ]
    write_atomically(rows_file.with_suffix(".md"), "\n".join(lines) + "\n")


def _table(kind: str, rows: list[dict]) -> list[str]:
    """Errors, coverage and time of each method."""
    body = []
    for name, words in _METHODS.items():
        error = np.array([row[name]["error"] for row in rows])
        moment = np.array([row["truth"][:3] for row in rows])
        sd = np.array([row[name]["sd"] for row in rows])
        known = sd > 0.0
        held = (np.abs(error) < _HALF_WIDTH * sd)[known].mean()
        rms = np.sqrt(np.mean(error**2, axis=0))
        moments = 100.0 * np.sqrt(np.mean((error[:, :3] / moment) ** 2))
        products, K = (
            1e3 * np.sqrt(np.mean(rms[part] ** 2)) for part in (slice(3, 6), slice(6, 9))
        )
        seconds = np.median([row[name]["seconds"] for row in rows])
        cells = [words, f"{moments:.3f}", f"{products:.2f}", f"{K:.2f}", f"{100 * held:.0f} %"]
        body.append([*cells, f"{seconds:.1f}"])
    head = ["", "moments [%]", "products [10⁻³ kg m²]", "K [10⁻³]", "90 % hold", "s"]
    name = "Nothing missing" if kind == "clean" else f"Missing: {kind.replace('-', ' ')}"
    return [f"## {name}, {len(rows)} campaigns", "", *table_lines(head, body), ""]


def main() -> None:
    """Simulate and estimate."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--each", type=int, default=0, help="campaigns of each kind")
    parser.add_argument("--work", type=Path, default=Path("run_other_methods"))
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.each:
        ids = tuple(f"{kind}/{i}" for i in range(options.each) for kind in KINDS)
        work = Work("campaigns", AllMethods(), ids, options={})
        rows = Execution(notice=print).run(work, options.work).rows
        write_atomically(RESULTS, "".join(f"{row['line']}\n" for row in rows))
    if options.page:
        write_page(RESULTS)


if __name__ == "__main__":
    main()
