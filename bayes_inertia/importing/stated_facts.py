"""What a file states itself is taken; where the mapping says otherwise, that is an error.

Units stand in rows of units and in attributes; CCSDS AEM states the columns, the form, the frames
and the direction of attitudes.
"""

from __future__ import annotations

import re
from typing import Any

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.attitude_forms import COLUMNS_OF_FORM, AttitudeConvention
from bayes_inertia.importing.mapping_schema import AttitudeStream
from bayes_inertia.importing.questions import question_at
from bayes_inertia.importing.unit_factors import unit_factor
from bayes_inertia.tables.raw_table import RawTable, is_inertial

# Names of frames as CCSDS (SANA registry) and ground systems write them, in capitals.
_BODY = re.compile(r"(SC|SPACECRAFT)_?(BODY|FRAME)?(_\d+)?|BODY.*|S/C.*")
_TRACKER = re.compile(r"(STAR_?TRACKER|STR|ST|AST|INSTRUMENT|STARTRACKER).*")


def agreed(stated: Any, mapped: Any, where: str, file: str) -> Any:
    """What the file or the mapping says, or an error if they say different things.

    `stated`: what the file says; "" or None where it says nothing. `mapped`: what the mapping says;
    "", None or empty where it says nothing.

    Examples
    --------
    >>> agreed("last", None, "m.toml, key scalar", "a.aem")
    'last'
    """
    if not stated:
        return mapped
    if mapped and mapped != stated:
        raise CampaignError(
            f"{mapped!r} contradicts the file {file}, which states {stated!r}",
            where=where,
            advice="leave the key out to take what the file states, or correct the file",
        )
    return stated


def agreed_unit(table: RawTable, name: str, quantity: str, mapped: str, where: str) -> str:
    """The unit of a column.

    `mapped`: the unit that the mapping states; "" where it states none.
    """
    stated = table.column(name).unit
    if not mapped and not stated:
        path = tuple(where.rpartition(", key ")[2].split("."))
        raise CampaignError(
            "missing key",
            where=f"{where}.unit",
            advice=f'add unit = "...": units are never guessed. {question_at((*path, "unit"))}',
        )
    if not mapped:
        _factor(quantity, stated, f"{table.label}, column {name}")
        return stated
    factor = _factor(quantity, mapped, f"{where}.unit")
    try:
        differs = bool(stated) and abs(unit_factor(quantity, stated) / factor - 1.0) > 1e-9
    except CampaignError:  # Such as "counts": the file states no unit of this quantity.
        differs = False
    if differs:
        agreed(stated, mapped, f"{where}.unit", f"{table.label} (column {name})")
    return mapped


def _factor(quantity: str, unit: str, where: str) -> float:
    try:
        return unit_factor(quantity, unit)
    except CampaignError as error:
        raise CampaignError(f"{unit!r} {error.what}", where=where, advice=error.advice) from None


def agreed_attitude(
    table: RawTable, part: AttitudeStream, where: str
) -> tuple[list[str], AttitudeConvention, bool]:
    """The columns of the attitudes of a table and what they mean.

    Returns `of_tracker`: whether the attitudes are those of the tracker's axes, not of the body's.
    """
    says = stated_attitude(table)
    unit = _angle_unit(table, part, says, where)

    def value(key: str) -> Any:
        mapped = getattr(part, key)
        mapped = mapped.lower() if key == "sequence" else mapped
        both = agreed(says.get(key), mapped, f"{where}.{key}", table.label)
        if not both:
            raise _unanswered(key, where)
        return both

    form = value("form")
    names = list(value("names"))
    if len(names) != COLUMNS_OF_FORM[form]:
        raise CampaignError(
            f"{len(names)} columns for the form {form!r}",
            where=f"{where}.names",
            advice=f"name {COLUMNS_OF_FORM[form]} columns in their order",
        )
    euler = form == "euler"
    convention = AttitudeConvention(
        form,
        value("maps"),
        scalar=value("scalar") if form == "quaternion" else "last",
        sequence=value("sequence") if euler else "",
        turns=value("turns") if euler else "intrinsic",
        radians=_factor("angle", unit, f"{where}.unit") if euler else 1.0,
    )
    of_tracker = value("frame") == "tracker"
    if of_tracker and part.body_from_tracker is None:
        raise _unanswered("body_from_tracker", where)
    return names, convention, of_tracker


def _unanswered(key: str, where: str) -> CampaignError:
    question = question_at(("streams", "attitude", key))
    return CampaignError("missing key", where=f"{where}.{key}", advice=f"add it: {question}")


def _angle_unit(table: RawTable, part: AttitudeStream, says: dict[str, Any], where: str) -> str:
    """Unit of Euler angles; "" for other forms."""
    if (says.get("form") or part.form) != "euler":
        return ""
    if says.get("unit"):
        return str(agreed(says["unit"], part.unit, f"{where}.unit", table.label))
    first = (part.names or says.get("names") or [""])[0]
    return agreed_unit(table, first, "angle", part.unit, where)


def stated_attitude(table: RawTable) -> dict[str, Any]:
    """What a file states of its attitudes, in the keys of a mapping."""
    stated = table.attitude
    if stated is None:
        return {}
    start, end = stated.from_frame.upper(), stated.to_frame.upper()
    says: dict[str, Any] = {
        "names": list(stated.names),
        "form": "quaternion" if stated.scalar else "euler",
        "scalar": stated.scalar,
        "sequence": stated.sequence.lower(),
        "turns": "intrinsic" if stated.sequence else "",
        "unit": stated.angle_unit,
    }
    if is_inertial(start):
        return says | {"maps": "inertial_to_body", "frame": _frame(end)}
    if is_inertial(end):
        return says | {"maps": "body_to_inertial", "frame": _frame(start)}
    raise CampaignError(
        f"the attitudes are between the frames {stated.from_frame} and {stated.to_frame}, "
        "of which none is inertial",
        where=table.label,
        advice="export the attitude relative to inertial axes, such as EME2000 or ICRF",
    )


def _frame(name: str) -> str:
    """What a frame of the spacecraft is; "" if its name does not say it."""
    if _BODY.fullmatch(name):
        return "body"
    return "tracker" if _TRACKER.fullmatch(name) else ""
