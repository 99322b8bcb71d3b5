"""By how much telemetry breaks the three laws under a reading of it.

Misfits are in standard deviations of what noise and undisclosed physics may leave (`limits`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, DRIVE, LAWS, LawData, Told
from bayes_inertia.conventions.linear_fit import LinearFit
from bayes_inertia.conventions.motion import Motion, motion_of
from bayes_inertia.conventions.noise_seen import CHANNELS, believed_noise
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.sampled_slews import SampledSlews


@dataclass(frozen=True, eq=False)
class Misfits:
    """The three laws, for a campaign at some sixty moments a slew; results are kept.

    Parameters
    ----------
    campaign : Campaign
        Hardware and priors.
    slews : SampledSlews
        Its telemetry.
    """

    campaign: Campaign
    slews: SampledSlews
    kept: dict = field(default_factory=dict)

    def of(self, reading: Reading) -> dict[str, LinearFit]:
        """The fit of every law that the telemetry can be held against.

        Returns: by the name of the law; a law without telemetry is absent.
        """
        fits = {law: self.fit(law, reading) for law in LAWS}
        return {law: fit for law, fit in fits.items() if fit is not None}

    def mends(self, reading: Reading, limit: float) -> bool:
        """Whether a reading brings every law below a limit; the cheap laws are asked first.

        `limit` [sd].
        """
        return all(
            fit is None or fit.worst < limit
            for fit in (self.fit(law, reading) for law in (DRIVE, CLOSURE, CONSERVATION))
        )

    def motion(self, reading: Reading) -> Motion:
        """The motion that the rates tell."""
        key = ("motion", reading.rate.tobytes(), reading.time, reading.bias_B.tobytes())
        if key not in self.kept:
            self.kept[key] = motion_of(self.slews, reading)
        return self.kept[key]

    def law(self, law: str, reading: Reading, bias_sd: np.ndarray | None = None) -> LawData | None:
        """One law as a linear problem.

        `bias_sd` (3,): sd of the rate bias [rad/s] where it is supposed to be stale.
        """
        return LAWS[law](replace(self.told(reading), bias_sd=bias_sd))

    def told(self, reading: Reading) -> Told:
        """What the telemetry tells under a reading."""
        if "noise" not in self.kept:
            self.kept["noise"] = {c: believed_noise(self.campaign, c) for c in CHANNELS}
        noise = self.kept["noise"]
        return Told(self.campaign, self.slews, reading, self.motion(reading), noise)

    def fit(self, law: str, reading: Reading) -> LinearFit | None:
        """The fit of one law; the same reading of the same channels is fitted once."""
        arrays = (getattr(reading, part).tobytes() for part in self.parts_of(law))
        key = (law, reading.time, *arrays)
        if key not in self.kept:
            data = self.law(law, reading)
            self.kept[key] = None if data is None else data.fit()
        return self.kept[key]

    def parts_of(self, law: str) -> tuple[str, ...]:
        """Which fields of a reading, besides time, a law depends on."""
        parts: dict[str, tuple[str, ...]] = {
            CLOSURE: ("rate", "bias_B", "attitude"),
            CONSERVATION: ("rate", "bias_B", "axes_B", "inertia", self.wheel_channel),
            DRIVE: ("torque", "momentum"),
        }
        return parts[law]

    @property
    def wheel_channel(self) -> str:
        """Which field of a reading tells the wheels' momentum."""
        return "torque" if self.slews.momentum is None else "momentum"
