"""Words of the report: macros of the templates in `words/`, filled in with values of a result.

A phrase may stand on several lines of its template. Sentences are a list there: each begins with
a dash and a blank.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from inspect import getmembers, isfunction
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from bayes_inertia.campaign.sensors import CHANNELS, STREAMS
from bayes_inertia.campaign.slew import PART
from bayes_inertia.inference.settings import NOTHING, OPEN_VERDICTS
from bayes_inertia.report import criteria, formatting
from bayes_inertia.report.formatting import either_or, kind_of, listed, plain
from bayes_inertia.report.layout import LAYOUT


def meaning(name: str) -> str:
    """Meaning of a parameter.

    >>> meaning("Jxy"), meaning("K2"), meaning("wheel_friction.coulomb1")
    ('inertia tensor element xy', 'rate-sensor scale factor, axis 2', 'wheel friction: coulomb1')
    """
    return {
        "moment of inertia": f"moment of inertia, body {name[1:2]}",
        "product of inertia": f"inertia tensor element {name[1:]}",
        "K": f"rate-sensor scale factor, axis {name[1:]}",
    }.get(kind_of(name)) or plain(name)


def correlation_sentences(names: Sequence[str], matrix: Sequence[Sequence[float]]) -> list[str]:
    """Sentences on pairs of parameters that the data determine only together.

    >>> correlation_sentences(["Jxx", "K1"], [[1.0, -0.95], [-0.95, 1.0]])[0][:59]
    'Jxx and K1 are hard to tell apart (correlation −0.95): rais'
    """
    pairs = [
        (matrix[i][j], plain(names[j]), plain(name))
        for i, name in enumerate(names)
        for j in range(i)
        if abs(matrix[i][j]) > LAYOUT.strong_correlation
    ]
    return sentences("fit", "correlations", sorted(pairs, key=lambda pair: -abs(pair[0])))


def averaged_over(summary: Mapping[str, Any]) -> str:
    """The effects that J and K are averaged over, with their probabilities.

    >>> averaged_over({"averaged_over": [
    ...     {"effects": ["rate_bias", "a_b"], "probability": 0.7},
    ...     {"effects": ["rate_bias", "c"], "probability": 0.3}]})
    'a b 70 %, c 30 %'
    >>> averaged_over({"averaged_over": [
    ...     {"effects": [], "probability": 0.9}, {"effects": ["c"], "probability": 0.1}]})
    'nothing more 90 %, c 10 %'

    Rows that are others already are told with those for which there is no room, once:

    >>> share = {"a": 0.5, "others": 0.2, "b": 0.1, "c": 0.1, "d": 0.06, "e": 0.04}
    >>> averaged_over({"averaged_over": [
    ...     {"effects": [name], "probability": p} for name, p in share.items()]})
    'a 50 %, b 10 %, c 10 %, d 6 %, others 24 %'
    """
    rows = summary.get("averaged_over", [])
    in_all = set.intersection(*(set(row["effects"]) for row in rows)) if rows else set()
    cases = [
        (listed([plain(name) for name in row["effects"] if name not in in_all]), row["probability"])
        for row in rows
    ]
    others = [case for case in cases if case[0] == "others"]
    by_size = [case for case in cases if case not in others]
    by_size[1:] = sorted(by_size[1:], key=lambda case: -case[1])
    if len(by_size) + len(others) > LAYOUT.most_cases_listed:
        kept = LAYOUT.most_cases_listed - 1
        rest = sum(probability for _, probability in (*by_size[kept:], *others))
        by_size, others = by_size[:kept], [("others", rest)]
    return ", ".join(
        f"{effects or 'nothing more'} {100.0 * probability:.0f} %"
        for effects, probability in (*by_size, *others)
    )


# One sentence a kind and treatment; the number of places and the channel are filled in.
_KINDS = {
    "outliers": "outliers",
    "gap": "gaps",
    "stuck": "stuck readings",
    "saturated": "saturated readings",
    "duplicate": "repeated rows",
    "clock": "errors",
    "quantised": "rounding of the readings",
    "coloured": "noise that is correlated in time",
    "noise_level": "noise of another size than stated",
    "stale_bias": "bias far from the stated one",
}
_CHANNELS = {
    **{stream.name: f"the {stream.sensor}" for stream in STREAMS},
    "torque": "the torque commands",
    "time": "the time stamps",
}
_TREATED = {"masked": "left out", "modelled": "taken into account", "ignored": "left as it is"}


def dirt_rows(dirt: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Records of dirt, one row a kind, channel and treatment.

    >>> record = {"kind": "outliers", "channel": "rate", "slew": "a", "rows": [3, 9]}
    >>> dirt_rows([record | {"treated": "masked", "note": "far off"}])[0]["rows"]
    2
    """
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for record in dirt:
        key = (record["kind"], record["channel"], record["treated"])
        groups.setdefault(key, []).append(record)
    return [
        {
            "kind": _KINDS[kind],
            "channel": _CHANNELS.get(channel, channel),
            "treated": _TREATED[treated],
            "rows": sum(len(record["rows"]) for record in records),
            # Parts of a slew that was cut are one slew.
            "slews": list(dict.fromkeys(r["slew"].split(PART)[0] for r in records if r["slew"])),
            "notes": [record["note"] for record in records if record.get("note")],
        }
        for (kind, channel, treated), records in groups.items()
    ]


