"""Keys, values and comments of a mapping as text."""

from __future__ import annotations

import textwrap
from typing import Any

import tomlkit

from bayes_inertia.importing.questions import open_questions, question_at

_WIDTH = 96  # Of a comment.


def mapping_value(value: Any) -> str:
    """A value as TOML writes it on one line.

    Examples
    --------
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
    """A comment in lines of the usual width.

    Examples
    --------
    >>> mapping_comment("as drawn")
    '# as drawn'
    """
    return "\n".join(f"# {line}" for line in textwrap.wrap(text, _WIDTH))


def mapping_entry(path: tuple[str, ...], value: Any, comment: str = "", hint: str = "") -> str:
    """One key, with its question above where it is open.

    Examples
    --------
    >>> print(mapping_entry(("streams", "attitude", "unit"), "?", hint="It reads 1 to 9."))
    # Which unit: deg or rad? It reads 1 to 9.
    unit = "?"
    """
    text = f"{path[-1]} = {mapping_value(value)}"
    if open_questions({"value": value}):
        return f"{mapping_comment(f'{question_at(path)} {hint}')}\n{text}"
    return f"{text}  # {comment}" if comment else text
