"""What is known to have changed during a campaign: fuel used, a panel deployed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayes_inertia.campaign.hardware import require, require_positive


@dataclass(frozen=True)
class Change:
    """A change of the spacecraft at a known time, of unknown size: every model has it.

    Parameters
    ----------
    name : str
        The change, as printed; its parameters are called "NAME.change_Jxx" and so on.
    time : float
        When, on the campaign's clock [s]; slews that start then or later have what came after.
    sigma_fraction : float, optional
        Prior sd of the change of each tensor element, as a fraction of the mean moment of inertia.
    part : "inertia", optional
        What changed.

    Raises
    ------
    CampaignError
        If the time is not finite, the sd not positive or the part unknown.

    Examples
    --------
    >>> Change("fuel", 1900.0).sigma_fraction
    0.03
    """

    name: str
    time: float
    sigma_fraction: float = 0.03
    part: Literal["inertia"] = "inertia"

    def __post_init__(self) -> None:
        key = f"changes.{self.name}"
        require(bool(self.name), "changes", "a change without a name", "give each a name")
        finite = bool(np.isfinite(self.time))
        require(finite, f"{key}.time", f"{self.time!r} is not finite", "give a time in seconds")
        require_positive(self.sigma_fraction, f"{key}.sigma_fraction")
        known = self.part == "inertia"
        require(known, f"{key}.part", f"{self.part!r} is unknown", 'write "inertia"')
