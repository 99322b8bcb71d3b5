"""Questions on raw logs that only the user can answer, and how a mapping asks them.

Questions on raw logs that only the user can answer.

A mapping that `import --start` writes has "?" at each of these keys, with the question beside it.
An import with a "?" left repeats the question.

Keys, values and comments of a mapping as text.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import tomlkit

from bayes_inertia.campaign.checked_toml import table_label
from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.limits import LIMITS

UNKNOWN = "?"
"""What stands in a mapping where the user must answer."""

QUESTIONS: Mapping[str, str] = MappingProxyType(
    {
        "streams.time.names": (
            "Which column holds the time? Several are added: GPS week and seconds, date and time "
            "of the day, sec and nanosec. A log without stamps: rate_hz = rows a second instead."
        ),
        "streams.time.kind": (
            'Which clock? utc, tai, gps, tt for dates as text; "gps_s", "gps_week", "tai_s", '
            '"unix_s", "unix_ms", "cds", ... for counts; "s", "ms", "us" from a zero of its own. '
            "The telemetry handbook says; UTC and GPS differ by 18 s since 2017."
        ),
        "streams.time.epoch": (
            'When was zero? A UTC date; "campaign" if all streams that count seconds share one '
            'zero; "file" if each file starts its own clock.'
        ),
        "streams.names": "Which columns, in the order x, y, z (or of [[wheels]])?",
        "streams.unit": "Which unit? (of scale and offset, where the columns are counts)",
        "streams.rate.unit": (
            "Which unit: rad/s, deg/s, arcsec/s, ...? A slew of 1 deg/s reads 0.017 in rad/s."
        ),
        "streams.wheel_torque.unit": (
            "Which unit: N m, mN m, ...? A small reaction wheel has some mN m."
        ),
        "streams.wheel_momentum.unit": "Which unit: N m s, mN m s, ...?",
        "streams.wheel_speed.unit": (
            "Which unit: rpm, rad/s, ...? 1000 rpm are 105 rad/s; most wheels stay below 6000 rpm."
        ),
        "streams.attitude.unit": "Which unit: deg or rad?",
        "streams.rate.frame": (
            '"body": the readings are along body axes already; "sensor": along the axes of the '
            "sensor, whose mounting then stands beside it."
        ),
        "streams.rate.mounting": (
            "v_sensor = mounting v_body: row i is the sensor's axis i in body axes. Write "
            "body_from_sensor instead if the drawing gives the other direction."
        ),
        "streams.acts_on": (
            'A positive torque speeds the wheel up: "wheel"; it turns the body the other way '
            'round, as a control torque does: "body".'
        ),
        "streams.relative_to": (
            '"body": as a tachometer reads; "inertial": the whole momentum or speed about the spin '
            "axis, as simulators give it (Hwhl of 42): the import takes the body's turning out."
        ),
        "streams.magnetic_field.frame": '"inertial" is read; rotate other fields before.',
        "streams.position.frame": '"inertial" is read; rotate Earth-fixed positions before.',
        "streams.attitude.form": '"quaternion", "euler", "dcm" or "mrp"?',
        "streams.attitude.scalar": (
            "Which of the four is the cosine of half the angle? It is near 1 for small turns and "
            "changes least."
        ),
        "streams.attitude.maps": (
            '"inertial_to_body": v_B = C(q) v_N, with C = (eta^2 - eps.eps) 1 + 2 eps eps^T '
            '- 2 eta [eps]x. A q with v_N = q v_B q* (scipy, ROS, Eigen: "body to world") is this '
            'q. "body_to_inertial": its conjugate.'
        ),
        "streams.attitude.sequence": 'Axes in the order of the turns, such as "zyx" for yaw first.',
        "streams.attitude.turns": (
            '"intrinsic": about the axes as turned so far (yaw, pitch, roll of aircraft); '
            '"extrinsic": about the fixed axes.'
        ),
        "streams.attitude.frame": (
            '"body", or "tracker": the tracker\'s own axes, whose mounting then stands beside it '
            "(body_from_tracker, v_body = R v_tracker)."
        ),
        "streams.attitude.body_from_tracker": (
            "v_body = R v_tracker: column i is the tracker's axis i in body axes."
        ),
        "streams.valid.equals": "Which value of the flag marks a good reading?",
        "inertia.tensor": "The inertia tensor known before flight [kg m^2], three rows.",
        "inertia.relative_sigma": "The sd of each diagonal element, as a fraction, such as 0.05.",
        "inertia.product_sigma": "The sd of each product of inertia [kg m^2].",
        "inertia.includes_wheel_spin": (
            "true if the tensor was computed with the wheels as rigid parts, false if without "
            "their spin inertia."
        ),
        "wheels.axis": (
            "The unit spin axis in body axes; a positive speed turns right-handed about it."
        ),
        "wheels.spin_inertia": "Moment of inertia about the spin axis [kg m^2].",
        "rate_sensor.range": "Largest reading of an axis [rad/s].",
        "star_tracker.boresight": "The unit vector of the boresight in body axes.",
        "epoch": (
            'When was zero of the clocks that count? A UTC date; "campaign" if all streams share '
            'one zero; "file" if each file starts its own. A stream may state its own in `time`.'
        ),
        "name": "What the campaign is called.",
    }
)
"""The question at each key; a key of one stream goes before that of all."""


def question_at(path: tuple[str, ...]) -> str:
    """The question at a key of a mapping.

    `path`: the key's path, tables in lists by their label, such as ("streams", "rate", "unit").
    Returns: the question; a general one where none is written.

    Examples
    --------
    >>> question_at(("streams", "attitude", "form"))
    '"quaternion", "euler", "dcm" or "mrp"?'
    """
    short = (path[0], *path[2:]) if path[0] in ("streams", "wheels") else path
    for candidate in (path, short):
        if ".".join(candidate) in QUESTIONS:
            return QUESTIONS[".".join(candidate)]
    return f"What is {path[-1]}?"


def refuse_open_questions(document: dict[str, Any], label: str) -> None:
    """Raise an error if a mapping has a question left open.

    Examples
    --------
    >>> refuse_open_questions({"streams": [{"holds": "rate", "unit": "?"}]}, "m.toml")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: m.toml, key streams.rate.unit: the question is open; ...
    """
    paths = open_questions(document)
    if not paths:
        return
    more = f" ({len(paths) - 1} more keys have a question)" if len(paths) > 1 else ""
    raise CampaignError(
        "the question is open",
        where=f"{label}, key {'.'.join(paths[0])}",
        advice=f"write the answer in the place of {UNKNOWN!r}{more}. {question_at(paths[0])}",
    )


def open_questions(value: Any, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Paths of all keys whose value is, or holds, a "?".

    Examples
    --------
    >>> open_questions({"a": {"b": ["?", 1]}, "c": 1})
    [('a', 'b')]
    """
    if isinstance(value, dict):
        return [p for key, inner in value.items() for p in open_questions(inner, (*path, key))]
    if isinstance(value, list):
        if any(isinstance(inner, dict) for inner in value):
            labels = [table_label(inner) or str(k + 1) for k, inner in enumerate(value)]
            return [
                p
                for label, inner in zip(labels, value, strict=True)
                for p in open_questions(inner, (*path, label))
            ]
        return [path] if any(open_questions(inner) for inner in value) else []
    return [path] if value == UNKNOWN else []


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
    return "\n".join(f"# {line}" for line in textwrap.wrap(text, LIMITS.comment_width))


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
