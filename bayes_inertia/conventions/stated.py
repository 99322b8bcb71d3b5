"""What a campaign states about its columns, as plain values under the keys of campaign.toml."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.schema import CampaignPart

# A campaign built in memory is in SI units and has the package's senses.
_IN_MEMORY: dict[str, dict[str, Any]] = {
    "time": {"names": ["time"], "unit": "s"},
    "rate": {"names": ["rate_x", "rate_y", "rate_z"], "unit": "rad/s"},
    "wheel_torque": {"unit": "N m", "acts_on": "wheel"},
    "wheel_momentum": {"unit": "N m s", "relative_to": "body"},
    "attitude": {
        "names": ["q1", "q2", "q3", "q4"],
        "scalar": "last",
        "maps": "inertial_to_body",
    },
}


def stated_columns(
    campaign: Campaign, description: CampaignPart | None = None
) -> dict[str, Mapping[str, Any]]:
    """The entries of `[columns]`.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    description : CampaignPart, optional
        Its campaign.toml; None for a campaign that was built in memory, which is in SI units.

    Returns
    -------
    dict of str to mapping
        By quantity: names, unit, senses.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> stated_columns(small_campaign())["rate"]["unit"]
    'rad/s'
    """
    if description is not None:
        given = description.columns.given()
        return {key: entry.model_dump() for key, entry in given.items()}
    columns: dict[str, Mapping[str, Any]] = {key: _IN_MEMORY[key] for key in ("time", "rate")}
    for key in ("wheel_torque", "wheel_momentum", "attitude"):
        if any(getattr(slew, key) is not None for slew in campaign.slews):
            names = [f"{key}.{wheel.name}" for wheel in campaign.wheels]
            columns[key] = {"names": names, **_IN_MEMORY[key]}
    return columns
