"""One call from a campaign to its posterior."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from threading import Thread
from time import perf_counter

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.flexible_mode_search import with_ringing
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior import Posterior, build
from bayes_inertia.inference.sampler import Progress, Settings, sample
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.simulator import Drive


def fit(
    campaign: Campaign,
    *,
    effects: Sequence[Effect] = (),
    drive: Drive | None = None,
    seed: int = 0,
    settings: Settings | None = None,
    chains: Path | None = None,
    about: dict | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Estimate J, K and the parameters of active effects, and sample their posterior.

    Parameters
    ----------
    effects : physical effects to fit along. drive : see `Model`. seed : fixes everything.
    settings : of the sampler; its seed is replaced by `seed`.
    chains : folder in which the chains are kept while they grow (a killed run goes on there).
    about : further attributes of the result. progress : called with (what, done, of).

    Raises
    ------
    CampaignError, EffectError, EstimateError : see `Model` and `estimate`.
    """
    began = perf_counter()
    # ArviZ takes seconds to import; it can do so while the compiler, which needs no interpreter lock, works.
    Thread(target=import_module, args=("arviz",), daemon=True).start()
    settings = Settings(**{**(settings or Settings()).__dict__, "seed": seed})
    if progress:
        progress("optimizing", 0, 1)
    model = Model(campaign, tuple(effects), drive)
    at = with_ringing(estimate(model, seed=seed))
    found = sample(at, settings, folder=chains, progress=progress)
    about = {"campaign": campaign.name, "seed": seed, "campaign_sha256": None} | (about or {})
    posterior = build(at, found, about, seed)
    return _with_seconds(posterior, perf_counter() - began)


def _with_seconds(posterior: Posterior, seconds: float) -> Posterior:
    import json

    attributes = posterior.attributes
    attributes["diagnostics"]["seconds"] = seconds
    posterior.tree.attrs["bayes_inertia"] = json.dumps(attributes)
    return posterior
