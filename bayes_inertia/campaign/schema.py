"""The form of `campaign.toml`, and error messages that say which key is wrong and what it should be."""

from __future__ import annotations

import difflib
import re
import reprlib
import tomllib
from typing import Annotated, Any, Literal, get_args

from annotated_types import Len
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from bayes_inertia.campaign.units import UNITS
from bayes_inertia.errors import CampaignError

FORMAT = "bayes-inertia-campaign/1"


def _spread(value: Any) -> Any:
    return [value] * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


Vector3 = Annotated[list[float], Len(3, 3)]
Matrix33 = Annotated[list[Vector3], Len(3, 3)]
OneOrThree = Annotated[Vector3, BeforeValidator(_spread)]
Names = Annotated[list[str], Len(1)]
Names1 = Annotated[list[str], Len(1, 1)]
Names3 = Annotated[list[str], Len(3, 3)]
Names4 = Annotated[list[str], Len(4, 4)]
# The accepted units are those of the table, so that adding one there is enough.
TimeUnit = Literal[tuple(UNITS["time"])]
TorqueUnit = Literal[tuple(UNITS["wheel_torque"])]
MomentumUnit = Literal[tuple(UNITS["wheel_momentum"])]
SpeedUnit = Literal[tuple(UNITS["wheel_speed"])]
RateUnit = Literal[tuple(UNITS["rate"])]
FieldUnit = Literal[tuple(UNITS["magnetic_field"])]
PositionUnit = Literal[tuple(UNITS["position"])]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class InertiaPart(_Part):
    """`[inertia]`: what was known before flight."""

    tensor: Matrix33 = Field(description="tensor = three rows of three numbers [kg m^2]")
    relative_sigma: float = Field(
        description="relative_sigma = the sd of each diagonal element, as a fraction of it, such as 0.04"
    )
    product_sigma: float = Field(
        description="product_sigma = the sd of each product of inertia [kg m^2]"
    )
    includes_wheel_spin: bool = Field(
        description="includes_wheel_spin = true if the tensor includes the wheels' spin inertia, false if not"
    )


class WheelPart(_Part):
    """One `[[wheels]]`."""

    name: str = Field(description='name = "..."')
    axis: Vector3 = Field(
        description="axis = the unit spin axis in body axes, such as [1.0, 0.0, 0.0]"
    )
    spin_inertia: float = Field(
        description="spin_inertia = the inertia about the spin axis [kg m^2]"
    )
    max_torque: float | None = None
    max_momentum: float | None = None
    momentum_sigma: float | None = None


class RateSensorPart(_Part):
    """`[rate_sensor]`: only `sigma` has no default."""

    sigma: OneOrThree = Field(
        description="sigma = the white noise per sample [rad/s], one number or three"
    )
    axes: Matrix33 | None = None
    range: float | None = None
    scale_factor: OneOrThree | None = None
    scale_factor_sigma: OneOrThree | None = None
    bias: OneOrThree | None = None
    bias_sigma: OneOrThree | None = None


class StarTrackerPart(_Part):
    """`[star_tracker]`."""

    boresight: Vector3 = Field(description="boresight = a unit vector in body axes")
    sigma_cross: float = Field(description="sigma_cross = the noise across the boresight [rad]")
    sigma_roll: float = Field(description="sigma_roll = the noise about the boresight [rad]")


class TimeColumn(_Part):
    """`time` of `[columns]`."""

    names: Names1 = Field(description='names = ["..."], one column')
    unit: TimeUnit


class TorqueColumns(_Part):
    """`wheel_torque` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: TorqueUnit
    acts_on: Literal["wheel", "body"]


class MomentumColumns(_Part):
    """`wheel_momentum` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: MomentumUnit
    relative_to: Literal["body"]


