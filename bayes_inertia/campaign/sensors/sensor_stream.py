"""A sensor's stream of readings, as a campaign knows it: its column, words and stated noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.campaign.slew import Slew


@dataclass(frozen=True)
class SensorStream(ABC):
    """One sensor's readings; a class for each kind of sensor, an instance for each sensor.

    Parameters
    ----------
    name : str
        Of the channel, as files and messages say it.
    field : str
        Of `Slew`, which holds the readings.
    """

    name: str
    field: str

    # In words; of the readings.
    sensor: ClassVar[str]
    unit: ClassVar[str]
    # Whether every row of a slew may hold a reading; else there are fixes here and there.
    is_series: ClassVar[bool] = True

    def of(self, slew: Slew) -> np.ndarray | None:
        """Readings (n, columns) of a slew, None where it has none."""
        return getattr(slew, self.field)

    @abstractmethod
    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Stated noise of each column or axis, None where it is not stated."""

    def correlated(self, campaign: Campaign) -> CorrelatedNoise | None:
        """How the noise was measured to be correlated in time; None: it is white."""
        return None

    @abstractmethod
    def louder(self, campaign: Campaign, factor: float) -> Campaign:
        """The campaign with this sensor's stated noise multiplied."""
