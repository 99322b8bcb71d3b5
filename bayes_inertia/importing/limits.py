"""Limits by which raw logs become a campaign, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Fields by the file that reads them."""

    # `stream_readings.py`
    # Largest element of M M^T - 1 of a matrix that counts as a rotation.
    not_orthogonal: float = 1e-3
    # A jump between two rows that no body makes, if it comes back to the very same attitude [rad].
    attitude_jump: float = 0.1
    # So many of the attitudes that stand most often are looked at.
    most_common_attitudes: int = 4
    # Counts of so many bits may have lost their sign. With fewer bits, or fewer different readings
    # beyond, they may be other numbers, or a mark.
    bits_of_counts: tuple[int, ...] = (16, 24, 32)
    fewest_negative_counts: int = 3
    # Rows looked at for what rounding does to an attitude.
    attitudes_of_rounding: int = 50
    # Quaternions of one length, but for this share of it, are counts; this share of the rows must
    # be.
    even_length: float = 1e-3
    most_even_rows: float = 0.9
    # A column with less than this share of the readings of the fullest is worth a word.
    complete_column: float = 0.95

    # `common_clock.py`
    counter_bits: tuple[int, ...] = (16, 24, 31, 32)
    # Across a wrap rows follow each other within this many steps: one may be lost, stamps jitter.
    wrap_nearest: float = 0.2
    wrap_farthest: float = 2.5
    # A pause longer than this share of the period may hide a whole one; a wrap in it needs a long
    # one.
    wrap_pause: float = 0.1
    long_counter_bits: int = 24

    # `cut_picture.py`
    picture_size: tuple[float, float] = (9.0, 4.5)  # [inch]
    # Left, bottom, width and height, as shares: a layout engine would draw all of it four times.
    picture_axes: tuple[float, float, float, float] = (0.085, 0.11, 0.905, 0.82)
    most_points_drawn: int = 6000
    label_height: float = 0.97  # Of the height.
    # The axis of speeds begins at this share of the lower threshold.
    bottom_of_axis: float = 0.03

    # `import_logs.py`
    # A known offset that puts this share of the readings into slews is meant.
    meant_offset_share: float = 0.998
    # What units of time lie apart; spans are so alike, and steps of such streams so different.
    unit_factors_of_time: tuple[float, ...] = (60.0, 3.6e3, 1e3, 6e4, 1e6, 3.6e6, 1e9)
    alike_spans: float = 0.03
    different_steps: float = 10.0

    # `log_reader.py`
    fewest_rates: int = 10  # Fewer tell neither rest nor slew.

    # `logged_stream.py`
    # Of the rows of a stream: the most that are left out with no more than a note. As many at
    # random would make the sds larger by 2.6 % only; more are a clock or column that was misread.
    most_left_out: float = 0.05

    # `mapping.py`
    # Smallest determinant of three axes that do not lie in one plane.
    independent_axes: float = 1e-3

    # `questions.py`
    comment_width: int = 96  # Of a comment.

    # `rest_noise.py`
    # Steps between readings of one series differ by at most this share of the median step.
    even_steps: float = 0.1
    # A stated noise further from the seen one than this factor is worth a word.
    noise_differs: float = 1.3

    # `slew_cutting.py`
    # Rest kept on each side of a slew unless the mapping says otherwise: as long as the motion, and
    # at least these seconds and so many fixes. Rest tells the bias and the attitude before and
    # after.
    rest_kept_s: float = 120.0
    fixes_kept: int = 10
    longest_wait_s: float = 300.0  # [s] for the first fixes after a motion.
    # Fewer seconds at rest than these, or than hold so many fixes or `fewest_rates`, are no rest.
    shortest_rest_s: float = 2.0
    fixes_in_rest: int = 3
    # A slew begins with its first command if that spares it this share of its first rest at most.
    rest_without_command: float = 0.1
    # A pause of the rates longer than this divides a log [s], and longer than so many steps.
    pause_s: float = 30.0
    pause_steps: int = 20
    # A motion that turns less than this share of the largest one is no slew.
    small_turn: float = 0.03

    # `imported_folder.py`
    # Rows of a table are written to the nanosecond.
    decimals_of_time: int = 9
    # Commands are logged at every step if this share of so many steps is alike.
    most_alike_steps: float = 0.9
    fewest_alike_steps: int = 30

    # `column_families.py`
    last_index: int = 99  # Larger numbers in names are years, serial numbers or addresses.
    # Arrays with room for more are those of a simulator (36 in Basilisk), filled from the first.
    most_wheels: int = 12

    # `starting_mapping.py`
    most_packets: int = 40  # More different values are a counter, or texts.

    # `unit_factors.py`
    # Letters: Newton and Hertz are names, which have no capitals; kNms is none.
    shortest_unit_name: int = 5


LIMITS = Limits()
