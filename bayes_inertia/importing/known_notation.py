"""What names of columns say by a notation that a simulator defines; suggestions, said as such.

Basilisk writes the frame into the name: omega_BN_B is the rate of B against N in axes of B,
sigma_BN the modified Rodrigues parameters of B from N; its wheelSpeeds are relative to the body
[rad/s], and its motorTorque acts on the wheel [N m]. 42's wbn is in axes of the body, its Hwhl the
whole momentum about the spin axis. ROS (REP 103) and PX4 write rates in rad/s and the quaternion
that takes vectors of the body to the world; PX4 begins it with the scalar and counts microseconds.
Names with _B or "body" say that the axes are the body's.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

_NOTATIONS: tuple[tuple[str, re.Pattern[str], str, Mapping[str, str]], ...] = tuple(
    (holds, re.compile(pattern), why, MappingProxyType(says))
    for holds, pattern, why, says in (
        ("rate", r"omega_BN_B", "Basilisk's", {"unit": "rad/s", "frame": "body"}),
        (
            "attitude",
            r"sigma_BN",
            "Basilisk's",
            {"maps": "inertial_to_body", "frame": "body"},
        ),
        ("wheel_speed", r"wheelSpeeds", "Basilisk's", {"unit": "rad/s", "relative_to": "body"}),
        ("wheel_torque", r"motorTorque", "Basilisk's", {"unit": "N m", "acts_on": "wheel"}),
        ("rate", r"wbn\[", "42's", {"frame": "body"}),
        ("wheel_momentum", r"Hwhl\[", "42's", {"relative_to": "inertial"}),
        (
            "rate",
            r"vehicle_angular_velocity|gyro_rad",
            "PX4's",
            {"unit": "rad/s", "frame": "body"},
        ),
        ("rate", r"angular_velocity", "ROS's", {"unit": "rad/s"}),
        (
            "attitude",
            r"vehicle_attitude",
            "PX4's",
            {"scalar": "first", "maps": "inertial_to_body", "frame": "body"},
        ),
        ("attitude", r"orientation", "ROS's", {"maps": "inertial_to_body"}),
        ("time", r"timestamp_sample|vehicle_[a-z_]+_\d+/timestamp", "PX4's", {"kind": "us"}),
        ("rate", r"_B(\b|_|\[)|[Bb]ody", "a usual", {"frame": "body"}),
        ("magnetic_field", r"_(N|eci|ECI)(\b|_|\[)|inertial", "a usual", {"frame": "inertial"}),
        ("position", r"_(N|eci|ECI)(\b|_|\[)|inertial", "a usual", {"frame": "inertial"}),
    )
)


def notation_of(holds: str, name: str) -> dict[str, tuple[str, str]]:
    """What a name says by its notation.

    Parameters
    ----------
    holds : str
        What the column seems to hold, as a mapping says it.
    name : str
        The column.

    Returns
    -------
    dict of str to tuple of str
        For keys of the stream a value, and whose notation says it; the first that fits.

    Examples
    --------
    >>> notation_of("rate", "omega_BN_B[0]")["frame"], notation_of("rate", "gx_dps")
    (('body', "Basilisk's notation"), {})
    """
    for of, pattern, whose, says in _NOTATIONS:
        if of == holds and pattern.search(name):
            return {key: (value, f"{whose} notation") for key, value in says.items()}
    return {}
