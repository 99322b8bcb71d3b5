"""Numbers of simulated flights, each with its reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Numerics:
    """Fields by the file that reads them."""

    # `closed_loop.py`
    # Relaxation ends when no command changes by more than this fraction of the largest.
    relaxation_tolerance: float = 1e-9
    most_relaxations: int = 60

    # `closed_loop_flights.py`
    # Stands for a limit that the hardware does not have, in any unit.
    no_limit: float = 1e30
    # Most phase [rad] of the attitude loop in the time that a command is held: its lag, half of it,
    # leaves the damping as it is. From 1.4 on the loop is unstable.
    phase_of_period: float = 0.5

    # `example_flight.py`
    # A slew lasts for this share of the time to the next one.
    example_flown_share: float = 0.75
    # Steps of a slew, and of the rest before and after its rotation; one reading or command every
    # so many steps, which divide both.
    example_rows: int = 600
    example_rest: int = 60
    example_every: Mapping[str, int] = MappingProxyType(
        {
            "wheel_torque": 2,
            "wheel_momentum": 2,
            "wheel_speed": 2,
            "attitude": 10,
            "direction": 5,
            "input": 10,
            "magnetic_field_N": 10,
        }
    )
    example_digits: int = 10  # significant, of numbers in the tables

    # `mission.py`
    # Fixes follow each other throughout a slew where no gap is longer than so many of them.
    longest_gap_of_fixes: float = 5.0
    # A flown rotation may be off the planned one by so much [rad], and by this share of its angle:
    # errors of J, K and bias on board.
    rotation_off: float = math.radians(2.0)
    rotation_off_share: float = 0.1
    # A flown peak rate may be off the planned one by this share, and by so many noise sigmas.
    peak_rate_off_share: float = 0.25
    peak_rate_off_sigmas: float = 6.0

    # `planned_telemetry.py`
    # Of the largest torque or momentum that a plan asks of a device, what may be missing.
    unreached: float = 1e-6

    # `orbit.py`
    earth_dipole: float = 7.75e15  # [T m^3], axial term of the geomagnetic field
    smallest_radius: float = 6.0e6  # [m]

    # `planned_motion.py`
    # Rows in the rest before, each ramp, the coast, the settling and the rest after.
    rows_of_phases: tuple[int, ...] = (8, 14, 24, 14, 8, 8)
    # Shortest coast in the grid [s]: a slew without a coast keeps increasing times.
    shortest_coast: float = 0.05

    # `steering.py`
    # Directions in which what a device can give is worked out: 10 deg apart.
    envelope_directions: int = 400
    # How many of the strongest torques of a campaign stand for what a told torque can give.
    torques_of_envelope: int = 200
    # Projections that share a torque among thrusters: each halves what is missing.
    projections: int = 40
    # Newton steps from row to row, and to the first row from the angles before the first slew.
    steps_of_row: int = 4
    steps_to_start: int = 24
    # Of the mean square slope: what keeps gimbals from running away where they are singular.
    gimbal_damping: float = 1e-9

    @property
    def rows_of_slew(self) -> int:
        """Rows of the grid of a slew."""
        return sum(self.rows_of_phases) + 1


NUMERICS = Numerics()
