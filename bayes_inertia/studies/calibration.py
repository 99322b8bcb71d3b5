"""Simulation-based calibration: is the truth where the posterior says, as often as it says?

J, K, bias and effects are drawn from the prior, slews are flown in closed loop with noise, and the
campaign is fitted as real data would be. If prior, simulator, likelihood and sampler belong
together, the truth's rank among draws of the posterior is uniform (Talts et al. 2018), for every
quantity that draws give: J, K, principal moments, the correction slew that they predict, and the
log posterior itself, which notices what all others miss (Modrak et al. 2023).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.numerics import NUMERICS as DESIGN_NUMERICS
from bayes_inertia.errors import SettingsError, StudyError, require
from bayes_inertia.flight.closed_loop_flights import predict_correction_slew
from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.flight.planned_telemetry import planned_campaign, with_effect_values
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.flight.spacecraft import Controller
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.marginal_posterior import LogDensity
from bayes_inertia.inference.sampler import log_density_at, sample
from bayes_inertia.inference.settings import Settings
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.constant_torque import ConstantTorque
from bayes_inertia.physics.effects.sensor_misalignment import RateSensorMisalignment
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import BASE_NAMES, N_BASE
from bayes_inertia.studies.limits import LIMITS
from bayes_inertia.studies.rank_statistics import Coverage, Ranks
from bayes_inertia.studies.work import Row, TaskFailure, Work, WorkResult

QUANTITIES = (*BASE_NAMES, "I1", "I2", "I3", "correction slew", "log posterior")


@dataclass(frozen=True)
class CalibrationCase:
    """One kind of campaign."""

    name: str  # lower case, for ids and files
    says: str  # what it is, in a few words
    plan: Plan  # what is flown, each time with other angles, senses and start attitude
    mission: Mission  # hardware and prior
    effects: tuple[Effect, ...] = ()  # that act, drawn from their priors, and are fitted along
    star_tracker: bool = True  # whether its fixes are in the telemetry
    tachometers: bool = True  # whether the wheels' momentum is

    def as_measured(self, campaign: Campaign) -> Campaign:
        """A flown campaign without the readings that this case lacks."""
        if not self.star_tracker:
            slews = tuple(replace(slew, attitude=None) for slew in campaign.slews)
            campaign = replace(campaign, star_tracker=None, slews=slews)
        if not self.tachometers:
            wheels = tuple(replace(wheel, momentum_sigma=None) for wheel in campaign.wheels)
            slews = tuple(replace(slew, wheel_momentum=None) for slew in campaign.slews)
            campaign = replace(campaign, wheels=wheels, slews=slews)
        return campaign


def calibration_cases() -> tuple[CalibrationCase, ...]:
    """All cases, of the MOST-like spacecraft at one row a second."""
    mission = most_like_mission()
    five = replace(paper_like_plan(), telemetry_period=LIMITS.period_s)
    weak = (PlannedSlew((1.0, 0.0, 0.0), 1.0), PlannedSlew((0.0, 1.0, 1.0), 1.0))
    two = replace(five, slews=weak)
    effects = (ConstantTorque(LIMITS.torque_sigma), RateSensorMisalignment())
    case = partial(CalibrationCase, plan=five, mission=mission)
    turned = "five slews with a constant torque and a turned rate sensor"
    return (
        case("five-slews", "five slews about five axes"),
        case("two-slews", "weak data: two slews", plan=two),
        case("no-star-tracker", "five slews without star tracker", star_tracker=False),
        case("no-tachometers", "five slews without tachometers", tachometers=False),
        case("effects", turned, effects=effects),
    )


def cases_named(names: Sequence[str]) -> tuple[CalibrationCase, ...]:
    """The cases of these names, in their order; all for none."""
    known = {case.name: case for case in calibration_cases()}
    for name in names:
        advice = f"choose from {', '.join(known)}"
        require(name in known, "cases", f"no case {name!r}", advice, error=SettingsError)
    return tuple(known[name] for name in dict.fromkeys(names)) or tuple(known.values())


@dataclass(frozen=True)
class CalibrationFit:
    """The task: one campaign of a case flown, fitted and ranked."""

    cases: Mapping[str, CalibrationCase]  # by name; a task's id is "name/number"
    # Of the sampler; its seed is the task's.
    settings: Settings = field(
        default_factory=lambda: Settings(ensembles=2, walkers=50, steps=12, max_steps=12, threads=1)
    )

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Ranks, truths, means and sds of `QUANTITIES`; and what the fit says about itself."""
        case = self.cases[task_id.partition("/")[0]]
        flying, fitting = seed.spawn(2)
        template = planned_campaign(case.plan, case.mission)
        flight = draw_flight(template, case.plan, flying, effects=case.effects)
        campaign = self.as_fitted(case.as_measured(flight.campaign))
        number = int(fitting.generate_state(1)[0])
        model = Model(campaign, case.effects)
        estimate = optimizer.estimate(model, seed=number, starts=1)
        settings = replace(self.settings, seed=number)
        chains = sample(estimate, settings)
        # Each walker halfway and at its end: hardly correlated, nearly every step proposes anew.
        length, size = chains.samples.shape[2:]
        draws = chains.samples[:, :, [length // 2 - 1, length - 1]].reshape(-1, size)[
            : LIMITS.ranked_draws
        ]
        density = log_density_at(estimate)
        values = _quantities(case, density, self.as_reported(draws))
        truth = _quantities(case, density, _truth(flight, model)[None])[0]
        return {
            "rank": (values < truth).sum(0),
            "truth": truth,
            "mean": values.mean(0),
            "sd": values.std(0, ddof=1),
            "reduced_chi2": estimate.tests["total"].reduced_chi2,
            "explained": not any(test.rejected for test in estimate.tests.values()),
            "nested_rhat": chains.diagnostics.nested_rhat_max,
        }

    def as_fitted(self, campaign: Campaign) -> Campaign:
        """The campaign that is fitted; another one in fits that are wrong on purpose."""
        return campaign

    def as_reported(self, draws: np.ndarray) -> np.ndarray:
        """The draws (n, d) that are ranked; others in fits that are wrong on purpose."""
        return draws


def calibration_work(cases: Sequence[CalibrationCase], fits: int, seed: int = 0) -> Work:
    """A calibration as tasks "name/0", "name/1", ..., of which the cases have equally many."""
    each = -(-fits // len(cases))
    ids = tuple(f"{case.name}/{i}" for case in cases for i in range(each))
    task = CalibrationFit({case.name: case for case in cases})
    options: dict[str, Any] = {
        "cases": {case.name: repr((asdict(case.plan), case.effects)) for case in cases},
        "settings": repr(task.settings),
        "ranked": LIMITS.ranked_draws,
        "pipeline": "right",
    }
    return Work("fits", task, ids, seed, options)


def _truth(flight: Flight, model: Model) -> np.ndarray:
    """The flight's theta (d,), effects included."""
    theta = np.array(model.space.mean, dtype=float)
    theta[:N_BASE] = flight.mission.theta
    return with_effect_values(model, theta, model.effects, flight.spacecraft.values)


def _quantities(case: CalibrationCase, density: LogDensity, thetas: np.ndarray) -> np.ndarray:
    """`QUANTITIES` (n, 14) of each theta (n, d)."""
    base = thetas[:, :N_BASE]
    moments = inertia_tensor.principal_moments(base[:, :6])
    return np.column_stack([base, moments, _correction_slews(case, base), density(thetas)])


def _correction_slews(case: CalibrationCase, thetas: np.ndarray) -> np.ndarray:
    """Correction slew (n,) [rad] that each J and K (n, 9) predict, flown on the prior's mean."""
    mission = case.mission.at_prior_mean()
    craft = replace(mission.spacecraft, bias=(0.0, 0.0, 0.0))
    plan = replace(
        case.plan, slews=(PlannedSlew(LIMITS.corrected_axis, DESIGN_NUMERICS.corrected_turn),)
    )
    controller = Controller(craft.inertia_B, craft.scale_factor)
    return predict_correction_slew(thetas, plan, replace(mission, spacecraft=craft), controller)


@array_dataclass
class CaseCalibration:
    """The fits of one case."""

    name: str  # of the case
    says: str
    ranks: np.ndarray  # (n, 14) of the truth among the draws, of each of `QUANTITIES`
    z: np.ndarray  # (n, 14) truth minus mean, in sds of the draws
    explained: np.ndarray  # (n,) whether the residuals of these perfect fits pass their tests
    nested_rhat: np.ndarray  # (n,) of the short chains

    @cached_property
    def p_values(self) -> np.ndarray:
        """P-values of the uniformity of the ranks (14,)."""
        return np.array([Ranks(ranks, LIMITS.ranked_draws).p_value for ranks in self.ranks.T])

    @property
    def departures(self) -> np.ndarray:
        """ECDFs minus that of uniform ranks, in standard errors (14, 199)."""
        return np.array([Ranks(ranks, LIMITS.ranked_draws).departure for ranks in self.ranks.T])

    def coverage(self, quantity: int) -> tuple[Coverage, ...]:
        """Coverage of intervals of 50, 90 and 95 % of a quantity, by its index."""
        return tuple(
            map(Ranks(self.ranks[:, quantity], LIMITS.ranked_draws).coverage, LIMITS.levels)
        )


@array_dataclass
class Calibration:
    """A finished calibration."""

    cases: tuple[CaseCalibration, ...]  # in the order in which they were asked for
    failures: tuple[TaskFailure, ...] = ()  # fits that failed; they count in nothing

    @property
    def fits(self) -> int:
        """Fits that were ranked."""
        return sum(len(case.ranks) for case in self.cases)

    @property
    def limit(self) -> float:
        """p-value below which ranks are not uniform: 1 % shared by all cases and quantities."""
        return LIMITS.false_alarm / (len(self.cases) * len(QUANTITIES))

    @property
    def rejected(self) -> tuple[tuple[str, str], ...]:
        """(case, quantity) of all ranks that are not uniform."""
        return tuple(
            (case.name, name)
            for case in self.cases
            for name, p in zip(QUANTITIES, case.p_values, strict=True)
            if p < self.limit
        )


def calibration_of(cases: Sequence[CalibrationCase], result: WorkResult) -> Calibration:
    """The rows of a calibration's fits, by case; StudyError where a case has none."""
    parts = []
    for case in cases:
        rows = [row for row in result.rows if row["task"].partition("/")[0] == case.name]
        reason = result.failures[0].reason if result.failures else "none was asked for"
        what = f"no fit of the case {case.name} succeeded: {reason}"
        advice = "leave the case out, or ask for more fits"
        require(bool(rows), "calibration", what, advice, error=StudyError)
        column = WorkResult(tuple(rows)).column
        z = (column("truth") - column("mean")) / column("sd")
        told = column("rank"), z, column("explained"), column("nested_rhat")
        parts.append(CaseCalibration(case.name, case.says, *told))
    return Calibration(tuple(parts), result.failures)
