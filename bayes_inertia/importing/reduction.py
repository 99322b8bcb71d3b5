"""High-rate streams of an imported campaign as block means, where the mapping asks for it."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from bayes_inertia.campaign.block_means import reduced
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign

DESCRIPTION = "campaign.toml"


def reduced_content(
    content: Mapping[str, bytes], campaign: Campaign
) -> tuple[dict[str, bytes], Campaign]:
    """A campaign folder with block means in place of its high-rate readings.

    Parameters
    ----------
    content : mapping of str to bytes
        The folder's files.
    campaign : Campaign
        What they hold.

    Returns
    -------
    content : dict of str to bytes
        The files of the reduced campaign; other files (pictures, records) stay.
    campaign : Campaign
        What they hold: the same campaign where blocks of two readings are too long.
    """
    means = reduced(campaign)
    if means is campaign:
        return dict(content), campaign
    sigma = campaign.rate_sensor.sigma[0] / means.rate_sensor.sigma[0]
    readings = round(sigma**2)
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(means, folder)
        written = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
        campaign = read_campaign(folder)
    said = (
        f"# Rates and wheel momentum are means of {readings} readings each, because the mapping\n"
        '# says reduce = "block_means"; their noise is smaller by the root of that.\n'
    )
    written[DESCRIPTION] = said.encode() + written[DESCRIPTION]
    kept = {name: data for name, data in content.items() if not name.endswith((".csv", ".toml"))}
    return kept | written, campaign
