"""Numbers of the search for a plan, each with its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Numerics:
    """Fields by the file that reads them."""

    # `comparison.py`
    # Truths that expected sds are averaged over.
    expected_flights: int = 24

    # `designer.py`
    # A limit that a plan comes this close to, of what its reserve leaves, is active.
    active_slack: float = 0.01
    # The paper's angular acceleration [rad/s^2].
    paper_acceleration: float = math.radians(0.05)
    # By what factor, and how often at most, angles are reduced until a plan fits its time, and
    # rates and ramps until wheels can drive it.
    reduction: float = 0.93
    most_reductions: int = 60
    # Smallest angle [rad] of a slew like the paper's.
    paper_smallest_angle: float = 1e-3
    # How far rounding to an operator's digits may reach into a reserve [fraction of the limit].
    rounding_slack: float = 2e-3

    # `after_campaign.py`
    # Longest control period [s] of a forecast: on-board loops are faster than slow telemetry.
    control_period: float = 1.0

    # `feasible_region.py`
    # A slew that hardly turns [rad]: it shows what the start alone demands.
    negligible_angle: float = 1e-6
    # Shortest ramp [s] and smallest angle [rad]: shorter ones are over before the controller
    # settles.
    shortest_ramp: float = 4.0
    smallest_angle: float = math.radians(5.0)
    # Largest rate [rad/s] where nothing limits it.
    default_rate: float = math.radians(1.0)
    # How many times the sd of noise and bias a rate is at most where nothing turns; noise alone
    # reaches three.
    noise_of_rest: float = 5.0
    # How many sds of the scale factors keep-out cones are widened by.
    scale_factor_sigmas: float = 2.5
    # Smallest fractions of rate and acceleration.
    smallest_fractions: tuple[float, float] = (0.15, 0.03)

    # `information_forecast.py`
    # Points of the table that holds an orbit's environment.
    orbit_points: int = 200
    # Of how many readings a row stands at least: what is divided by it, or rooted, has derivatives.
    least_readings: float = 1e-12

    # `goals.py`
    # Turn of the slew whose correction is forecast [deg], as everywhere in the package.
    corrected_turn_deg: float = 60.0
    # The largest of several sds, made smooth: a norm of this order is at most 5 % above that of
    # three.
    norm_order: int = 24

    # `margins.py`
    # A limit counts as kept when this fraction of it is missing: rounding.
    rounding_tolerance: float = 1e-9

    # `plan_problem.py`
    # Plans that one call of compiled code scores.
    plans_per_batch: int = 10

    # `designer.py`, the search
    # Limits are kept this far away [fraction] in the search, so that rounding does not cross them.
    limit_clearance: float = 1e-3
    # Slack [fraction] that stands for a limit which does not exist: SLSQP cannot hold infinity.
    unlimited_slack: float = 1e3
    # Most steps of each descent.
    descent_steps: int = 50

    # `separating_slew.py`
    # Slews of each round of the search, and how many such rounds draw from the whole region.
    slews_per_batch: int = 128
    first_batches: int = 4
    # Rounds of the search around the best, how many are kept in each, and how far it reaches at
    # first.
    search_rounds: int = 5
    kept_each_round: int = 10
    first_width: float = 0.3
    # What a violated limit adds to the logarithm of the goal, for each fraction of the limit.
    limit_penalty: float = 1e3

    @property
    def corrected_turn(self) -> float:
        """`corrected_turn_deg` in radians."""
        return math.radians(self.corrected_turn_deg)


NUMERICS = Numerics()
