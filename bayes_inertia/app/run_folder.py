"""A run folder: everything a fit needs to go on after a kill, and everything it gave.

`RUN/run.json` (what is fitted, with which seed), `RUN/campaign/` (a copy of the telemetry),
`RUN/chains/` (emcee's HDF5 chains, growing), and when done `posterior.nc`, `summary.json`,
`report.html`. A diagnosis first writes `diagnosis.json`; what it names is then fitted in full.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import PlainValidator, TypeAdapter, ValidationError

from bayes_inertia.app.diagnosed_fit import fit_after_diagnosis, investigate
from bayes_inertia.app.diagnosis_json import (
    DIAGNOSIS_FILE,
    blaming_diagnosis,
    next_fit_from,
    read_diagnosis,
    to_json,
)
from bayes_inertia.app.fit_campaign import fit, import_in_background
from bayes_inertia.app.result_folder import (
    GIVE_A_RUN,
    NEW_RUN,
    ResultFolder,
    origin,
    write_json,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.prior import GaussianPrior, prior_from_json
from bayes_inertia.campaign.reader import campaign_sha256, copy_campaign, read_campaign
from bayes_inertia.design.numerics import NUMERICS as DESIGN_NUMERICS
from bayes_inertia.errors import CampaignError, EffectError, SettingsError, require
from bayes_inertia.files import write_atomically
from bayes_inertia.folder_lock import working_in
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.settings import FitContext, Settings, require_settings, usual_settings
from bayes_inertia.physics.channel_noise import NoiseModel, noise_model_from_json
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named, pinned_names
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.progress import Progress, silent
from bayes_inertia.report.plan_promise import PlanPromise
from bayes_inertia.report.verdict import with_verdict_sentence
from bayes_inertia.sealing import SEAL_KEY, blaming, read_sealed_json, sealed
from bayes_inertia.version import __version__

FORMAT = "bayes-inertia-run/1"
_RESULT_FILES = ("posterior.nc", "summary.json", "diagnosis.json", "report.html", "chains")
# xarray asks dask's workers before it writes, where they are installed.
_WANTED_LATER = ("arviz_stats", "h5netcdf", "distributed")
_WANTED_BY_REPORT = ("bayes_inertia.report.fit_sections",)


# How they are read: a key that they do not know is an error.
_SettingsRead = Annotated[Settings, PlainValidator(lambda told: Settings(**told))]
_NoiseRead = Annotated[NoiseModel, PlainValidator(noise_model_from_json)]


@dataclass(frozen=True)
class Run:
    """Inputs of the fit of a run folder."""

    campaign_sha256: str  # digest of the campaign
    # Names of the effects to fit along; of a run of the kind "diagnose", of candidates beyond the
    # library.
    effects: tuple[str, ...]
    # What drives the model; None for the campaign's best.
    drive: Drive | None
    settings: _SettingsRead  # of the sampler, seed included
    # A run of the kind "diagnose" fits what its diagnosis names.
    kind: Literal["fit", "diagnose"] = "fit"
    # Take telemetry and noise as they are stated: no dirt is looked for in residuals.
    as_stated: bool = False
    # The noise of each channel, of a run of the kind "fit".
    noise: _NoiseRead = field(default_factory=NoiseModel)
    # J and K known before, as `GaussianPrior.json`; None for the campaign's own.
    prior: dict[str, Any] | None = None

    @property
    def options(self) -> dict[str, Any]:
        """What makes it this run and no other, beside the campaign."""
        told = asdict(self) | {"noise": self.noise.json()}
        return {key: value for key, value in told.items() if key != "campaign_sha256"}

    def owner(self, folder: Path) -> ResultFolder:
        """The claim of this run on a folder."""
        # What older versions left out of it is as in a run that does not ask for it.
        usual = Run(self.campaign_sha256, self.effects, self.drive, self.settings)
        claim = ("run", "run.json", FORMAT, self.campaign_sha256, self.options, _RESULT_FILES)
        return ResultFolder(folder, *claim, flat=True, defaults=usual.options)


def read_run(folder: Path) -> Run:
    """The run that a folder holds."""
    path = folder / "run.json"
    require(path.is_file(), str(path), "no run here", GIVE_A_RUN)
    content = read_sealed_json(path, NEW_RUN)
    try:
        if content.get("format") != FORMAT:
            raise ValueError(f"format {content.get('format')!r}")
        return TypeAdapter(Run).validate_json(json.dumps(content), strict=True)
    except (SettingsError, ValueError, TypeError) as error:
        reason = str(error)
        if isinstance(error, ValidationError):
            problem = error.errors()[0]
            reason = f"{problem['loc'][0]}: {problem['msg']}"
        what = reason if isinstance(error, SettingsError) else f"not a run description ({reason})"
        raise CampaignError(what, where=str(path), advice=NEW_RUN) from error


def start(
    campaign: Path,
    folder: Path,
    *,
    effects: Sequence[str] = (),
    drive: Drive | None = None,
    settings: Settings | None = None,
    kind: Literal["fit", "diagnose"] = "fit",
    as_stated: bool = False,
    noise: NoiseModel | None = None,
    prior: GaussianPrior | None = None,
) -> Run:
    """Begin a run in a folder, or find the same run there (then it goes on)."""
    names, noise = pinned_names(effects), noise or NoiseModel()
    settings = require_settings(settings, usual_settings(effects_named(names)))
    Model(_with_prior(read_campaign(campaign), prior), effects_named(names), drive, noise)
    known = None if prior is None else prior.json()
    digest = campaign_sha256(campaign)
    run = Run(digest, names, drive, settings, kind, as_stated, noise, known)
    owner = run.owner(folder)
    if not owner.holds_this_work():
        with working_in(folder):
            # The copy is part of the claim and goes on with what a kill left of the same copy:
            # where run.json is, it is complete.
            copy_campaign(campaign, folder / "campaign")
            owner.claim({"version": __version__, **origin(campaign)})
    return run


def _with_prior(campaign: Campaign, prior: GaussianPrior | None) -> Campaign:
    """The campaign with what is known of J and K before; None for its own."""
    return campaign if prior is None else replace(campaign, prior=prior)


def finish(folder: Path, *, report: bool = True, progress: Progress | None = None) -> Posterior:
    """Bring a run to its end: sample, going on where its chains end, and write all results."""
    run = read_run(folder)
    with working_in(folder):
        return _finish(folder, run, report, progress)


def _finish(folder: Path, run: Run, report: bool, progress: Progress | None) -> Posterior:
    copy = folder / "campaign"
    what = "the run's copy of the campaign was changed"
    require(campaign_sha256(copy) == run.campaign_sha256, str(copy), what, "start a new run")
    import_in_background([*_WANTED_LATER, *(_WANTED_BY_REPORT if report else ())])
    posterior = _posterior(folder, run, progress)
    posterior.save(folder / "posterior.nc")
    write_json(folder / "summary.json", run_summary(posterior, folder))
    if report:
        (progress or silent)("writing the report", 0, 0)
        write_atomically(folder / "report.html", run_page(posterior, folder, intact=True))
    return posterior


def _posterior(folder: Path, run: Run, progress: Progress | None) -> Posterior:
    """Posterior of the effects that the run names, or that its diagnosis does."""
    campaign = campaign_of_run(folder, run)
    asked: dict[str, Any] = {
        "drive": run.drive,
        "settings": run.settings,
        "chains": folder / "chains",
        "as_stated": run.as_stated,
        "progress": progress,
    }
    if run.kind == "diagnose":
        content = _diagnosed(folder, campaign, run, progress)
        # Always from the file's content, so that a run that was killed gives the same bits.
        with blaming_diagnosis(folder, content):
            choice = next_fit_from(content, _candidates(folder, run))
        return fit_after_diagnosis(campaign, choice, campaign_sha256=run.campaign_sha256, **asked)
    effects, context = effects_of_run(folder, run), FitContext(run.campaign_sha256)
    return fit(campaign, effects=effects, context=context, noise=run.noise, **asked)


def campaign_of_run(folder: Path, run: Run) -> Campaign:
    """The campaign that a run fits, with the former result that is its prior."""
    known = None if run.prior is None else prior_from_json(run.prior, str(folder / "run.json"))
    return _with_prior(read_campaign(folder / "campaign"), known)


def _diagnosed(
    folder: Path, campaign: Campaign, run: Run, progress: Progress | None
) -> dict[str, Any]:
    """The run's diagnosis, made now unless it was made before the run was interrupted."""
    stored = read_diagnosis(folder)
    if stored is not None:
        return stored
    investigation = investigate(
        campaign,
        drive=run.drive,
        seed=run.settings.seed,
        library=_candidates(folder, run),
        as_stated=run.as_stated,
        progress=progress,
    )
    content = sealed(to_json(investigation))
    text = json.dumps(content, indent=None, separators=(", ", ": "), allow_nan=False)
    write_atomically(folder / DIAGNOSIS_FILE, text + "\n")
    return content


