"""Plans as TOML files that an operator can read, with angles in degrees."""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_inertia.campaign.checked_toml import toml_document
from bayes_inertia.campaign.schema import DEGREE
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.files import read_bytes, text_of, write_atomically
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan, PlannedSlew

FORMAT = "bayes-inertia-plan/1"
# Key in the file -> field and factor to SI; a factor of None marks what is no single number.
_SLEW = {
    "axis": ("axis_B", None),
    "angle_deg": ("angle", DEGREE),
    "rate_deg_per_s": ("rate", DEGREE),
    "acceleration_deg_per_s2": ("acceleration", DEGREE),
    "profile": ("profile", None),
    "duration_s": ("duration", 1.0),
}
_ORBIT = {
    "radius_km": ("radius", 1e3),
    "inclination_deg": ("inclination", DEGREE),
    "node_deg": ("node", DEGREE),
    "argument_deg": ("argument", DEGREE),
}
_PLAN = {
    "name": ("name", None),
    "start_attitude": ("start_attitude", None),
    "wheel_momentum_Nms": ("wheel_momentum", None),
    **{
        f"{key}_s": (key, 1.0)
        for key in (
            "telemetry_period",
            "rest_before",
            "first_fix",
            "fix_spacing",
            "settle",
            "rest_after",
            "pause",
        )
    },
}
# Fields that are lists, and how long; None for any length.
_LIST_LENGTHS = {"axis_B": 3, "start_attitude": 4, "wheel_momentum": None}


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

    path = Path(path)
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
    if path.exists() and not overwrite and text_of(read_bytes(path), str(path)) != text:
        raise OutputError(
            "would overwrite another file", where=str(path), advice="choose another name"
        )
    return write_atomically(path, text)


def read_plan(path: str | Path) -> Plan:
    """The plan in a TOML file.

    Parameters
    ----------
    path : str or Path
        The file.

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
    label = str(path)
    text = text_of(read_bytes(Path(path)), label)
    document = toml_document(text, label)
    try:
        return _plan(document)
    except CampaignError as error:
        raise error.inside(label) from None


def _plan(document: dict[str, Any]) -> Plan:
    """The plan that a TOML document describes."""
    if document.pop("format", None) != FORMAT:
        raise CampaignError(
            "missing or of another version", where="key format", advice=f'write format = "{FORMAT}"'
        )
    slews, orbit = document.pop("slews", []), document.pop("orbit", None)
    if not isinstance(slews, list) or not all(isinstance(slew, dict) for slew in slews):
        raise CampaignError(
            "not a list of tables",
            where="key slews",
            advice="write [[slews]] and its keys below, once a slew",
        )
    fields = _fields(document, _PLAN, "", required=("name",), known=("format", "slews", "orbit"))
    if orbit is not None:
        fields["orbit"] = Orbit(**_fields(orbit, _ORBIT, "orbit."))
    planned = tuple(
        PlannedSlew(
            **_fields(
                slew, _SLEW, f"slews[{i + 1} of {len(slews)}].", required=("axis", "angle_deg")
            )
        )
        for i, slew in enumerate(slews)
    )
    return Plan(slews=planned, **fields)


def _fields(
    table: Any,
    keys: Mapping[str, tuple[str, float | None]],
    place: str,
    required: tuple[str, ...] = (),
    known: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Fields and their values in SI, from a table of the file at `place`."""
    if not isinstance(table, dict):
        raise CampaignError(
            "not a table of keys",
            where=f"key {place.rstrip('.')}",
            advice="write it as [table] with keys below",
        )
    for key in table:
        if key not in keys:
            raise _unknown_key(key, place, [*keys, *known])
    for key in required:
        if key not in table:
            raise CampaignError("missing key", where=f"key {place}{key}", advice="add it")
    return {
        keys[key][0]: _value(value, *keys[key], f"key {place}{key}") for key, value in table.items()
    }


def _unknown_key(key: str, place: str, known: list[str]) -> CampaignError:
    """The error for a key that is not known, with the nearest one that is."""
    near = difflib.get_close_matches(key, known, 1, 0.5)
    advice = f'did you mean "{near[0]}"?' if near else f"known here: {', '.join(known)}"
    return CampaignError("unknown key", where=f"key {place}{key}", advice=advice)


def _is_number(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    # A whole number may be too large for a float.
    return -sys.float_info.max <= value <= sys.float_info.max


def _value(value: Any, name: str, factor: float | None, where: str) -> Any:
    """The value of a field in SI."""
    if factor is not None:
        return _number(value, factor, where)
    if name in _LIST_LENGTHS:
        return _numbers(value, _LIST_LENGTHS[name], where)
    if not isinstance(value, str):
        raise CampaignError(f"{value!r} is not text", where=where, advice="write text in quotes")
    return value


def _number(value: Any, factor: float, where: str) -> float:
    """A number times its factor to SI."""
    if not _is_number(value):
        raise CampaignError(
            f"{value!r} is not a finite number",
            where=where,
            advice="write a number without quotes",
        )
    return math.radians(value) if factor == DEGREE else value * factor


def _numbers(value: Any, n: int | None, where: str) -> tuple[float, ...]:
    """A list of n numbers; of any length if n is None."""
    is_list = isinstance(value, list) and all(_is_number(x) for x in value)
    if not is_list or n not in (None, len(value)):
        raise CampaignError(
            f"{value!r} is not a list of {n or 'one or more'} numbers",
            where=where,
            advice="write [1.0, 0.0, ...]",
        )
    return tuple(float(x) for x in value)


def _table(part: Any, keys: Mapping[str, tuple[str, float | None]]) -> dict[str, Any]:
    """A plan, slew or orbit as keys and values of the file."""
    values = ((key, getattr(part, name), factor) for key, (name, factor) in keys.items())
    return {key: _file_value(value, factor) for key, value, factor in values if value is not None}


def _file_value(value: Any, factor: float | None) -> Any:
    """A value in the unit of the file, with the fewest digits that read back as the same number."""
    if factor is None:
        return list(value) if isinstance(value, tuple) else value
    in_unit = math.degrees(value) if factor == DEGREE else value / factor
    candidates = [float(f"{in_unit:.{digits}g}") for digits in range(6, 18)]
    exact = [
        x for x in candidates if (math.radians(x) if factor == DEGREE else x * factor) == value
    ]
    return (exact or candidates[-1:])[0]
