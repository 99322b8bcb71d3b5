"""A run folder: everything a fit needs to go on after a kill, and everything it found.

`RUN/run.json` (what is fitted, with which seed), `RUN/campaign/` (a copy of the telemetry),
`RUN/chains/` (emcee's HDF5 chains, growing), and when done `posterior.nc`, `summary.json`, `report.html`.
A diagnosis first writes `diagnosis.json`; what it names is then fitted in full.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from bayes_inertia import __version__
from bayes_inertia.app.diagnose_campaign import investigated
from bayes_inertia.app.diagnosis_json import alternatives_of, effects_of
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import campaign_sha256, copy_campaign, read_campaign
from bayes_inertia.diagnosis.model_averaging import averaged
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.files import check_folder, write_atomically
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.sampler import Progress, Settings
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.simulator import Drive
from bayes_inertia.report import Section, diagnosis_sections, standard_sections, write_report

FORMAT = "bayes-inertia-run/1"


@dataclass(frozen=True)
class Run:
    """What a run folder fits: `campaign_sha256`, names of the `effects`, `drive`, sampler `settings` (seed included); of the
    `kind` "diagnose" it fits what its diagnosis names."""

    campaign_sha256: str
    effects: tuple[str, ...]
    drive: Drive | None
    settings: Settings
    kind: Literal["fit", "diagnose"] = "fit"

    def to_json(self) -> str:
        """The content of run.json."""
        content = {
            "format": FORMAT,
            "version": __version__,
            **asdict(self),
            "effects": list(self.effects),
        }
        return json.dumps(content, indent=1) + "\n"


def read_run(folder: Path) -> Run:
    """The run that a folder holds; CampaignError if it holds none."""
    path = folder / "run.json"
    if not path.is_file():
        raise CampaignError(
            "no run here", where=str(path), advice="give the folder that `fit -o` wrote"
        )
    try:
        content = json.loads(path.read_text())
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']!r}")
        return Run(
            content["campaign_sha256"],
            tuple(content["effects"]),
            content["drive"],
            Settings(**content["settings"]),
            content.get("kind", "fit"),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise CampaignError(
            f"not a run description ({error})",
            where=str(path),
            advice="start a new run in another folder",
        ) from error


def start(
    campaign: Path,
    folder: Path,
    *,
    effects: Sequence[str] = (),
    drive: Drive | None = None,
    settings: Settings | None = None,
    kind: Literal["fit", "diagnose"] = "fit",
) -> Run:
    """Begin a run in a folder, or find the same run there (then it goes on).

    Raises
    ------
    CampaignError, EffectError : the campaign, an effect's name, or an effect or drive with this campaign is no good (nothing is written).
    OutputError : the folder holds another run, or files that a run would overwrite.
    """
    Model(read_campaign(campaign), by_name(effects), drive)
    run = Run(campaign_sha256(campaign), tuple(effects), drive, settings or Settings(), kind)
    check_folder(folder)
    if (folder / "run.json").is_file():
        _same_or_error(folder, read_run(folder), run)
        return run
    taken = [
        name
        for name in ("posterior.nc", "summary.json", "diagnosis.json", "report.html", "chains")
        if (folder / name).exists()
    ]
    if taken:
        raise OutputError(
            f"{taken[0]} is there already, without a run.json",
            where=str(folder),
            advice="choose an empty folder",
        )
    copy_campaign(campaign, folder / "campaign")  # goes on with what a kill left of the same copy
    write_atomically(folder / "run.json", run.to_json())
    return run


def _same_or_error(folder: Path, there: Run, wanted: Run) -> None:
    if there.campaign_sha256 != wanted.campaign_sha256:
        raise OutputError(
            "holds a run of other data",
            where=str(folder),
            advice="choose another folder; nothing was overwritten",
        )
    if there != wanted:
        differs = [key for key, value in asdict(wanted).items() if asdict(there)[key] != value]
        advice = (
            "choose another folder, or go on with `bayes-inertia resume`; nothing was overwritten"
        )
        raise OutputError(
            f"holds a run with other {', '.join(differs)}", where=str(folder), advice=advice
        )


def finish(folder: Path, *, report: bool = True, progress: Progress | None = None) -> Posterior:
    """Bring a run to its end: optimize, sample (going on where its chains end), write all results.

    Raises
    ------
    CampaignError : the folder holds no run, or its copy of the campaign was changed.
    """
    run = read_run(folder)
    if campaign_sha256(folder / "campaign") != run.campaign_sha256:
        raise CampaignError(
            "the run's copy of the campaign was changed",
            where=str(folder / "campaign"),
            advice="start a new run",
        )
    campaign, effects, about, others = (
        read_campaign(folder / "campaign"),
        by_name(run.effects),
        {},
        (),
    )
    if run.kind == "diagnose":
        content = _diagnosed(folder, campaign, run, progress)
        effects, about, others = (
            effects_of(content),
            {"verdict": content["verdict"]},
            alternatives_of(content),
        )
        if content["verdict"] != "unknown":
            campaign = with_measured_noise(campaign, content["noise"], content["drive"])
            about["noise"] = content["noise"]
    seed = run.settings.seed
    posterior = fit(
        campaign,
        effects=effects,
        drive=run.drive,
        seed=seed,
        settings=run.settings,
        chains=folder / "chains",
        about={"campaign_sha256": run.campaign_sha256} | about,
        progress=progress,
    )
    posterior = averaged(posterior, others, seed)
    posterior.save(folder / "posterior.nc")
    write_atomically(
        folder / "summary.json", json.dumps(posterior.summary(), indent=1, allow_nan=False) + "\n"
    )
    if report:
        if progress:
            progress("writing the report", 0, 1)
        write_report(posterior, folder / "report.html", sections(posterior, folder))
    return posterior


def sections(posterior: Posterior, folder: Path) -> list[Section]:
    """The sections of a run's report: of its diagnosis, if it has one, then of its fit."""
    content = read_diagnosis(folder)
    return ([] if content is None else diagnosis_sections(content)) + standard_sections(posterior)


