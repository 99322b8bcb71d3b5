"""`diagnose`: find which physical effect is missing."""

from __future__ import annotations

from bayes_inertia.app.commands.options import (
    Anyway,
    AsJson,
    AsStated,
    CampaignFolder,
    DriveName,
    FurtherCandidates,
    OpenPage,
    OutputFolder,
    Seed,
    WithReport,
    names_in,
)
from bayes_inertia.app.terminal import progress_bar


def diagnose_command(
    campaign: CampaignFolder,
    out: OutputFolder,
    effects: FurtherCandidates = "",
    drive: DriveName = None,
    seed: Seed = 0,
    report: WithReport = True,
    open_page: OpenPage = False,
    anyway: Anyway = False,
    as_stated: AsStated = False,
    as_json: AsJson = False,
) -> None:
    """Find which physical effect is missing, and fit it along.

    Writes diagnosis.json, then what `fit` writes.
    """
    from dataclasses import replace

    from bayes_inertia.app.commands.doctor import refuse_or_warn
    from bayes_inertia.app.commands.run_result import show_run

    with progress_bar() as progress:
        # Before anything heavy is loaded: seconds against minutes.
        if not anyway:
            refuse_or_warn(campaign, progress, names_in(effects))

        from bayes_inertia.app import run_folder
        from bayes_inertia.inference.settings import STOCHASTIC_SETTINGS

        run_folder.start(
            campaign,
            out,
            effects=names_in(effects),
            drive=drive,
            settings=replace(STOCHASTIC_SETTINGS, seed=seed),
            kind="diagnose",
            as_stated=as_stated,
        )
        posterior = run_folder.finish(out, report=report, progress=progress)
    show_run(posterior, out, report, as_json=as_json, open_page=open_page)
