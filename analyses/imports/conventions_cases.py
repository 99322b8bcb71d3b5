"""A right campaign to be spoilt, and a wrong convention put into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analyses.imports.conventions_folder import Mend, RawCampaign, changed

FULL, NO_TACHOMETERS, NO_TRACKER, THROWS = KINDS = (
    "with tachometers and star tracker",
    "without tachometers",
    "without star tracker",
    "throws",
)


@dataclass(frozen=True)
class Base:
    """A right campaign to be spoilt.

    `moving_fixes`: the star tracker gives fixes in motion. `limits`: torques have a stated limit.
    `moments_differ`: as far as the prior knows. `late`: by how much a late stream is late [s]; 0
    for none.
    `share`: the place of the third of the wrong conventions that are tried; None for all.
    """

    name: str
    kind: str
    raw: RawCampaign
    moving_fixes: bool = False
    limits: bool = True
    moments_differ: bool = True
    late: float = 1.0
    share: int | None = None


@dataclass(frozen=True)
class Wrong:
    """A wrong convention put into a campaign.

    `shown` says whether the data can show it, and `why` why not. `keys`: how many keys are wrong.
    """

    name: str
    raw: RawCampaign
    mends: tuple[Mend, ...]
    shown: bool = True
    why: str = ""
    keys: int = 1


def exchanged_names(names: list, i: int, j: int) -> list:
    swapped = list(names)
    swapped[i], swapped[j] = names[j], names[i]
    return swapped


def gyro_axes(raw: RawCampaign) -> np.ndarray:
    return np.array(raw.description["rate_sensor"].get("axes", np.eye(3)))


def wheel_axis(raw: RawCampaign) -> np.ndarray:
    return np.array(raw.wheels[0]["axis"])


def turned_readings(raw: RawCampaign, turn: np.ndarray) -> RawCampaign:
    """Readings along axes that are turned."""
    return changed(raw, "rate", lambda w: w @ turn.T)
