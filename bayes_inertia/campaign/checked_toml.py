"""From the text of a TOML file to its checked content, with errors that name the key.

The form of the file is a pydantic model. Descriptions of its fields are what messages advise.
"""

from __future__ import annotations

import difflib
import re
import reprlib
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.schema import UNITS, UnitOf
from bayes_inertia.errors import CampaignError


def parse_toml[Form: BaseModel](text: str, label: str, form: type[Form]) -> Form:
    """The content of a TOML file, every key checked; tables of several forms differ in one key."""
    return checked_document(toml_document(text, label), label, form)


def toml_document(text: str, label: str) -> dict[str, Any]:
    """The content of a TOML file, its keys not yet checked."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise _syntax_error(error, text, label) from error


def checked_document[Form: BaseModel](
    document: dict[str, Any], label: str, form: type[Form]
) -> Form:
    """The content of a TOML file in its form."""
    try:
        return formed(document, form)
    except CampaignError as error:
        raise error.inside(label) from None


def formed[Form: BaseModel](document: dict[str, Any], form: type[Form]) -> Form:
    """A document in its form; errors do not know the file."""
    try:
        return form.model_validate(document)
    except ValidationError as error:
        problems: list[Any] = list(error.errors(include_url=False))
        raise _Wording(form, document).error(min(problems, key=_urgency)) from None


def _syntax_error(error: Exception, text: str, label: str) -> CampaignError:
    place = re.search(r"\(at (?:line (\d+), column \d+|end of document)\)", str(error))
    line = place[1] if place and place[1] else len(text.splitlines()) or 1
    where = f"{label}, line {line}" if place else label
    what = re.sub(r"\s*\(at .*\)$", "", str(error))
    if not isinstance(error, tomllib.TOMLDecodeError):
        what = "a number has too many digits, or lists are nested too deeply"
    what = f"not valid TOML: {what[:1].lower()}{what[1:]}"
    advice = "text needs quotes, keys no repetition, lists commas"
    return CampaignError(what, where=where, advice=advice)


def _urgency(problem: dict) -> tuple:
    # Another format explains every other problem, and a misspelt key explains a missing one.
    return problem["loc"] != ("format",), problem["type"] != "extra_forbidden", len(problem["loc"])


_ADVICE_ON_SENSE = {
    "frame": "rotate the vectors into the {} frame before they are stored",
    "relative_to": "subtract the body's own rate about the wheel axis first: "
    "momentum is spin inertia times speed RELATIVE to the body",
    "format": "this version of the package reads no other format",
}


_LISTS = ("wheels", "slews", "streams", "sensors", "actuators", "environment", "changes")


def _wrong_type(kind: str, key: str, value: Any, message: str) -> tuple[str, str]:
    shown = reprlib.repr(value)
    brackets = "write numbers without quotes, in brackets where there are several"
    if key == "names":
        brackets = 'write a list in brackets, such as ["t_s"]'
    elif key in _LISTS:
        brackets = f"write [[{key}]]"
    length = message.replace("List", "the list").replace(" after validation", "")
    known = {
        "float_type": (f"{shown} is not a number", "write a number without quotes, such as 0.04"),
        "finite_number": (f"{shown} is not finite", "write a finite number"),
        "less_than": (
            f"{shown} is too large",
            message.replace("Input should be", "write a number"),
        ),
        "greater_than": (f"{shown} is not positive", "write a positive number"),
        "greater_than_equal": (f"{shown} is negative", "write 0 or more"),
        "string_type": (f"{shown} is not text", 'write text in quotes, such as "slew 1"'),
        "bool_type": (f"{shown} is neither true nor false", "write true or false, without quotes"),
        "list_type": (f"{shown} is not a list", brackets),
        "too_short": (f"{shown} has too few elements", length),
        "too_long": (f"{shown} has too many elements", length),
    }
    known["model_type"] = known["dict_type"] = (
        f"{shown} is not a table of keys",
        f"write [{key}] and its keys below, or {key} = {{ ... }}",
    )
    return known.get(kind, (f"{shown} is not accepted", message))


@dataclass(frozen=True)
class _Wording:
    """Words for a problem of a document that should have a form."""

    form: type[BaseModel]
    document: dict[str, Any]

    def error(self, problem: dict) -> CampaignError:
        """The error that names the key of a problem that pydantic reports."""
        kind, loc, value = problem["type"], problem["loc"], problem["input"]
        if kind in ("union_tag_not_found", "union_tag_invalid"):
            # What tells the forms apart is a key like any other.
            key = problem["ctx"]["discriminator"].strip("'")
            loc, value = (*loc, key), problem["ctx"].get("tag")
            kind = "missing" if kind == "union_tag_not_found" else "literal_error"
        key = str(loc[-1])
        if kind == "extra_forbidden":
            what, advice = "unknown key", self._nearest_key(key, loc)
        elif kind == "missing":
            what, advice = self._missing(key, loc)
        elif kind == "literal_error":
            choices = self._choices(loc)
            what = f"{reprlib.repr(value)} is not one of {', '.join(f'"{c}"' for c in choices)}"
            # Where there is no choice, the data must change.
            only = _ADVICE_ON_SENSE.get(key, "") if len(choices) == 1 else ""
            advice = only.format(*choices) or "write one of these exactly"
        else:
            what, advice = _wrong_type(kind, key, value, problem["msg"])
        return CampaignError(what, where=f"key {self._path(loc)}", advice=advice)

    def _missing(self, key: str, loc: tuple) -> tuple[str, str]:
        choices = self._choices(loc)
        if choices:
            never = "" if key == "format" else ": units and senses are never guessed"
            return "missing key", f"add {key} = {' or '.join(f'"{c}"' for c in choices)}{never}"
        return "missing key", f"add {self._fields(loc)[key].description}"

    def _forms_at(self, loc: tuple) -> list[type[BaseModel]]:
        """The forms that the table at a place may have; none if no table stands there."""
        forms: list[type[BaseModel]] = [self.form]
        for part in loc:
            if isinstance(part, int):
                continue
            chosen = [form for form in forms if _is_tag(part, form)]
            if len(forms) > 1 and chosen:
                forms = chosen
                continue
            known = {} if not forms else forms[0].model_fields
            forms = _inner_forms(known[part].annotation) if part in known else []
        return forms

    def _fields(self, loc: tuple) -> dict[str, FieldInfo]:
        """The keys of the table that holds the key at a place."""
        forms = self._forms_at(loc[:-1])
        return forms[0].model_fields if forms else {}

    def _choices(self, loc: tuple) -> tuple[str, ...]:
        key = str(loc[-1])
        forms = self._forms_at(loc[:-1])
        fields = [form.model_fields[key] for form in forms if key in form.model_fields]
        parts = (part for x in fields for part in (*get_args(x.annotation), *x.metadata))
        return tuple(dict.fromkeys(_literals(parts)))

    def _nearest_key(self, key: str, loc: tuple) -> str:
        known = list(self._fields(loc))
        other: Mapping[str, str] = getattr(self.form, "other_format", {})
        if len(loc) == 1 and key in other:
            return other[key]
        elsewhere = [
            _table_of(part, form)
            for part, field in self.form.model_fields.items()
            for form in _inner_forms(field.annotation)
            if _plain_key(key) in form.model_fields
        ]
        hint = f"it belongs to {elsewhere[0]}; " if elsewhere else ""
        return advice_on_key(key, known, hint)

    def _path(self, loc: tuple) -> str:
        path = ""
        node: Any = self.document
        for k, part in enumerate(loc):
            if isinstance(part, str):
                if len(self._forms_at(loc[:k])) > 1 and k + 1 < len(loc):
                    continue  # a tag: the path names the table by it already
                path += f".{part}" if path else part
                node = node.get(part) if isinstance(node, dict) else None
                continue
            total = len(node) if isinstance(node, list) else 0
            node = node[part] if part < total else None
            label = table_label(node)
            path += f".{label}" if label else f"[{part + 1} of {total}]"
        return path


def advice_on_key(key: str, known: Sequence[str], otherwise: str = "") -> str:
    """The known key that an unknown one comes near to, else all that are known.

    >>> advice_on_key("tracker-star", ["gyro", "star_tracker"]), advice_on_key("x", ["gyro"])
    ('did you mean "star_tracker"?', 'known here: gyro')
    """
    lower = _plain_key(key)
    words = sorted(lower.split("_"))
    near = [
        name for name in known if sorted(name.split("_")) == words
    ] or difflib.get_close_matches(lower, known, 1, LIMITS.misspelt)
    return f'did you mean "{near[0]}"?' if near else f"{otherwise}known here: {', '.join(known)}"


def _plain_key(key: str) -> str:
    return key.lower().replace("-", "_")


def table_label(table: Any) -> str:
    """Label of a table that is one of several: its name, or its content."""
    if not isinstance(table, dict):
        return ""
    label = table.get("name", table.get("holds"))
    return label if isinstance(label, str) else ""


def _table_of(part: str, form: type[BaseModel]) -> str:
    """The header of a table, with the key that tells its form from others."""
    for tag in ("type", "holds"):
        if tag in form.model_fields:
            return f'[[{part}]] with {tag} = "{get_args(form.model_fields[tag].annotation)[0]}"'
    return f"[{part}]"


def _is_tag(part: str, form: type[BaseModel]) -> bool:
    """Whether a word is what tells a form from others."""
    return any(part in get_args(field.annotation) for field in form.model_fields.values())


def _literals(parts: Iterable[Any]) -> Iterator[str]:
    """The words that parts of an annotation accept."""
    for part in parts:
        if isinstance(part, str):
            yield part
        elif isinstance(part, UnitOf):
            yield from UNITS[part.quantity]
        else:
            yield from _literals(get_args(part))


def _inner_forms(annotation: Any) -> list[type[BaseModel]]:
    """The forms of tables that an annotation allows."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [form for inner in get_args(annotation) for form in _inner_forms(inner)]
