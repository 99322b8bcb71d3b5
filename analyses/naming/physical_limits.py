"""Up to which size an effect can be real: strong effects beyond that are not flown in a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.maths.inertia_tensor import elements, is_physical, tensor

_LARGEST_ANGLE = 0.5  # of a misalignment [rad]: nobody mounts a sensor worse by mistake
_LARGEST_ATTRACTION = 2.0  # times the gravity gradient of the Earth
_LEAST_GAIN, _MOST_GAIN = 0.3, 1.7  # of a wheel's torque
_LARGEST_LAG = 10.0  # of wheels or sensors [s]; slews last two minutes
_MOST_OF_LIMIT = 1.0  # peak torque and momentum of a wheel


def why_not_physical(values: Mapping[str, Mapping[str, Any]], inertia_B: np.ndarray) -> str:
    """Why no spacecraft has effects of such sizes; empty if one may.

    `values` is {effect: {parameter: value}}; `inertia_B` the tensor (3, 3) that flies.

    >>> why_not_physical({"wheel_torque_gain": {"gain": np.array([1.0, -0.2, 1.0])}}, np.eye(3))
    'wheel_torque_gain: a wheel with gain -0.2'
    """
    for effect, parameters in values.items():
        reason = _reason({k: np.asarray(v, float) for k, v in parameters.items()}, inertia_B)
        if reason:
            return f"{effect}: {reason}"
    return ""


def _reason(p: Mapping[str, np.ndarray], inertia_B: np.ndarray) -> str:
    angles = np.concatenate(
        [np.ravel(v) for k, v in p.items() if k.startswith(("angle", "tilt", "shift"))] or [[0.0]]
    )
    if np.linalg.norm(angles) > _LARGEST_ANGLE:
        return f"an angle of {np.linalg.norm(angles):.2g} rad"
    if "gain" in p and not np.all((p["gain"] > _LEAST_GAIN) & (p["gain"] < _MOST_GAIN)):
        return f"a wheel with gain {min(p['gain'], key=lambda g: -abs(g - 1.0)):.2g}"
    if "tau" in p and np.max(np.abs(p["tau"])) > _LARGEST_LAG:
        return f"a delay of {float(np.max(np.abs(p['tau']))):.2g} s"
    if "factor" in p and abs(float(p["factor"])) > _LARGEST_ATTRACTION:
        return f"{float(p['factor']):.2g} times the Earth's attraction"
    if "change" in p and not _is_body(inertia_B + np.asarray(tensor(p["change"]))):
        return "no body has the tensor afterwards"
    if "coupling" in p and not _is_body(inertia_B - np.outer(p["coupling"], p["coupling"])):
        return "the appendage has more inertia than the whole"
    return ""


def _is_body(inertia_B: np.ndarray) -> bool:
    return bool(is_physical(elements(inertia_B)))


def why_not_flown(flight: Flight) -> str:
    """Why a flight does not count: wheels at their limits are no effect of the library."""
    for what, peak in (("torque", flight.peak_torque), ("momentum", flight.peak_momentum)):
        if np.nanmax(peak, initial=0.0) > _MOST_OF_LIMIT:
            return f"the wheels would need {np.nanmax(peak):.2g} times their largest {what}"
    return ""
