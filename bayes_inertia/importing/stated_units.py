"""Numbers of the hardware with their unit: `sigma_cross = "5 arcsec"` in a mapping.

Data sheets state noise in arc seconds and degrees an hour. A number without a unit is in SI units
and radians, as in campaign.toml.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.unit_factors import QUANTITIES, unit_factor

_RATE_KEYS = ("sigma", "range", "bias", "bias_sigma", "bias_instability")
# Table, key and quantity of what may carry a unit.
_QUANTITIES: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "rate_sensor": dict.fromkeys(_RATE_KEYS, "rate"),
        "star_tracker": dict.fromkeys(
            ("sigma_cross", "sigma_roll", "low_frequency_sigma"), "angle"
        ),
        "wheels": {
            "spin_inertia": "spin_inertia",
            "max_torque": "wheel_torque",
            "max_momentum": "wheel_momentum",
            "momentum_sigma": "wheel_momentum",
        },
    }
)
_NUMBER_WITH_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


def with_si_hardware(document: dict[str, Any], label: str) -> dict[str, Any]:
    """A mapping whose hardware is stated in SI units and radians.

    Parameters
    ----------
    document : dict
        The content of the mapping.
    label : str
        The file, as messages name it.

    Returns
    -------
    dict
        The same with numbers in place of texts such as "5 arcsec".

    Raises
    ------
    CampaignError
        If a text is no number with a unit of its quantity.

    Examples
    --------
    >>> tracker = {"star_tracker": {"sigma_cross": "3600 arcsec"}}
    >>> round(with_si_hardware(tracker, "m.toml")["star_tracker"]["sigma_cross"], 6)
    0.017453
    """
    converted = dict(document)
    for part, quantities in _QUANTITIES.items():
        where = f"{label}, key {part}"
        tables = document.get(part)
        if isinstance(tables, dict):
            converted[part] = _in_si(tables, quantities, where)
        elif isinstance(tables, list):
            converted[part] = [
                _in_si(table, quantities, f"{where}.{table.get('name')}")
                if isinstance(table, dict)
                else table
                for table in tables
            ]
    return converted


def _in_si(table: dict[str, Any], quantities: Mapping[str, str], where: str) -> dict[str, Any]:
    return {
        key: _value(value, quantities[key], f"{where}.{key}") if key in quantities else value
        for key, value in table.items()
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
        raise CampaignError(
            f"{value!r} is no number with a unit",
            where=where,
            advice=example + QUANTITIES[quantity][1],
        )
    try:
        factor = unit_factor(quantity, parts[2])
    except CampaignError as error:
        raise CampaignError(f"{value!r}: {error.what}", where=where, advice=error.advice) from None
    si = float(parts[1]) * factor
    # 15 digits: 5 arcsec are written as they are read.
    return float(f"{si:.15g}") if math.isfinite(si) else si
