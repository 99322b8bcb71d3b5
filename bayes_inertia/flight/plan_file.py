"""Plans as TOML files that an operator can read, with angles in degrees."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Len
from pydantic import Field, create_model

from bayes_inertia.campaign.checked_toml import parse_toml
from bayes_inertia.campaign.description import stated_keys
from bayes_inertia.campaign.schema import DEGREE, Part, Vector3
from bayes_inertia.errors import CampaignError, OutputError, require, require_kind
from bayes_inertia.files import path_of, read_bytes, text_of, write_atomically
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan, PlannedSlew, times_left_out

FORMAT = "bayes-inertia-plan/1"
_POSITIVE, _FROM_ZERO = Annotated[float, Gt(0.0)], Annotated[float, Ge(0.0)]
# Key in the file -> field, factor to SI and type; a factor of None marks what is no single number.
_Keys = Mapping[str, tuple[str, float | None, Any]]
_SLEW: _Keys = {
    "axis": ("axis_B", None, Vector3),
    "angle_deg": ("angle", DEGREE, _POSITIVE),
    "rate_deg_per_s": ("rate", DEGREE, _POSITIVE),
    "acceleration_deg_per_s2": ("acceleration", DEGREE, _POSITIVE),
    "profile": ("profile", None, str),
    "duration_s": ("duration", 1.0, _POSITIVE),
}
_ORBIT: _Keys = {
    "radius_km": ("radius", 1e3, float),
    "inclination_deg": ("inclination", DEGREE, float),
    "node_deg": ("node", DEGREE, float),
    "argument_deg": ("argument", DEGREE, float),
}
_PLAN: _Keys = {
    "name": ("name", None, str),
    "start_attitude": ("start_attitude", None, Annotated[list[float], Len(4, 4)]),
    "wheel_momentum_Nms": ("wheel_momentum", None, list[float]),
    "fixes_in_motion": ("fixes_in_motion", None, bool),
    "telemetry_period_s": ("telemetry_period", 1.0, _POSITIVE),
    "rest_before_s": ("rest_before", 1.0, _POSITIVE),
    "first_fix_s": ("first_fix", 1.0, _FROM_ZERO),
    "fix_spacing_s": ("fix_spacing", 1.0, _POSITIVE),
    "settle_s": ("settle", 1.0, _POSITIVE),
    "rest_after_s": ("rest_after", 1.0, _POSITIVE),
    "pause_s": ("pause", 1.0, _FROM_ZERO),
}
# In errors, by the name of a field.
_KEYS_OF_FIELDS = {field: key for keys in (_PLAN, _SLEW) for key, (field, *_) in keys.items()}


def _form(name: str, keys: _Keys, required: dict[str, str], **tables: Any) -> Any:
    """The form of a table of the file; `required`: what to add where such a key is missing."""
    fields: dict[str, Any] = {key: (kind | None, None) for key, (*_, kind) in keys.items()}
    fields |= {key: (keys[key][-1], Field(description=says)) for key, says in required.items()}
    return create_model(name, __base__=Part, **(fields | tables))


_SlewForm = _form(
    "PlannedSlew",
    _SLEW,
    {
        "axis": "axis = the axis of the slew in body axes, such as [1.0, 0.0, 0.0]",
        "angle_deg": "angle_deg = the angle of the slew [deg]",
    },
)
_PlanForm = _form(
    "Plan",
    _PLAN,
    {"name": 'name = "..."'},
    format=(Literal["bayes-inertia-plan/1"], ...),
    slews=(GenericAlias(list, _SlewForm), []),
    orbit=(_form("Orbit", _ORBIT, {}) | None, None),
)


def write_plan(plan: Plan, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a plan as TOML that `read_plan` reads back.

    Angles go through degrees, so they agree to rounding.

    Parameters
    ----------
    plan : Plan
        What to write.
    path : str or Path
        The file.
    overwrite : bool
        Whether another file of this name may be replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If another file is in the way and not to be overwritten.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> with TemporaryDirectory() as folder:
    ...     path = write_plan(paper_like_plan(), Path(folder, "plan.toml"))
    ...     read_plan(path) == paper_like_plan()
    True
    """
    import tomlkit

    require_kind(plan, Plan, "plan")
    path = path_of(path, "path")
    document = tomlkit.document()
    document["format"] = FORMAT
    document.add(tomlkit.comment("Quaternions: inertial to body, scalar last. Axes in body axes."))
    for key, value in _table(plan, _PLAN).items():
        document[key] = value
    if plan.orbit is not None:
        document["orbit"] = _table(plan.orbit, _ORBIT)
    slews = tomlkit.aot()
    for slew in plan.slews:
        slews.append(tomlkit.item(_table(slew, _SLEW)))
    document["slews"] = slews
    text = tomlkit.dumps(document)
    other = path.exists() and not overwrite and text_of(read_bytes(path), str(path)) != text
    what, advice = "would overwrite another file", "choose another name"
    require(not other, str(path), what, advice, error=OutputError)
    return write_atomically(path, text)


