"""`fit`: estimate J, K and active effects."""

from __future__ import annotations

from bayes_inertia.app.commands.options import (
    Anyway,
    AsJson,
    AsStated,
    CampaignFolder,
    DriveName,
    EffectNames,
    Inflate,
    NoiseOfChannel,
    OpenPage,
    OutputFolder,
    PriorRun,
    Remainder,
    SampledNoise,
    Seed,
    WithReport,
    names_in,
)
from bayes_inertia.app.terminal import progress_bar


def fit_command(
    campaign: CampaignFolder,
    out: OutputFolder,
    effects: EffectNames = "",
    drive: DriveName = None,
    seed: Seed = 0,
    report: WithReport = True,
    open_page: OpenPage = False,
    anyway: Anyway = False,
    as_stated: AsStated = False,
    noise: NoiseOfChannel = None,
    sample_noise: SampledNoise = "",
    remainder: Remainder = None,
    prior: PriorRun = None,
    inflate: Inflate = 0.0,
    as_json: AsJson = False,
) -> None:
    """Estimate J, K and active effects.

    Writes posterior.nc, summary.json and report.html.
    """
    from bayes_inertia.app.commands.doctor import refuse_or_warn
    from bayes_inertia.app.commands.run_result import show_run

    with progress_bar() as progress:
        # Before anything heavy is loaded: seconds against minutes.
        if not anyway:
            refuse_or_warn(campaign, progress, names_in(effects))

        from bayes_inertia.app import run_folder
        from bayes_inertia.campaign.prior import prior_in
        from bayes_inertia.inference.settings import usual_settings
        from bayes_inertia.physics.channel_noise import noise_model_from_text
        from bayes_inertia.physics.named_effects import effects_named, remainders

        names = [*names_in(effects), *(effect.name for effect in remainders(remainder))]
        run_folder.start(
            campaign,
            out,
            effects=names,
            drive=drive,
            settings=usual_settings(effects_named(names), seed=seed),
            as_stated=as_stated,
            noise=noise_model_from_text(noise or [], names_in(sample_noise)),
            prior=None if prior is None else prior_in(prior).inflated(inflate),
        )
        posterior = run_folder.finish(out, report=report, progress=progress)
    show_run(posterior, out, report, as_json=as_json, open_page=open_page)
