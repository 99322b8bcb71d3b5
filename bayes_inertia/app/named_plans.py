"""Plans as a command line names them: files, or the word `paper`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.follow_on import following_plan
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan
from bayes_inertia.sealing import sha256_of

PAPER = "paper"


def plans_named(texts: Sequence[str], campaign: Campaign) -> dict[str, Plan]:
    """Plans from files, or `paper`: five slews like the paper's, from where the campaign ended.

    Returns: {name: Plan}; plans of one name are told apart by their files.
    """
    base = following_plan(campaign)
    # The paper's slews from where the campaign ended, so that all plans start alike.
    paper = replace(base, name="five slews like the paper's", slews=paper_like_plan().slews)
    read = [(text, paper if text == PAPER else read_plan(text)) for text in texts]
    names = [plan.name for _, plan in read]
    named = {
        plan.name if names.count(plan.name) == 1 else f"{plan.name} ({Path(text).stem})": plan
        for text, plan in read
    }
    if len(named) < len(read):
        raise CampaignError("the same plan twice", where="plans", advice="give each once")
    return named


def plan_sha256(plan: Plan) -> str:
    """Digest of a plan: two plans of one digest are flown alike."""
    return sha256_of(repr(plan))
