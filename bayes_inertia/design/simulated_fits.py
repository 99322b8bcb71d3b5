"""Errors of fits to simulated campaigns of a plan."""

from __future__ import annotations

import numpy as np

from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model


@array_dataclass
class AchievedErrors:
    """Errors of fits to n simulated campaigns whose truths were drawn from the prior.

    Parameters
    ----------
    errors : (n, 6 + axes) array
        Estimate minus truth, of Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K of each sensor axis.
    stated : (n, 6 + axes) array
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
        """Achieved sds (6 + axes,): root mean square of the errors."""
        return np.sqrt(np.mean(self.errors**2, axis=0))

    @property
    def stated_sd(self) -> np.ndarray:
        """Stated sds (6 + axes,): root mean square over the campaigns."""
        return np.sqrt(np.mean(self.stated**2, axis=0))

    @property
    def sd_error(self) -> np.ndarray:
        """Standard errors (6 + axes,) of `sd`, from the scatter of the squared errors."""
        n = len(self.errors)
        return np.std(self.errors**2, axis=0, ddof=1) / np.sqrt(n) / (2.0 * self.sd)


def fit_simulated_campaign(
    plan: Plan, mission: Mission, source: np.random.SeedSequence
) -> dict[str, np.ndarray]:
    """Fly a plan once with noise, with a truth drawn from the prior, and fit the campaign in full.

    `source`: of truth and noise. Campaigns of two plans from one source have the same truth.
    """
    template = planned_campaign(plan, mission)
    flight = draw_flight(template, plan, source, vary=False, craft=mission.spacecraft)
    estimate = optimizer.estimate(Model(flight.campaign), starts=1, discount=False)
    n = estimate.model.n_base
    return {
        "errors": estimate.theta[:n] - flight.mission.theta,
        "stated": estimate.sd[:n],
        "peak_torque": np.max(flight.peak_torque, initial=-np.inf),
        "peak_momentum": np.max(flight.peak_momentum, initial=-np.inf),
        "chi2": np.asarray(estimate.tests["total"].reduced_chi2),
    }
