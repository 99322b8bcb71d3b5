"""What is missing from the model? The verdict on the content of diagnosis.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.report.dirt_wording import dirt_sentences
from bayes_inertia.report.verdict import Level, Verdict
from bayes_inertia.report.words import phrase, sentences

_LEVELS: dict[str, Level] = {
    "consistent": "good",
    "named": "good",
    "ambiguous": "caution",
    "formula": "caution",
    "partial": "caution",
    "unknown": "bad",
}


def diagnosis_verdict(content: Mapping[str, Any]) -> Verdict:
    """What is missing, and what that means.

    Returns: the answer first, then where, how much, what to fly next, and what remains open.
    """
    reasons = sentences("diagnosis", "reasons", content, dirt_sentences(content.get("dirt", [])))
    return Verdict(_LEVELS[content["verdict"]], headline(content), tuple(reasons))


def in_brief(content: Mapping[str, Any]) -> list[str]:
    """What of a diagnosis a terminal shows: where, how much, what to fly next. The page has all."""
    return sentences("diagnosis", "brief", content)


def headline(content: Mapping[str, Any]) -> str:
    """The verdict of a diagnosis in one line.

    Examples
    --------
    >>> headline({"verdict": "consistent", "named": [], "ambiguous_with": []})
    'Nothing is missing that these slews show: the model explains the data.'
    """
    return phrase("diagnosis", "headline", content)