def dirt_sentences(dirt: Sequence[Mapping[str, Any]]) -> list[str]:
    """Records of dirt as sentences.

    >>> record = {"kind": "outliers", "channel": "rate", "slew": "a", "rows": [3, 9]}
    >>> dirt_sentences([record | {"treated": "masked"}])
    ['Outliers of the rate sensor: 2 rows (a), left out.']
    """
    return sentences("fit", "dirt", dirt_rows(dirt))


# Files of version 0.1 do not state the rules of their search: they were these.
_RULES_OF_0_1 = {
    "false_alarm_probability": 0.02,
    "log_evidence_margin": 3.0,
    "imitation_correlation": 0.6,
}


def phrase(template: str, macro: str, *values: Any) -> str:
    """A phrase of a template, on one line.

    >>> phrase("diagnosis", "per_cent", 0.123), phrase("diagnosis", "per_cent", 1e-9)
    ('12 %', 'under 1 %')
    """
    return _on_one_line(_said(template, macro, values))


def sentences(template: str, macro: str, *values: Any) -> list[str]:
    """Sentences of a template, one an item.

    >>> sentences("diagnosis", "block_means", {"readings_a_mean": 1})
    []
    """
    items = re.split(r"^\s*- ", _said(template, macro, values), flags=re.M)[1:]
    return [line for item in items if (line := _on_one_line(item))]


def _said(template: str, macro: str, values: Sequence[Any]) -> str:
    module: Any = _words().get_template(f"{template}.txt").module
    return getattr(module, macro)(*values)


def _on_one_line(text: str) -> str:
    return re.sub(r"[ \n]+", " ", text).strip(" \n")


def templates_in(folder: str, **options: Any) -> Environment:
    """Templates of a folder of the report: what they lack is an error, control leaves no line."""
    environment = Environment(
        loader=PackageLoader("bayes_inertia.report", folder),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **options,
    )
    environment.globals |= _GLOBALS
    environment.filters |= _FILTERS
    environment.tests |= {"contains": operator.contains, "endswith": str.endswith}
    return environment


_words = cache(partial(templates_in, "words"))


def rules_of(content: Mapping[str, Any]) -> Mapping[str, float]:
    """The rules that the search went by.

    >>> rules_of({"rules": {"log_evidence_margin": 4.0}})["log_evidence_margin"]
    4.0
    """
    return _RULES_OF_0_1 | content.get("rules", {})


