"""Limits by which a campaign's files are read and judged, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Fields by the file that reads them."""

    # For raw logs and the conventions check too: sds from a reading to its neighbours.
    outlier_sds: float = 8.0

    # `block_means.py`
    block_error_of_noise: float = 0.01  # error of a block mean, as a share of its noise
    block_remainder: float = 0.016  # of w'''' L^4, after the curvature is removed
    block_neighbours: int = 5  # block means that tell a curvature
    largest_block: int = 1000  # [readings]
    least_kept_by_blocks: float = 0.95  # of the readings
    # Where slews have more rows than the first number a diagnosis takes block means, and at least
    # the second number of them: ringing of 50 periods in a slew can still be told.
    rows_for_blocks: int = 1000
    fewest_blocks: int = 200
    # Steps of rounding beyond so many sigmas make errors that last, which a mean does not reduce.
    coarse_rounding: float = 1.0

    # `campaign.py`
    # A reading this close to the sensor's range, as a fraction of it, is taken for saturated.
    saturated: float = 0.999

    # `commands.py`
    # Pieces of one gap, and of all gaps of one slew: every piece costs one unknown a wheel.
    most_lost_in_gap: int = 8
    most_lost_in_slew: int = 48
    fewest_trials: int = 30
    most_rows_on_a_line: int = 3  # lost rows of a gap; errors of longer lines add up
    line_error_safety: float = 1.25  # times the rms error of the lines
    # A change beyond twice that of nine in ten rows is a step: half of it may be missed.
    smooth_factor: float = 2.0
    smooth_quantile: float = 0.9
    # of a step: the last lost row stands at least so long before the next command
    whole_step: float = 0.2

    # `fix_groups.py`
    # Two fixes further apart than this share of the slew, or than so many usual spacings, are of
    # two groups.
    fix_group_share: float = 0.1
    fix_group_spacings: float = 5.0

    # `gaps.py`
    # A step this many times the median lacks a row.
    longest_step: float = 1.5
    # A stream is regular if this share of its steps is within that fraction of the median.
    regular_steps: float = 0.8
    step_jitter: float = 0.2
    fewest_steps: int = 5
    fewest_rates_of_part: int = 10  # of a part of a slew
    same_row: float = 0.01  # of a step: a row so close to a lost command takes it

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

    # `impossible.py`
    fastest_rate: float = 1e3  # [rad/s]; small bodies are torn apart by a tenth of it
    largest_momentum: float = 1e6  # [N m s]; the largest gyros of space stations hold 5e3
    largest_torque: float = 1e6  # [N m]
    # of the commands; where more are impossible, it is their unit that is wrong
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

    # `momentum_gaps.py`
    # The line may be wrong by this much of the rates' noise, and of the star tracker's: the
    # estimate of it errs on the large side, and one slew in many is concerned.
    momentum_line_of_rate_noise: float = 0.1
    momentum_line_of_attitude_noise: float = 2.0
    readings_for_slope: int = 4

    # `quantisation.py`
    # of the differences between values must be whole multiples of the step
    share_of_multiples: float = 0.99
    multiple_tolerance: float = 0.01  # [steps]
    fewest_values: int = 3  # different ones

    # `reader.py`
    # Errors below these shares of the noise of one reading are not told by all readings together.
    negligible_of_rate_noise: float = 0.02
    negligible_of_attitude_noise: float = 0.1
    shortest_slew: float = 1e-9  # [s]; what is divided by it stays finite

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

    # `short_gaps.py`
    most_rows_on_a_curve: int = 3  # in one gap
    curve_error_safety: float = 2.0
    # All curves of a slew may err by this many errors that all readings together do not tell.
    times_negligible: float = 2.0

    # `slew.py`
    # Rows with a reading of every axis are enough to tell the motion if they are this share of all.
    enough_complete_rows: float = 0.1

    # `stamps.py`
    # Rounding matters if the resolution is this share of the step; beyond the second share nothing
    # can be told of the clock.
    fine_resolution: float = 0.01
    coarse_resolution: float = 0.4
    # Stamps are uneven if this share of steps differs from the median by that share of it: a few
    # other stamps between those of a regular clock are no jitter.
    uneven_share: float = 0.25
    uneven_step: float = 0.01
    # of a resolution: how far a rounded stamp is from its time, with some allowance
    half_resolution: float = 0.55
    fewest_stamps: int = 20

    # `streams.py`
    same_time: float = 1e-9  # [s]; stamps closer than this are one time

    # `stuck.py`
    shortest_stuck_run: int = 5  # [readings]
    shortest_stuck_run_of_fixes: int = 3
    stuck_false_alarms: float = 1e-6  # a slew
    fewest_readings_beside_runs: int = 20  # readings outside runs, to tell the noise from
    fewest_fixes_beside_runs: int = 5
    # Noise below this share of the stated one is no noise to judge by.
    least_noise_to_judge: float = 0.2

    # `uneven_stamps.py`
    # Jitter is less than this share of the step, else rows cannot be counted.
    largest_jitter: float = 0.45
    # Means of so many rows may not stray further than white jitter does, by this factor.
    jitter_block: int = 20
    jitter_wander: float = 4.0
    # Rows of the curve that is taken for the motion, and of the line that is its slope.
    curve_rows: int = 7
    line_rows: int = 9
    most_counted_sds: float = 6.0  # sd; a reading counts no more than this.
    # Between the slope and one half, in sds, where readings are said to decide: the other of 0 and
    # 1 is then twice as many sds away at least.
    sure_sds: float = 4.0


LIMITS = Limits()
