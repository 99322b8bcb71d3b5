"""Phrases on the answer of a diagnosis: how probable it is, and what is larger than it may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.report.formatting import listed, plain
from bayes_inertia.report.layout import LAYOUT


def beyond_prior_text(row: Mapping[str, Any]) -> str:
    """That an effect is larger than its prior allows.

    Examples
    --------
    >>> row = {"effect": "rate_bias", "parameter": "bias_x", "prior_sds": 12.7, "prior_scale": 16.0}
    >>> beyond_prior_text(row).split(":")[0]
    'The size of rate bias is 13 prior sd from its prior (bias x)'
    """
    return (
        f"The size of {plain(row['effect'])} is {row['prior_sds']:.2g} prior sd from its prior "
        f"({plain(row['parameter'])}): the prior is too narrow, or another cause that looks alike "
        f"is at work. It is fitted with its prior {row['prior_scale']:g} times as wide."
    )


def probabilities_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Probability of each answer, the most probable first.

    Examples
    --------
    >>> rows = [{"kind": "effects", "effects": ["rate_bias"], "probability": 0.97}]
    >>> rows += [{"kind": "nameless", "effects": [], "probability": 0.03}]
    >>> probabilities_text(rows)
    'How probable each answer is: rate bias 97 %; an unmodelled disturbance 3 %.'
    """
    told = [row for row in rows if row["probability"] > LAYOUT.negligible_probability][
        : LAYOUT.most_answers_told
    ]
    answers = [f"{answer_text(row)} {per_cent(row['probability'])}" for row in told]
    return f"How probable each answer is: {'; '.join(answers)}."


def answer_text(row: Mapping[str, Any]) -> str:
    """Answer of a hypothesis, in words.

    Examples
    --------
    >>> answer_text({"kind": "effects", "effects": ["rate_bias", "wheel_friction"]})
    'rate bias and wheel friction'
    """
    if row["kind"] == "nameless" and row["effects"]:
        names = [plain(name) for name in row["effects"]]
        return listed([*names, "something without a name"])
    words = {
        "nothing": "nothing is missing",
        "nameless": "an unmodelled disturbance",
        "others": "other effects",
    }
    return words.get(row["kind"]) or listed([plain(name) for name in row["effects"]])


def per_cent(probability: float) -> str:
    """A probability in print: no answer is certain, and none is impossible.

    Examples
    --------
    >>> per_cent(0.123), per_cent(0.9999), per_cent(1e-9)
    ('12 %', 'over 99 %', 'under 1 %')
    """
    if probability < 1.0 - LAYOUT.nearly_certain:
        return "under 1 %"
    return "over 99 %" if probability > LAYOUT.nearly_certain else f"{100.0 * probability:.0f} %"
