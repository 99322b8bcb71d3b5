"""The content of observability.json."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_inertia.maths.values import json_ready
from bayes_inertia.observability.result import (
    Observability,
    ParameterObservability,
    commands_worth,
    in_windows,
)
from bayes_inertia.observability.sentences import sentence

FORMAT = "bayes-inertia-observability/1"
_CONTROLLER_NOTE = (
    "A controller commands whatever torque keeps a slew on its profile, "
    "so that a wrong J hardly shows in the motion. "
    "The fit takes the commands as recorded: nothing is hidden from it. "
    "commands_worth is the sd with the commands ignored (tachometers drive the model) "
    "over the sd with them; 1 means that they add nothing."
)
_COPIED_FIELDS = (
    "unit",
    "value",
    "prior_sd",
    "sd",
    "robust_sd",
    "contraction",
    "verdict",
    "signal",
    "signal_of_size",
    "conditional_sd",
    "variance_inflation",
    "inflation",
)


def observability_json(observability: Observability) -> dict[str, Any]:
    """The content of observability.json, plain numbers and text."""
    windows = {arrival.slew: in_windows(arrival) for arrival in observability.arrivals}
    names = observability.names
    content = {
        "format": FORMAT,
        "campaign": observability.campaign,
        "drive": observability.drive,
        "effects": observability.effects,
        "discounted": observability.discounted,
        "parameters": {
            p.name: _parameter(observability, p, windows) for p in observability.parameters
        },
        "directions": [
            {
                "says": direction.says,
                "information": direction.information,
                "contraction": direction.contraction,
                "exact": direction.exact,
                "weights": dict(zip(names, direction.weights, strict=True)),
            }
            for direction in observability.directions
        ],
        "degeneracies": [
            {
                key: getattr(degeneracy, key)
                for key in ("name", "exact", "in_sd", "parameters", "information_ratio", "says")
            }
            for degeneracy in observability.degeneracies
        ],
        "windows": {slew: edges for slew, (edges, _) in windows.items()},
        "controller": _CONTROLLER_NOTE,
    }
    return json_ready(content)


def _parameter(
    observability: Observability,
    p: ParameterObservability,
    windows: dict[str, tuple[np.ndarray, np.ndarray]],
) -> dict[str, Any]:
    i, slews = observability.names.index(p.name), observability.slews
    middle = observability.middle_half(p.name)
    return {key: getattr(p, key) for key in _COPIED_FIELDS} | {
        "says": sentence(observability, p.name),
        "signal_by": _by_slew_and_channel(observability, p.signal_by),
        "share": _by_slew_and_channel(observability, p.share),
        "share_own_prior": p.share_own_prior,
        "share_other_priors": p.share_other_priors,
        "sd_without_slew": dict(zip(slews, p.sd_without_slew, strict=True)),
        "sd_without_channel": dict(zip(observability.channels, p.sd_without_channel, strict=True)),
        "partners": [{"with": name, "correlation": r} for name, r in p.partners],
        "sd_other_drive": p.sd_other_drive,
        "commands_worth": commands_worth(p, observability.drive),
        "middle_half": None
        if middle is None
        else dict(zip(("slew", "t_start", "t_end"), middle, strict=True)),
        "arrival": {
            slew: dict(zip(observability.channels, (rows[..., i] * p.sd**2).T, strict=True))
            for slew, (_, rows) in windows.items()
        },
    }


def _by_slew_and_channel(observability: Observability, numbers: np.ndarray) -> dict[str, dict]:
    return {
        slew: dict(zip(observability.channels, row, strict=True))
        for slew, row in zip(observability.slews, numbers, strict=True)
    }
