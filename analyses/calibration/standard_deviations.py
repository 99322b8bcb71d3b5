"""Is there a fault of two per cent in the sds? Two thousand campaigns at the optimum.

    python -m analyses.calibration.standard_deviations --work FOLDER [--campaigns 2000]
        [--jobs 2] [--only NAME]

The ranks of `ranks.py` (400 campaigns of five slews) stand at the edge of their band, and in
200 campaigns of `study_command.py` without a star tracker mean z squared is 1.12 +- 0.04. Here
are more campaigns of these plans, with other seeds, fitted without sampling: the posterior is
so nearly Gaussian that the optimum and its covariance stand for it. The squared distance of the
truth from the estimate, (truth - estimate)^T C^-1 (truth - estimate), then follows chi^2 with nine
degrees of freedom, however correlated the nine errors are. Sds that are wrong by a share shift its
mean by twice that share. Writes results/calibration/calibration_settled.{json,md}.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg, stats

from analyses import aloud, results_of
from analyses.calibration.ranks import studies
from analyses.pages.table import table_lines
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.studies.calibration import CalibrationCase, cases_named
from bayes_inertia.studies.work import Row, Work
from bayes_inertia.version import __version__

RESULTS = results_of(__file__) / "calibration_settled.json"
SEED = 2027  # Another than that of the published ranks.
FAULT = 0.02  # The share by which sds may be wrong, and whether that would be noticed.
PARAMETERS = 9


@dataclass(frozen=True)
class DistanceOfTruth:
    """The task: one campaign of a plan flown and fitted."""

    case: CalibrationCase

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """The squared distance of the truth, and each error in sds."""
        template = planned_campaign(self.case.plan, self.case.mission)
        flight = draw_flight(template, self.case.plan, seed)
        craft = flight.spacecraft
        J = craft.inertia_B[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        campaign = self.case.as_measured(flight.campaign)
        estimate = optimizer.estimate(Model(campaign), seed=int(task_id), starts=1)
        error = np.concatenate([J, craft.scale_factor]) - estimate.theta
        root = linalg.cholesky(estimate.covariance, lower=True)
        distance = float(np.sum(linalg.solve_triangular(root, error, lower=True) ** 2))
        return {"distance": distance, "z": (error / estimate.sd).tolist()}


def cases() -> tuple[CalibrationCase, ...]:
    """The two plans of `ranks.py`, and the case without a star tracker."""
    plans = (
        CalibrationCase(study.name, "", study.plan, most_like_mission()) for study in studies()
    )
    return (*plans, *cases_named(["no-star-tracker"]))


def judged(distances: np.ndarray, z: np.ndarray) -> dict:
    """What the distances say of the sds."""
    n = len(distances)
    mean, error = float(distances.mean() / PARAMETERS), float(np.sqrt(2.0 / (PARAMETERS * n)))
    wrong = distances / (1.0 - FAULT) ** 2
    return {
        "campaigns": n,
        "mean": mean,
        "standard_error": error,
        "sd_wrong_by": 0.5 * (mean - 1.0),
        "p_value": float(stats.kstest(distances, stats.chi2(PARAMETERS).cdf).pvalue),
        "p_value_of_sds_2_percent_too_small": float(
            2.0 * stats.norm.sf(abs(wrong.mean() / PARAMETERS - 1.0) / error)
        ),
        "mean_z": z.mean(0).tolist(),
        "sd_z": z.std(0, ddof=1).tolist(),
        "in_90": float(np.mean(np.abs(z) < stats.norm.ppf(0.95))),
    }


def page(results: dict[str, dict]) -> str:
    """The figures and what they mean."""
    head = ["plan", "campaigns", "mean distance²/9", "standard error", "so sds are wrong by"]
    head += ["p, all of the distribution", "p of the mean, were sds 2 % too small"]
    head += ["sd of z, smallest and largest of nine", "90 % intervals that hold the truth"]
    rows = [
        [
            name,
            f"{of_plan['campaigns']:,}",
            f"{of_plan['mean']:.3f}",
            f"{of_plan['standard_error']:.3f}",
            f"{100 * of_plan['sd_wrong_by']:+.1f} ± {50 * of_plan['standard_error']:.1f} %",
            f"{of_plan['p_value']:.2g}",
            f"{of_plan['p_value_of_sds_2_percent_too_small']:.1g}",
            f"{min(of_plan['sd_z']):.3f}, {max(of_plan['sd_z']):.3f}",
            f"{100 * of_plan['in_90']:.1f} %",
        ]
        for name, of_plan in results.items()
    ]
    lines = ["# Are the sds wrong by two per cent?", ""]
    lines += [f"Version {__version__}; `python -m analyses.calibration.standard_deviations`.", ""]
    lines += [*(__doc__ or "").split("\n\n")[2].splitlines(), ""]
    lines += [*table_lines(head, rows), ""]
    return "\n".join(lines)


def main() -> None:
    """Run what is missing and write both files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder for the rows")
    parser.add_argument("--campaigns", type=int, default=2000, help="of each plan")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", choices=[case.name for case in cases()])
    options = parser.parse_args()
    results = json.loads(RESULTS.read_text()) if options.only else {}
    for case in (case for case in cases() if options.only in (None, case.name)):
        ids = tuple(str(i) for i in range(options.campaigns))
        told = {"case": repr(case)}
        work = Work("campaigns", DistanceOfTruth(case), ids, SEED, told)
        execution = aloud(options.jobs)
        rows = execution.run(work, options.work / case.name.replace(" ", "_")).rows
        if len(rows) < options.campaigns:
            sys.exit(f"{options.campaigns - len(rows)} campaigns have no row")
        distances = np.array([row["distance"] for row in rows])
        results[case.name] = judged(distances, np.array([row["z"] for row in rows]))
    write_atomically(RESULTS, json.dumps(results, indent=1) + "\n")
    write_atomically(RESULTS.with_suffix(".md"), page(results))


if __name__ == "__main__":
    main()
