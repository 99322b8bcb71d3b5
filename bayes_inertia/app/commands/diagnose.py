"""`diagnose`: find which physical effect is missing."""

from __future__ import annotations

from bayes_inertia.app.commands.options import (
    Anyway,
    AsJson,
    AsStated,
    CampaignFolder,
    DriveName,
    FurtherCandidates,
    OutputFolder,
    Seed,
    WithReport,
    names_in,
)


def diagnose_command(
    campaign: CampaignFolder,
    out: OutputFolder,
    effects: FurtherCandidates = "",
    drive: DriveName = None,
    seed: Seed = 0,
    report: WithReport = True,
    anyway: Anyway = False,
    as_stated: AsStated = False,
    as_json: AsJson = False,
) -> None:
    """Find which physical effect is missing, and fit it along.

    Writes diagnosis.json, then what `fit` writes.
    """
    from dataclasses import replace

    from bayes_inertia.app.commands.doctor import refuse_or_warn

    # Before anything heavy is loaded: seconds against minutes.
    if not anyway:
        refuse_or_warn(campaign)

    from bayes_inertia.app import run_folder
    from bayes_inertia.app.commands.run_result import finish_and_show
    from bayes_inertia.app.diagnosed_fit import DIAGNOSED_SETTINGS

    settings = replace(DIAGNOSED_SETTINGS, seed=seed)
    run_folder.start(
        campaign,
        out,
        effects=names_in(effects),
        drive=drive,
        settings=settings,
        kind="diagnose",
        as_stated=as_stated,
    )
    finish_and_show(out, report, as_json)
