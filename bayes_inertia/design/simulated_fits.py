"""What fits to simulated campaigns of a plan achieve."""

from __future__ import annotations

import joblib
import numpy as np

from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model

# Campaigns a task: few enough to share work, enough to pay for compiling.
_CAMPAIGNS_A_TASK = 25


@array_dataclass
class AchievedErrors:
    """Errors of fits to n simulated campaigns whose truths were drawn from the prior.

    Parameters
    ----------
    errors : (n, 9) array
        Estimate minus truth, of Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K1 K2 K3.
    stated : (n, 9) array
        Sds that the fits stated.
    peak_torque : (n,) array
        Largest torque as a fraction of the wheel's limit; NaN where unlimited.
    peak_momentum : (n,) array
        Largest momentum as a fraction of the wheel's limit; NaN where unlimited.
    chi2 : (n,) array
        Reduced chi^2 of all telemetry.
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


def fit_simulated_campaigns(
    plan: Plan, mission: Mission, campaigns: int | range, seed: int = 0, jobs: int = 1
) -> AchievedErrors:
    """Fly a plan many times with noise, and fit each campaign in full.

    Each campaign has another truth, drawn from the prior.

    Parameters
    ----------
    plan : Plan
        What is flown.
    mission : Mission
        Wheels, sensors and prior.
    campaigns : int or range
        How many campaigns, or the numbers of those wanted.
    seed : int, optional
        Campaign i of two plans has the same truth for the same seed.
    jobs : int, optional
        How many processes share the work.

    Returns
    -------
    AchievedErrors
        In the order of the campaigns.
    """
    numbers = range(campaigns) if isinstance(campaigns, int) else campaigns
    starts = range(0, len(numbers), _CAMPAIGNS_A_TASK)
    tasks = [numbers[i : i + _CAMPAIGNS_A_TASK] for i in starts]
    with joblib.parallel_config(
        "loky" if jobs > 1 else "sequential",
        n_jobs=jobs,
        inner_max_num_threads=1 if jobs > 1 else None,
    ):
        results = joblib.Parallel()(
            joblib.delayed(_fits)(plan, mission, seed, task) for task in tasks
        )
    return AchievedErrors(*(np.concatenate(parts) for parts in zip(*results, strict=True)))


def _fits(plan: Plan, mission: Mission, seed: int, numbers: range) -> tuple[np.ndarray, ...]:
    """The fields of `AchievedErrors` for the campaigns of these numbers."""
    template = planned_campaign(plan, mission)
    rows = []
    for i in numbers:
        source = np.random.SeedSequence(seed, spawn_key=(i,))
        flight = draw_flight(template, plan, source, vary=False)
        estimate = optimizer.estimate(Model(flight.campaign), starts=1, discount=False)
        rows.append(
            (
                estimate.theta - flight.mission.theta,
                estimate.sd,
                np.max(flight.peak_torque),
                np.max(flight.peak_momentum),
                estimate.tests["total"].reduced_chi2,
            )
        )
    return tuple(np.array(column) for column in zip(*rows, strict=True))
