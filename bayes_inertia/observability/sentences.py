"""Why each parameter is as uncertain as it is, in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bayes_inertia.files import vocabulary
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.observability.limits import LIMITS
from bayes_inertia.observability.result import Observability, ParameterObservability, commands_worth

_SAYS = vocabulary("observability")["sentences"]
VERDICTS = {
    "determined": "determined",
    "partly": "partly determined",
    "weakly": "mostly the prior",
    "prior": "the prior",
}


def answer(observability: Observability, shown: Callable[[str], str] = str) -> str:
    """Which parameters a campaign determines, and which slew alone carries which of them.

    `shown`: how the name of a parameter is printed.
    """
    groups: dict[str, list[str]] = {words: [] for words in VERDICTS.values()}
    carried: dict[str, list[str]] = {slew: [] for slew in observability.slews}
    untied = is_size_untied(observability)
    for p in observability.parameters:
        if not (untied and p.name in ELEMENTS):
            groups[VERDICTS[p.verdict]].append(shown(p.name))
        by_slew = p.share.sum(1)
        if len(by_slew) > 1 and by_slew.max() > LIMITS.carried:
            carried[observability.slews[int(np.argmax(by_slew))]].append(shown(p.name))
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
        return _SAYS["invisible"].format(name=name, signal=p.signal)
    verdict = _SAYS[p.verdict].format(gain=_factor(p.prior_sd / p.sd))
    if p.name in ELEMENTS and is_size_untied(observability):
        verdict = _SAYS["ratio"]
    parts = [f"{name} {verdict} (signal {_factor(p.signal)} sigma)", _lost(p)]
    if p.tells_most is None:
        parts.append(_SAYS["no_slew"])
    elif p.verdict != "prior" and (middle := observability.middle_half(name)):
        source = _source(p, observability, p.tells_most)
        parts.append(_SAYS["half"].format(source=source, begin=middle[1], end=middle[2]))
    worth = commands_worth(p, observability.drive)
    if worth is not None and worth > LIMITS.mentioned_sd_ratio:
        parts.append(_SAYS["without_commands"].format(times=_factor(worth)))
    return "; ".join(parts) + "."


def _lost(p: ParameterObservability) -> str:
    """To which other unknowns information is lost."""
    if p.variance_inflation < LIMITS.lost_variance_inflation:
        return _SAYS["nothing_lost"]
    logs = {group: math.log(max(factor, 1.0)) for group, factor in p.inflation.items()}
    least = 0.15 * sum(logs.values())
    large = [group for group in logs if logs[group] > least and p.inflation[group] > 1.1]
    worst = sorted(large, key=lambda group: -logs[group])
    named = ", ".join(
        f"{_group_without(p.name, group)} (× {_factor(math.sqrt(p.inflation[group]))})"
        for group in worst[: LIMITS.most_groups]
    )
    return _SAYS["lost"].format(times=_factor(math.sqrt(p.variance_inflation)), named=named)


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
        "devices": "." in name,
    }
    return f"the rest of {group}" if is_member.get(group) else group


def _source(p: ParameterObservability, observability: Observability, best: int) -> str:
    """How much the slew tells that tells most, and which channel."""
    by_slew, by_channel = p.share.sum(1), p.share.sum(0)
    most = int(np.argmax(by_channel))
    slew, channel = observability.slews[best], observability.channels[most]
    prior, told = p.share_own_prior + p.share_other_priors, {"slew": slew, "channel": channel}
    if prior > 0.5:
        return _SAYS["from_prior"].format(percent=100 * prior, **told)
    through = 100 * by_channel[most]
    return _SAYS["from_slew"].format(percent=100 * by_slew[best], through=through, **told)
