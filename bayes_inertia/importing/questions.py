"""Questions on raw logs that only the user can answer, and how a mapping asks them.

A mapping that `import --start` writes has "?" at each of these keys, with the question beside it.
An import with a "?" left repeats the question.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import tomlkit

from bayes_inertia.campaign.checked_toml import table_label
from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import vocabulary
from bayes_inertia.importing.limits import LIMITS

UNKNOWN = "?"
"""What stands in a mapping where the user must answer."""

QUESTIONS: Mapping[str, str] = vocabulary("importing")["questions"]
"""The question at each key; a key of one stream goes before that of all."""


def question_at(path: tuple[str, ...]) -> str:
    """The question at a key of a mapping, tables in lists by their label; else a general one.

    >>> question_at(("streams", "attitude", "form"))
    '"quaternion", "euler", "dcm" or "mrp"?'
    """
    short = (path[0], *path[2:]) if path[0] in ("streams", "wheels") else path
    for candidate in (path, short):
        if ".".join(candidate) in QUESTIONS:
            return QUESTIONS[".".join(candidate)]
    return f"What is {path[-1]}?"


def require_answer(answer: Any, path: tuple[str, ...], where: str) -> None:
    """Ask the question of a key of a table at `where` that neither file nor mapping answers."""
    require(bool(answer), f"{where}.{path[-1]}", "missing key", f"add it: {question_at(path)}")


def refuse_open_questions(document: dict[str, Any], label: str) -> None:
    """Raise an error if a mapping has a question left open."""
    paths = open_questions(document)
    if not paths:
        return
    more = f" ({len(paths) - 1} more keys have a question)" if len(paths) > 1 else ""
    what = "the question is open"
    advice = f"write the answer in the place of {UNKNOWN!r}{more}. {question_at(paths[0])}"
    raise CampaignError(what, where=f"{label}, key {'.'.join(paths[0])}", advice=advice)


def open_questions(value: Any, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Paths of all keys whose value is, or holds, a "?".

    >>> open_questions({"a": {"b": ["?", 1]}, "c": 1})
    [('a', 'b')]
    """
    if isinstance(value, dict):
        return [p for key, inner in value.items() for p in open_questions(inner, (*path, key))]
    if isinstance(value, list):
        if any(isinstance(inner, dict) for inner in value):
            labels = [table_label(inner) or str(k + 1) for k, inner in enumerate(value)]
            parts = zip(labels, value, strict=True)
            return [p for label, x in parts for p in open_questions(x, (*path, label))]
        return [path] if any(open_questions(inner) for inner in value) else []
    return [path] if value == UNKNOWN else []


def mapping_value(value: Any) -> str:
    """A value as TOML writes it on one line.

    >>> mapping_value({"names": ["t"], "kind": "utc"})
    '{ names = ["t"], kind = "utc" }'
    """
    if isinstance(value, dict):
        inner = ", ".join(f"{key} = {mapping_value(inner)}" for key, inner in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(mapping_value(inner) for inner in value)}]"
    return tomlkit.item(value).as_string()


def mapping_comment(text: str) -> str:
    """A comment in lines of the usual width."""
    return "\n".join(f"# {line}" for line in textwrap.wrap(text, LIMITS.comment_width))


def mapping_entry(path: tuple[str, ...], value: Any, comment: str = "", hint: str = "") -> str:
    """One key, with its question above where it is open.

    >>> print(mapping_entry(("streams", "attitude", "unit"), "?", hint="It reads 1 to 9."))
    # Which unit: deg or rad? It reads 1 to 9.
    unit = "?"
    """
    text = f"{path[-1]} = {mapping_value(value)}"
    if open_questions({"value": value}):
        return f"{mapping_comment(f'{question_at(path)} {hint}')}\n{text}"
    return f"{text}  # {comment}" if comment else text
