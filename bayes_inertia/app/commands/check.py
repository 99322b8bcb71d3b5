"""`check`: read a campaign and say what it contains."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from bayes_inertia.app.commands.options import Anyway, CampaignFolder
from bayes_inertia.app.terminal import headed, plain_console

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign
    from bayes_inertia.campaign.slew import Slew

_COLUMNS = (
    "slew",
    "rows",
    "step [s]",
    "duration [s]",
    "peak rate [deg/s]",
    "fixes",
    "commands",
    "wheel momentum",
)


def check_command(campaign: CampaignFolder, anyway: Anyway = False) -> None:
    """Read a campaign, check it and its conventions, and say what it contains."""
    from bayes_inertia.campaign.reader import read_campaign
    from bayes_inertia.conventions.check import refuse_impossible

    show_campaign(read_campaign(campaign))
    if not anyway:
        refuse_impossible(campaign)


def show_campaign(campaign: Campaign) -> None:
    """Print what a campaign contains, and what can be done with it.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    """
    console = plain_console()
    slews, wheels = len(campaign.slews), len(campaign.wheels)
    console.print(headed(campaign.name, f": {slews} slews, {wheels} wheels"))
    table = Table(*_COLUMNS)
    for slew in campaign.slews:
        table.add_row(*_slew_cells(slew))
    console.print(table)
    moments = ", ".join(f"{m:.4g}" for m in np.linalg.eigvalsh(campaign.inertia.tensor))
    kind = "with" if campaign.inertia.includes_wheel_spin else "without"
    console.print(f"prior principal moments: {moments} kg m^2 ({kind} the wheels' spin inertia)")
    drives = ", ".join(_possible_drives(campaign))
    console.print(
        f"possible drives: {drives or 'none: add wheel_torque or wheel_momentum columns'}"
    )
    if campaign.star_tracker is None:
        console.print(
            "no star tracker: attitude is not compared, "
            "start and final attitude errors stay unknown"
        )
    for record in campaign.dirt:
        where = f"{record.slew}, {record.channel}" if record.slew else record.channel
        console.print(f"{record.kind} ({where}): {record.note} [{record.treated}]", markup=False)


def _slew_cells(slew: Slew) -> tuple[str, ...]:
    _, rates = slew.complete_rates()
    peak = f"{np.degrees(np.linalg.norm(rates, axis=1).max()):.3g}" if len(rates) else "none"
    return (
        slew.name,
        str(len(slew.time)),
        f"{np.median(slew.rate_steps):.4g}",
        f"{slew.duration:.4g}",
        peak,
        str(int(slew.fixes.sum())),
        "no" if slew.wheel_torque is None else "yes",
        "no" if slew.wheel_momentum is None else "yes",
    )


def _possible_drives(campaign: Campaign) -> list[str]:
    drives = ["commanded"] if campaign.has_commands or not campaign.wheels else []
    return [*drives, "measured"] if campaign.has_tachometers else drives
