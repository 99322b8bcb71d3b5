"""`doctor`: is this installation sound; and are a campaign's conventions those of its data?"""

from __future__ import annotations

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
    if as_json:
        print_json(check.json())
    else:
        show_check(check)
    if check.verdict == "wrong":
        raise typer.Exit(2)


def show_check(check: ConventionsCheck) -> None:
    """Print a check for people.

    Parameters
    ----------
    check : ConventionsCheck
        What was found.
    """
    from bayes_inertia.conventions.invisible import invisible_in_brief

    console = plain_console()
    hidden = invisible_in_brief(check.cannot_show)
    style = "bold red" if check.verdict == "wrong" else "bold"
    console.print(headed(f"{check.campaign}: {check.verdict}", style=style))
    console.print(check.sentence)
    for title, lines in (
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
