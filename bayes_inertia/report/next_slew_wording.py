"""Which slew to fly next after a diagnosis, and what becomes of its correction, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.report.formatting import arcsec_text, plain, vector_text


def separating_text(slew: Mapping[str, Any]) -> str:
    """The slew that would tell two effects apart.

    Parameters
    ----------
    slew : mapping
        An entry of `separating` of diagnosis.json.

    Returns
    -------
    str
        One sentence.

    Examples
    --------
    >>> change = {"before": 10, "after": 40}
    >>> separating_text({"effects": ["a", "b"], "axis": [0.0, 0.6, -0.8], "angle_deg": 60.0,
    ...     "rate_deg_s": 1.0, "correlation_before": 0.97, "correlation_after": 0.5,
    ...     "noncentrality": {"a": change, "b": change}})[:63]
    'To tell a from b, fly a slew of 60° about (0.00, 0.60, −0.80) i'
    """
    first, second = (plain(name) for name in slew["effects"])
    least_gain = min(
        power["after"] / max(power["before"], 1e-12) for power in slew["noncentrality"].values()
    )
    return (
        f"To tell {first} from {second}, fly a slew of {slew['angle_deg']:.3g}° "
        f"about ({vector_text(slew['axis'])}) in body axes, up to {slew['rate_deg_s']:.2g} deg/s: "
        "what is seen of one and not of the other "
        f"grows {least_gain:.2g} times in χ² or more "
        f"(correlation of the two {slew['correlation_before']:.2f} before, "
        f"{slew['correlation_after']:.2f} after)."
    )


def correction_text(forecast: Mapping[str, Any]) -> str:
    """What becomes of the next correction slew.

    Parameters
    ----------
    forecast : mapping
        `correction_slew` of diagnosis.json.

    Returns
    -------
    str
        One sentence.

    Examples
    --------
    >>> correction_text({"axis": "x", "angle_deg": 60.0, "promised": [8e-5, 2e-4],
    ...     "expected": [8.5e-4, 1e-3], "updated": [1e-4, 2.2e-4]})[:65]
    'A slew of 60° about x, flown with J and K of the base model, shou'
    """
    promised, expected, updated = (
        f"{arcsec_text(middle)} arcsec (95 %: below {arcsec_text(most)})"
        for middle, most in (forecast[key] for key in ("promised", "expected", "updated"))
    )
    return (
        f"A slew of {forecast['angle_deg']:.0f}° about {forecast['axis']}, flown with J and K "
        f"of the base model, should need a correction of {promised}; "
        f"with what was found it will need {expected}, "
        f"and {updated} when flown with the new J and K."
    )
