"""From the text of `mapping.toml` to its checked content.

Wheels of one type: `same_as` takes what one wheel of a mapping says for another.

Data sheets state noise in arc seconds and degrees an hour. A number without a unit is in SI units
and radians, as in campaign.toml.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_inertia.campaign.checked_toml import checked_document, toml_document
from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import by_word, vocabulary
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.mapped_lines import lines_of
from bayes_inertia.importing.mapping_schema import (
    STREAM_TYPES,
    AttitudeStream,
    MappedStream,
    MappingPart,
    RateStream,
    TorqueStream,
    WheelStream,
)
from bayes_inertia.importing.questions import refuse_open_questions
from bayes_inertia.importing.stream_readings import (
    COLUMNS_OF_FORM,
    AttitudeConvention,
    bad_attitude,
)
from bayes_inertia.importing.unit_factors import QUANTITIES, unit_factor
from bayes_inertia.tables.time_stamps import FREE_CLOCKS

_FORM_OF_KEY = {"scalar": "quaternion", "sequence": "euler", "turns": "euler", "unit": "euler"}


def parse_mapping(text: str, label: str) -> MappingPart:
    """The content of a `mapping.toml`, every key checked; messages name the file `label`."""
    document = toml_document(text, label)
    refuse_open_questions(document, label)
    _refuse_few_axes(document, label)
    complete = with_si_hardware(with_alike_wheels(document, label), label)
    mapping = checked_document(complete, label, MappingPart)
    _check_streams(mapping, label)
    _check_cut(mapping, label)
    for stream in mapping.streams:
        where = f"{label}, key streams.{stream.holds}"
        _check_columns(stream, text, label)
        _check_numbers(stream, where)
        if isinstance(stream, AttitudeStream):
            _check_attitude(stream, where)
        if isinstance(stream, RateStream):
            _check_mounting(stream, mapping, where)
        if isinstance(stream, WheelStream):
            _check_wheels(stream, mapping, where)
    streams = [_with_epoch(_with_signs(stream), mapping.epoch) for stream in mapping.streams]
    return mapping.model_copy(update={"streams": streams})


def _with_signs(stream: MappedStream) -> MappedStream:
    """The stream in which a minus before a column, as in campaign.toml, is one of its scale."""
    minus = [name.startswith("-") for name in stream.names]
    if not any(minus):
        return stream
    signs, names = np.where(minus, -1.0, 1.0), [name.removeprefix("-") for name in stream.names]
    given = {key: getattr(stream, key, None) for key in ("scale", "offset")}
    numbers = {k: (signs * value + 0.0).tolist() for k, value in given.items() if value is not None}
    return stream.model_copy(update={"names": names, **numbers})


def _with_epoch(stream: MappedStream, epoch: str) -> MappedStream:
    """The stream with the epoch of all, if it counts from a zero and states none."""
    time = stream.time
    if time.epoch or not (time.kind in FREE_CLOCKS or time.rate_hz is not None):
        return stream
    return stream.model_copy(update={"time": time.model_copy(update={"epoch": epoch})})


def _refuse_few_axes(document: dict[str, Any], label: str) -> None:
    """Refuse rates about fewer than three axes, before the form of the file does without a why."""
    streams = document.get("streams")
    for stream in streams if isinstance(streams, list) else []:
        names = stream.get("names") if isinstance(stream, dict) else None
        few = isinstance(names, list) and 0 < len(names) < 3 and stream.get("holds") == "rate"
        what = "fewer than three columns for the rates about three axes"
        advice = "name one a sensor axis; a rig that is held to turn about fewer axes cannot be "
        advice += "fitted, as the model turns freely about all three"
        require(not few, f"{label}, key streams.rate.names", what, advice)


def _check_streams(mapping: MappingPart, label: str) -> None:
    """Refuse streams that are missing, doubled, or contradict the hardware."""
    where = f"{label}, key streams"
    held = [stream.holds for stream in mapping.streams]
    advice = 'add a [[streams]] that holds = "rate"'
    require("rate" in held, where, "no stream holds the rates, which the method needs", advice)
    both = {"wheel_momentum", "wheel_speed"} <= set(held)
    advice = "keep one of the two, they are the same measurement"
    require(not both, where, "wheel_momentum and wheel_speed are both given", advice)
    tracked = "attitude" not in held or mapping.star_tracker is not None
    what, advice = "attitudes without a star tracker", "add [star_tracker] with its boresight"
    require(tracked, f"{label}, key streams.attitude", what, advice)
    names = mapping.wheels_of()
    distinct = len(set(names)) == len(names)
    what, advice = "a name is used twice", "give each its own name"
    require(distinct, f"{label}, key wheels", what, advice)
    for holds, kind in STREAM_TYPES.items():
        streams = streams_that_hold(mapping, holds)
        if not kind.of_wheels():
            advice = "keep one; several files of one stream stand in one list `files`"
            require(len(streams) < 2, where, f"two streams hold {holds!r}", advice)
            continue
        read = {name for stream in streams for name in mapping.wheels_of(stream)}
        lacking = ", ".join(name for name in names if name not in read)
        what = f"no column holds the wheel {lacking}"
        advice = "name its column, or take a wheel that is off out of [[wheels]]"
        if kind is not TorqueStream:
            advice += ", or leave out what all tachometers read"
        require(not streams or not lacking, f"{label}, key streams.{holds}.wheels", what, advice)


def _check_cut(mapping: MappingPart, label: str) -> None:
    """Refuse keys of `[cut]` that its way of cutting would ignore."""
    cut, where = mapping.cut, f"{label}, key cut"
    what = "[[slews]] say already how the log is cut"
    require(cut.by is None or not mapping.slews, f"{where}.by", what, "keep one of them")
    how = "slews" if mapping.slews else cut.by
    used: dict[str, tuple[str | None, ...]] = {"longest_s": ("gaps",)}
    used |= dict.fromkeys(("before_s", "after_s", "min_rest_s"), ("rest", None))
    for key, used_by in used.items():
        ignored = getattr(cut, key) is not None and how not in used_by
        what = "is not used here" if how is None else f"is not used where {how} cut the log"
        require(not ignored, f"{where}.{key}", what, f'leave it out, or write by = "{used_by[0]}"')


def _check_wheels(stream: WheelStream, mapping: MappingPart, where: str) -> None:
    """Refuse columns that do not fit the wheels."""
    names = mapping.wheels_of()
    for name in stream.wheels or []:
        advice = f"name one of {', '.join(names) or 'no wheel: add [[wheels]]'}"
        require(name in names, f"{where}.wheels", f"there is no wheel {name!r}", advice)
    wanted = mapping.wheels_of(stream)
    what = f"{len(stream.names)} column(s) for {len(wanted)} wheel(s)"
    advice = "name one column a wheel, in the order of [[wheels]], or add wheels = [...] with the "
    advice += "names of the wheels that these columns are of"
    require(len(stream.names) == len(wanted), f"{where}.names", what, advice)


def _check_columns(stream: MappedStream, text: str, label: str) -> None:
    """Refuse a column that stands for two quantities of a stream."""
    named = [*stream.time.names, *(name.removeprefix("-") for name in stream.names)]
    doubled = next((name for k, name in enumerate(named) if name in named[:k]), None)
    if doubled is None:
        return
    stated = lines_of(text, f"columns.{stream.holds}.names")
    lines = [n for n, line in stated if doubled in line] or [n for n, _ in stated]
    line = f"line {lines[0]}, " if lines else ""
    of_time = doubled in stream.time.names
    what = f"the column {doubled!r} is named {'as time and as reading' if of_time else 'twice'}"
    where = f"{label}, {line}key streams.{stream.holds}.names"
    advice = "name for each element the column that holds it, in their order"
    raise CampaignError(what, where=where, advice=advice)


def _check_numbers(stream: MappedStream, where: str) -> None:
    """Refuse scales and offsets that are not one, or one a column."""
    for key in ("scale", "offset"):
        value = getattr(stream, key, 0.0)
        if isinstance(value, list) and stream.names:
            fits = len(value) == len(stream.names)
            what = f"{len(value)} numbers for {len(stream.names)} columns"
            require(fits, f"{where}.{key}", what, "give one number, or one a column")
    scales = stream.scale if isinstance(stream.scale, list) else [stream.scale]
    zero = any(scale == 0.0 for scale in scales)
    require(not zero, f"{where}.scale", "a scale of 0", "give the size of one count")


def _check_mounting(stream: RateStream, mapping: MappingPart, where: str) -> None:
    """Refuse a mounting that is missing, or stated in two ways."""
    given = [key for key in ("mounting", "body_from_sensor") if getattr(stream, key) is not None]
    axes = mapping.rate_sensor.axes
    stated = [*(f"streams.rate.{key}" for key in given), *(["rate_sensor.axes"] if axes else [])]
    known = stream.frame != "sensor" or len(stated) > 0
    advice = 'add mounting = [[...], [...], [...]], v_sensor = mounting v_body (frame = "sensor")'
    require(known, f"{where}.mounting", "missing key", advice)
    for key in given:
        independent = abs(np.linalg.det(np.array(getattr(stream, key)))) > LIMITS.independent_axes
        what = "the axes lie in one plane"
        require(independent, f"{where}.{key}", what, "give three independent axes")
    advice = "keep one of them"
    require(len(stated) < 2, where, f"the mounting is stated by {' and '.join(stated)}", advice)
    what = f'"body" and {" and ".join(stated)} contradict each other'
    advice = 'write frame = "sensor" if the readings are along the axes of the sensor, '
    advice += "or leave the matrix out"
    require(stream.frame == "sensor" or not stated, f"{where}.frame", what, advice)


def _check_attitude(stream: AttitudeStream, where: str) -> None:
    """Refuse keys of an attitude that are missing or belong to another form."""
    for key, form in _FORM_OF_KEY.items():
        stray = bool(getattr(stream, key)) and stream.form not in (form, None)
        advice = f'leave it out, or write form = "{form}"'
        require(not stray, f"{where}.{key}", f"belongs to the form {form!r}", advice)
    if stream.form is not None and stream.names:
        wanted = COLUMNS_OF_FORM[stream.form]
        what = f"{len(stream.names)} column(s) for the form {stream.form!r}"
        fits = len(stream.names) == wanted
        require(fits, f"{where}.names", what, f"name {wanted} columns in their order")
    good = re.fullmatch(r"(([xyz])(?!\2)){3}", stream.sequence.lower()) or not stream.sequence
    what = f"{stream.sequence!r} is no sequence of three axes"
    require(bool(good), f"{where}.sequence", what, 'write such as "zyx" or "zxz"')
    matrix = stream.body_from_tracker
    what = '"body" and body_from_tracker contradict each other'
    advice = 'write frame = "tracker" if the attitudes are those of the tracker, '
    advice += "or leave the matrix out"
    require(stream.frame != "body" or matrix is None, f"{where}.frame", what, advice)
    known = stream.frame != "tracker" or matrix is not None
    advice = "add body_from_tracker = [[...], [...], [...]], v_body = R v_tracker "
    advice += '(frame = "tracker")'
    require(known, f"{where}.body_from_tracker", "missing key", advice)
    if matrix is not None:
        convention = AttitudeConvention("dcm", "inertial_to_body")
        problem = bad_attitude(np.array(matrix).reshape(1, 9), convention)
        what = "" if problem is None else problem[1]
        advice = "give the nine cosines with enough digits; column i is the tracker's axis i"
        require(problem is None, f"{where}.body_from_tracker", what, advice)


def streams_that_hold(mapping: MappingPart, holds: str) -> list[MappedStream]:
    """The streams of a mapping that hold a quantity."""
    return [stream for stream in mapping.streams if stream.holds == holds]


def rate_sensor_axes(mapping: MappingPart) -> Any:
    """C_rate, the rows of which are the axes of the rate sensor in body axes."""
    stream = next(stream for stream in mapping.streams if isinstance(stream, RateStream))
    if stream.mounting is not None:
        return stream.mounting
    if stream.body_from_sensor is not None:
        # + 0.0 makes no -0.0 of a zero.
        return (np.linalg.inv(np.array(stream.body_from_sensor)) + 0.0).tolist()
    return mapping.rate_sensor.axes or np.eye(3).tolist()


_OF_TYPE = ("spin_inertia", "max_torque", "max_momentum", "momentum_sigma")


def with_alike_wheels(document: dict[str, Any], label: str) -> dict[str, Any]:
    """A mapping whose wheels all say themselves what `same_as` took from another."""
    wheels = document.get("wheels")
    if not isinstance(wheels, list) or not all(isinstance(wheel, dict) for wheel in wheels):
        return document
    complete: list[dict[str, Any]] = []
    for wheel in wheels:
        own = dict(wheel)
        if "same_as" in own:
            other = own.pop("same_as")
            above = {before.get("name"): before for before in complete}
            where = f"{label}, key wheels.{own.get('name')}.same_as"
            known = ", ".join(map(str, above)) or "none: it is the first"
            advice = f"name one of {known}, or give spin_inertia"
            is_above = isinstance(other, str) and other in above
            require(is_above, where, f"{other!r} is no wheel above it", advice)
            own = {k: v for k, v in above[other].items() if k in _OF_TYPE} | own
        complete.append(own)
    return document | {"wheels": complete}


# Table, key and quantity of what may carry a unit.
_QUANTITIES = {part: by_word(keys) for part, keys in vocabulary("importing")["hardware"].items()}
_NUMBER_WITH_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


def with_si_hardware(document: dict[str, Any], label: str) -> dict[str, Any]:
    """A mapping whose hardware is in SI units: numbers in place of texts such as "5 arcsec"."""
    parts = {part: keys for part, keys in _QUANTITIES.items() if part in document}
    return document | {
        part: _in_si(document[part], keys, f"{label}, key {part}") for part, keys in parts.items()
    }


def _in_si(given: Any, quantities: Mapping[str, str], where: str) -> Any:
    """A table, or one a wheel; what is none is left to the check of types."""
    if isinstance(given, list):
        names = [table.get("name") if isinstance(table, dict) else "" for table in given]
        named = zip(given, [name or k for k, name in enumerate(names, 1)], strict=True)
        return [_in_si(table, quantities, f"{where}.{name}") for table, name in named]
    if not isinstance(given, dict):
        return given
    return {
        key: _value(value, quantities[key], f"{where}.{key}") if key in quantities else value
        for key, value in given.items()
    }


def _value(value: Any, quantity: str, where: str) -> Any:
    """A number, or one an axis; what is no text is left to the check of types."""
    if isinstance(value, list):
        return [_value(part, quantity, where) for part in value]
    if not isinstance(value, str):
        return value
    parts = _NUMBER_WITH_UNIT.fullmatch(value)
    example = f'write such as 1e-5 ({QUANTITIES[quantity][0]}) or "1e-5 UNIT", UNIT one of '
    if parts is None:
        what, advice = f"{value!r} is no number with a unit", example + QUANTITIES[quantity][1]
        raise CampaignError(what, where=where, advice=advice)
    try:
        factor = unit_factor(quantity, parts[2])
    except CampaignError as error:
        raise CampaignError(f"{value!r}: {error.what}", where=where, advice=error.advice) from None
    si = float(parts[1]) * factor
    # 15 digits: 5 arcsec are written as they are read.
    return float(f"{si:.15g}") if math.isfinite(si) else si
