"""`fit`: estimate J, K and active effects."""

from __future__ import annotations

from bayes_inertia.app.commands.options import (
    Anyway,
    AsStated,
    CampaignFolder,
    DriveName,
    EffectNames,
    OutputFolder,
    Seed,
    WithReport,
    names_in,
)


def fit_command(
    campaign: CampaignFolder,
    out: OutputFolder,
    effects: EffectNames = "",
    drive: DriveName = None,
    seed: Seed = 0,
    report: WithReport = True,
    anyway: Anyway = False,
    as_stated: AsStated = False,
) -> None:
    """Estimate J, K and active effects.

    Writes posterior.nc, summary.json and report.html.
    """
    from bayes_inertia.conventions.check import refuse_impossible

    # Before anything heavy is loaded: seconds against minutes.
    if not anyway:
        refuse_impossible(campaign)

    from bayes_inertia.app import run_folder
    from bayes_inertia.app.commands.run_result import finish_and_show
    from bayes_inertia.inference.sampler import Settings

    run_folder.start(
        campaign,
        out,
        effects=names_in(effects),
        drive=drive,
        settings=Settings(seed=seed),
        as_stated=as_stated,
    )
    finish_and_show(out, report)
