"""Keys that were written in the same wrong unit as a mended one: noises, and the prior's products.

No law shows them. A stated noise that agrees with the noise of the readings while both are read in
the wrong unit was written in that unit too, and must be mended with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.units import UNITS
from bayes_inertia.conventions import limits
from bayes_inertia.conventions.hypothesis import KeyChange, Mistake
from bayes_inertia.conventions.noise_seen import noise_ratios


def with_companions(mistake: Mistake, campaign: Campaign, written: Mapping[str, Any]) -> Mistake:
    """A mistake together with the keys that share its unit.

    Parameters
    ----------
    mistake : Mistake
        What is to be mended.
    campaign : Campaign
        As it states itself.
    written : mapping
        Content of campaign.toml; empty for a campaign that was built in memory.

    Returns
    -------
    Mistake
        With more changes, where noises or products are in the same wrong unit.
    """
    more = [
        change for mended in mistake.changes for change in _companions(mended, campaign, written)
    ]
    if not more:
        return mistake
    names = ", ".join(dict.fromkeys(change.key for change in more))
    words = f"{mistake.words}, and so is {names}"
    changes = (*mistake.changes, *more)
    return replace(mistake, changes=changes, words=words, companions=len(more))


def _companions(
    mended: KeyChange, campaign: Campaign, written: Mapping[str, Any]
) -> Iterator[KeyChange]:
    if mended.key == "columns.rate.unit" and _in_one_unit(campaign, "rate"):
        factor = UNITS["rate"][mended.mended] / UNITS["rate"][mended.stated]
        sigma = written.get("rate_sensor", {}).get("sigma", list(campaign.rate_sensor.sigma))
        yield KeyChange("rate_sensor.sigma", sigma, _times(sigma, factor))
    if mended.key == "columns.wheel_momentum.unit" and _in_one_unit(campaign, "momentum"):
        units = UNITS["wheel_momentum"]
        factor = units[mended.mended] / units[mended.stated]
        for wheel in campaign.wheels:
            sigma = wheel.momentum_sigma
            if sigma is not None:
                key = f"wheels.{wheel.name}.momentum_sigma"
                yield KeyChange(key, sigma, _times(sigma, factor))
    if mended.key == "inertia.tensor":
        factor = float(np.trace(mended.mended) / np.trace(mended.stated))
        products = campaign.inertia.product_sigma
        # No product of inertia is larger than the moments: this sd is in the tensor's own unit.
        if factor < 0.1 and products > np.trace(mended.mended):
            yield KeyChange("inertia.product_sigma", products, _times(products, factor))


def _in_one_unit(campaign: Campaign, channel: str) -> bool:
    """Whether the noise of a channel agrees with what is stated, as both are read now."""
    ratio = noise_ratios(campaign, channel)
    known = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    if not len(known):
        return False
    return bool(np.all(np.abs(np.log(known)) < np.log(limits.ONE_UNIT)))


def _times(value: Any, factor: float) -> Any:
    """Numbers times a factor, with six digits."""
    if isinstance(value, list):
        return [_times(item, factor) for item in value]
    return float(f"{value * factor:.6g}")
