"""The tables of a diagnosis as plain numbers: candidates, steps, how far J and K move."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.diagnosis.residuals import held_out_chi2
from bayes_inertia.diagnosis.result import Candidate, Diagnosis, Step
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.physics.parameters import N_BASE

_REASON_INVISIBLE = (
    "invisible: an effect of the size of its prior would change the telemetry "
    "by less than its noise"
)


def candidate_rows(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Every candidate of the library: those that were scored, best evidence first, then the others.

    `diagnosis`: with its candidates, what was skipped, and the noise. Returns: {effect, dof, score,
    p_value, log_bayes_factor, parameters, reason} of each.
    """
    added = {step.added for step in diagnosis.steps}
    rows = [_scored(c, diagnosis.final, c.effect in added) for c in diagnosis.candidates]
    scored = {row["effect"] for row in rows}
    rows += [_unscored(name, reason) for name, reason in diagnosis.skipped]
    without = [e.name for e in diagnosis.base.model.effects if e.name not in scored]
    rows += [_unscored(name, "has no parameters in this campaign") for name in without]
    louder = {channel: factor for channel, factor in diagnosis.noise.items() if factor > 1.0}
    return [*rows, _unscored("noise_level", _noise_text(louder))]


def _scored(candidate: Candidate, final: Estimate, added: bool) -> dict[str, Any]:
    return {
        "effect": candidate.effect,
        "dof": candidate.dof,
        "score": candidate.score,
        "p_value": candidate.p_value,
        "log_bayes_factor": candidate.log_bayes_factor,
        "parameters": parameter_rows(final, candidate.effect) if added else None,
        "reason": None if candidate.dof else _REASON_INVISIBLE,
    }


def _unscored(name: str, reason: str) -> dict[str, Any]:
    return {
        "effect": name,
        "dof": 0,
        "score": None,
        "p_value": None,
        "log_bayes_factor": None,
        "parameters": None,
        "reason": reason,
    }


def _noise_text(louder: dict[str, float]) -> str:
    if not louder:
        return "measured by itself: the white noise is not significantly larger than stated"
    return "measured by itself: " + ", ".join(
        f"the noise of the {channel} channel is {factor:.2f} times what is stated"
        for channel, factor in louder.items()
    )


def parameter_rows(estimate: Estimate, effect: str) -> dict[str, dict[str, Any]] | None:
    """The parameters of an effect as fitted.

    Returns: {parameter: {mean, sd, q025, q975, unit}}; None if the effect is not fitted.
    """
    space = estimate.model.space
    part = space.slice_of(effect)
    fitted = np.isin(np.arange(part.start, part.stop), estimate.free).all()
    if part.stop == part.start or not fitted:
        return None
    rows = {}
    for i in range(part.start, part.stop):
        mean, sd = float(estimate.theta[i]), float(estimate.sd[i])
        low, high = (
            float(np.clip(mean + z * sd, space.lower[i], space.upper[i]))
            for z in (-LAYOUT.quantile_95, LAYOUT.quantile_95)
        )
        rows[space.names[i].split(".", 1)[1]] = {
            "mean": mean,
            "sd": sd,
            "q025": low,
            "q975": high,
            "unit": space.units[i],
        }
    return rows


def step_row(step: Step) -> dict[str, Any]:
    """One effect added: what it changed, and what would explain the data as well."""
    return {
        "added": step.added,
        "log_bayes_factor": step.log_bayes_factor,
        "alternatives": [
            {
                "effect": other.effect,
                "correlation": other.correlation,
            }
            for other in step.alternatives
        ],
        "reduced_chi2_before": {key: t.reduced_chi2 for key, t in step.before.tests.items()},
        "reduced_chi2_after": {key: t.reduced_chi2 for key, t in step.after.tests.items()},
        "held_out_before": held_out_chi2(step.before),
        "held_out_after": held_out_chi2(step.after),
        "shift": shift_rows(step.before, step.after),
        "share": share_explained(step),
    }


def share_explained(step: Step) -> float:
    """The share of the misfit before a step that it explains, 0 to 1: of chi^2 beyond its dof."""
    before, after = (t.tests["total"].reduced_chi2 for t in (step.before, step.after))
    if before is None or after is None or before <= 1.0:
        return 0.0
    return float(np.clip((before - after) / (before - 1.0), 0.0, 1.0))


def shift_rows(before: Estimate, after: Estimate) -> dict[str, dict[str, Any]]:
    """Shifts of J and K from one fit to another.

    Returns: {name: {before, sd_before, after, sd_after, shift, unit}} of the nine.
    """
    space = before.model.space
    return {
        space.names[i]: {
            "before": float(before.theta[i]),
            "sd_before": float(before.sd[i]),
            "after": float(after.theta[i]),
            "sd_after": float(after.sd[i]),
            "shift": float(after.theta[i] - before.theta[i]),
            "unit": space.units[i],
        }
        for i in range(N_BASE)
    }


def alike_pairs(diagnosis: Diagnosis, limit: float) -> list[tuple[tuple[str, str], float]]:
    """Pairs of candidates that this campaign hardly tells apart, most alike first."""
    return sorted(
        ((pair, r) for pair, r in diagnosis.correlations.items() if r > limit),
        key=lambda item: -item[1],
    )
