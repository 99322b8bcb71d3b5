"""Which uncertainty of J and K to quote: candidates against truth, by kind of campaign.

    python -m analyses.calibration.quoted_sd --each 60 [--work FOLDER] [--kinds clean,designed]
    python -m analyses.calibration.quoted_sd --page

Each campaign is fitted as `fit` does, without sampling (Laplace approximation), and each candidate
says what the sd of J and K is. The package's own choice is `quoted_parameters`. Writes
`results/calibration/quoted_sd.jsonl` and, with --page, `quoted_sd.md` and its figure.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analyses import aloud, results_of
from analyses.calibration.quoted_sd_campaigns import CLASSES, Case, case_of
from analyses.calibration.quoted_sd_page import write_page
from analyses.data_quality.pipeline import PERFECT
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.errors import BayesInertiaError, EstimateError
from bayes_inertia.files import write_atomically
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import clean_fit
from bayes_inertia.inference.gates import check_gates
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.studies.work import Row, Work

RESULTS = results_of(__file__) / "quoted_sd.jsonl"


@dataclass(frozen=True)
class Fitted:
    """The task: one campaign, fitted. Ids are "class/index"."""

    tachometers: bool
    work: Path

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its row."""
        kind, _, index = task_id.partition("/")
        try:
            case = case_of(kind, int(index), seed, self.tachometers, self.work)
            row = _row(case)
        except BayesInertiaError as error:
            row = {"error": str(error)[:200]}
        return {"line": json.dumps({"kind": kind, "tachometers": self.tachometers} | row)}


def _row(case: Case) -> dict:
    """What each candidate makes of J and K."""
    estimate = clean_fit(optimizer.estimate(Model(case.campaign))).estimate
    gates, scatter = check_gates(estimate, PERFECT), estimate.slew_scatter
    averaged = quoted_parameters(estimate)
    dispersion = estimate.dispersion_factor
    if scatter is None:
        raise EstimateError("one slew", where=case.hidden, advice="give more")
    return {
        "hidden": case.hidden,
        "trusted": all(gate["passed"] for gate in gates),
        "dispersion": scatter.dispersion.json(),
        "error": _short(estimate.theta[:9] - case.truth),
        "averaged_error": _short(averaged.mean - case.truth),
        "sd": _short(estimate.sd[:9]),
        "robust_sd": _short(estimate.robust_sd[:9]),
        "averaged_sd": _short(averaged.sd / dispersion),
        **{name: _short(values[:9]) for name, values in estimate.scatter_sds.items()},
    }


def _short(values: np.ndarray) -> list[float]:
    """Six digits are enough, and their file is half as large."""
    return [float(f"{value:.5e}") for value in values]


def main() -> None:
    """Simulate and fit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--each", type=int, default=0, help="campaigns of each class and half")
    parser.add_argument("--work", type=Path, default=Path("quoted_sd_run"))
    parser.add_argument("--kinds", default=",".join(CLASSES))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    lines = []
    execution = aloud(options.jobs)
    options.work.mkdir(parents=True, exist_ok=True)
    for kind in options.kinds.split(",") if options.each else ():
        for tachometers in (True, False):
            ids = tuple(f"{kind}/{i}" for i in range(options.each))
            work = Work(
                "campaigns",
                Fitted(tachometers, options.work),
                ids,
                seed=41,
                options={"tachometers": tachometers},
            )
            name = f"{kind}_{'with' if tachometers else 'without'}"
            rows = execution.run(work, options.work / name).rows
            lines += [row["line"] for row in rows]
    if lines:
        write_atomically(RESULTS, "".join(f"{line}\n" for line in lines))
    if options.page:
        write_page(RESULTS)


if __name__ == "__main__":
    main()
