"""A diagnosis as plain numbers: the content of RUN/diagnosis.json, and what the fit reads back
from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from bayes_inertia.app.diagnosed_fit import NextFit, fitted_effects
from bayes_inertia.app.diagnosis_pictures import pictures_json
from bayes_inertia.app.diagnosis_tables import alike_pairs, candidate_rows, step_row
from bayes_inertia.app.investigation import Investigation
from bayes_inertia.design.correction_slew import CorrectionForecast
from bayes_inertia.design.numerics import NUMERICS as DESIGN_NUMERICS
from bayes_inertia.design.separating_slew import Separation
from bayes_inertia.diagnosis.residuals import Disagreement
from bayes_inertia.diagnosis.result import AlternativeParameters, Diagnosis
from bayes_inertia.diagnosis.unexplained import UnexplainedSignal, describe
from bayes_inertia.inference.treatment import DirtTreatment, treatment_from
from bayes_inertia.maths.values import json_ready
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, REMAINDERS, STOCHASTIC
from bayes_inertia.physics.effects.formula import Formula
from bayes_inertia.physics.effects.of_device import OfDevice

FORMAT = "bayes-inertia-diagnosis/1"


def to_json(investigation: Investigation) -> dict[str, Any]:
    """The content of diagnosis.json; no NaN and no infinity in it."""
    diagnosis, before = investigation.diagnosis, investigation.disagreement_before
    after, unknown = investigation.disagreement_after, investigation.unexplained
    content = {
        "format": FORMAT,
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "readings_a_mean": investigation.readings_a_mean,
        "dirt": [dirt.json() for dirt in diagnosis.dirt],
        "disagreement": _windows(before),
        "disagreement_after": None if after is None else _windows(after),
        "slew_start": _slew_starts(before),
        "candidates": candidate_rows(diagnosis),
        "steps": [step_row(step) for step in diagnosis.steps],
        "beyond_prior": [asdict(row) for row in diagnosis.beyond_prior],
        "unknown": None if unknown is None else _unknown(unknown),
        "correction_slew": _correction(investigation.correction),
        "separating": [_separating(s) for s in investigation.separating_slews],
        "alternatives": [_alternative(a) for a in investigation.alternatives],
        "could_hide": [asdict(u) for u in investigation.blind_spots],
        **_search(diagnosis),
        "fitted": fitted_rows(diagnosis),
        "pictures": pictures_json(investigation),
    }
    return json_ready(content)


def _search(diagnosis: Diagnosis) -> dict[str, Any]:
    """Record of the search."""
    return {
        "why_unknown": diagnosis.why_unknown,
        "nameless_lead": diagnosis.nameless_lead,
        "nameless_source": diagnosis.nameless_source,
        "formulas": _formulas(diagnosis),
        "hypotheses": [asdict(row) for row in diagnosis.hypotheses],
        "threshold": diagnosis.threshold,
        "rules": asdict(diagnosis.rules),
        "noise": dict(diagnosis.noise),
        "treatment": diagnosis.treatment.json(),
        "skipped": [{"effect": name, "reason": reason} for name, reason in diagnosis.skipped],
        "alike": [
            {"effects": list(pair), "correlation": r}
            for pair, r in alike_pairs(diagnosis, diagnosis.rules.imitation_correlation)
        ],
        "fit": {
            key: {"reduced_chi2": t.reduced_chi2, "p_chi2": t.p_chi2, "p_white": t.p_white}
            for key, t in diagnosis.tests.items()
        },
        "drive": diagnosis.base.model.structure.drive,
    }


def _formulas(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """What was weighed for want of a name: the formulas that count, and how many there are."""
    search = diagnosis.formulas
    if search is None:
        return None
    best = search.terms[0]
    return {
        "tried": len(search.terms),
        "log_evidence": search.log_evidence,
        "false_alarm_at_most": min(1.0, math.exp(-search.log_evidence)),
        "terms": [
            {
                "effect": term.formula.name,
                "formula": term.formula.text,
                "behind_best": best.log_weight - term.log_weight,
            }
            for term in search.equals(diagnosis.rules.log_evidence_margin)
        ],
    }


def fitted_rows(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """The effects to fit in full after a diagnosis, with the settings that they were found with."""
    return [{"effect": e.name, "settings": _settings(e)} for e in fitted_effects(diagnosis)]


def _settings(effect: Effect) -> dict[str, Any]:
    """Fields of an effect that are plain numbers or names, and differ from their defaults."""
    values = {f.name: (getattr(effect, f.name), f.default) for f in fields(effect)}
    return {
        name: value
        for name, (value, default) in values.items()
        if value != default and isinstance(value, int | float | str)
    }


def next_fit_from(content: Mapping[str, Any], library: Sequence[Effect] = LIBRARY) -> NextFit:
    """Fit that a diagnosis.json wants in full.

    `library`: where the names of effects are looked up, beside stochastic ones.
    Returns: bit for bit the one of the diagnosis that was written.

    Examples
    --------
    >>> content = {"verdict": "named", "noise": {"rate": 1.0}, "drive": "commanded"}
    >>> content["fitted"] = [{"effect": "flexible_mode", "settings": {"frequency": 0.3}}]
    >>> next_fit_from(content).effects[0].frequency
    0.3
    """
    known = {e.name: e for e in (*STOCHASTIC, *library)}
    # Files of earlier versions state the level of the noise alone.
    before = DirtTreatment(level=content["noise"])
    fitted = tuple(
        OfDevice.of_name(row["effect"], row["settings"])
        or replace(known.get(row["effect"]) or Formula.of_name(row["effect"]), **row["settings"])
        for row in content["fitted"]
    )
    if content["verdict"] == "unknown" and not content.get("alternatives"):
        fitted = fitted or REMAINDERS  # Files of earlier versions leave them out.
    return NextFit(
        content["verdict"],
        fitted,
        treatment_from(content["treatment"]) if "treatment" in content else before,
        content["drive"],
        tuple(_alternative_from(row) for row in content.get("alternatives", [])),
    )


def _alternative(alternative: AlternativeParameters) -> dict[str, Any]:
    return {
        **asdict(alternative),
        "names": list(alternative.names),
        "mean": alternative.mean.tolist(),
        "covariance": alternative.covariance.tolist(),
    }


def _alternative_from(row: Mapping[str, Any]) -> AlternativeParameters:
    arrays = {key: np.array(row[key]) for key in ("mean", "covariance")}
    return AlternativeParameters(**{**row, **arrays, "names": tuple(row["names"])})


def _correction(correction: CorrectionForecast | None) -> dict[str, Any] | None:
    if correction is None:
        return None
    return {**asdict(correction), "unit": "rad", "angle_deg": DESIGN_NUMERICS.corrected_turn_deg}


def _separating(separation: Separation) -> dict[str, Any]:
    slew = separation.slew
    noncentrality = zip(separation.effects, separation.noncentrality, strict=True)
    return {
        "effects": list(separation.effects),
        "axis": list(slew.axis_B),
        "angle_deg": math.degrees(slew.angle),
        "rate_deg_s": math.degrees(slew.rate),
        "acceleration_deg_s2": math.degrees(slew.acceleration),
        "correlation_before": separation.correlation[0],
        "correlation_after": separation.correlation[1],
        "noncentrality": {
            name: {"before": before, "after": after} for name, (before, after) in noncentrality
        },
    }


def _slew_starts(disagreement: Disagreement) -> dict[str, float]:
    """Time [s] of each slew's first row, from which the report counts."""
    edges = next(iter(disagreement.cells.values())).edges
    return {name: float(t[0]) for name, t in zip(disagreement.slews, edges, strict=True)}


def _windows(disagreement: Disagreement) -> list[dict[str, Any]]:
    keys = ("channel", "slew", "component", "t_start", "t_end", "kind", "score", "p_value")
    return [{key: getattr(w, key) for key in keys} for w in disagreement.windows]


def _unknown(unknown: UnexplainedSignal) -> dict[str, Any]:
    return {
        "description": describe(unknown),
        "axis": unknown.axis_B.tolist(),
        "frequency_hz": unknown.frequency_hz,
        "torque_rms": unknown.torque_rms,
        "source": unknown.source,
        "axis_share": unknown.axis_share,
        "explained": unknown.torque.explained,
        "matches": [
            {"with": m.name, "share": m.share, "log_evidence": m.log_evidence}
            for m in unknown.matches
        ],
    }
