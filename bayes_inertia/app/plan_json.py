"""Plans as a command line names them, and as plain numbers in design.json and compare.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.comparison import Contender
from bayes_inertia.design.designer import Design
from bayes_inertia.design.margins import Margin
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.follow_on import following_plan
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.report.formatting import plain
from bayes_inertia.sealing import sha256_of

PAPER = "paper"


def plans_named(texts: Sequence[str], campaign: Campaign) -> dict[str, Plan]:
    """Plans from files, or `paper`: five slews like the paper's, from where the campaign ended.

    Those that would be printed alike bear the name of their file too.
    """
    base = following_plan(campaign)
    # The paper's slews from where the campaign ended, so that all plans start alike.
    paper = replace(base, name="five slews like the paper's", slews=paper_like_plan().slews)
    read = [(text, paper if text == PAPER else read_plan(text)) for text in texts]
    printed = [plain(plan.name) for _, plan in read]
    named = {
        plan.name if printed.count(name) == 1 else f"{plan.name} ({Path(text).stem})": plan
        for name, (text, plan) in zip(printed, read, strict=True)
    }
    if len({plain(name) for name in named}) < len(read):
        raise CampaignError("the same plan twice", where="plans", advice="give each once")
    return named


def plan_sha256(plan: Plan) -> str:
    """Digest of a plan: two plans of one digest are flown alike."""
    return sha256_of(repr(plan))


_MARGIN_KEYS = ("limit", "where", "used", "allowed", "unit", "left", "kept", "says")


def slew_rows(plan: Plan) -> list[dict[str, Any]]:
    """The slews of a plan in degrees and seconds."""
    return [
        {
            "axis_B": list(slew.axis_B),
            "angle_deg": math.degrees(slew.angle),
            "rate_deg_s": math.degrees(slew.rate),
            "acceleration_deg_s2": math.degrees(slew.acceleration),
            "start_s": start,
            "duration_s": duration,
        }
        for slew, start, duration in zip(plan.slews, plan.starts, plan.durations, strict=True)
    ]


def contender_json(contender: Contender) -> dict[str, Any]:
    """A plan in a comparison: expected and achieved sds, costs, margins, slews."""
    names = base_names(len(contender.expected))
    content = {
        "expected_sd": dict(zip(names, contender.expected.tolist(), strict=True)),
        "total_time_s": contender.total_time,
        "motion_time_s": contender.motion_time,
        "peak_momentum_Nms": _finite(contender.peak_momentum),
        "peak_torque_Nm": _finite(contender.peak_torque),
        "margins": [_margin_row(m) for m in contender.margins],
        "slews": slew_rows(contender.plan),
    }
    achieved = contender.achieved
    if achieved is None:
        return content
    return content | {
        "achieved_sd": dict(zip(names, achieved.sd.tolist(), strict=True)),
        "achieved_sd_standard_error": dict(zip(names, achieved.sd_error.tolist(), strict=True)),
        "stated_sd": dict(zip(names, achieved.stated.mean(0).tolist(), strict=True)),
        "reduced_chi2": float(achieved.chi2.mean()),
        "campaigns": len(achieved.errors),
    }


def design_json(
    design: Design, contenders: Sequence[Contender], campaign: Campaign
) -> dict[str, Any]:
    """A design: what it is expected to give, beside slews like the paper's."""
    designed, reference = contenders
    return {
        "campaign": campaign.name,
        "goal": {"name": str(design.goal), "says": design.goal.says, "unit": design.goal.unit},
        "value": design.value,
        "reference_value": design.reference_value,
        "gain": design.gain,
        "best_of_random_plans": _finite(design.best_random),
        "random_plans": design.random_plans,
        "expected_sd": design.sd,
        "reference_sd": design.reference_sd,
        "sd_before": design.sd_before,
        "plan": contender_json(designed),
        "reference": contender_json(reference),
        "margins": [_margin_row(m) for m in design.margins],
        "flown_margins": [_margin_row(m) for m in design.flown],
        "kept": design.kept,
        "active_limits": list(design.active),
        "limits": design.limits.to_json(),
        "history": [list(path) for path in design.history],
        "seed": design.seed,
        "seconds": design.seconds,
    }


def _margin_row(margin: Margin) -> dict[str, Any]:
    return {key: getattr(margin, key) for key in _MARGIN_KEYS}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