def effects_of_run(folder: Path, run: Run) -> tuple[Effect, ...]:
    """The effects that a run names."""
    try:
        return effects_named(run.effects)
    except EffectError as error:
        raise error.inside(str(folder / "run.json")) from error


def _candidates(folder: Path, run: Run) -> tuple[Effect, ...]:
    """Candidates of a diagnosis: the library, and what the run names beyond it or with settings."""
    further = tuple(e for e in effects_of_run(folder, run) if e not in LIBRARY)
    named = {effect.name for effect in further}
    return (*(effect for effect in LIBRARY if effect.name not in named), *further)


def run_summary(posterior: Posterior, folder: Path) -> dict[str, Any]:
    """The content of a run's summary.json."""
    content = read_diagnosis(folder)
    if content is None:
        return with_verdict_sentence(posterior.summary())
    with blaming_diagnosis(folder, content):
        return with_verdict_sentence(posterior.summary(), content)


def run_page(
    posterior: Posterior, folder: Path, *, intact: bool, promise: PlanPromise | None = None
) -> str:
    """The report of a run: of its fit, and of its diagnosis if it has one."""
    # Plots take half a second to load: not before sampling.
    from bayes_inertia.report.fit_sections import standard_sections
    from bayes_inertia.report.page import render
    from bayes_inertia.report.plan_promise import plan_promise_section

    content = read_diagnosis(folder)
    sealed_diagnosis = content is None or SEAL_KEY in content
    with blaming(folder, intact=intact and sealed_diagnosis, advice=NEW_RUN):
        sections = standard_sections(posterior, content, _forecast(posterior, folder))
        if promise is not None:
            # Behind result, reasons and parameters.
            sections.insert(3, plan_promise_section(promise))
        return render(posterior, sections, _origin(folder))


def _origin(folder: Path) -> dict[str, str]:
    """Date and data of the run, as far as it states them."""
    path = folder / "run.json"
    claim = read_sealed_json(path, NEW_RUN) if path.is_file() else {}
    return {key: str(claim[key]) for key in ("date", "data") if key in claim}


def _forecast(posterior: Posterior, folder: Path) -> dict[str, Any] | None:
    """The error of the next slew, of a result that may be used and whose campaign is at hand."""
    from bayes_inertia.app.export_run import forecast_of

    copy = folder / "campaign"
    digest = posterior.attributes.get("campaign_sha256")
    told = posterior.trusted and copy.is_dir() and campaign_sha256(copy) == digest
    forecast = forecast_of(posterior, read_campaign(copy)) if told else None
    if forecast is None:
        return None
    return asdict(forecast) | {"angle_deg": DESIGN_NUMERICS.corrected_turn_deg}
