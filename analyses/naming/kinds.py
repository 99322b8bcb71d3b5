"""Campaigns of `table_study.py`: each kind hides something else.

`clean`: nothing. `single`, `pair`, `triple`: effects of a fixed shape, one, two or three, as large
as an ideal test finds in 99 % of such campaigns; `strong`: one at 3, 10 and 30 times that size.
`random`: an effect without a fixed shape. `outside`: a disturbance that the library does not hold.
`stated`: nothing, beside noise that wanders as the campaign says; `beside`: an effect of a fixed
shape in such noise, with outliers. `prior`: whatever the prior of a diagnosis may hide, each as
often. `random_x10`: ten times that size; `single_0.9`: as an ideal test finds in 90 %.

Campaigns of effects of a fixed shape are flown by the package's own simulator, which knows all of
them, the others by another one (`second_simulator.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analyses.naming.coloured_noise_campaigns import beside_campaign
from analyses.naming.fixed_shape import LEVEL, NAMES, Case, hidden_in, tasks, why_skipped
from analyses.naming.fixed_shape_campaigns import draw, without_tachometers
from analyses.naming.physical_limits import why_not_flown
from analyses.naming.prior_campaigns import DrawnCampaign, prior_campaign
from analyses.naming.second_simulator import replayed
from analyses.naming.stochastic_campaigns import (
    OF_TACHOMETERS,
    POWER,
    RANDOM,
    SizeOfTest,
    random_campaign,
    stated_campaign,
)
from analyses.naming.unlisted_disturbances import KINDS, outside
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.studies.work import task_seed

FIXED_KINDS = ("clean", "single", "strong", "pair", "triple")
NOTHING = ("clean", "stated")  # kinds in which nothing is hidden


@dataclass(frozen=True)
class Kind:
    """A kind of campaigns.

    Parameters
    ----------
    name : str
        As above, without power or times.
    tachometers : bool
        Whether the wheels have them.
    power : float
        Of the ideal test that finds what is hidden.
    times : float
        Size over that of the test.
    """

    name: str
    tachometers: bool
    power: float = POWER
    times: float = 1.0

    @classmethod
    def of(cls, text: str) -> Kind:
        """The kind of such a text.

        >>> Kind.of("random_x10/tacho")
        Kind(name='random', tachometers=True, power=0.99, times=10.0)
        >>> Kind.of("single_0.9/notacho").power
        0.9
        """
        told, _, measured = text.partition("/")
        name, _, size = told.partition("_")
        times = float(size[1:]) if size.startswith("x") else 1.0
        power = float(size) if size and times == 1.0 else POWER
        return cls(name, measured == "tacho", power, times)

    @property
    def labels(self) -> list[str]:
        """Labels of its campaigns: what is hidden in them."""
        if self.name in FIXED_KINDS:
            return list(dict.fromkeys(label for label, *_ in tasks(self.name, 1)))
        if self.name == "outside":
            return list(KINDS)
        if self.name == "beside":
            return list(NAMES)
        if self.name == "random":
            return [name for name in RANDOM if self.tachometers or name not in OF_TACHOMETERS]
        return [self.name]

    def campaign(self, label: str, index: int) -> DrawnCampaign | str:
        """The campaign of a label and a number, or why it is not flown."""
        if self.name in FIXED_KINDS:
            return self._of_fixed_shape(label, index)
        seed = task_seed(0, f"{label}/{index}")
        if self.name == "prior":
            return prior_campaign(seed, self.tachometers)
        flight, campaign = self._flown(label, seed)
        return DrawnCampaign(flight, campaign, () if self.name in NOTHING else (label,))

    def _flown(self, label: str, seed: np.random.SeedSequence) -> tuple[Flight, Campaign]:
        """A flight without effects of a fixed shape alone, and its telemetry."""
        if self.name == "stated":
            return stated_campaign(seed, self.tachometers)
        if self.name == "beside":
            return beside_campaign(label, seed, self.tachometers)[:2]
        if self.name == "random":
            of_test = SizeOfTest(self.power, self.times)
            return random_campaign(label, of_test, seed, self.tachometers)[:2]
        flown, noise, path = seed.spawn(3)
        flight = draw(flown, (), {}, True)
        missing = outside(label, np.random.default_rng(path))
        campaign = replayed(flight, missing, np.random.default_rng(noise))
        return flight, campaign if self.tachometers else without_tachometers(campaign)

    def _of_fixed_shape(self, label: str, index: int) -> DrawnCampaign | str:
        (effects,) = (
            e for name, i, e in tasks(self.name, index + 1) if (name, i) == (label, index)
        )
        case = Case(self.name, label, index, effects, self.tachometers)
        hidden = hidden_in(case, self.power, LEVEL)
        strong = self.name == "strong"
        if strong and (reason := why_skipped(case, hidden)):
            return reason
        flight = draw(case.seed, case.effects, hidden.values, self.tachometers)
        reason = why_not_flown(flight) if strong else None
        return reason or DrawnCampaign(flight, flight.campaign, tuple(case.hidden))
