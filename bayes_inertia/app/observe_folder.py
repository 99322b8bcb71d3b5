"""`observe` on a folder: estimate a campaign and write what it tells about each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_inertia.app.fit_campaign import settled_estimate
from bayes_inertia.app.result_folder import ResultFolder
from bayes_inertia.app.run_folder import FORMAT as RUN_FORMAT
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.observability.against_posterior import (
    PosteriorComparison,
    compare_with_posterior,
    comparison_json,
)
from bayes_inertia.observability.analysis import observe
from bayes_inertia.observability.observability_json import FORMAT, observability_json
from bayes_inertia.observability.result import Observability
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named, pinned_names
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.progress import Progress, silent
from bayes_inertia.report.observability_sections import observability_sections
from bayes_inertia.sealing import blaming, is_sealed

FILE, PICTURE, PAGE = "observability.json", "observability.png", "observability.html"


@dataclass(frozen=True)
class ObservedCampaign:
    """Result of `observe` on a folder."""

    observability: Observability  # what the campaign tells about each parameter
    # With the posterior of the same fit; None where the folder has none.
    comparison: tuple[PosteriorComparison, ...] | None


def run_observe(
    campaign: Path,
    folder: Path,
    *,
    effects: Sequence[str] = (),
    drive: Drive | None = None,
    seed: int = 0,
    both_drives: bool = True,
    progress: Progress = silent,
) -> ObservedCampaign:
    """Estimate, ask what is observable, and write observability.json, .png and .html."""
    flown, names = read_campaign(campaign), pinned_names(effects)
    instances = effects_named(names)
    digest = campaign_sha256(campaign)
    options = {"effects": names, "drive": drive, "seed": seed, "both_drives": both_drives}
    owner = ResultFolder(folder, "result", FILE, FORMAT, digest, options, (PICTURE, PAGE))
    owner.holds_this_work()
    if (folder / "run.json").exists():
        ResultFolder(folder, "run", "run.json", RUN_FORMAT, digest, flat=True).holds_this_work()
    progress("fitting", 0, 0)
    # As `fit` does: what is asked is asked of the same estimate.
    estimate, _ = settled_estimate(Model(flown, instances, drive), seed, False, progress)
    progress("fitting in the other drive", 0, 0)
    other_drive = _in_other_drive(estimate, seed) if both_drives else None
    progress("asking each slew what it tells", 0, 0)
    observability = observe(estimate, other_drive)
    comparison = _comparison(observability, folder, digest)
    rows = None if comparison is None else comparison_json(comparison)
    progress("drawing", 0, 0)
    content = observability_json(observability) | {"seed": seed, "posterior": rows}
    sections = observability_sections(observability, comparison)
    title = f"Observability of {flown.name}"
    owner.write(content, title, sections, campaign, mission=flown.mission)
    return ObservedCampaign(observability, comparison)


def _in_other_drive(estimate: Estimate, seed: int) -> Estimate | None:
    """The same estimated in the other drive; None where the campaign has not both."""
    model = estimate.model
    if not (model.campaign.has_commands and model.campaign.has_tachometers):
        return None
    drive: Drive = "measured" if model.structure.drive == "commanded" else "commanded"
    return optimizer.estimate(
        Model(model.campaign, model.effects, drive), seed=seed, start=estimate.theta
    )


def _comparison(
    observability: Observability, folder: Path, digest: str
) -> tuple[PosteriorComparison, ...] | None:
    path = folder / "posterior.nc"
    if not path.is_file():
        return None
    posterior, advice = Posterior.load(path), "write it again with `bayes-inertia resume`"
    with blaming(path, intact=is_sealed(path, advice), advice=advice):
        attributes, priors = posterior.attributes, [p.prior_sd for p in observability.parameters]
        same = (
            attributes.get("campaign_sha256") == digest
            and attributes["drive"] == observability.drive
            and posterior.names == list(observability.names)
            and np.allclose(posterior.tree["estimate"]["prior_sd"], priors, rtol=1e-6)
        )
        return compare_with_posterior(observability, posterior) if same else None