def probabilities(content: Mapping[str, Any]) -> list[tuple[str, float]]:
    """What of the ambiguous sets may be true, and how probable it is.

    >>> probabilities({"alternatives": [
    ...     {"effect": "wheel_friction", "instead_of": "viscous_torque", "probability": 0.25}]})
    [('viscous torque', 0.75), ('wheel friction', 0.25)]
    """
    alternatives = content["alternatives"]
    replaced = list(dict.fromkeys(a["instead_of"] for a in alternatives))
    rows: list[tuple[str, float]] = []
    for alternative in alternatives:
        effect = plain(alternative["effect"]) or "nothing"
        if len(replaced) > 1:
            effect += f" instead of {plain(alternative['instead_of'])}"
        rows.append((effect, alternative["probability"]))
    named = listed([plain(name) for name in replaced])
    return [(named, 1.0 - sum(p for _, p in rows)), *rows]


def _farthest_alternative(content: Mapping[str, Any]) -> tuple[float, str, str]:
    """The alternative that moves J and K most: by how many sds, which parameter, its effect."""
    shift = content["steps"][-1]["shift"]
    return max(
        (abs(mean - shift[name]["after"]) / shift[name]["sd_after"], name, alternative["effect"])
        for alternative in content["alternatives"]
        for name, mean in zip(alternative["names"], alternative["mean"], strict=True)
    )


def _least_gain(slew: Mapping[str, Any]) -> float:
    """How many times a slew shows more of each of two effects, at least."""
    powers = slew["noncentrality"].values()
    return min(power["after"] / max(power["before"], 1e-12) for power in powers)


def _most_moved_first(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Parameters that what may hide moves, first the one that moves by most sds."""
    return sorted(rows, key=lambda row: -row["shift"] / row["sd"])


def _elements(jump: Any, history: Any) -> list[tuple[str, float, float]]:
    """Name, size and sd of the elements that a jump changed for sure; at least of one."""
    # They bring JAX along, which other words do without.
    from bayes_inertia.physics.parameters import base_names
    from bayes_inertia.series.history import OF_PART

    names = base_names(history.mean.shape[1])[OF_PART[jump.part]]
    rows = list(zip(names, jump.size, jump.sd, strict=True))
    sure = [row for row in rows if abs(row[1]) > LAYOUT.change_told_sd * row[2]]
    return sure or [max(rows, key=lambda row: abs(row[1] / row[2]))]


def _in_order(channels: Iterable[str]) -> list[str]:
    """Channels in the order of the usual ones, others behind them."""
    hit = set(channels)
    return [name for name in dict.fromkeys((*CHANNELS, *sorted(hit))) if name in hit]


# What templates know beside their values; as filters, functions of criteria and formatting too.
_GLOBALS: Mapping[str, Any] = {
    "layout": LAYOUT,
    "NOTHING": NOTHING,
    "OPEN": OPEN_VERDICTS,
    "averaged_over": averaged_over,
    "exp": math.exp,
    "rules": rules_of,
    "sentences": sentences,
    "shares": probabilities,
} | {name: getattr(formatting, name) for name in ("exponent", "power_text", "sd_column", "sd_head")}


_FILTERS: Mapping[str, Callable[..., Any]] = {
    **dict(getmembers(criteria, isfunction)),
    **dict(getmembers(formatting, isfunction)),
    "arcsec": formatting.arcsec_text,
    "channel": formatting.channel_name,
    "digits": format,
    "either": lambda names: either_or([plain(name) for name in names]),
    "elements": _elements,
    "farthest_alternative": _farthest_alternative,
    "in_order": _in_order,
    "least_gain": _least_gain,
    "meaning": meaning,
    "most_moved_first": _most_moved_first,
    "names": lambda names: listed([plain(name) for name in names]),
    "p": formatting.probability,
    "sentence": lambda text: text[:1].upper() + text[1:],
    "unit": formatting.unit_text,
    "value": formatting.value_text,
    "vector": formatting.vector_text,
}
