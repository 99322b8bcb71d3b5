"""One plan in a comparison: what to expect of it, and what it costs."""

from __future__ import annotations

import numpy as np

from bayes_inertia.design.expected_accuracy import expected_sd
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin, planned_margins
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.design.simulated_fits import AchievedErrors
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.maths.values import array_dataclass

# What the names of such plans say.
_REFERENCE = "slews like the paper's"


@array_dataclass
class Contender:
    """One plan in a comparison.

    Parameters
    ----------
    name : str
        The plan's name in the comparison.
    plan : Plan
        What would be flown.
    expected : (6 + axes,) array
        Sds of J [kg m^2] and K to expect, see `expected_sd`.
    achieved : AchievedErrors or None
        What fits to simulated campaigns achieved; None unless simulated.
    total_time : float
        From the first row of telemetry to the last [s].
    motion_time : float
        Of all slews [s].
    peak_momentum : float
        Largest of any wheel, planned [N m s]; NaN where unlimited.
    peak_torque : float
        Largest of any wheel, planned [N m]; NaN where unlimited.
    margins : tuple of Margin
        What is left of every limit.
    """

    name: str
    plan: Plan
    expected: np.ndarray
    achieved: AchievedErrors | None
    total_time: float
    motion_time: float
    peak_momentum: float
    peak_torque: float
    margins: tuple[Margin, ...]

    @property
    def is_reference(self) -> bool:
        """Whether it is of slews like the paper's, which other plans are measured by."""
        return _REFERENCE in self.name

    @property
    def worst_cross_term(self) -> float:
        """Largest expected sd of a product of inertia [kg m^2]."""
        return float(self.expected[3:6].max())


def assess_plan(
    name: str,
    plan: Plan,
    mission: Mission,
    limits: Limits,
    *,
    seed: int = 0,
    achieved: AchievedErrors | None = None,
) -> Contender:
    """Expected sds of a plan, and its margin to every limit."""
    margins = planned_margins(plan, mission.spacecraft, limits)
    peaks = {
        key: [margin.used for margin in margins if margin.limit.startswith(f"{key} of")]
        for key in ("torque", "momentum")
    }
    expected = expected_sd(plan, mission, truths=NUMERICS.expected_flights, seed=seed + 1)
    return Contender(
        name=name,
        plan=plan,
        expected=expected,
        achieved=achieved,
        total_time=plan.starts[-1] + plan.durations[-1],
        motion_time=float(sum(slew.motion_time for slew in plan.slews)),
        peak_momentum=max(peaks["momentum"], default=float("nan")),
        peak_torque=max(peaks["torque"], default=float("nan")),
        margins=margins,
    )
