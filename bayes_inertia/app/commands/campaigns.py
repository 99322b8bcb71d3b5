"""`new`, `simulate`: a commented campaign to begin with, and a plan flown in simulation."""

from __future__ import annotations

import json
from pathlib import Path

from bayes_inertia.app.options import LIKE
from bayes_inertia.app.terminal import plain_console, print_json, progress_bar, say
from bayes_inertia.errors import SettingsError, require
from bayes_inertia.files import text_of, write_new_files
from bayes_inertia.maths.printed import counted

FORMAT = "bayes-inertia-new/1"


def new_command(folder: Path, like: str = "microsat", seed: int = 1, as_json: bool = False) -> None:
    """Write a commented campaign to begin with: a spacecraft like yours, and a simulated flight.

    Every key stands in campaign.toml with its unit. `check`, `doctor` and `fit` work at once; what
    the fit should find is in truth.json.
    """
    text = template(like)
    with progress_bar() as progress:
        progress("flying the slews", 0, 0)
        from bayes_inertia.campaign.writer import files_of
        from bayes_inertia.flight.example_flight import example_flight

        tables, truth = example_flight(text, f"{like}.toml", seed)
    content = {"truth.json": f"{json.dumps(truth, indent=1)}\n".encode(), **files_of(text, tables)}
    write_new_files(folder, content, holds="campaign")
    if as_json:
        place = {"campaign": str(folder), "truth": str(folder / "truth.json")}
        print_json({"format": FORMAT, **place, "tables": sorted(tables)})
        return
    say(f"wrote campaign.toml, {len(tables)} tables and truth.json in {folder}")
    say(f"next: bayes-inertia fit {folder} -o run")


def templates() -> dict[str, str]:
    """The text of each commented campaign, by its name."""
    return {name: text_of(file.read_bytes(), file.name) for name, file in LIKE.items()}


def template(name: str) -> str:
    """The text of one commented campaign."""
    known = templates()
    what, advice = f"no spacecraft is called {name!r}", f"choose among {', '.join(known)}"
    require(name in known, "--like", what, advice, error=SettingsError)
    return known[name]


def simulate_command(
    out: Path,
    plan: str | None = None,
    campaign: Path | None = None,
    draw: bool = False,
    hide: list[str] | None = None,
    seed: int = 0,
    as_json: bool = False,
) -> None:
    """Fly a plan with a simulated spacecraft: yours, or a MOST-like one.

    Writes a campaign folder, with its truth beside it.
    """
    with progress_bar() as progress:
        progress("flying the plan", 0, 0)
        from bayes_inertia.app.plan_folder import run_simulate

        told = run_simulate(out, plan, campaign, hidden=hide or (), draw=draw, seed=seed)
    for note in told["notes"]:
        say(note)
    if as_json:
        print_json(told)
        return
    console = plain_console()
    console.print(f"flown by {told['spacecraft']}", soft_wrap=True)
    if plan and campaign is None:
        console.print("for the one that the plan was designed for: --campaign CAMPAIGN")
    slews = counted(len(told["slews"]), "slew")
    console.print(f"wrote {slews} and truth.json in {out}", soft_wrap=True)
