"""Plans side by side: what to expect of each, what simulated campaigns achieve, what they cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.design.expected_accuracy import expected_sd
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin, planned_margins
from bayes_inertia.design.simulated_fits import AchievedErrors, fit_simulated_campaigns
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.maths.values import array_dataclass

# Flights that expected sds are averaged over.
_EXPECTED_FLIGHTS = 24


@array_dataclass
class Contender:
    """One plan in a comparison.

    Parameters
    ----------
    name : str
        The plan's name in the comparison.
    plan : Plan
        What would be flown.
    expected : (9,) array
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
    def worst_cross_term(self) -> float:
        """Largest expected sd of a product of inertia [kg m^2]."""
        return float(self.expected[3:6].max())


def compare_plans(
    plans: Sequence[Plan] | Mapping[str, Plan],
    mission: Mission,
    *,
    limits: Limits | None = None,
    simulated: int = 0,
    seed: int = 0,
    jobs: int = 1,
) -> tuple[Contender, ...]:
    """Compare plans of one mission.

    Parameters
    ----------
    plans : sequence of Plan, or mapping of str to Plan
        Under their own names, or under those given.
    mission : Mission
        Wheels and sensors, J to expect, and how well it is known.
    limits : Limits, optional
        None for those of the hardware alone.
    simulated : int, optional
        Campaigns to fly and fit in full for each plan, each with its own J, K and bias from the
        prior; all plans meet the same.
    seed : int, optional
        Of those.
    jobs : int, optional
        How many processes share the work.

    Returns
    -------
    tuple of Contender
        In the order of the plans.

    Raises
    ------
    CampaignError
        If there is no plan, or two have one name.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> compare_plans([], most_like_mission())
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: plans: no plan to compare; give each its own name
    """
    named = dict(plans) if isinstance(plans, Mapping) else {plan.name: plan for plan in plans}
    if not named or len(named) < len(plans):
        raise CampaignError(
            "no plan to compare" if not named else "two plans have one name",
            where="plans",
            advice="give each its own name",
        )
    mean = mission.at_prior_mean()
    mean = replace(mean, spacecraft=replace(mean.spacecraft, bias=None))
    limits = limits or Limits()
    return tuple(
        _contender(name, plan, mean, limits, simulated, seed, jobs) for name, plan in named.items()
    )


def _contender(
    name: str, plan: Plan, mean: Mission, limits: Limits, simulated: int, seed: int, jobs: int
) -> Contender:
    """One plan of the comparison, for a mission at the mean of its prior."""
    margins = planned_margins(plan, mean.spacecraft, limits)
    peaks = {
        key: [margin.used for margin in margins if margin.limit.startswith(f"{key} of")]
        for key in ("torque", "momentum")
    }
    expected = expected_sd(plan, mean, truths=_EXPECTED_FLIGHTS, seed=seed + 1)
    achieved = fit_simulated_campaigns(plan, mean, simulated, seed, jobs) if simulated else None
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
