"""What a campaign tells of each parameter, in plain sentences and in observability.json."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.maths.values import json_ready
from bayes_inertia.observability.limits import LIMITS
from bayes_inertia.observability.result import (
    Observability,
    ParameterObservability,
    commands_worth,
    in_windows,
)

VERDICTS = {
    "determined": "determined",
    "partly": "partly determined",
    "weakly": "mostly the prior",
    "prior": "the prior",
}


def answer(observability: Observability) -> str:
    """Which parameters a campaign determines, and which slew alone carries which of them."""
    groups: dict[str, list[str]] = {words: [] for words in VERDICTS.values()}
    carried: dict[str, list[str]] = {slew: [] for slew in observability.slews}
    untied = is_size_untied(observability)
    for p in observability.parameters:
        if not (untied and p.name in ELEMENTS):
            groups[VERDICTS[p.verdict]].append(p.name)
        by_slew = p.share.sum(1)
        if len(by_slew) > 1 and by_slew.max() > LIMITS.carried:
            carried[observability.slews[int(np.argmax(by_slew))]].append(p.name)
    told = [f"{words}: {', '.join(names)}" for words, names in groups.items() if names]
    if untied:
        told.insert(0, "of J only its ratios are determined, its size is the prior's")
    if len(groups[VERDICTS["determined"]]) == len(observability.parameters):
        told = [f"all {len(observability.parameters)} parameters are determined"]
    carries = [f"{slew} carries {', '.join(names)}" for slew, names in carried.items() if names]
    said = f"{'; '.join([*told, *carries])}."
    return said[0].upper() + said[1:]


def is_size_untied(observability: Observability) -> bool:
    """Whether nothing tells the absolute size of J, so that only its ratios are determined."""
    return any(d.name == "size of J" and d.exact for d in observability.degeneracies)


def verdict_of(observability: Observability, p: ParameterObservability) -> str:
    """How far the data determine a parameter, in words."""
    if p.name in ELEMENTS and is_size_untied(observability):
        return "only its ratio"
    return VERDICTS[p.verdict]


def sentence(observability: Observability, name: str) -> str:
    """Why a parameter is as uncertain as it is."""
    p = observability[name]
    if p.signal < 1.0:
        return (
            f"{name} is the prior: a change by its whole prior sd moves all telemetry "
            f"by {p.signal:.2g} sigma, less than the noise."
        )
    gain = p.prior_sd / p.sd
    verdict = {
        "prior": "is the prior, although the telemetry responds",
        "weakly": f"is mostly the prior, {_factor(gain)} times sharper than it",
        "partly": f"is partly determined, {_factor(gain)} times sharper than the prior",
        "determined": f"is determined, {_factor(gain)} times sharper than the prior",
    }[p.verdict]
    parts = [f"{name} {verdict} (signal {_factor(p.signal)} sigma)", _lost(p)]
    middle = observability.middle_half(name)
    if middle and p.verdict != "prior":
        _, begin, end = middle
        source = _source(p, observability)
        parts.append(f"{source}, half of that slew's part between {begin:.4g} and {end:.4g} s")
    worth = commands_worth(p, observability.drive)
    if worth is not None and worth > LIMITS.mentioned_sd_ratio:
        parts.append(f"without the recorded commands its sd would be {_factor(worth)} times larger")
    return "; ".join(parts) + "."


def _lost(p: ParameterObservability) -> str:
    """To which other unknowns information is lost."""
    if p.variance_inflation < LIMITS.lost_variance_inflation:
        return "almost nothing is lost to other unknowns"
    logs = {group: math.log(max(factor, 1.0)) for group, factor in p.inflation.items()}
    worst = [
        group
        for group in sorted(logs, key=lambda group: -logs[group])
        if logs[group] > 0.15 * sum(logs.values()) and p.inflation[group] > 1.1
    ]
    named = ", ".join(
        f"{_group_without(p.name, group)} (× {_factor(math.sqrt(p.inflation[group]))})"
        for group in worst[: LIMITS.most_groups]
    )
    return (
        f"its sd is {_factor(math.sqrt(p.variance_inflation))} times what it would be "
        f"with all else known, mostly through {named}"
    )


def _factor(value: float) -> str:
    """A factor of at least one, without an exponent.

    >>> _factor(2.46), _factor(3580.4)
    ('2.5', '3,580')
    """
    return f"{value:.2g}" if value < 10.0 else f"{value:,.0f}"


def _group_without(name: str, group: str) -> str:
    """A group of unknowns as seen from one parameter, which may be a member of it."""
    is_member = {
        "J": name.startswith("J"),
        "K": name[:1] == "K" and "." not in name,
        "effects": "." in name,
    }
    return f"the rest of {group}" if is_member.get(group) else group


def _source(p: ParameterObservability, observability: Observability) -> str:
    """Which slew and which channel tell most."""
    by_slew, by_channel = p.share.sum(1), p.share.sum(0)
    best, most = int(np.argmax(by_slew)), int(np.argmax(by_channel))
    slew, channel = observability.slews[best], observability.channels[most]
    prior = p.share_own_prior + p.share_other_priors
    if prior > 0.5:
        return (
            f"{100 * prior:.0f} % of what is known is prior knowledge; "
            f"of the slews {slew} tells most, through the {channel} channel"
        )
    return (
        f"{100 * by_slew[best]:.0f} % of what is known comes from {slew}, "
        f"{100 * by_channel[most]:.0f} % from the {channel} channel"
    )


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