def read_diagnosis(folder: Path) -> dict[str, Any] | None:
    """The content of a run's diagnosis.json, None if it has none; CampaignError if it cannot be read."""
    path = folder / "diagnosis.json"
    if not path.is_file():
        return None
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise CampaignError(
            f"not a diagnosis ({error})",
            where=str(path),
            advice="delete it and run `bayes-inertia resume`",
        ) from error


def _diagnosed(
    folder: Path, campaign: Campaign, run: Run, progress: Progress | None
) -> dict[str, Any]:
    """The run's diagnosis, made now unless it was made before the run was interrupted."""
    done = read_diagnosis(folder)
    if done is not None:
        return done
    if progress:
        progress("diagnosing", 0, 1)
    content = investigated(campaign, run.drive, run.settings.seed)
    write_atomically(
        folder / "diagnosis.json",
        json.dumps(content, indent=None, separators=(", ", ": "), allow_nan=False) + "\n",
    )
    return content


def with_measured_noise(
    campaign: Campaign, factors: dict[str, float], drive: Drive = "commanded"
) -> Campaign:
    """The campaign with each sensor's sigma multiplied by what a diagnosis measured of it.

    In the measured drive tachometers have no channel of their own: their noise is in that of the rate sensor, and grows with it.
    """
    factors = factors if drive == "commanded" else factors | {"momentum": factors["rate"]}
    sensor, tracker = campaign.rate_sensor, campaign.star_tracker
    louder = replace(sensor, sigma=tuple(factors["rate"] * s for s in sensor.sigma))
    wheels = tuple(
        replace(w, momentum_sigma=w.momentum_sigma and factors["momentum"] * w.momentum_sigma)
        for w in campaign.wheels
    )
    if tracker is not None:
        tracker = replace(
            tracker,
            sigma_cross=factors["attitude"] * tracker.sigma_cross,
            sigma_roll=factors["attitude"] * tracker.sigma_roll,
        )
    return replace(campaign, rate_sensor=louder, wheels=wheels, star_tracker=tracker)


def with_seed(settings: Settings, seed: int) -> Settings:
    """The same settings with another seed.

    >>> with_seed(Settings(), 7).seed
    7
    """
    return replace(settings, seed=seed)
