"""The content of observability.json."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from bayes_inertia.files import vocabulary
from bayes_inertia.maths.values import json_ready, picked
from bayes_inertia.observability.result import (
    Observability,
    ParameterObservability,
    commands_worth,
    in_windows,
)
from bayes_inertia.observability.sentences import sentence

FORMAT = "bayes-inertia-observability/1"


def observability_json(observability: Observability) -> dict[str, Any]:
    """The content of observability.json, plain numbers and text."""
    windows = {arrival.slew: in_windows(arrival) for arrival in observability.arrivals}
    names = observability.names
    content = {
        "format": FORMAT,
        **picked(observability, "campaign", "drive", "wheels", "effects", "discounted"),
        "parameters": {
            p.name: _parameter(observability, p, windows) for p in observability.parameters
        },
        "directions": [
            picked(direction, "says", "information", "contraction", "exact")
            | {"weights": dict(zip(names, direction.weights, strict=True))}
            for direction in observability.directions
        ],
        "degeneracies": [asdict(degeneracy) for degeneracy in observability.degeneracies],
        "windows": {slew: edges for slew, (edges, _) in windows.items()},
        "controller": vocabulary("observability")["sentences"]["controller"],
    }
    return json_ready(content)


def _parameter(
    observability: Observability,
    p: ParameterObservability,
    windows: dict[str, tuple[np.ndarray, np.ndarray]],
) -> dict[str, Any]:
    i, slews = observability.names.index(p.name), observability.slews
    middle = observability.middle_half(p.name)
    fields = {key: value for key, value in vars(p).items() if key != "name"}
    return fields | {
        "verdict": p.verdict,
        "says": sentence(observability, p.name),
        "signal_by": _by_slew_and_channel(observability, p.signal_by),
        "share": _by_slew_and_channel(observability, p.share),
        "sd_without_slew": dict(zip(slews, p.sd_without_slew, strict=True)),
        "sd_without_channel": dict(zip(observability.channels, p.sd_without_channel, strict=True)),
        "partners": [{"with": name, "correlation": r} for name, r in p.partners],
        "commands_worth": commands_worth(p, observability.drive),
        "middle_half": middle and dict(zip(("slew", "t_start", "t_end"), middle, strict=True)),
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
