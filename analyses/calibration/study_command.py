"""`study calibration`, and pipelines that are wrong on purpose.

    python -m analyses.calibration.study_command --work FOLDER [--fits 1000] [--jobs 2] [--wrong 30]

The command's own study, all its cases; then fits of weak data by three wrong pipelines: posterior
sds times 0.75, scale factors forgotten, products of inertia with the wrong sign. What is in the
work folder is kept, so that the same command goes on. Writes
results/calibration/calibration_study.{json,md}.
`ranks.py` is the older study, of two cases and nine parameters.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from analyses import results_of
from bayes_inertia.app.study_folder import calibration_json, run_calibration
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.maths.values import json_ready
from bayes_inertia.studies.calibration import (
    CalibrationFit,
    calibration_of,
    calibration_work,
    cases_named,
)
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.limits import LIMITS as STUDIES_LIMITS

RESULTS = results_of(__file__) / "calibration_study.json"
# Wrong pipelines see the case in which the prior counts most.
_WRONG_CASE = "two-slews"
_SMALL_SD = 0.75
_HELD_SCALE_FACTOR_SIGMA = 1e-7


class SmallSd(CalibrationFit):
    """Posterior sds that are too small."""

    def as_reported(self, draws: np.ndarray) -> np.ndarray:
        """The draws (n, d), drawn together about their mean."""
        mean = draws.mean(0)
        return mean + _SMALL_SD * (draws - mean)


class HeldScaleFactors(CalibrationFit):
    """K held at one."""

    def as_fitted(self, campaign: Campaign) -> Campaign:
        """The campaign, its gyro without errors of scale."""
        held = (_HELD_SCALE_FACTOR_SIGMA,) * 3
        sensor = replace(campaign.three_axis_gyro, scale_factor_sigma=held)
        return replace(campaign, rate_sensor=sensor)


class FlippedSign(CalibrationFit):
    """Products of inertia with the wrong sign."""

    def as_reported(self, draws: np.ndarray) -> np.ndarray:
        """The draws (n, d), with the signs of Jxy, Jxz and Jyz turned."""
        changed = draws.copy()
        changed[:, 3:6] *= -1.0
        return changed


WRONG = {"small_sd": SmallSd, "no_scale_factors": HeldScaleFactors, "flipped_sign": FlippedSign}
_SAYS = {
    "small_sd": "posterior sds times 0.75",
    "no_scale_factors": "K held at one",
    "flipped_sign": "products of inertia with the wrong sign",
}


def right_pipeline(work: Path, fits: int, jobs: int) -> dict[str, Any]:
    """All cases by the package's own pipeline, and how long it took by the clock."""
    began = monotonic()
    calibration = run_calibration(work / "right", fits=fits, execution=Execution(jobs=jobs))
    return calibration_json(calibration) | {"clock_seconds": monotonic() - began, "jobs": jobs}


def wrong_pipelines(work: Path, fits: int) -> dict[str, Any]:
    """The three wrong pipelines on weak data."""
    cases = cases_named([_WRONG_CASE])
    right, found = calibration_work(cases, fits), {}
    for name, fit in WRONG.items():
        task = fit({case.name: case for case in cases})
        wrong = replace(right, task=task, options={**right.options, "pipeline": name})
        found[name] = calibration_json(calibration_of(cases, Execution().run(wrong, work / name)))
    return found


def page(right: Mapping[str, Any], wrong: Mapping[str, Mapping[str, Any]]) -> str:
    """Counts, coverage and verdicts."""
    lines = [
        "# Calibration by the command",
        "",
        "Made by `python -m analyses.calibration.study_command`, which runs `bayes-inertia study "
        "calibration`: J, K, bias and effects drawn from the prior, slews flown in",
        "closed loop, fitted, and the truth ranked among "
        f"{STUDIES_LIMITS.ranked_draws} draws of the posterior: J, K, "
        "principal moments, the correction slew, the log posterior.",
        "",
        f"**{right['fits']} fits: {right['verdict']}.** Ranks are rejected at p < "
        f"{right['p_value_limit']:.1g} (1 % shared by all cases and quantities). "
        f"Fits that failed: {len(right['failures'])}.",
        "",
        "| case | fits | mean z² of J, K | smallest p | of | in 50 % | in 90 % | in 95 % | "
        "residuals pass |",
        "|---|---|---|---|---|---|---|---|---|",
        *(_case_row(name, case) for name, case in right["cases"].items()),
        "",
        "z²: squared distance of the truth from the mean in sds; 1 where sds are right. Intervals: "
        "share of all fits and quantities J, K whose central",
        "interval held the truth. Quantities of one fit are correlated, so these shares scatter "
        "more than their number suggests; the verdict rests on the ranks.",
        "",
        "## Pipelines that are wrong on purpose",
        "",
        "| pipeline | fits | verdict | quantities rejected | mean z² of J, K |",
        "|---|---|---|---|---|",
        *(_wrong_row(name, content) for name, content in wrong.items()),
        "",
    ]
    return "\n".join(lines)


def _case_row(name: str, case: Mapping[str, Any]) -> str:
    quantities = case["quantities"]
    worst = min(quantities, key=lambda quantity: quantities[quantity]["p_value"])
    base = list(quantities.values())[:9]
    covered = [sum(q["coverage"][k]["share"] for q in base) / len(base) for k in range(3)]
    return (
        f"| {name}: {case['says']} | {case['fits']} | {_z2(case)} | "
        f"{quantities[worst]['p_value']:.2g} | {worst} | "
        f"{' | '.join(f'{100 * share:.1f} %' for share in covered)} | "
        f"{100 * case['explained']:.0f} % |"
    )


def _wrong_row(name: str, content: Mapping[str, Any]) -> str:
    (case,) = content["cases"].values()
    rejected = ", ".join(entry["quantity"] for entry in content["rejected"]) or "none"
    return f"| {_SAYS[name]} | {case['fits']} | {content['verdict']} | {rejected} | {_z2(case)} |"


def _z2(case: Mapping[str, Any]) -> str:
    return f"{case['mean_z2_of_J_and_K']:.3g} ± {case['mean_z2_standard_error']:.1g}"


def main() -> None:
    """Run or go on, and write both files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="folder for the rows")
    parser.add_argument("--fits", type=int, default=1000, help="fits of all cases together")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes")
    parser.add_argument("--wrong", type=int, default=30, help="fits of each wrong pipeline")
    options = parser.parse_args()
    right = right_pipeline(options.work, options.fits, options.jobs)
    wrong = wrong_pipelines(options.work, options.wrong)
    content = json_ready({"right": right, "wrong": wrong})
    write_atomically(RESULTS, json.dumps(content, indent=1, allow_nan=False) + "\n")
    write_atomically(RESULTS.with_suffix(".md"), page(right, wrong))


if __name__ == "__main__":
    main()
