"""Units of raw logs: spelled as the field spells them, read by pint, turned into SI and radians.

To pint an angle has no dimension. Here a rate needs one, so that 1/s, which could mean turns or
radians, is refused; of a wheel, hertz and 1/min are turns. The spellings that pint does not know
(mNm, Nms, N.m, deg/sec, krpm, s-1) are rewritten before it reads them. Suggested are the units of a
campaign folder, `campaign.schema.UNITS`, which `doctor` tries.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from bayes_inertia.campaign.schema import UNITS
from bayes_inertia.errors import CampaignError
from bayes_inertia.files import by_word, vocabulary
from bayes_inertia.importing.limits import LIMITS

_SPELLED = vocabulary("importing")["units"]
QUANTITIES: Mapping[str, Sequence[str]] = {
    quantity: (next(iter(units)), ", ".join(units)) for quantity, units in UNITS.items()
} | _SPELLED["quantities"]
"""For each quantity its SI unit (with radians) and the units that an error suggests."""

_ONE = frozenset({"1", "-", "", "none", "unitless", "dimensionless"})

_SIGNS = str.maketrans(_SPELLED["signs"])
# Whole words that pint reads otherwise or not at all, in small letters.
_WORDS = by_word(_SPELLED["words"])
_NEWTON_METRE = re.compile(r"([munkcµμ]?)N([cm]?m)(s?)")
_JOULE_SECOND = re.compile(r"([munkµμ]?)J(s)")
# Of a wheel these count turns; 1/s is left open.
_TURNS = re.compile(r"(min|minute|hertz|Hz)\b")

_ANGLES = frozenset(_SPELLED["angles"]["words"].split())
_OF_ANGLES = frozenset({"angle", "rate", "wheel_speed"})


@cache
def _registry() -> Any:
    """Pint's units; built once, as that takes 0.3 s."""
    import pint

    return pint.UnitRegistry()


def _powers_of_angle(value: Any) -> float:
    """The exponent of units of angle in a quantity of pint."""
    items = ((_registry().parse_unit_name(name), power) for name, power in value.unit_items())
    return sum(power for meant, power in items if _ANGLES & {base for _, base, _ in meant})


def _word(text: str) -> str:
    """One word of a unit in pint's spelling."""
    if text in _SPELLED["exact"]:
        return str(_SPELLED["exact"][text])
    if joined := _NEWTON_METRE.fullmatch(text):
        return f"{joined[1]}N*{joined[2]}" + ("*s" if joined[3] else "")
    if joined := _JOULE_SECOND.fullmatch(text):
        return f"{joined[1]}J*s"
    small = text.lower()
    inner = _WORDS.get(small[1:], "")
    if small not in _WORDS and text[:1] in _SPELLED["prefixes"] and ("/" in inner or "(" in inner):
        return f"({_SPELLED['prefixes'][text[0]]}*({inner}))"
    return _WORDS.get(small, small if len(text) >= LIMITS.shortest_unit_name else text)


def spelled_for_pint(unit: str) -> str:
    """A unit as the field writes it, in the spelling that pint reads.

    >>> [spelled_for_pint(unit) for unit in ("mNm", "N.m.s", "[deg s-1]", "kg m2/s")]
    ['mN*m', 'N*m*s', 'deg*s**-1', 'kg*m**2/s']
    """
    text = unit.strip()
    if text[:1] + text[-1:] in ("[]", "()", "<>"):
        text = text[1:-1].strip()
    if re.match("(RAD|DEG|REV|ARC)[A-Z]*[ /]", text) and text.isupper():
        text = text.lower()
    text = re.sub(r"(?<=[a-z])Per(?=[A-Z])|[\s_]+per[\s_]+", "/", text)
    text = re.sub("(?i)arc[-_ ](?=sec|min)", "arc", text.replace("''", "″"))
    text = (f"1{text}" if text.startswith("/") else text).translate(_SIGNS)
    text = re.sub(r"(?<=[A-Za-z])[.\-_](?=[A-Za-z])", "*", text)  # N.m, N-m, N_m
    text = text.replace("**", "^")
    text = re.sub(r"([A-Za-z])\^?\(?(-?\d+)\)?", r"\1^\2", text)  # m2, s-1, s^(-1)
    text = re.sub(r"\s*([*/^])\s*", r"\1", text)
    text = re.sub(r"\s+", "*", text)
    text = re.sub(r"[A-Za-zµμ]+", lambda match: _word(match[0]), text)
    return text.replace("^", "**")


def _factor(quantity: str, spelled: str) -> float:
    """SI units of a quantity in a unit that pint reads; its errors are pint's."""
    import pint

    si, registry = spelled_for_pint(QUANTITIES[quantity][0]), _registry()
    # An expression may hold a factor of its own, as that of the gauss does.
    value = registry.Quantity(1.0) * registry.parse_expression(spelled)
    factor = float(value.to(si).magnitude)
    powers = _powers_of_angle(value)
    if quantity == "wheel_speed" and powers == 0.0 and _TURNS.search(spelled):
        return factor * 2.0 * math.pi
    if powers != (quantity in _OF_ANGLES):
        raise pint.DimensionalityError(spelled, si)
    return factor


@cache
def unit_factor(quantity: str, unit: str) -> float:
    """The factor from a unit to the SI unit of a quantity, with radians.

    >>> unit_factor("wheel_torque", "mNm"), unit_factor("time", "ms")
    (0.001, 0.001)
    >>> unit_factor("rate", "Hz")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: unit 'Hz': is no unit of a rate; write rad/s, mrad/s, ...
    """
    import pint

    _, accepted = QUANTITIES[quantity]
    where, advice = f"unit {unit!r}", f"write {accepted}"
    if unit.strip().lower() in _ONE:
        raise CampaignError("no unit is given", where=where, advice=advice)
    spelled = spelled_for_pint(unit)
    try:
        try:
            factor = _factor(quantity, spelled)
        except pint.DimensionalityError:
            meant = _SPELLED["second_meanings"]
            other = re.sub(rf"\b({'|'.join(meant)})\b", lambda word: meant[word[0]], spelled)
            factor = _factor(quantity, other)
    except pint.DimensionalityError as error:
        article = "an" if quantity == "angle" else "a"
        what = f"is no unit of {article} {quantity.replace('_', ' ')}"
        raise CampaignError(what, where=where, advice=advice) from error
    except Exception as error:  # Pint's parser raises whatever it stumbles over.
        raise CampaignError("is not a known unit", where=where, advice=advice) from error
    if not np.isfinite(factor) or factor <= 0.0:
        raise CampaignError("has no scale", where=where, advice=advice)
    return factor


def to_si_with(
    values: np.ndarray, unit: str, quantity: str, *, scale: float = 1.0, offset: float = 0.0
) -> np.ndarray:
    """Values of a raw column in SI units; of counts, `unit` is that of scale and offset.

    >>> to_si_with(np.array([100.0]), "mN m", "wheel_torque", scale=0.1, offset=-5.0).tolist()
    [0.005]
    """
    factor = unit_factor(quantity, unit)
    read = np.asarray(values, dtype=float)
    # An overflow becomes infinite, which the campaign refuses by name.
    with np.errstate(over="ignore"):
        if scale != 1.0 or offset != 0.0:
            read = scale * read + offset
        return read * factor