def read_plan(path: str | Path, base: Plan | None = None) -> Plan:
    """The plan in a TOML file.

    Parameters
    ----------
    path : str or Path
        The file.
    base : Plan, optional
        Start, telemetry, rests and orbit where the file leaves them out; None for those of `Plan`.
        Left-out times fit the stated ones: whole periods, the first fix at most half the rest.

    Returns
    -------
    Plan
        What it says, angles in radians.

    Raises
    ------
    CampaignError
        If anything is unknown, missing, of the wrong type or impossible; it names the line or key.

    Examples
    --------
    >>> read_plan("no/such/plan.toml")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no/such/plan.toml: cannot be read ...
    """
    require_kind(base, Plan | None, "base")
    path = path_of(path, "path")
    label = str(path)
    stated = parse_toml(text_of(read_bytes(path), label), label, _PlanForm)
    given = _fields(stated, _PLAN)
    try:
        if stated.orbit is not None:
            given["orbit"] = Orbit(**_fields(stated.orbit, _ORBIT))
        given["slews"] = tuple(
            _slew(form, f"slews[{i} of {len(stated.slews)}]")
            for i, form in enumerate(stated.slews, 1)
        )
        given |= times_left_out(base, given)
        return Plan(**given) if base is None else replace(base, **given)
    except CampaignError as error:
        where = re.sub(r"\w+$", _key, error.where)
        # Of one word, such as "rate", are words of every sentence.
        what, advice = (re.sub(r"\w+_\w+", _key, text) for text in (error.what, error.advice))
        raise CampaignError(what, where=f"{label}, {where}", advice=advice) from None


def _key(field: re.Match[str]) -> str:
    """How the file calls what is named here."""
    return _KEYS_OF_FIELDS.get(field[0], field[0])


def _slew(form: Any, place: str) -> PlannedSlew:
    """A slew of the file; errors name its place there."""
    try:
        return PlannedSlew(**_fields(form, _SLEW))
    except CampaignError as error:
        where = error.where.replace("slews", place)
        raise CampaignError(error.what, where=where, advice=error.advice) from None


def _fields(form: Any, keys: _Keys) -> dict[str, Any]:
    """Fields and their values in SI, of a table of the file."""
    said = {key: value for key, value in stated_keys(form).items() if key in keys}
    return {keys[key][0]: _si(value, keys[key][1]) for key, value in said.items()}


def _si(value: Any, factor: float | None) -> Any:
    """A value of the file in SI; lists as tuples."""
    if factor is None:
        return tuple(value) if isinstance(value, list) else value
    return math.radians(value) if factor == DEGREE else value * factor


def _table(part: Any, keys: _Keys) -> dict[str, Any]:
    """A plan, slew or orbit as keys and values of the file."""
    values = ((key, getattr(part, name), factor) for key, (name, factor, _) in keys.items())
    said = (row for row in values if row[1] is not None)
    return {key: _file_value(value, factor) for key, value, factor in said}


def _file_value(value: Any, factor: float | None) -> Any:
    """A value in the unit of the file, with the fewest digits that read back as the same number."""
    if factor is None:
        return list(value) if isinstance(value, tuple) else value
    in_unit = math.degrees(value) if factor == DEGREE else value / factor
    candidates = [float(f"{in_unit:.{digits}g}") for digits in range(6, 18)]
    exact = [x for x in candidates if _si(x, factor) == value]
    return (exact or candidates[-1:])[0]
