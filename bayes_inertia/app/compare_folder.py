"""`compare` on a folder: compare plans of a campaign's spacecraft, and write what was found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayes_inertia.app.plan_json import contender_json, plan_sha256, plans_named
from bayes_inertia.app.result_folder import ResultFolder, write_page
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.design.comparison import Contender
from bayes_inertia.flight.mission import Mission
from bayes_inertia.report.pictures.design import draw_comparison
from bayes_inertia.report.pictures.figure_file import write_png
from bayes_inertia.report.plan_sections import comparison_sections
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.plan_comparison import compare_plans

FORMAT = "bayes-inertia-compare/1"
FILE, PICTURE, PAGE = "compare.json", "compare.png", "compare.html"


def run_compare(
    campaign: Path,
    plans: Sequence[str],
    folder: Path,
    *,
    simulated: int = 0,
    seed: int = 0,
    execution: Execution | None = None,
) -> tuple[Contender, ...]:
    """Compare plans and write compare.json, compare.png and compare.html."""
    flown, digest = read_campaign(campaign), campaign_sha256(campaign)
    named = plans_named(plans, flown)
    options = {
        "plans": {name: plan_sha256(plan) for name, plan in named.items()},
        "simulated": simulated,
        "seed": seed,
    }
    owner = ResultFolder(folder, "comparison", FILE, FORMAT, digest, options, (PICTURE, PAGE))
    owner.holds_this_work()
    contenders = compare_plans(
        named,
        Mission.of(flown),
        simulated=simulated,
        seed=seed,
        folder=folder / "fits",
        **vars(execution or Execution()),
    )
    rows = {c.name: contender_json(c) for c in contenders}
    stated = {"campaign": flown.name, "simulated": simulated, "seed": seed}
    owner.claim(stated | {"plans": rows})
    write_png(draw_comparison(contenders), folder / PICTURE)
    title, sections = f"Plans after {flown.name}", comparison_sections(contenders)
    write_page(folder / PAGE, title, flown.mission, campaign, sections, digest)
    return contenders
