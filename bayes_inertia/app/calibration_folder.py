"""`study calibration` on a folder: are posteriors right over campaigns drawn from the prior?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.app.result_folder import ResultFolder, write_json
from bayes_inertia.errors import SettingsError
from bayes_inertia.maths.values import json_ready
from bayes_inertia.report.pictures.calibration import RankCurves, draw_calibration
from bayes_inertia.report.pictures.figure_file import write_png
from bayes_inertia.studies.calibration import (
    QUANTITIES,
    RANKED,
    Calibration,
    CaseCalibration,
    Pipeline,
    calibration_of,
    calibration_work,
    cases_named,
)
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.rank_statistics import ecdf_band

FORMAT = "bayes-inertia-calibration/1"


def run_calibration(
    folder: Path,
    *,
    fits: int = 1000,
    cases: Sequence[str] = (),
    seed: int = 0,
    pipeline: Pipeline = "right",
    execution: Execution | None = None,
) -> Calibration:
    """Fly, fit and rank campaigns from the prior, and write calibration.json and calibration.png.

    `folder`: where to write. Rows that are there already are kept; more fits may be asked for
    later. `fits`: how many in all; the cases share them evenly. `pipeline`: the package's, or one
    that is wrong on purpose. `execution`: where campaigns are fitted, and who is told; None: in
    this process.
    """
    chosen = cases_named(cases)
    if fits < len(chosen):
        raise SettingsError(
            f"{fits} fits for {len(chosen)} cases",
            where="fits",
            advice=f"ask for {len(chosen)} or more",
        )
    work = calibration_work(chosen, fits, seed, pipeline)
    options = {"seed": seed, "pipeline": pipeline}
    owner = ResultFolder(folder, "calibration", "calibration_of.json", FORMAT, "", options)
    owner.claim()
    result = (execution or Execution()).run(work, folder)
    calibration = calibration_of(chosen, result)
    write_png(calibration_picture(calibration), folder / "calibration.png")
    content = {"format": FORMAT, **options, **calibration_json(calibration)}
    write_json(folder / "calibration.json", json_ready(content))
    return calibration


def calibration_picture(calibration: Calibration):
    """ECDFs of all ranks with the band that holds them all in 99 % of right studies."""
    level = 1.0 - calibration.limit
    curves = [
        RankCurves(
            f"{case.name}, {len(case.ranks)} fits",
            case.departures,
            ecdf_band(len(case.ranks), RANKED, level),
            len(case.ranks),
        )
        for case in calibration.cases
    ]
    return draw_calibration(curves, QUANTITIES)


def calibration_json(calibration: Calibration) -> dict[str, Any]:
    """A calibration as calibration.json holds it.

    Returns: verdict, and for every case and quantity p-value, z and coverage.
    """
    return {
        "verdict": "rejected" if calibration.rejected else "not rejected",
        "rejected": [{"case": case, "quantity": name} for case, name in calibration.rejected],
        "p_value_limit": calibration.limit,
        "fits": calibration.fits,
        "cases": {case.name: _case_json(case) for case in calibration.cases},
        "failures": [asdict(failure) for failure in calibration.failures],
    }


def _case_json(case: CaseCalibration) -> dict[str, Any]:
    z, n = case.z, len(case.z)
    quantities = {
        name: {
            "p_value": float(case.p_values[k]),
            "mean_z": float(z[:, k].mean()),
            "mean_z2": float((z[:, k] ** 2).mean()),
            "coverage": [coverage._asdict() for coverage in case.coverage(k)],
        }
        for k, name in enumerate(QUANTITIES)
    }
    each = np.mean(z[:, :9] ** 2, axis=1)
    error = float(each.std(ddof=1) / np.sqrt(n)) if n > 1 else None
    return {
        "says": case.says,
        "fits": n,
        "mean_z2_of_J_and_K": float(each.mean()),
        "mean_z2_standard_error": error,
        "explained": float(case.explained.mean()),
        "nested_rhat_max": float(case.nested_rhat.max()),
        "quantities": quantities,
    }
