"""From the text of `campaign.toml` to its checked content, with errors that name the key."""

from __future__ import annotations

import difflib
import re
import reprlib
import tomllib
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from bayes_inertia.campaign.schema import CampaignPart
from bayes_inertia.errors import CampaignError


def parse_description(text: str, label: str) -> CampaignPart:
    """The content of a `campaign.toml`, every key checked.

    Parameters
    ----------
    text : str
        The content of the file.
    label : str
        The file, as messages name it.

    Returns
    -------
    CampaignPart
        What the file says.

    Raises
    ------
    CampaignError
        If it is no TOML (naming the line), or a key is unknown, missing, or of a wrong type or
        value (naming the key).

    Examples
    --------
    >>> parse_description('format = "bayes-inertia-campaign/1"\\nnmae = "x"', "campaign.toml")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: campaign.toml, key nmae: unknown key; did you mean "name"?
    """
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise _syntax_error(error, text, label) from error
    try:
        parsed = CampaignPart.model_validate(document)
    except ValidationError as error:
        problems: list[Any] = list(error.errors(include_url=False, include_context=False))
        raise _problem(min(problems, key=_urgency), document, label) from None
    _check_columns(parsed, label)
    return parsed


def _syntax_error(error: Exception, text: str, label: str) -> CampaignError:
    place = re.search(r"\(at (?:line (\d+), column \d+|end of document)\)", str(error))
    line = place[1] if place and place[1] else len(text.splitlines()) or 1
    where = f"{label}, line {line}" if place else label
    what = re.sub(r"\s*\(at .*\)$", "", str(error))
    if not isinstance(error, tomllib.TOMLDecodeError):
        what = "a number has too many digits, or lists are nested too deeply"
    return CampaignError(
        f"not valid TOML: {what[:1].lower()}{what[1:]}",
        where=where,
        advice="text needs quotes, keys no repetition, lists commas",
    )


def _urgency(problem: dict) -> tuple:
    # Another format explains every other problem, and a misspelt key explains a missing one.
    return problem["loc"] != ("format",), problem["type"] != "extra_forbidden", len(problem["loc"])


def _problem(problem: dict, document: dict, label: str) -> CampaignError:
    kind, loc, value = problem["type"], problem["loc"], problem["input"]
    key = str(loc[-1])
    if kind == "extra_forbidden":
        what, advice = "unknown key", _nearest_key(key, loc)
    elif kind == "missing":
        what, advice = _missing(key, loc)
    elif kind == "literal_error":
        choices = ", ".join(f'"{c}"' for c in _choices(loc))
        what, advice = (
            f"{reprlib.repr(value)} is not one of {choices}",
            _ADVICE_ON_SENSE.get(key, "write one of these exactly"),
        )
    else:
        what, advice = _wrong_type(kind, key, value, problem["msg"])
    return CampaignError(what, where=f"{label}, key {_path(loc, document)}", advice=advice)


_ADVICE_ON_SENSE = {
    "frame": "rotate the vectors into the inertial frame before they are stored",
    "relative_to": "subtract the body's own rate about the wheel axis first: "
    "momentum is spin inertia times speed RELATIVE to the body",
    "format": "this version of the package reads no other format",
}


def _missing(key: str, loc: tuple) -> tuple[str, str]:
    choices = _choices(loc)
    if choices:
        never = "" if key == "format" else ": units and senses are never guessed"
        return "missing key", f"add {key} = {' or '.join(f'"{c}"' for c in choices)}{never}"
    field = _fields_at(loc[:-1])[key]
    return "missing key", f"add {field.description}"


