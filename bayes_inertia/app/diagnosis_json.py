"""A diagnosis as plain numbers: the content of RUN/diagnosis.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from bayes_inertia.design.correction_slew import CorrectionForecast
from bayes_inertia.design.separating_slew import Separation
from bayes_inertia.diagnosis.blind_spots import Undetected
from bayes_inertia.diagnosis.cross_validation import held_out
from bayes_inertia.diagnosis.free_signal import History
from bayes_inertia.diagnosis.model_averaging import Alternative
from bayes_inertia.diagnosis.residual_scan import Disagreement
from bayes_inertia.diagnosis.result import NOISE, Diagnosis, Step
from bayes_inertia.diagnosis.search import Rules
from bayes_inertia.diagnosis.unexplained import Unknown
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY

FORMAT = "bayes-inertia-diagnosis/1"
ALIKE = Rules.alike  # pairs beyond it are listed


def to_json(
    found: Diagnosis,
    where: Disagreement,
    after: Disagreement | None = None,
    unknown: Unknown | None = None,
    correction: CorrectionForecast | None = None,
    separating: Sequence[Separation] = (),
    alternatives: Sequence[Alternative] = (),
    hidden: Sequence[Undetected] = (),
) -> dict[str, Any]:
    """The content of diagnosis.json; no NaN and no infinity in it.

    Parameters
    ----------
    where, after : the scans of the residuals before and after effects were added. unknown : if the verdict is "unknown".
    correction : the next correction slew before and after. separating : slews that would tell the ambiguous effects apart.
    alternatives : J and K with another effect of an ambiguous set. hidden : how far what is too weak to be found could have moved them.
    """
    content = {
        "format": FORMAT,
        "verdict": found.verdict,
        "named": list(found.named),
        "ambiguous_with": [list(names) for names in found.ambiguous_with],
        "disagreement": _windows(where),
        "disagreement_after": _windows(after) if after is not None else None,
        "slew_start": _starts(where),
        "candidates": candidates(found),
        "steps": [_step(step) for step in found.steps],
        "unknown": None if unknown is None or found.verdict != "unknown" else _unknown(unknown),
        "correction_slew": None
        if correction is None
        else asdict(correction) | {"unit": "rad", "angle_deg": 60.0},
        "separating": [_separating(s) for s in separating],
        "alternatives": [
            asdict(a)
            | {"names": list(a.names), "mean": a.mean.tolist(), "covariance": a.covariance.tolist()}
            for a in alternatives
        ],
        "could_hide": [asdict(u) for u in hidden],
        "why_unknown": found.why_unknown,
        "nameless_lead": found.nameless_lead,
        "threshold": found.threshold,
        "noise": dict(found.noise),
        "skipped": [{"effect": name, "reason": reason} for name, reason in found.skipped],
        "alike": [{"effects": list(pair), "correlation": r} for pair, r in alike(found)],
        "fit": {
            key: {"reduced_chi2": t.reduced_chi2, "p_chi2": t.p_chi2, "p_white": t.p_white}
            for key, t in found.tests.items()
        },
        "drive": found.base.model.structure.drive,
        "fitted": fitted(found),
        "pictures": {
            "before": _cells(where),
            "after": _cells(after) if after is not None else None,
            "torque": _signal(unknown.torque, where.slews, ("x", "y", "z"))
            if unknown is not None
            else None,
            "other": _signal(unknown.other, where.slews, None)
            if unknown is not None and unknown.other is not None
            else None,
        },
    }
    return _plain(content)


def _separating(found: Separation) -> dict[str, Any]:
    slew = found.slew
    return {
        "effects": list(found.effects),
        "axis": list(slew.axis_B),
        "angle_deg": math.degrees(slew.angle),
        "rate_deg_s": math.degrees(slew.rate),
        "acceleration_deg_s2": math.degrees(slew.acceleration),
        "correlation_before": found.correlation[0],
        "correlation_after": found.correlation[1],
        "noncentrality": {
            name: {"before": b, "after": a}
            for name, (b, a) in zip(found.effects, found.noncentrality, strict=True)
        },
    }


def fitted(found: Diagnosis) -> list[dict[str, Any]]:
    """The effects to fit in full after the diagnosis, with the settings that they were found with; none where the verdict is "unknown"."""
    if found.verdict == "unknown":
        return []
    instances = {e.name: e for e in found.final.model.effects}
    return [{"effect": s.added, "settings": _settings(instances[s.added])} for s in found.steps]


def _settings(effect: Effect) -> dict[str, Any]:
    """Fields of an effect that are plain numbers or names, and differ from their defaults."""
    values = {f.name: (getattr(effect, f.name), f.default) for f in fields(effect)}
    return {
        name: value
        for name, (value, default) in values.items()
        if value != default and isinstance(value, int | float | str)
    }


def effects_of(content: dict[str, Any], library: Sequence[Effect] = LIBRARY) -> tuple[Effect, ...]:
    """The effects that a diagnosis.json wants fitted.

    Parameters
    ----------
    library : where their names are looked up.

    >>> effects_of({"fitted": [{"effect": "flexible_mode", "settings": {"frequency": 0.3}}]})[0].frequency
    0.3
    """
    known = {e.name: e for e in library}
    return tuple(
        replace(known[entry["effect"]], **entry["settings"]) for entry in content["fitted"]
    )


def alternatives_of(content: dict[str, Any]) -> tuple[Alternative, ...]:
    """The alternatives that a diagnosis.json holds.

    >>> alternatives_of({"alternatives": []})
    ()
    """
    return tuple(
        Alternative(
            **entry
            | {
                "names": tuple(entry["names"]),
                "mean": np.array(entry["mean"]),
                "covariance": np.array(entry["covariance"]),
            }
        )
        for entry in content.get("alternatives", [])
    )


def _cells(found: Disagreement) -> dict[str, Any]:
    channels = {
        # From each slew's first row on: a time from an epoch would lose its seconds in rounding.
        name: {
            "components": cells.components,
            "edges": _rounded(cells.edges - cells.edges[:, :1], 8),
            "shift": _rounded(cells.shift, 4),
        }
        for name, cells in found.cells.items()
    }
    return {"slews": found.slews, "channels": channels}


def _signal(
    found: History, slews: Sequence[str], components: Sequence[str] | None
) -> dict[str, Any]:
    names = components or [f"{found.source} {i + 1}" for i in range(found.mean.shape[-1])]
    numbers = {
        "time": _rounded(found.time - found.time[:, :1], 8),
        "mean": _rounded(found.mean, 4),
        "sd": _rounded(found.sd, 4),
    }
    return {
        "source": found.source,
        "unit": found.unit,
        "slews": slews,
        "components": names,
        "length": found.length,
        **numbers,
    }


def _rounded(values: np.ndarray, digits: int) -> list:
    """Nested lists rounded to significant digits: pictures need no more."""
    values = np.asarray(values, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        power = 10.0 ** (digits - 1 - np.floor(np.log10(np.abs(values))))
        shown = np.where(np.isfinite(power), np.round(values * power) / power, values)
    return shown.tolist()


def alike(found: Diagnosis) -> list[tuple[tuple[str, str], float]]:
    """Pairs of candidates whose canonical correlation is above 0.6, most alike first."""
    return sorted(
        ((pair, r) for pair, r in found.correlations.items() if r > ALIKE),
        key=lambda item: -item[1],
    )


def candidates(found: Diagnosis) -> list[dict[str, Any]]:
    """Every candidate of the library: those that were scored, best evidence first, then those that could not be."""
    added = {step.added for step in found.steps}
    rows = [
        {
            "effect": c.effect,
            "dof": c.dof,
            "score": c.score,
            "p_value": c.p_value,
            "log_bayes_factor": c.log_bayes_factor,
            "parameters": parameters_of(found.final, c.effect) if c.effect in added else None,
            "reason": None
            if c.dof
            else "invisible: an effect of the size of its prior would change the telemetry by less than its noise",
        }
        for c in found.candidates
    ]
    scored = {row["effect"] for row in rows}
    rows += [_unscored(name, reason) for name, reason in found.skipped]
    waiting = [e.name for e in found.base.model.effects if e.name not in scored]
    rows += [_unscored(name, "has no parameters in this campaign") for name in waiting]
    louder = {channel: factor for channel, factor in found.noise.items() if factor > 1.0}
    rows.append(_unscored(NOISE, _noise_text(louder)))
    return rows


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
        f"the noise of the {c} channel is {f:.2f} times what is stated" for c, f in louder.items()
    )


def parameters_of(at: Estimate, effect: str) -> dict[str, dict[str, Any]] | None:
    """{parameter: {mean, sd, q025, q975, unit}} of an effect as fitted; None if the estimate does not hold it."""
    space, part = at.model.space, at.model.space.slice_of(effect)
    if part.stop == part.start or not np.isin(np.arange(part.start, part.stop), at.free).all():
        return None
    rows = {}
    for i in range(part.start, part.stop):
        mean, sd = float(at.theta[i]), float(at.sd[i])
        low, high = (
            float(np.clip(mean + z * sd, space.lower[i], space.upper[i]))
            for z in (-1.959964, 1.959964)
        )
        rows[space.names[i].split(".", 1)[1]] = {
            "mean": mean,
            "sd": sd,
            "q025": low,
            "q975": high,
            "unit": space.units[i],
        }
    return rows


def _step(step: Step) -> dict[str, Any]:
    return {
        "added": step.added,
        "log_bayes_factor": step.log_bayes_factor,
        "alternatives": [
            {"effect": rival.effect, "correlation": rival.correlation}
            for rival in step.alternatives
        ],
        "reduced_chi2_before": {key: t.reduced_chi2 for key, t in step.before.tests.items()},
        "reduced_chi2_after": {key: t.reduced_chi2 for key, t in step.after.tests.items()},
        "held_out_before": held_out(step.before),
        "held_out_after": held_out(step.after),
        "shift": shift(step.before, step.after),
    }


def shift(before: Estimate, after: Estimate) -> dict[str, dict[str, Any]]:
    """How far J and K move: {name: {before, sd_before, after, sd_after, shift, unit}}."""
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
        for i in range(9)
    }


def _starts(found: Disagreement) -> dict[str, float]:
    """Time [s] of each slew's first row, from which the report counts."""
    edges = next(iter(found.cells.values())).edges
    return {name: float(t[0]) for name, t in zip(found.slews, edges, strict=True)}


def _windows(found: Disagreement) -> list[dict[str, Any]]:
    keys = ("channel", "slew", "component", "t_start", "t_end", "kind", "score", "p_value")
    return [{key: getattr(w, key) for key in keys} for w in found.windows]


def _unknown(found: Unknown) -> dict[str, Any]:
    return {
        "description": found.description,
        "axis": found.axis_B.tolist(),
        "frequency_hz": found.frequency_hz,
        "torque_rms": found.torque_rms,
        "source": found.source,
        "axis_share": found.axis_share,
        "explained": found.torque.explained,
        "matches": [
            {"with": m.name, "share": m.share, "correlation": m.correlation} for m in found.matches
        ],
    }


def _plain(value: Any) -> Any:
    """The same with Python's own numbers, and None for what is not finite."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
