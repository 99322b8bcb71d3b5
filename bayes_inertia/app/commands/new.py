"""`new`: a commented campaign to begin with, and a flight of it."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from bayes_inertia.app.commands.options import AsJson, Seed
from bayes_inertia.app.terminal import print_json, progress_bar, say
from bayes_inertia.errors import SettingsError
from bayes_inertia.files import text_of, write_new_files

FORMAT = "bayes-inertia-new/1"
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
