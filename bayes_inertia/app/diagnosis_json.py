"""A diagnosis as plain numbers: the content of RUN/diagnosis.json, and what the fit reads back
from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.app.diagnosed_fit import Investigation, NextFit
from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.design.after_campaign import CorrectionForecast
from bayes_inertia.design.numerics import NUMERICS as DESIGN_NUMERICS
from bayes_inertia.design.separating_slew import Separation
from bayes_inertia.diagnosis.quoted_parameters import fitted_effects
from bayes_inertia.diagnosis.residuals import Disagreement, held_out_chi2
from bayes_inertia.diagnosis.result import AlternativeParameters, Candidate, Diagnosis, Step
from bayes_inertia.diagnosis.unexplained import FreeSignal, UnexplainedSignal
from bayes_inertia.errors import CampaignError
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.treatment import DirtTreatment, treatment_from
from bayes_inertia.maths.values import by_name, json_ready, picked
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, REMAINDERS, STOCHASTIC
from bayes_inertia.physics.effects.formula import Formula
from bayes_inertia.physics.effects.of_device import OfDevice
from bayes_inertia.physics.named_effects import remainders
from bayes_inertia.report.words import phrase
from bayes_inertia.sealing import SEAL_KEY, blaming, read_sealed_json

FORMAT = "bayes-inertia-diagnosis/1"


def to_json(investigation: Investigation) -> dict[str, Any]:
    """The content of diagnosis.json; no NaN and no infinity in it."""
    diagnosis, before = investigation.diagnosis, investigation.disagreement_before
    after, unknown = investigation.disagreement_after, investigation.unexplained
    content = {
        "format": FORMAT,
        **picked(diagnosis, "verdict", "named", "ambiguous_with"),
        "readings_a_mean": investigation.readings_a_mean,
        "dirt": [dirt.json() for dirt in diagnosis.dirt],
        "disagreement": before.windows,
        "disagreement_after": None if after is None else after.windows,
        "slew_start": _slew_starts(before),
        "candidates": candidate_rows(diagnosis),
        "steps": [step_row(step) for step in diagnosis.steps],
        "beyond_prior": diagnosis.beyond_prior,
        "unknown": None if unknown is None else _unknown(unknown),
        "correction_slew": _correction(investigation.correction),
        "separating": [_separating(s) for s in investigation.separating_slews],
        "alternatives": diagnosis.other_rows,
        "could_hide": investigation.blind_spots,
        **picked(diagnosis, "why_unknown", "nameless_lead", "nameless_source"),
        "formulas": _formulas(diagnosis),
        **picked(diagnosis, "hypotheses", "threshold", "rules", "noise", "noise_probabilities"),
        "treatment": diagnosis.treatment.json(),
        "skipped": [{"effect": name, "reason": reason} for name, reason in diagnosis.skipped],
        "alike": alike_pairs(diagnosis),
        "fit": {
            key: picked(test, "reduced_chi2", "p_chi2", "p_white")
            for key, test in diagnosis.tests.items()
        },
        "drive": diagnosis.base.model.structure.drive,
        "fitted": [{"effect": e.name, "settings": _settings(e)} for e in fitted_effects(diagnosis)],
        "pictures": pictures_json(investigation),
    }
    return json_ready(content)


def _formulas(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """What was weighed for want of a name: the formulas that count, and how many there are."""
    search = diagnosis.formulas
    if search is None:
        return None
    terms = [
        {
            "effect": term.formula.name,
            "formula": term.formula.text,
            "behind_best": search.terms[0].log_weight - term.log_weight,
        }
        for term in search.equals(diagnosis.rules.log_evidence_margin)
    ]
    return {
        "tried": len(search.terms),
        "log_evidence": search.log_evidence,
        "false_alarm_at_most": min(1.0, math.exp(-search.log_evidence)),
        "terms": terms,
    }


def _settings(effect: Effect) -> dict[str, Any]:
    """Fields of an effect that are plain numbers or names, and differ from their defaults."""
    told = ((f.name, getattr(effect, f.name), f.default) for f in fields(effect))
    changed = {name: value for name, value, default in told if value != default}
    return {name: x for name, x in changed.items() if isinstance(x, int | float | str)}


def next_fit_from(content: Mapping[str, Any], library: Sequence[Effect] = LIBRARY) -> NextFit:
    """Fit that a diagnosis.json wants in full.

    `library`: where the names of effects are looked up, beside stochastic ones.
    Returns: bit for bit the one of the diagnosis that was written.

    >>> content = {"verdict": "named", "noise": {"rate": 1.0}, "drive": "commanded"}
    >>> content["fitted"] = [{"effect": "flexible_mode", "settings": {"frequency": 0.3}}]
    >>> next_fit_from(content).effects[0].frequency
    0.3
    """
    known = {e.name: e for e in (*STOCHASTIC, *library)}
    # Files of earlier versions state the level of the noise alone.
    treatment = DirtTreatment(level=content["noise"])
    if "treatment" in content:
        treatment = treatment_from(content["treatment"])
    fitted = tuple(
        OfDevice.of_name(row["effect"], row["settings"])
        or replace(known.get(row["effect"]) or Formula.of_name(row["effect"]), **row["settings"])
        for row in content["fitted"]
    )
    others = content.get("alternatives", [])
    if content["verdict"] == "unknown":
        # Files of earlier versions leave free shapes out, or average over them.
        fitted, others = tuple(e for e in fitted if e in REMAINDERS) or remainders("both"), []
    alternatives = tuple(_alternative_from(row) for row in others)
    return NextFit(content["verdict"], fitted, treatment, content["drive"], alternatives)


def _alternative_from(row: Mapping[str, Any]) -> AlternativeParameters:
    arrays = {key: np.array(row[key]) for key in ("mean", "covariance")}
    return AlternativeParameters(**{**row, **arrays, "names": tuple(row["names"])})


def _correction(correction: CorrectionForecast | None) -> dict[str, Any] | None:
    if correction is None:
        return None
    return {**asdict(correction), "unit": "rad", "angle_deg": DESIGN_NUMERICS.corrected_turn_deg}


def _separating(separation: Separation) -> dict[str, Any]:
    slew = separation.slew
    before, after = zip(*separation.noncentrality, strict=True)
    return {
        "effects": list(separation.effects),
        "axis": list(slew.axis_B),
        "angle_deg": math.degrees(slew.angle),
        "rate_deg_s": math.degrees(slew.rate),
        "acceleration_deg_s2": math.degrees(slew.acceleration),
        "correlation_before": separation.correlation[0],
        "correlation_after": separation.correlation[1],
        "noncentrality": by_name(separation.effects, before=before, after=after),
    }


def _slew_starts(disagreement: Disagreement) -> dict[str, float]:
    """Time [s] of each slew's first row, from which the report counts."""
    edges = next(iter(disagreement.cells.values())).edges
    return {name: float(t[0]) for name, t in zip(disagreement.slews, edges, strict=True)}


