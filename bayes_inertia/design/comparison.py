"""Plans side by side: what to expect of each, what simulated campaigns achieve, and what they cost in time, momentum and torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import joblib
import numpy as np

from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin, planned_margins
from bayes_inertia.design.rehearsal import expected_sd
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model

NAMES = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")
# Campaigns a task: few enough to share work, enough to pay for compiling.
_SHARD = 25
# Flights that expected sds are averaged over.
_TRUTHS = 24


@array_dataclass
class Achieved:
    """Errors of fits to simulated campaigns whose truths were drawn from the prior.

    Attributes
    ----------
    errors : (n, 9) estimate minus truth. stated : (n, 9) sds that the fits stated. peak_torque, peak_momentum : (n,) largest, as
        a fraction of the wheel's limit (NaN where unlimited). chi2 : (n,) reduced chi^2 of all telemetry.
    """

    errors: np.ndarray
    stated: np.ndarray
    peak_torque: np.ndarray
    peak_momentum: np.ndarray
    chi2: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Achieved sds (9,): root mean square of the errors."""
        return np.sqrt(np.mean(self.errors**2, axis=0))

    @property
    def sd_error(self) -> np.ndarray:
        """Standard errors (9,) of `sd`, from the scatter of the squared errors."""
        n = len(self.errors)
        return np.std(self.errors**2, axis=0, ddof=1) / np.sqrt(n) / (2.0 * self.sd)


@array_dataclass
class Contender:
    """One plan in a comparison.

    Attributes
    ----------
    name, plan : what. expected : (9,) sds of J and K to expect (see `expectation.expected_sd`). achieved : None unless simulated.
    total_time [s]; motion_time : of all slews [s]. margins : what is left of every limit.
    peak_momentum [N m s], peak_torque [N m] : largest of any wheel, planned.
    """

    name: str
    plan: Plan
    expected: np.ndarray
    achieved: Achieved | None
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
    """Compare plans of one spacecraft.

    Parameters
    ----------
    plans : under their own names, or others. mission : wheels and sensors, J to expect, and how well it is known.
    simulated : campaigns to fly and fit in full for each plan, each with its own J, K and bias from the prior; all plans meet the same.
    seed : of those. jobs : processes.

    Raises
    ------
    CampaignError : no plan, or two of one name.

    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> bool(compare_plans([paper_like_plan()], most_like_mission())[0].worst_cross_term < 1e-4)
    True
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
    name: str,
    plan: Plan,
    mean: Mission,
    limits: Limits,
    simulated: int,
    seed: int,
    jobs: int,
) -> Contender:
    found = planned_margins(plan, mean.spacecraft, limits)
    peaks = {
        key: [m.used for m in found if m.limit.startswith(f"{key} of")]
        for key in ("torque", "momentum")
    }
    return Contender(
        name=name,
        plan=plan,
        expected=expected_sd(plan, mean, truths=_TRUTHS, seed=seed + 1),
        achieved=achieve(plan, mean, simulated, seed, jobs) if simulated else None,
        total_time=plan.starts[-1] + plan.durations[-1],
        motion_time=float(sum(slew.motion_time for slew in plan.slews)),
        peak_momentum=max(peaks["momentum"], default=float("nan")),
        peak_torque=max(peaks["torque"], default=float("nan")),
        margins=found,
    )


def achieve(
    plan: Plan,
    mission: Mission,
    n: int | range,
    seed: int = 0,
    jobs: int = 1,
) -> Achieved:
    """Fly a plan n times with noise, each time another truth drawn from the prior, and fit each campaign in full.

    Parameters
    ----------
    mission : wheels, sensors and prior. n : how many campaigns, or the numbers of those wanted.
    seed : campaign i of two plans has the same truth for the same seed. jobs : processes.
    """
    wanted = range(n) if isinstance(n, int) else n
    spans = [wanted[i : i + _SHARD] for i in range(0, len(wanted), _SHARD)]
    with joblib.parallel_config(
        "loky" if jobs > 1 else "sequential",
        n_jobs=jobs,
        inner_max_num_threads=1 if jobs > 1 else None,
    ):
        done = joblib.Parallel()(
            joblib.delayed(_shard)(plan, mission, seed, span) for span in spans
        )
    return Achieved(*(np.concatenate(parts) for parts in zip(*done, strict=True)))


def _shard(plan: Plan, mission: Mission, seed: int, span: range) -> tuple[np.ndarray, ...]:
    template = planned_campaign(plan, mission)
    rows = []
    for i in span:
        flight = draw_flight(
            template, plan, np.random.SeedSequence(seed, spawn_key=(i,)), vary=False
        )
        at = estimate(Model(flight.campaign), starts=1, discount=False)
        truth = flight.mission.theta
        rows.append(
            (
                at.theta - truth,
                at.sd,
                np.max(flight.peak_torque),
                np.max(flight.peak_momentum),
                at.tests["total"].reduced_chi2,
            )
        )
    return tuple(np.array(column) for column in zip(*rows, strict=True))
