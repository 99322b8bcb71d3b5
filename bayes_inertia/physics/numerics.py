"""Numbers of the forward model, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Numerics:
    """Fields by the file that reads them."""

    # `check_effect.py`
    # Draws of the prior where telemetry and derivatives are tried, and their seed.
    checked_draws: int = 8
    checked_seed: int = 20250
    # Parts of an integration step over which a torque that jumps is told from one that is steep.
    parts_of_step: int = 32
    # Step of the differences that derivatives are held against [prior sds].
    difference_step: float = 1e-4
    coefficient_seed: int = 20251
    # Eigenvalues of a correlation matrix below this are taken for zero.
    zero_eigenvalue: float = 1e-12
    # Asymmetry and negative eigenvalues that are rounding, as a share of the largest number of a
    # covariance.
    covariance_rounding: float = 1e-9

    # `effects/formula.py`
    # Shares of the torque that makes the motion, and of rate and momentum, that a formula's prior
    # allows. It has no other scale; a diagnosis averages over sizes anyway.
    formula_torque: float = 0.1
    formula_reading: float = 0.01
    formula_turn: float = 20.0  # times the star tracker's sigma_cross, as its shift
    formula_field: float = 3e-5  # [T], of the Earth in a low orbit

    # `integration_plan.py`
    # Noise of tachometers and gimbal angles moves the attitude by its slow shapes and by those near
    # the nutation: so many beyond each end of its frequencies, at most so many in all. The rest
    # acts only on its own sample.
    slow_input_shapes: int = 12
    nutation_margin: float = 3.0
    most_nutation_shapes: int = 64
    # [rad/s] of wheels whose limit nobody states: 6000 revolutions a minute is usual, 9500 much.
    fastest_rotor: float = 1e3
    # Largest error of what a sensor is predicted to read, as a share of its noise.
    error_of_noise: float = 1.0 / 100.0
    # Error as a share of the turn times (f h)^6: the largest of 128 tumbling bodies with and
    # without wheels was 2.8e-4, half of them stayed below 2e-6.
    error_of_step: float = 3e-4
    longest_turn: float = 1.0  # f h at most [rad]
    # Steps allowed, an octave: 4 % apart. With four, rows a little too far apart cost twice.
    steps_an_octave: int = 16
    # The largest rate and momentum of a slew are so many times this quantile: outliers do not
    # count.
    largest_quantile: float = 0.95
    largest_over_quantile: float = 1.25
    # What the wheels do within a step moves the body by the angle that is integrated to first
    # order, times this and the turn of the step.
    coupling_of_wheels: float = 0.1
    # Rows a step that are tried: few, for each is another program. Every size that slews of
    # `rows_of_long_slew` are padded to is a multiple of all (`padded_size`).
    rows_per_step: tuple[int, ...] = (96, 48, 24, 12, 6, 3, 1)
    # One step of the integrator takes as long as so many rows of dense output.
    rows_worth_a_step: float = 20.0
    # Slews of fewer rows are integrated row by row: steps of several rows take longer to compile
    # than they save.
    rows_of_long_slew: int = 256

    # `packing.py`
    # Rows and star-tracker fixes are padded to multiples of these, so that campaigns of similar
    # length share compiled code.
    row_multiple: int = 32
    fix_multiple: int = 8
    # Grid points of a slew; more come of a slip of units.
    most_grid_points: float = 1e6
    # Times closer than this share of the slew's clock are one: rounding of a file.
    shortest_step: float = 1e-9
    # On the grid of the telemetry's rows straight lines follow this much [rad] of the fastest
    # rotation, which is so many times the quantile `largest_quantile` of the readings.
    straight_turn: float = 0.05
    fastest_over_quantile: float = 2.0

    # `simulator.py`
    # Steps of a block: a look at each takes as long as the step.
    steps_of_block: int = 16

    # `slow_tachometers.py`
    # Tachometers are slow where so many rates are read between two of their readings.
    slow_tachometer: int = 4
    fewest_slow_readings: int = 4  # of a slew: for a spline, and for errors of lines
    # Free knots between two readings that are tried, and of a whole slew at most: each costs one
    # unknown a wheel.
    free_knots: tuple[int, ...] = (1, 2, 3, 5, 7, 11, 15)
    most_free_knots: int = 64
    # Splines follow the rates where they leave so much of their noise's variance: the noise is
    # known to 1 %.
    rates_followed: float = 1.03

    # `step_drive.py`
    # Degree of the polynomial that the wheels' momentum is within a step.
    drive_degree: int = 3


NUMERICS = Numerics()
