"""`fit`: estimate J, K and active effects."""

from __future__ import annotations

from dataclasses import replace

from bayes_inertia.app.commands.options import (
    Anyway,
    AsJson,
    AsStated,
    CampaignFolder,
    DriveName,
    EffectNames,
    NoiseOfChannel,
    OutputFolder,
    Remainder,
    SampledNoise,
    Seed,
    WithReport,
    names_in,
)

_REMAINDERS: dict[str | None, tuple[str, ...]] = {
    None: (),
    "torque": ("torque_remainder",),
    "rate": ("rate_remainder",),
    "both": ("torque_remainder", "rate_remainder"),
}


def fit_command(
    campaign: CampaignFolder,
    out: OutputFolder,
    effects: EffectNames = "",
    drive: DriveName = None,
    seed: Seed = 0,
    report: WithReport = True,
    anyway: Anyway = False,
    as_stated: AsStated = False,
    noise: NoiseOfChannel = None,
    sample_noise: SampledNoise = "",
    remainder: Remainder = None,
    as_json: AsJson = False,
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
    from bayes_inertia.inference.settings import STOCHASTIC_SETTINGS, Settings
    from bayes_inertia.physics.channel_noise import noise_model_from_text

    run_folder.start(
        campaign,
        out,
        effects=[*names_in(effects), *_REMAINDERS[remainder]],
        drive=drive,
        settings=replace(STOCHASTIC_SETTINGS if remainder else Settings(), seed=seed),
        as_stated=as_stated,
        noise=noise_model_from_text(noise or [], names_in(sample_noise)),
    )
    finish_and_show(out, report, as_json)