class SpeedColumns(_Part):
    """`wheel_speed` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: SpeedUnit
    relative_to: Literal["body"]


class RateColumns(_Part):
    """`rate` of `[columns]`: one column a sensor axis."""

    names: Names3 = Field(description='names = ["...", "...", "..."], one column a sensor axis')
    unit: RateUnit


class AttitudeColumns(_Part):
    """`attitude` of `[columns]`: a quaternion, with the place of its scalar and its sense."""

    names: Names4 = Field(
        description='names = ["...", "...", "...", "..."], the four elements of the quaternion'
    )
    scalar: Literal["first", "last"]
    maps: Literal["inertial_to_body", "body_to_inertial"]


class MagneticFieldColumns(_Part):
    """`magnetic_field` of `[columns]`."""

    names: Names3 = Field(description='names = ["...", "...", "..."], along the inertial axes')
    unit: FieldUnit
    frame: Literal["inertial"]


class PositionColumns(_Part):
    """`position` of `[columns]`."""

    names: Names3 = Field(description='names = ["...", "...", "..."], along the inertial axes')
    unit: PositionUnit
    frame: Literal["inertial"]


class ColumnsPart(_Part):
    """`[columns]`: which columns of the tables hold what, in which unit and sense."""

    time: TimeColumn = Field(description='time = { names = ["..."], unit = "s" }')
    rate: RateColumns = Field(
        description='rate = { names = ["...", "...", "..."], unit = "rad/s" }'
    )
    wheel_torque: TorqueColumns | None = None
    wheel_momentum: MomentumColumns | None = None
    wheel_speed: SpeedColumns | None = None
    attitude: AttitudeColumns | None = None
    magnetic_field: MagneticFieldColumns | None = None
    position: PositionColumns | None = None

    def given(self) -> dict[str, Any]:
        """The entries that the campaign has, by key."""
        return {
            key: entry
            for key in type(self).model_fields
            if (entry := getattr(self, key)) is not None
        }


class SlewPart(_Part):
    """One `[[slews]]`."""

    name: str = Field(description='name = "..."')
    file: str = Field(description='file = the table of the slew, such as "slew_01.csv"')
    start: float = Field(description="start = the time of the first row in the campaign [s]")
    axis: Vector3 | None = None
    angle_deg: float | None = None


class CampaignPart(_Part):
    """The whole of `campaign.toml`."""

    format: Literal["bayes-inertia-campaign/1"]
    name: str = Field(description='name = "..."')
    inertia: InertiaPart = Field(
        description="[inertia] with tensor, relative_sigma, product_sigma, includes_wheel_spin"
    )
    rate_sensor: RateSensorPart = Field(description="[rate_sensor] with at least sigma")
    columns: ColumnsPart = Field(description="[columns] with at least time and rate")
    slews: Annotated[list[SlewPart], Len(1)] = Field(
        description="one [[slews]] a slew, with name, file, start"
    )
    wheels: list[WheelPart] = Field(default=[])
    star_tracker: StarTrackerPart | None = None


def parse_description(text: str, label: str) -> CampaignPart:
    """The content of a `campaign.toml`, every key checked; `label` names the file in messages.

    Raises `CampaignError` naming the line (syntax) or the key (an unknown or missing key, a wrong type or value).

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
        problems = error.errors(include_url=False, include_context=False)
        raise _problem(min(problems, key=_urgency), document, label) from None
    _check_columns(parsed, label)
    return parsed


def _syntax_error(error: Exception, text: str, label: str) -> CampaignError:
    found = re.search(r"\(at (?:line (\d+), column \d+|end of document)\)", str(error))
    line = found[1] if found and found[1] else len(text.splitlines()) or 1
    where = f"{label}, line {line}" if found else label
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
            _SENSE.get(key, "write one of these exactly"),
        )
    else:
        what, advice = _wrong_type(kind, key, value, problem["msg"])
    return CampaignError(what, where=f"{label}, key {_path(loc, document)}", advice=advice)


_SENSE = {
    "frame": "rotate the vectors into the inertial frame before they are stored",
    "relative_to": "subtract the body's own rate about the wheel axis first: momentum is spin inertia times speed RELATIVE to the body",
    "format": "this version of the package reads no other format",
}


def _missing(key: str, loc: tuple) -> tuple[str, str]:
    choices = _choices(loc)
    if choices:
        never = "" if key == "format" else ": units and senses are never guessed"
        return "missing key", f"add {key} = {' or '.join(f'"{c}"' for c in choices)}{never}"
    field = _model_at(loc[:-1]).model_fields[key]
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
    model = CampaignPart
    for part in loc:
        if isinstance(part, str):
            model = (
                _inner_model(model.model_fields[part].annotation)
                if model and part in model.model_fields
                else None
            )
    return model


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for inner in get_args(annotation) if (model := _inner_model(inner))), None)


def _choices(loc: tuple) -> tuple:
    model = _model_at(loc[:-1])
    field = model.model_fields.get(str(loc[-1])) if model else None
    return tuple(c for c in get_args(field.annotation) if isinstance(c, str)) if field else ()


def _nearest_key(key: str, loc: tuple) -> str:
    known = list(_model_at(loc[:-1]).model_fields)
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
    """What a single key cannot tell: entries of `[columns]` that contradict each other or the hardware."""

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
