"""Forecast of a plan beside the sds of a finished run of its flight, from their files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.plan_json import slew_rows
from bayes_inertia.app.run_folder import read_run
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.flown_slews import other_slews
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_file import read_plan
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.plan_promise import PlanPromise, plan_promise
from bayes_inertia.sealing import read_sealed_json
from bayes_inertia.studies.plan_comparison import compare_plans


def promise_of_plan(run: Path, plan: Path, summary: dict[str, Any]) -> PlanPromise:
    """Put what a plan promised beside what a run of its flight achieved.

    Promised is what `design` wrote into the design.json beside the plan. For any other plan it is
    forecast now, as `compare` does, for the hardware and prior of the run's campaign.
    """
    promised, campaign = read_plan(plan), _campaign_of(run)
    difference = other_slews(promised, campaign)
    if difference:
        raise CampaignError(
            f"the run is of other slews than the plan {promised.name!r}: {difference}",
            where=str(plan),
            advice="name the plan that was flown; `simulate --campaign CAMPAIGN --plan PLAN` flies "
            "this one",
        )
    stored = _designed_sd(promised, plan.parent / "design.json")
    source = "what design.json says beside the plan"
    if stored is None:
        source = "forecast now, with hardware and prior of the run's campaign"
        (contender,) = compare_plans([promised], Mission.of(campaign))
        stored = dict(zip(BASE_NAMES, contender.expected.tolist(), strict=True))
    return plan_promise(promised.name, str(plan), source, stored, summary)


def _campaign_of(run: Path) -> Campaign:
    if not (run / "run.json").is_file():
        raise CampaignError(
            "the run keeps no campaign, so nothing tells whether the plan was flown",
            where=str(run),
            advice="give the folder that `fit -o` or `diagnose -o` wrote",
        )
    read_run(run)
    return read_campaign(run / "campaign")


def _designed_sd(plan: Plan, path: Path) -> dict[str, float] | None:
    """{parameter: sd} that `design` wrote of this very plan; None if it did not."""
    if not path.is_file():
        return None
    content = read_sealed_json(path, "design the plan again, or move the plan elsewhere")
    try:
        designed = content["plan"]
        sd = {name: float(designed["expected_sd"][name]) for name in BASE_NAMES}
        same = _same_slews(designed["slews"], slew_rows(plan))
    except (KeyError, TypeError, ValueError):
        return None
    return sd if same else None


def _same_slews(designed: list[dict[str, Any]], planned: list[dict[str, Any]]) -> bool:
    """Whether two lists of slews, as `slew_rows` gives them, are equal to rounding."""
    if len(designed) != len(planned):
        return False
    return all(
        math.isclose(x, y, rel_tol=LAYOUT.same_slew, abs_tol=LAYOUT.same_slew)
        for a, b in zip(designed, planned, strict=True)
        for key in b
        for x, y in zip(_numbers(a[key]), _numbers(b[key]), strict=True)
    )


def _numbers(value: Any) -> list[float]:
    return list(value) if isinstance(value, list) else [value]