def _unknown(unknown: UnexplainedSignal) -> dict[str, Any]:
    return {
        "description": phrase("diagnosis", "equivalent_signal", unknown),
        "axis": unknown.axis_B,
        **picked(unknown, "frequency_hz", "torque_rms", "source", "axis_share"),
        "explained": unknown.torque.explained,
        "matches": [{"with": m.name} | picked(m, "share", "log_evidence") for m in unknown.matches],
    }


_REASON_INVISIBLE = (
    "invisible: an effect of the size of its prior would change the telemetry "
    "by less than its noise"
)


def candidate_rows(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Every candidate: those that were scored, best evidence first, then the others."""
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
        **asdict(candidate),
        "parameters": parameter_rows(final, candidate.effect) if added else None,
        "reason": None if candidate.dof else _REASON_INVISIBLE,
    }


def _unscored(name: str, reason: str) -> dict[str, Any]:
    none = dict.fromkeys(("score", "p_value", "log_bayes_factor", "parameters"))
    return {"effect": name, "dof": 0, **none, "reason": reason}


def _noise_text(louder: dict[str, float]) -> str:
    if not louder:
        return "measured by itself: the white noise is not significantly larger than stated"
    return "measured by itself: " + ", ".join(
        f"the noise of the {channel} channel is {factor:.2f} times what is stated"
        for channel, factor in louder.items()
    )


def parameter_rows(estimate: Estimate, effect: str) -> dict[str, dict[str, Any]] | None:
    """The parameters of an effect as fitted."""
    space = estimate.model.space
    part = space.slice_of(effect)
    fitted = np.isin(np.arange(part.start, part.stop), estimate.free).all()
    if part.stop == part.start or not fitted:
        return None
    names = [name.split(".", 1)[1] for name in space.names[part]]
    mean, sd = estimate.theta[part], estimate.sd[part]
    low, high = (
        np.clip(mean + z * sd, space.lower[part], space.upper[part])
        for z in (-LAYOUT.quantile_95, LAYOUT.quantile_95)
    )
    return by_name(names, mean=mean, sd=sd, q025=low, q975=high, unit=space.units[part])


def step_row(step: Step) -> dict[str, Any]:
    """One effect added: what it changed, and what would explain the data as well."""
    return {
        "added": step.added,
        "log_bayes_factor": step.log_bayes_factor,
        "alternatives": [picked(other, "effect", "correlation") for other in step.alternatives],
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
    """Shifts of J and K from one fit to another."""
    space = before.model.space
    base = slice(before.model.n_base)
    return by_name(
        space.names[base],
        before=before.theta[base],
        sd_before=before.sd[base],
        after=after.theta[base],
        sd_after=after.sd[base],
        shift=after.theta[base] - before.theta[base],
        unit=space.units[base],
    )


def alike_pairs(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Pairs of candidates that this campaign hardly tells apart, most alike first."""
    limit = diagnosis.rules.imitation_correlation
    pairs = [(pair, r) for pair, r in diagnosis.correlations.items() if r > limit]
    pairs.sort(key=lambda item: -item[1])
    return [{"effects": pair, "correlation": r} for pair, r in pairs]


def pictures_json(investigation: Investigation) -> dict[str, Any]:
    """The part `pictures` of diagnosis.json."""
    before, after = investigation.disagreement_before, investigation.disagreement_after
    pictures: dict[str, Any] = {"torque": None, "other": None}
    if (unknown := investigation.unexplained) is not None:
        pictures["torque"] = _signal(unknown.torque, before.slews, ("x", "y", "z"))
        if unknown.better_signal is not None:
            pictures["other"] = _signal(unknown.better_signal, before.slews, None)
    after_map = None if after is None else _residual_map(after)
    return {"before": _residual_map(before), "after": after_map, **pictures}


def _residual_map(disagreement: Disagreement) -> dict[str, Any]:
    channels = {
        # From each slew's first row on: a time from an epoch would lose its seconds in rounding.
        name: {
            "components": cells.components,
            "edges": _rounded(cells.edges - cells.edges[:, :1], 8),
            "shift": _rounded(cells.shift, 4),
        }
        for name, cells in disagreement.cells.items()
    }
    return {"slews": disagreement.slews, "channels": channels}


def _signal(
    history: FreeSignal, slews: Sequence[str], components: Sequence[str] | None
) -> dict[str, Any]:
    count = history.mean.shape[-1]
    return {
        **picked(history, "source", "unit"),
        "slews": slews,
        "components": components or [f"{history.source} {i + 1}" for i in range(count)],
        "length": history.length,
        "time": _rounded(history.time - history.time[:, :1], 8),
        "mean": _rounded(history.mean, 4),
        "sd": _rounded(history.sd, 4),
    }


def _rounded(values: np.ndarray, digits: int) -> list:
    """Nested lists rounded to significant digits: pictures need no more."""
    values = np.asarray(values, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        power = 10.0 ** (digits - 1 - np.floor(np.log10(np.abs(values))))
        shown = np.where(np.isfinite(power), np.round(values * power) / power, values)
    return shown.tolist()


DIAGNOSIS_FILE = "diagnosis.json"
_ADVICE = "delete it and run `bayes-inertia resume`"


def blaming_diagnosis(folder: Path, content: Mapping[str, Any]) -> AbstractContextManager[None]:
    """Take any exception for damage of a run's diagnosis.json, where that has no seal."""
    return blaming(folder / DIAGNOSIS_FILE, intact=SEAL_KEY in content, advice=_ADVICE)


def read_diagnosis(folder: Path) -> dict[str, Any] | None:
    """The content of a run's diagnosis.json."""
    path = folder / DIAGNOSIS_FILE
    if not path.is_file():
        return None
    content = read_sealed_json(path, _ADVICE)
    if content.get("format") != FORMAT:
        raise CampaignError("not a diagnosis", where=str(path), advice=_ADVICE)
    return content
