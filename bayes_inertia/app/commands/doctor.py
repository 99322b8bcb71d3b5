"""`doctor`: is this installation sound; and are a campaign's conventions those of its data?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayes_inertia.app.commands.options import AsJson
from bayes_inertia.app.terminal import headed, plain_console, print_json

if TYPE_CHECKING:
    from bayes_inertia.conventions.check import ConventionsCheck

_CampaignOrNone = Annotated[
    Path | None,
    typer.Argument(help="Campaign folder; without it the installation is looked at."),
]


def doctor_command(campaign: _CampaignOrNone = None, as_json: AsJson = False) -> None:
    """Hold a campaign's conventions against physics; without a campaign, check the installation.

    Units, signs, orders, frames and clocks are those of the data, or the change that makes them so
    is named. Nothing is changed. Exit code 2 if a convention is wrong.
    """
    if campaign is None:
        from bayes_inertia.app.installation import installation_json, show_installation

        installation = installation_json()
        if as_json:
            print_json(installation)
        else:
            show_installation(installation)
        return
    from bayes_inertia.conventions.check import check_conventions

    check = check_conventions(campaign)
    lines = _mapping_lines(campaign, check)
    if as_json:
        print_json(check.json() | {"mapping_lines": lines})
    else:
        show_check(check, lines)
    if check.verdict == "wrong":
        raise typer.Exit(2)


def _mapping_lines(campaign: Path, check: ConventionsCheck) -> list[str]:
    """The lines of the mapping that the proposal is about, of a folder that was imported."""
    keys = [change.key for change in check.changes if change.proposal == 1]
    if not keys:
        return []
    from bayes_inertia.importing.mapped_lines import mapped_lines

    return [line for key in keys for line in mapped_lines(campaign, key)]


def show_check(check: ConventionsCheck, mapping_lines: Sequence[str] = ()) -> None:
    """Print a check for people.

    Parameters
    ----------
    check : ConventionsCheck
        What was found.
    mapping_lines : sequence of str
        The lines of the mapping that the proposal is about.
    """
    from bayes_inertia.conventions.invisible import invisible_in_brief

    console = plain_console()
    hidden = invisible_in_brief(check.cannot_show)
    style = "bold red" if check.verdict == "wrong" else "bold"
    console.print(headed(f"{check.campaign}: {check.verdict}", style=style))
    console.print(check.sentence)
    for title, lines in (
        ("the folder was imported; change this and import again:", mapping_lines),
        ("telemetry:", [_dirt_in_words(dirt) for dirt in check.dirt]),
        ("physical, no wrong convention:", check.remarks),
        ("this campaign cannot show (all of it with --json):", hidden),
    ):
        if lines:
            console.print(title)
            for line in lines:
                console.print(f"  - {line}")
    if check.verdict == "consistent":
        console.print("next: bayes-inertia fit CAMPAIGN -o RUN")


def _dirt_in_words(dirt: dict[str, Any]) -> str:
    """A record of dirt with its place and what is done, as `check` prints it."""
    where = ", ".join(str(dirt[key]) for key in ("slew", "channel") if dirt.get(key))
    return f"{dirt['kind']} ({where}): {dirt.get('note') or ''} [{dirt['treated']}]"
