"""Limits by which faults of telemetry are told, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Fields by the file that reads them, or by the question that several wings ask."""

    # `gaps.py`
    # A step this many times the median lacks a row.
    longest_step: float = 1.5
    # A stream is regular if this share of its steps is within that fraction of the median.
    regular_steps: float = 0.8
    step_jitter: float = 0.2
    fewest_steps: int = 5

    # `held.py`
    # Where fewer readings than this share stand twice, sds are wrong by less than 5 %.
    fewest_held: float = 0.1
    fewest_held_runs: int = 5
    # Between neighbours that are so many steps apart, rounding repeats less than one row in twenty:
    # where this share of them stands twice, they are held.
    clearly_changed_steps: float = 20.0
    held_share: float = 0.2
    # A steady drift moves by one step, never by the next whole number.
    drift_step: float = 1.5
    # Regular lengths are within one row of the usual one, or this share of it; all but a few are.
    held_length_jitter: float = 0.3
    regular_held_lengths: float = 0.8
    most_single_readings: float = 0.05
    # A run may miss readings. What stands longer than so many usual lengths are equal readings.
    longest_held_lengths: float = 3.0
    # A break in time is longer than so many steps.
    break_steps: float = 5.0

    # What nothing reaches
    fastest_rate: float = 1e3  # [rad/s]; small bodies are torn apart by a tenth of it
    largest_momentum: float = 1e6  # [N m s]; the largest gyros of space stations hold 5e3
    largest_torque: float = 1e6  # [N m]
    # Commands that no wheel can follow, as a share; where more are impossible, their unit is wrong.
    few_impossible: float = 0.02
    share_of_marker: float = 0.5  # of the commands, where all of them are one number
    # times that number must stand: fewer may be commands of a short slew
    fewest_of_marker: int = 10
    impossible_factor: float = 10.0  # times larger than all other commands are those that are dirt
    impossible_times_limit: float = 100.0  # of a wheel

    # `known_offsets.py`
    hour: float = 3600.0
    largest_time_zone_h: int = 14  # [h]
    parts_of_hour: tuple[float, ...] = (0.0, 0.5, 0.75, 0.25)
    # This share of the readings beside the slews shows that an offset is meant.
    meant_offset_share: float = 0.9

    # `noise.py`
    fewest_differences: int = 8
    smallest_series: int = 6
    # Largest improvement of chi^2 that chance may give to a kind of noise that is not there.
    chance_improvement: float = 9.0
    reweightings: int = 5
    # Rows of a log that show the step of its rounding.
    rows_of_rounding: int = 20_000
    numbers_of_decimals: int = 200  # of a column; fewer than so many show no step
    fewest_numbers: int = 3
    # Readings whose differences are larger than this many sds of their rounding show other noise.
    only_rounding: float = 3.0
    # Rows that tell a column's noise.
    rows_for_noise: int = 30
    second_difference_variance: float = 6.0  # variance of second differences of white unit noise

    # `outliers.py`
    outlier_sds: float = 8.0  # from a reading to its neighbours
    outlier_median_rows: int = 7  # of the running median
    fewest_with_outliers: int = 5  # readings

    # `quantisation.py`
    # of the differences between values must be whole multiples of the step
    share_of_multiples: float = 0.99
    multiple_tolerance: float = 0.01  # [steps]
    fewest_values: int = 3  # different ones

    # `motion_scan.py`
    averaged_s: float = 1.0  # [s] the running mean, but at least so many rows
    averaged_rows: int = 5
    outlier_rows: int = 5  # The running median: two rows in a row may be outliers.
    # Share of the readings that are slowest: the rate at rest is their median.
    slowest_share: float = 0.2
    # A body whose slowest rate is more than this share of its largest does not rest, unless it
    # keeps that rate for this share of the time, as one that points to the Earth does.
    rests_below: float = 0.2
    rests_for: float = 0.3
    # A log whose rates do not exceed their noise at rest by this factor shows no slew.
    visible_motion: float = 8.0
    # `low` is this factor above the median at rest, but at most this share of `high`.
    low_above_rest: float = 4.0
    low_over_high: float = 1.0 / 3.0
    # A slower moment shorter than this, as between braking and settling, is no rest [s].
    longest_dip_s: float = 5.0
    # `high` is at most this share of the largest rate.
    largest_threshold: float = 0.1
    sigmas_of_rest: float = 3.0
    # The conventions check, with the motion that the laws see: a fix is taken in motion if the
    # rate is this share of the slew's largest,
    in_motion: float = 0.2
    # and the body is at rest below this share.
    at_rest: float = 0.03

    # `row_order.py`
    # More wrong stamps than this share of all rows are no single glitches.
    most_glitches: float = 0.02
    # A late row fits where its neighbours are this many steps away.
    late_row_nearest: float = 0.75
    late_row_farthest: float = 3.0
    # So many rows before and after a clock was set back are in order, but for one; of shuffled rows
    # half go back, and that happens by chance once in 10,000 times.
    rows_in_order: int = 10
    # Neighbours of a wrong stamp are two steps apart, within this share of a step.
    glitch_tolerance: float = 0.1
    # A stamp is far off if it is away from the others by this many times their whole duration, and
    # by more than this time [s], or units of a clock that counts others.
    far_off_durations: float = 100.0
    longest_break: float = 3600.0
    # Stamps of 32 bits may be coarse by this share of their spacing.
    coarse_stamp: float = 0.01

    # `saturated.py`
    # A reading this close to the sensor's range, as a fraction of it, is taken for saturated.
    saturated: float = 0.999

    # `stamps.py`
    # Rounding matters if the resolution is this share of the step; beyond the second share nothing
    # can be told of the clock.
    fine_resolution: float = 0.01
    coarse_resolution: float = 0.4
    on_a_multiple: float = 0.02  # of a resolution: how far a step may be from a multiple of it
    # Stamps are uneven if this share of steps differs from the median by that share of it: a few
    # other stamps between those of a regular clock are no jitter.
    uneven_share: float = 0.25
    uneven_step: float = 0.01
    # of a resolution: how far a rounded stamp is from its time, with some allowance
    half_resolution: float = 0.55
    fewest_stamps: int = 20
    # Jitter is less than this share of the step, else rows cannot be counted.
    largest_jitter: float = 0.45
    # Means of so many rows may not stray further than white jitter does, by this factor.
    jitter_block: int = 20
    jitter_wander: float = 4.0
    exact_stamp: float = 1e-6  # of a step: stamps so near to a regular clock are on it
    # Rows of the curve that is taken for the motion, and of the line that is its slope.
    curve_rows: int = 7
    line_rows: int = 9
    most_counted_sds: float = 6.0  # sd; a reading counts no more than this.
    # Between the slope and one half, in sds, where readings are said to decide: the other of 0 and
    # 1 is then twice as many sds away at least.
    sure_sds: float = 4.0

    # `stuck.py`
    shortest_stuck_run: int = 5  # [readings]
    shortest_stuck_run_of_fixes: int = 3
    stuck_false_alarms: float = 1e-6  # a slew
    fewest_readings_beside_runs: int = 20  # readings outside runs, to tell the noise from
    fewest_fixes_beside_runs: int = 5
    # Noise below this share of the stated one is no noise to judge by.
    least_noise_to_judge: float = 0.2


LIMITS = Limits()
