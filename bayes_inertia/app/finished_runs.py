"""Finished runs, from their files alone: two side by side, or one beside its plan's forecast."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.plan_folder import plan_for
from bayes_inertia.app.result_folder import GIVE_A_RUN, NEW_RUN, finished_posterior
from bayes_inertia.app.run_folder import campaign_of_run, read_run, run_summary
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import require
from bayes_inertia.flight.mission import Mission, other_slews, repeating_plan
from bayes_inertia.flight.plan import Plan
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.report.fit_sections import settings_rows
from bayes_inertia.report.plan_promise import PlanPromise, plan_promise
from bayes_inertia.report.run_comparison import ComparedRun, RunComparison, compare_runs
from bayes_inertia.sealing import blaming, is_sealed, read_sealed_json, sha256_of
from bayes_inertia.studies.plan_comparison import compare_plans


def compare_two_runs(first: Path, second: Path) -> RunComparison:
    """Read two runs and compare them."""
    what = "both runs are the same folder"
    advice = "name two runs, such as one without and one with an effect"
    require(first.resolve() != second.resolve(), str(first), what, advice)
    names = [run.resolve().name for run in (first, second)]
    labels = names if names[0] != names[1] else [str(first), str(second)]
    return compare_runs(_compared_run(first, labels[0]), _compared_run(second, labels[1]))


def _compared_run(folder: Path, label: str) -> ComparedRun:
    posterior = finished_posterior(folder)
    with blaming(folder, intact=is_sealed(folder / "posterior.nc", ""), advice=NEW_RUN):
        settings = dict(settings_rows(posterior))
        summary = run_summary(posterior, folder)
    return ComparedRun(str(folder), label, summary, settings | _asked_for(folder))


def _asked_for(folder: Path) -> dict[str, str]:
    """Options of the command line; none for a posterior saved from Python."""
    if not (folder / "run.json").is_file():
        return {}
    run = read_run(folder)
    return {
        "command": run.kind,
        "telemetry and noise": "as stated" if run.as_stated else "checked for faults",
        "noise model": run.noise.in_words() or "Gaussian, as stated",
        "prior of J and K": "the campaign's" if run.prior is None else _former(run.prior),
    }


def _former(prior: dict[str, Any]) -> str:
    """A former result that was the prior: two that differ are called by other digests."""
    return f"a former result (SHA-256 {sha256_of(json.dumps(prior, sort_keys=True))[:12]})"


def promise_of_plan(run: Path, plan: Path, summary: dict[str, Any]) -> PlanPromise:
    """Put what a plan promised beside what a run of its flight achieved.

    Promised is what `design` wrote into the design.json beside the plan. For any other plan it is
    forecast now, as `compare` does, for the hardware and prior of the run's campaign.
    """
    campaign = _campaign_of(run)
    wheels = len(campaign.without_locked_wheels().wheels)
    # What the file leaves out is as where the flight began.
    promised = plan_for(plan, wheels, repeating_plan(campaign))
    difference = other_slews(promised, campaign)
    what = f"the run is of other slews than the plan {promised.name!r}: {difference}"
    advice = (
        "name the plan that was flown; `simulate --campaign CAMPAIGN --plan PLAN` flies this one"
    )
    require(not difference, str(plan), what, advice)
    stored = _designed_sd(promised, plan.parent / "design.json")
    source = "what design.json says beside the plan"
    if stored is None:
        source = "forecast now, with hardware and prior of the run's campaign"
        (contender,) = compare_plans([promised], Mission.of(campaign))
        names = base_names(len(contender.expected))
        stored = dict(zip(names, contender.expected.tolist(), strict=True))
    return plan_promise(promised.name, str(plan), source, stored, summary)


def _campaign_of(run: Path) -> Campaign:
    what = "the run keeps no campaign, so nothing tells whether the plan was flown"
    require((run / "run.json").is_file(), str(run), what, GIVE_A_RUN)
    return campaign_of_run(run, read_run(run))


def _designed_sd(plan: Plan, path: Path) -> dict[str, float] | None:
    """{parameter: sd} that `design` wrote of this very plan; None if it did not."""
    if not path.is_file():
        return None
    content = read_sealed_json(path, "design the plan again, or move the plan elsewhere")
    try:
        designed = content["plan"]
        sd = {name: float(x) for name, x in designed["expected_sd"].items()}
        same = _same_slews(designed["slews"], plan.slew_rows())
    except (KeyError, TypeError, ValueError):
        return None
    return sd if same else None


def _same_slews(designed: list[dict[str, Any]], planned: list[dict[str, Any]]) -> bool:
    """Whether two lists of slews, as `Plan.slew_rows` gives them, are equal to rounding."""
    if len(designed) != len(planned):
        return False
    told, flown = (
        [x for slew in slews for key in planned[0] for x in np.ravel(slew[key])]
        for slews in (designed, planned)
    )
    return np.allclose(told, flown, rtol=LAYOUT.same_slew, atol=LAYOUT.same_slew)
