"""Limits by which a campaign's files are read and judged, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Fields by the file that reads them."""

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

    # `body_rates.py`
    # With more noise than this share of the rms rate, sizes of readings say little of the motion.
    noise_of_motion: float = 0.3
    # Beyond this, angles of small steps [rad] do not add up to the integral of the rates.
    largest_turn_between_fixes: float = 0.5
    # Pieces of a spline, tried in turn, while each has this share of a number read at most.
    spline_pieces: tuple[int, ...] = (1, 2, 4, 6, 9, 13, 19, 28, 40, 60)
    splines_of_numbers: float = 0.5
    unseen_rate: float = 0.3  # [rad/s], sd of what no sensor sees
    # Of what wheels tell, as a share of the largest rate: J is not known, nor what else turned it.
    error_of_wheels: float = 0.3

    # `prior.py`
    # To here a Gaussian has the 5, 50 and 95 % points of principal moments within 0.3 of their sds.
    sd_of_moments: float = 0.2
    sd_of_axes: float = 10.0  # [deg]
    # Ends so many sds from the mean leave a ten-millionth of a prior: it is stated otherwise.
    ends_from_mean: float = 5.0

    # Attitudes from directions: rows of a slew that are worked out, and their noise over that of
    # the worst direction (two of them 45 deg apart).
    attitudes_by_directions: int = 300
    attitude_of_directions: float = 1.5
    # [rad]; rows whose turn since the first one is known worse tell nothing of the start
    known_turn: float = 0.5

    # `campaign.py`
    # Of full thrust: chamber pressures stray above 1, per cent without their unit do so by far.
    largest_level: float = 2.0

    # `checked_toml.py`
    # Keys that are alike to this degree are one word misspelt; less alike ones are other physics,
    # such as body_torque and wheel_torque (0.61).
    misspelt: float = 0.7

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

    # `slew.py`
    # Two fixes further apart than this share of the slew, or than so many usual spacings, are of
    # two groups.
    fix_group_share: float = 0.1
    fix_group_spacings: float = 5.0
    one_moment_s: float = 1.0  # [s]; a slew's start and its first row closer than this are one date
    # Rows with a reading of every axis are enough to tell the motion if they are this share of all.
    enough_complete_rows: float = 0.1

    # `slew_parts.py`
    fewest_rates_of_part: int = 10  # of a part of a slew
    same_row: float = 0.01  # of a step: a row so close to a lost command takes it
    # The line may be wrong by this much of the rates' noise, and of the star tracker's: the
    # estimate of it errs on the large side, and one slew in many is concerned.
    momentum_line_of_rate_noise: float = 0.1
    momentum_line_of_attitude_noise: float = 2.0
    readings_for_slope: int = 4

    # `reader.py`
    # Errors below these shares of the noise of one reading are not told by all readings together.
    negligible_of_rate_noise: float = 0.02
    negligible_of_attitude_noise: float = 0.1
    shortest_slew: float = 1e-9  # [s]; what is divided by it stays finite

    # `streams.py`
    same_time: float = 1e-9  # [s]; stamps closer than this are one time

    # Times of the rates' span: fixes may be taken before and after a slew, but a table that lies
    # further off counts by another clock.
    spans_apart: float = 5.0

    # `environment.py`
    # [days]; in low orbit older elements are some degrees along the orbit off, the field with them
    oldest_elements: float = 10.0


LIMITS = Limits()
