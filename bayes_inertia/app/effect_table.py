"""Effects as the command `effects` lists them: parameters, units, priors, hooks."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.maths.values import json_ready, picked
from bayes_inertia.physics.effect import BODY_HOOKS, LOOKING_BACK, Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.named_effects import installed_effects
from bayes_inertia.physics.parameters import LogNormal, Parameter, Prior
from bayes_inertia.physics.stochastic_effect import StochasticEffect
from bayes_inertia.report.formatting import brief, listed

FORMAT = "bayes-inertia-effects/1"


def effects_json(effects: Sequence[Effect], campaign: Campaign) -> dict[str, Any]:
    """Content of `effects --json`."""
    rows = [_row(effect, campaign) for effect in effects]
    content = {"format": FORMAT, "campaign": campaign.name, "effects": rows}
    return json_ready(content | {"installed": installed_effects()})


def effect_lines(row: Mapping[str, Any]) -> list[str]:
    """An effect in words."""
    kind = {
        "library": "tried by a diagnosis",
        "named": "stochastic: fitted when named",
        "outside": "of your own",
    }[row["kind"]]
    needs = f"; needs {listed(row['needs'])}" if row["needs"] else ""
    hooks = listed([hook.replace("_", " ") for hook in row["hooks"]]) or "its coefficients alone"
    lines = [row["says"], f"{kind}{needs}; acts in {hooks}"]
    for p in row["parameters"]:
        several = f" ({len(p['components'])})" if p["components"] else ""
        unit = f" [{p['unit']}]" if p["unit"] else ""
        off = brief(p["null"])
        lines.append(f"{p['name']}{several}{unit}: {_prior_text(p['prior'])}, off at {off}")
    return lines


def _row(effect: Effect, campaign: Campaign) -> dict[str, Any]:
    stochastic = isinstance(effect, StochasticEffect)
    tried = effect in LIBRARY or effect.device
    kind = "library" if tried else "named" if stochastic else "outside"
    return {
        "name": effect.name,
        "kind": kind,
        "says": (inspect.getdoc(type(effect)) or "").split("\n\n")[0].replace("\n", " "),
        "needs": list(effect.needs),
        "hooks": [hook for hook in (*BODY_HOOKS, *LOOKING_BACK) if effect.acts(hook)],
        "parameters": [_parameter_row(p) for p in effect.parameters(campaign)],
    }


def _parameter_row(p: Parameter) -> dict[str, Any]:
    return {
        **picked(p, "name", "unit", "null"),
        "components": list(p.names) if p.components else [],
        "prior": _prior_row(p.priors[0]),
    }


def _prior_row(prior: Prior) -> dict[str, Any]:
    limits = {"lower": prior.lower, "upper": prior.upper}
    if isinstance(prior, LogNormal):
        return {"kind": "lognormal", "median": prior.median, "log_sd": prior.scale, **limits}
    return {"kind": "normal", "mean": prior.mean, "scale": prior.scale, **limits}


def _prior_text(prior: Mapping[str, Any]) -> str:
    if prior["kind"] == "lognormal":
        return f"{brief(prior['median'], 3)}, known to a factor of {brief(np.exp(prior['log_sd']))}"
    lower, upper = prior["lower"], prior["upper"]
    limits = f", at least {brief(lower, 3)}" if lower is not None else ""
    limits += f", at most {brief(upper, 3)}" if upper is not None else ""
    return f"{brief(prior['mean'], 3)} ± {brief(prior['scale'])}{limits}"
