"""`new`, `simulate`: a commented campaign to begin with, and a plan flown in simulation."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayes_inertia.app.commands.options import PAPER_HELP, AsJson, OutputFolder, Seed
from bayes_inertia.app.terminal import plain_console, print_json, progress_bar, say
from bayes_inertia.errors import SettingsError
from bayes_inertia.files import text_of, write_new_files

if TYPE_CHECKING:
    from bayes_inertia.app.simulate_folder import SimulatedFlight

FORMAT, SIMULATE_FORMAT = "bayes-inertia-new/1", "bayes-inertia-simulate/1"
_TEMPLATES = files("bayes_inertia") / "templates"
_FILES = sorted(each.name for each in _TEMPLATES.iterdir())

NewFolder = Annotated[Path, typer.Argument(help="Folder for the campaign; made if absent.")]
Like = Annotated[
    str,
    typer.Option(
        help=f"Which spacecraft: {', '.join(name.removesuffix('.toml') for name in _FILES)}."
    ),
]


def new_command(
    folder: NewFolder, like: Like = "microsat", seed: Seed = 1, as_json: AsJson = False
) -> None:
    """Write a commented campaign to begin with: a spacecraft like yours, and a simulated flight.

    Every key stands in campaign.toml with its unit. `check`, `doctor` and `fit` work at once; what
    the fit should find is in truth.json.
    """
    text = template(like)
    with progress_bar() as progress:
        progress("flying the slews", 0, 0)
        from bayes_inertia.campaign.writer import files_of
        from bayes_inertia.flight.example_flight import example_flight

        flight = example_flight(text, f"{like}.toml", seed)
    truth = json.dumps(flight.truth, indent=1) + "\n"
    content = {"truth.json": truth.encode(), **files_of(text, flight.tables)}
    write_new_files(folder, content, holds="campaign")
    if as_json:
        tables = sorted(flight.tables)
        place = {"campaign": str(folder), "truth": str(folder / "truth.json")}
        print_json({"format": FORMAT, **place, "tables": tables})
        return
    say(f"wrote campaign.toml, {len(flight.tables)} tables and truth.json in {folder}")
    say(f"next: bayes-inertia fit {folder} -o run")


def templates() -> dict[str, str]:
    """The text of each commented campaign, by its name."""
    texts = {name: text_of((_TEMPLATES / name).read_bytes(), name) for name in _FILES}
    return {name.removesuffix(".toml"): text for name, text in texts.items()}


def template(name: str) -> str:
    """The text of one commented campaign."""
    known = templates()
    if name not in known:
        raise SettingsError(
            f"no spacecraft is called {name!r}",
            where="--like",
            advice=f"choose among {', '.join(known)}",
        )
    return known[name]


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
        "format": SIMULATE_FORMAT,
        "campaign": str(out),
        "slews": slews,
        "truth": str(out / "truth.json"),
        "spacecraft": simulated.spacecraft,
        "notes": list(simulated.notes),
    }
