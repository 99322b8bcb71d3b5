"""`simulate`: fly a plan with a simulated spacecraft."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_inertia.app.commands.options import AsJson, OutputFolder, Seed
from bayes_inertia.app.terminal import plain_console, print_json

FORMAT = "bayes-inertia-simulate/1"


def simulate_command(
    out: OutputFolder,
    plan: Annotated[
        Path | None,
        typer.Option(help="Plan to fly (TOML); without one, five slews like the paper's."),
    ] = None,
    hide: Annotated[
        list[str] | None,
        typer.Option(
            "--hide",
            "--effects",
            help="Hidden effect, as name or name.parameter=value[,value...]; may be repeated. One "
            "of your own: FILE.py:Class or FILE.py:Class.parameter=value.",
        ),
    ] = None,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Fly a plan with a simulated MOST-like spacecraft.

    Writes a campaign folder, with its truth beside it.
    """
    from bayes_inertia.flight.plan import paper_like_plan
    from bayes_inertia.flight.plan_file import read_plan
    from bayes_inertia.flight.simulated_campaigns import simulate_most

    flight = simulate_most(read_plan(plan) if plan else paper_like_plan(), out, seed, hide or ())
    if as_json:
        slews = [slew.name for slew in flight.campaign.slews]
        truth = str(out / "truth.json")
        print_json({"format": FORMAT, "campaign": str(out), "slews": slews, "truth": truth})
    else:
        console = plain_console()
        console.print(
            f"wrote {len(flight.campaign.slews)} slews and truth.json in {out}", soft_wrap=True
        )
        if plan:
            console.print(
                "flown by the MOST-like spacecraft; for the one that the plan was designed for: "
                "study CAMPAIGN --plan PLAN",
                soft_wrap=True,
            )
