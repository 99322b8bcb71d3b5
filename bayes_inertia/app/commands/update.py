"""`update`: what a former result knows of J and K, and a new campaign, together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_inertia.app.commands.fit import fit_command
from bayes_inertia.app.commands.options import (
    Anyway,
    AsJson,
    CampaignFolder,
    DriveName,
    EffectNames,
    Inflate,
    OpenPage,
    OutputFolder,
    Seed,
    WithReport,
)

FormerRun = Annotated[
    Path, typer.Argument(help="Folder of a finished run that is trusted, of `fit` or `update`.")
]


def update_command(
    run: FormerRun,
    campaign: CampaignFolder,
    out: OutputFolder,
    inflate: Inflate = 0.0,
    effects: EffectNames = "",
    drive: DriveName = None,
    seed: Seed = 0,
    report: WithReport = True,
    open_page: OpenPage = False,
    anyway: Anyway = False,
    as_json: AsJson = False,
) -> None:
    """Add a campaign to a former result, as if both were fitted together.

    The former posterior of J and K is the prior; rate bias, start states and effects of each
    campaign are its own. Writes what `fit` writes.
    """
    fit_command(
        campaign,
        out,
        effects=effects,
        drive=drive,
        seed=seed,
        report=report,
        open_page=open_page,
        anyway=anyway,
        prior=run,
        inflate=inflate,
        as_json=as_json,
    )
