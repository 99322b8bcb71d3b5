"""`simulate` on a folder: which spacecraft flies which plan, and what the flight leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_inertia.app.plan_folder import PAPER, plans_named
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.mission import Mission, devices_at_rest, most_like_mission, why_no_plans
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_file import read_plan
from bayes_inertia.flight.simulated_campaigns import draw_spacecraft, simulate, simulate_again

_FOLLOWED = (
    "the plan was followed exactly: only wheels with a gyro of three axes close an attitude loop "
    "in a simulated flight"
)


@dataclass(frozen=True)
class SimulatedFlight:
    """A plan flown in simulation, and what should be known of it."""

    campaign: Campaign  # what was flown
    spacecraft: str  # whose spacecraft flew, in words
    notes: tuple[str, ...] = ()  # what the simulation leaves out


def run_simulate(
    folder: Path,
    plan: str | None = None,
    campaign: Path | None = None,
    *,
    hidden: Sequence[str] = (),
    draw: bool = False,
    seed: int = 0,
) -> SimulatedFlight:
    """Fly a plan and write the campaign folder, with its truth beside it.

    `plan`: file of the plan, or `paper`; None for five slews like the paper's. `campaign`: folder
    of the campaign whose spacecraft flies: its wheels and sensors, their noise, J and K at the mean
    of its prior; one that no plan flies repeats its own slews, where none is named. None for the
    MOST-like spacecraft. `draw`: whether J and K are drawn from the
    campaign's prior instead.
    """
    if campaign is None:
        if draw:
            raise CampaignError(
                "J and K cannot be drawn without a prior",
                where="--draw",
                advice="name the campaign that states it with --campaign",
            )
        chosen = paper_like_plan() if plan in (None, PAPER) else read_plan(str(plan))
        flight = simulate(chosen, most_like_mission(), folder, seed, hidden=hidden)
        return SimulatedFlight(flight.campaign, "the MOST-like spacecraft")
    given = read_campaign(campaign)
    truth = "drawn from" if draw else "at the mean of"
    spacecraft = f"the spacecraft of {campaign}, J and K {truth} its prior"
    if plan is None and (why := why_no_plans(given)):
        flown = simulate_again(given, folder, seed, draw=draw, hidden=hidden)
        said = f"{why}: this campaign's own slews were flown again, from where each began"
        return SimulatedFlight(flown, spacecraft, (said,))
    (chosen,) = plans_named([plan or PAPER], given).values()
    mission = _drawn_mission(given, seed) if draw else Mission.of(given)
    flight = simulate(chosen, mission, folder, seed, hidden=hidden)
    followed = () if mission.spacecraft.flies_by_gyro else (_FOLLOWED,)
    notes = (*followed, *devices_at_rest(given))
    return SimulatedFlight(flight.campaign, spacecraft, notes)


def _drawn_mission(campaign: Campaign, seed: int) -> Mission:
    # Its own stream: the same seed draws noise and effects.
    rng = np.random.default_rng([seed, 3])
    craft = replace(draw_spacecraft(campaign, rng), bias=None)
    return Mission(craft, campaign.inertia, campaign.prior)
