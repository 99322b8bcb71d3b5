"""`simulate`: fly a plan with a simulated spacecraft."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayes_inertia.app.commands.options import PAPER_HELP, AsJson, OutputFolder, Seed
from bayes_inertia.app.terminal import plain_console, print_json, progress_bar, say

if TYPE_CHECKING:
    from bayes_inertia.app.simulate_folder import SimulatedFlight

FORMAT = "bayes-inertia-simulate/1"

PlanToFly = Annotated[
    str | None, typer.Option(help=f"Plan to fly (TOML), {PAPER_HELP}, as without it.")
]
SpacecraftOf = Annotated[
    Path | None,
    typer.Option(
        help="Campaign whose spacecraft flies: its wheels, sensors and noise, J and K at the mean "
        "of its prior. One that nothing turns as a plan asks (a spinner, torquers alone) repeats "
        "its own slews. Without it, a MOST-like spacecraft."
    ),
]
DrawTruth = Annotated[
    bool, typer.Option("--draw", help="Draw J and K from the campaign's prior instead.")
]
HiddenEffects = Annotated[
    list[str] | None,
    typer.Option(
        "--hide",
        "--effects",
        help="Hidden effect, as name or name.parameter=value[,value...]; may be repeated. One "
        "of your own: FILE.py:Class or FILE.py:Class.parameter=value.",
    ),
]


def simulate_command(
    out: OutputFolder,
    plan: PlanToFly = None,
    campaign: SpacecraftOf = None,
    draw: DrawTruth = False,
    hide: HiddenEffects = None,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Fly a plan with a simulated spacecraft: yours, or a MOST-like one.

    Writes a campaign folder, with its truth beside it.
    """
    with progress_bar() as progress:
        progress("flying the plan", 0, 0)
        from bayes_inertia.app.simulate_folder import run_simulate

        simulated = run_simulate(out, plan, campaign, hidden=hide or (), draw=draw, seed=seed)
    for note in simulated.notes:
        say(note)
    slews = [slew.name for slew in simulated.campaign.slews]
    if as_json:
        print_json(_document(simulated, slews, out))
        return
    console = plain_console()
    console.print(f"flown by {simulated.spacecraft}", soft_wrap=True)
    if plan and campaign is None:
        console.print("for the one that the plan was designed for: --campaign CAMPAIGN")
    console.print(f"wrote {len(slews)} slews and truth.json in {out}", soft_wrap=True)


def _document(simulated: SimulatedFlight, slews: list[str], out: Path) -> dict[str, object]:
    return {
        "format": FORMAT,
        "campaign": str(out),
        "slews": slews,
        "truth": str(out / "truth.json"),
        "spacecraft": simulated.spacecraft,
        "notes": list(simulated.notes),
    }
