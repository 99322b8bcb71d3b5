"""Everything that a diagnosis has to say of a campaign: where, which, how much it changes, what to fly next, what stays unknown."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from bayes_inertia.app.diagnosis_json import to_json
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.correction_slew import correction_forecast
from bayes_inertia.design.separating_slew import Separation, separating_slew
from bayes_inertia.diagnosis.blind_spots import undetected
from bayes_inertia.diagnosis.model_averaging import alternatives
from bayes_inertia.diagnosis.residual_scan import disagreement
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.diagnosis.unexplained import unknown_torque
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.simulator import Drive


def investigated(campaign: Campaign, drive: Drive | None = None, seed: int = 0) -> dict[str, Any]:
    """The content of diagnosis.json for a campaign.

    Raises
    ------
    CampaignError, EstimateError : as `diagnose`.
    """
    found = diagnose(campaign, drive=drive, seed=seed)
    before = disagreement(found.base, seed=seed)
    changed = bool(found.steps) or any(factor > 1.0 for factor in found.noise.values())
    after = disagreement(found.final, seed=seed, stated=False) if changed else None
    unknown = unknown_torque(found.base) if found.verdict == "unknown" else None
    correction = (
        correction_forecast(found.base, found.final, seed=seed)
        if found.steps and found.verdict != "unknown"
        else None
    )
    return to_json(
        found,
        before,
        after,
        unknown,
        correction,
        separating(found, seed),
        alternatives(found),
        undetected(found),
    )


def separating(found: Diagnosis, seed: int = 0) -> list[Separation]:
    """For every ambiguous set the slew that best tells its first two apart, where there is one."""
    instances, slews = {e.name: e for e in (*LIBRARY, *found.final.model.effects)}, []
    for first, second, *_ in found.ambiguous_with:
        with suppress(
            CampaignError, EffectError
        ):  # no feasible slew, or an effect with states of its own
            slews.append(
                separating_slew(found.final, instances[first], instances[second], seed=seed)
            )
    return slews
