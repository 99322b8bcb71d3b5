"""`study` on a folder: do the uncertainties hold that fits of simulated campaigns state?

A plan is flown again and again with noise, each time with another J, K and bias from the
campaign's prior. Each campaign is fitted as real data would be. If the stated sds are right,
errors over sds are standard normal, and intervals hold the truth as often as they say. Rows are
kept: a killed study goes on where it was. `study calibration`: are posteriors right over campaigns
drawn from the prior?
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.plan_folder import PAPER, plan_sha256, plans_named
from bayes_inertia.app.result_folder import ResultFolder, write_json
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.design.comparison import AchievedErrors
from bayes_inertia.errors import SettingsError, require
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.maths.printed import counted
from bayes_inertia.maths.values import json_ready
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.report.pictures.figure_file import write_png
from bayes_inertia.report.pictures.study import RankCurves, draw_calibration, draw_coverage
from bayes_inertia.studies.calibration import (
    QUANTITIES,
    Calibration,
    CaseCalibration,
    calibration_of,
    calibration_work,
    cases_named,
)
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.limits import LIMITS as STUDIES_LIMITS
from bayes_inertia.studies.plan_comparison import achieved_errors, simulated_fits
from bayes_inertia.studies.rank_statistics import coverage_from, ecdf_band
from bayes_inertia.studies.work import TaskFailure

FORMAT = "bayes-inertia-study/1"


@dataclass(frozen=True)
class Study:
    """Stated uncertainties of one plan against n simulated campaigns of it."""

    plan: Plan  # that was flown
    achieved: AchievedErrors  # errors and stated sds of every campaign that was fitted
    failures: tuple[TaskFailure, ...] = ()  # campaigns that could not be

    @property
    def names(self) -> tuple[str, ...]:
        """Of J and K."""
        return base_names(self.achieved.errors.shape[1])

    @property
    def z(self) -> np.ndarray:
        """Errors in units of the stated sd (n, 6 + axes)."""
        return self.achieved.errors / self.achieved.stated

    def coverage(self, level: float) -> list[tuple[float, float, float]]:
        """For each parameter: how often the central interval of this level held the truth."""
        held = np.abs(self.z) < stats.norm.ppf(0.5 + 0.5 * level)
        return [coverage_from(int(h.sum()), len(h), level)[1:] for h in held.T]

    @property
    def too_small(self) -> tuple[str, ...]:
        """Parameters whose errors are larger than their stated sds allow.

        By chi^2 of all errors, Bonferroni over the parameters.
        """
        p = stats.chi2.sf(np.sum(self.z**2, axis=0), len(self.z))
        limit = LAYOUT.study_false_alarm / len(p)
        return tuple(name for name, value in zip(self.names, p, strict=True) if value < limit)


def run_study(
    campaign: Path,
    folder: Path,
    plan: str = PAPER,
    *,
    campaigns: int = 200,
    seed: int = 0,
    execution: Execution | None = None,
) -> Study:
    """Simulate and fit campaigns of one plan, and write study.json and study.png."""
    given, digest = read_campaign(campaign), campaign_sha256(campaign)
    (chosen,) = plans_named([plan], given).values()
    what, advice = f"{counted(campaigns, 'campaign')} cannot scatter", "ask for 200"
    require(campaigns >= 2, "campaigns", what, advice)
    options = {"plan": plan_sha256(chosen), "seed": seed}
    owner = ResultFolder(folder, "study", "study_of.json", FORMAT, digest, options, flat=True)
    owner.claim()
    mission = Mission.of(given)
    work = simulated_fits(
        chosen, mission, campaigns, seed, options={**options, "campaign_sha256": digest}
    )
    result = (execution or Execution()).run(work, folder)
    study = Study(chosen, achieved_errors(result, least=2), result.failures)
    write_png(draw_coverage(study.names, study.achieved, study.z), folder / "study.png")
    content = {"format": FORMAT, "campaign_sha256": digest, **options, **_content(study)}
    write_json(folder / "study.json", content)
    return study


def _content(study: Study) -> dict[str, Any]:
    z, achieved = study.z, study.achieved
    rows = {}
    for i, name in enumerate(study.names):
        rows[name] = {
            "achieved_sd": float(achieved.sd[i]),
            "achieved_sd_standard_error": float(achieved.sd_error[i]),
            "stated_sd": float(achieved.stated_sd[i]),
            "mean_z": float(z[:, i].mean()),
            "sd_z": float(np.sqrt(np.mean(z[:, i] ** 2))),
            "coverage": {
                f"{100 * level:.0f}": study.coverage(level)[i] for level in LAYOUT.study_levels
            },
        }
    return {
        "campaigns": len(z),
        "parameters": rows,
        "too_small": list(study.too_small),
        "reduced_chi2": float(achieved.chi2.mean()),
        **({"failures": [asdict(f) for f in study.failures]} if study.failures else {}),
    }


CALIBRATION_FORMAT = "bayes-inertia-calibration/1"


def run_calibration(
    folder: Path,
    *,
    fits: int = 1000,
    cases: Sequence[str] = (),
    seed: int = 0,
    execution: Execution | None = None,
) -> Calibration:
    """Fly, fit and rank campaigns from the prior; write calibration.json and calibration.png."""
    chosen = cases_named(cases)
    what, advice = f"{fits} fits for {len(chosen)} cases", f"ask for {len(chosen)} or more"
    require(fits >= len(chosen), "fits", what, advice, error=SettingsError)
    work = calibration_work(chosen, fits, seed)
    options = {"seed": seed, "pipeline": "right"}
    owner = ResultFolder(
        folder, "calibration", "calibration_of.json", CALIBRATION_FORMAT, "", options
    )
    owner.claim()
    result = (execution or Execution()).run(work, folder)
    calibration = calibration_of(chosen, result)
    write_png(calibration_picture(calibration), folder / "calibration.png")
    content = {"format": CALIBRATION_FORMAT, **options, **calibration_json(calibration)}
    write_json(folder / "calibration.json", json_ready(content))
    return calibration


def calibration_picture(calibration: Calibration):
    """ECDFs of all ranks with the band that holds them all in 99 % of right studies."""
    level = 1.0 - calibration.limit
    curves = []
    for case in calibration.cases:
        n = len(case.ranks)
        band = ecdf_band(n, STUDIES_LIMITS.ranked_draws, level)
        curves.append(RankCurves(f"{case.name}, {n} fits", case.departures, band, n))
    return draw_calibration(curves, QUANTITIES)


def calibration_json(calibration: Calibration) -> dict[str, Any]:
    """A calibration as calibration.json holds it."""
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
