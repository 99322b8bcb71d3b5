"""Words of the report: macros of the templates in `words/`, filled in with values of a result.

A phrase may stand on several lines of its template. Sentences are a list there: each begins with
a dash and a blank.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.inference.settings import NOTHING, OPEN_VERDICTS
from bayes_inertia.report import formatting
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.parameter_wording import averaged_over

# Files of version 0.1 do not state the rules of their search: they were these.
_RULES_OF_0_1 = {
    "false_alarm_probability": 0.02,
    "log_evidence_margin": 3.0,
    "imitation_correlation": 0.6,
}


def phrase(template: str, macro: str, *values: Any) -> str:
    """A phrase of a template, on one line.

    Examples
    --------
    >>> phrase("diagnosis", "per_cent", 0.123), phrase("diagnosis", "per_cent", 1e-9)
    ('12 %', 'under 1 %')
    """
    return _on_one_line(_said(template, macro, values))


def sentences(template: str, macro: str, *values: Any) -> list[str]:
    """Sentences of a template, one an item.

    Examples
    --------
    >>> sentences("diagnosis", "block_means", {"readings_a_mean": 1})
    []
    """
    items = re.split(r"^\s*- ", _said(template, macro, values), flags=re.M)[1:]
    return [line for item in items if (line := _on_one_line(item))]


def _said(template: str, macro: str, values: Sequence[Any]) -> str:
    module: Any = _templates().get_template(f"{template}.txt").module
    return getattr(module, macro)(*values)


def _on_one_line(text: str) -> str:
    return re.sub(r"[ \n]+", " ", text).strip(" \n")


@cache
def _templates() -> Environment:
    environment = Environment(
        loader=PackageLoader("bayes_inertia.report", "words"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {
        "layout": LAYOUT,
        "NOTHING": NOTHING,
        "OPEN": OPEN_VERDICTS,
        "averaged_over": averaged_over,
        "rules": rules_of,
        "shares": probabilities,
    }
    environment.tests |= {"contains": operator.contains, "endswith": str.endswith}
    environment.filters |= {
        "arcsec": formatting.arcsec_text,
        "channel": formatting.channel_name,
        "either_or": formatting.either_or,
        "in_order": _in_order,
        "listed": formatting.listed,
        "p": formatting.probability,
        "plain": formatting.plain,
        "tenths": formatting.tenths,
        "two_digits": formatting.two_digits,
        "typeset": formatting.typeset,
        "unit": formatting.unit_text,
        "value": formatting.value_text,
        "vector": formatting.vector_text,
        "names": lambda names: formatting.listed([formatting.plain(name) for name in names]),
        "digits": format,
        "sentence": lambda text: text[:1].upper() + text[1:],
    }
    return environment


def rules_of(content: Mapping[str, Any]) -> Mapping[str, float]:
    """The rules that the search went by.

    Examples
    --------
    >>> rules_of({"rules": {"log_evidence_margin": 4.0}})["log_evidence_margin"]
    4.0
    """
    return _RULES_OF_0_1 | content.get("rules", {})


def probabilities(content: Mapping[str, Any]) -> list[tuple[str, float]]:
    """What of the ambiguous sets may be true, and how probable it is.

    Examples
    --------
    >>> probabilities({"alternatives": [
    ...     {"effect": "wheel_friction", "instead_of": "viscous_torque", "probability": 0.25}]})
    [('viscous torque', 0.75), ('wheel friction', 0.25)]
    """
    alternatives, plain = content["alternatives"], formatting.plain
    replaced = list(dict.fromkeys(a["instead_of"] for a in alternatives))
    rows: list[tuple[str, float]] = []
    for alternative in alternatives:
        effect = plain(alternative["effect"]) or "nothing"
        if len(replaced) > 1:
            effect += f" instead of {plain(alternative['instead_of'])}"
        rows.append((effect, alternative["probability"]))
    named = formatting.listed([plain(name) for name in replaced])
    return [(named, 1.0 - sum(p for _, p in rows)), *rows]


def _in_order(channels: Iterable[str]) -> list[str]:
    """Channels in the order of the usual ones, others behind them."""
    hit = set(channels)
    return [name for name in dict.fromkeys((*CHANNELS, *sorted(hit))) if name in hit]