def _wrong_type(kind: str, key: str, value: Any, message: str) -> tuple[str, str]:
    shown = reprlib.repr(value)
    brackets = (
        'write a list in brackets, such as ["t_s"]'
        if key == "names"
        else "write numbers without quotes, in brackets where there are several"
    )
    brackets = f"write [[{key}]]" if key in ("wheels", "slews") else brackets
    length = message.replace("List", "the list").replace(" after validation", "")
    known = {
        "float_type": (f"{shown} is not a number", "write a number without quotes, such as 0.04"),
        "finite_number": (f"{shown} is not finite", "write a finite number"),
        "string_type": (f"{shown} is not text", 'write text in quotes, such as "slew 1"'),
        "bool_type": (f"{shown} is neither true nor false", "write true or false, without quotes"),
        "list_type": (f"{shown} is not a list", brackets),
        "too_short": (f"{shown} has too few elements", length),
        "too_long": (f"{shown} has too many elements", length),
        "model_type": (
            f"{shown} is not a table of keys",
            f"write [{key}] and its keys below, or {key} = {{ ... }}",
        ),
    }
    return known.get(kind, (f"{shown} is not accepted", message))


def _model_at(loc: tuple) -> type[BaseModel] | None:
    model: type[BaseModel] | None = CampaignPart
    for part in loc:
        if isinstance(part, str):
            known = {} if model is None else model.model_fields
            model = _inner_model(known[part].annotation) if part in known else None
    return model


def _fields_at(loc: tuple) -> dict[str, FieldInfo]:
    """The keys of the table at a place of the description; none if no table stands there."""
    model = _model_at(loc)
    return {} if model is None else model.model_fields


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    models = (_inner_model(inner) for inner in get_args(annotation))
    return next((model for model in models if model is not None), None)


def _choices(loc: tuple) -> tuple:
    field = _fields_at(loc[:-1]).get(str(loc[-1]))
    return tuple(c for c in get_args(field.annotation) if isinstance(c, str)) if field else ()


def _nearest_key(key: str, loc: tuple) -> str:
    known = list(_fields_at(loc[:-1]))
    lower = key.lower().replace("-", "_")
    words = sorted(lower.split("_"))
    near = [
        name for name in known if sorted(name.split("_")) == words
    ] or difflib.get_close_matches(lower, known, 1, 0.5)
    if near:
        return f'did you mean "{near[0]}"?'
    elsewhere = [
        part
        for part, field in CampaignPart.model_fields.items()
        if (m := _inner_model(field.annotation)) and lower in m.model_fields
    ]
    hint = f"it belongs to [{elsewhere[0]}]; " if elsewhere else ""
    return f"{hint}known here: {', '.join(known)}"


def _path(loc: tuple, document: Any) -> str:
    path, node = "", document
    for part in loc:
        if isinstance(part, str):
            path += f".{part}" if path else part
            node = node.get(part) if isinstance(node, dict) else None
            continue
        total = len(node) if isinstance(node, list) else 0
        node = node[part] if part < total else None
        name = node.get("name") if isinstance(node, dict) else None
        path += f".{name}" if isinstance(name, str) else f"[{part + 1} of {total}]"
    return path


def _check_columns(campaign: CampaignPart, label: str) -> None:
    """Refuse entries of `[columns]` that contradict each other or the hardware."""

    def refuse(key: str, what: str, advice: str):
        raise CampaignError(what, where=f"{label}, key columns.{key}", advice=advice)

    given = campaign.columns.given()
    if "wheel_momentum" in given and "wheel_speed" in given:
        refuse(
            "wheel_speed",
            "wheel_momentum is given too",
            "keep one of the two, they are the same measurement",
        )
    for key in ("wheel_torque", "wheel_momentum", "wheel_speed"):
        if key in given and len(given[key].names) != len(campaign.wheels):
            refuse(
                f"{key}.names",
                f"{len(given[key].names)} column(s) for {len(campaign.wheels)} [[wheels]]",
                "name one column a wheel, in the same order",
            )
    if "attitude" in given and campaign.star_tracker is None:
        refuse(
            "attitude",
            "attitude columns without a star tracker",
            "add [star_tracker] with its sigmas, or leave the columns out",
        )
    used: dict[str, str] = {}
    for key, entry in given.items():
        for name in entry.names:
            if name in used:
                refuse(
                    f"{key}.names",
                    f"the column {name!r} is already used by {used[name]}",
                    "name each column once",
                )
            used[name] = key
