"""`observe`: estimate a campaign and write what it tells about each parameter, as observability.json and a picture."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.errors import OutputError
from bayes_inertia.files import check_folder, make_folder, write_atomically
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.observability.against_posterior import (
    Comparison,
    as_json,
    compare_with_posterior,
)
from bayes_inertia.observability.analysis import observe
from bayes_inertia.observability.result import FORMAT, Observability
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.simulator import Drive
from bayes_inertia.report.pictures.observability import observability as picture

FILE, PICTURE = "observability.json", "observability.png"


@dataclass(frozen=True)
class Observed:
    """What `observe` found: `found`, and `comparison` with the posterior of the same fit where the folder has one (else None)."""

    found: Observability
    comparison: tuple[Comparison, ...] | None


def observe_campaign(
    campaign: Path,
    folder: Path,
    *,
    effects: Sequence[str] = (),
    drive: Drive | None = None,
    seed: int = 0,
    both_drives: bool = True,
) -> Observed:
    """Estimate, ask what is observable, and write observability.json and observability.png.

    Parameters
    ----------
    campaign : its folder. folder : where to write; a posterior.nc of the same data, effects and drive there is compared.
    both_drives : also estimate in the other drive where the campaign allows it, to see what the commands are worth.

    Raises
    ------
    CampaignError, EffectError : bad input (nothing is written).
    OutputError : the folder holds results of another campaign.
    """
    flown, chosen = read_campaign(campaign), by_name(effects)
    digest = campaign_sha256(campaign)
    _ours_or_error(folder, digest)
    at = estimate(Model(flown, chosen, drive), seed=seed)
    found = observe(at, _other(flown, at, seed) if both_drives else None)
    comparison = _comparison(found, folder, digest)
    make_folder(folder)
    content = found.to_json() | {
        "campaign_sha256": digest,
        "seed": seed,
        "posterior": None if comparison is None else as_json(comparison),
    }
    write_atomically(folder / FILE, json.dumps(content, indent=1, allow_nan=False) + "\n")
    write_atomically(
        folder / PICTURE,
        lambda path: picture(found).savefig(
            path, format="png", dpi=130, metadata={"Software": None}
        ),
    )
    return Observed(found, comparison)


def _other(campaign: Campaign, at: Estimate, seed: int) -> Estimate | None:
    """The same estimated in the other drive; None where the campaign has not both."""
    if not (campaign.has_commands and campaign.has_tachometers):
        return None
    other = "measured" if at.model.structure.drive == "commanded" else "commanded"
    return estimate(Model(campaign, at.model.effects, other), seed=seed, start=at.theta)


def _ours_or_error(folder: Path, digest: str) -> None:
    check_folder(folder)
    if (folder / PICTURE).exists() and not (folder / FILE).exists():
        raise OutputError(
            f"{PICTURE} is there already, without {FILE}",
            where=str(folder),
            advice="choose another folder; nothing was overwritten",
        )
    for name, form in (("run.json", None), (FILE, FORMAT)):
        path = folder / name
        if not path.exists():
            continue
        try:
            there = json.loads(path.read_text())
            same, known = (
                there.get("campaign_sha256") == digest,
                form is None or there.get("format") == form,
            )
        except (ValueError, OSError, AttributeError):
            same, known = False, False
        if not known:
            raise OutputError(
                f"{name} there was not written by this command",
                where=str(folder),
                advice="choose another folder; nothing was overwritten",
            )
        if not same:
            raise OutputError(
                "holds results of other data",
                where=str(folder),
                advice="choose another folder; nothing was overwritten",
            )


def _comparison(found: Observability, folder: Path, digest: str) -> tuple[Comparison, ...] | None:
    path = folder / "posterior.nc"
    if not path.is_file():
        return None
    posterior = Posterior.load(path)
    about = posterior.attributes
    if (
        about.get("campaign_sha256") != digest
        or about["drive"] != found.drive
        or posterior.names != list(found.names)
    ):
        return None
    return compare_with_posterior(found, posterior)
