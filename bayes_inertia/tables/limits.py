"""Limits of files that become columns, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Fields by the file that reads them."""

    # `array_files.py`
    deepest: int = 12  # Of groups, objects or lists inside each other.
    most_arrays: int = 20000

    # `array_tables.py`
    most_columns: int = 64  # That one array or list may become; a picture is no telemetry.
    largest_arrays: int = 4 * 2**30  # [bytes] of all arrays of a NumPy file together.

    # `isolated.py`
    # Processor time for any file, once its library is loaded; more for a large one.
    processor_seconds: float = 3.0
    # [s] on the clock, and as many times more: other programs want the processor too.
    clock_seconds: float = 60.0
    bytes_per_second: float = 5e6
    least_content: int = 10**8  # [bytes] that even a small, compressed file may hold.
    largest_compression: int = 300  # Bytes of arrays a byte of file.
    most_content: int = 2 * 2**30  # [bytes]
    # What a reader takes beside its libraries: some copies of the arrays, and room for its own.
    copies_of_arrays: int = 4
    room_beside_arrays: int = 2**28  # [bytes]
    files_kept: int = 16  # in memory

    # `json_lines.py`
    most_columns_of_json: int = 2000
    longest_vector: int = 16  # Numbers of one reading, as of a matrix; more are rows of a table.
    few_objects: int = 3  # Objects; of fewer none tells that the last one breaks off.

    # `raw_files.py`
    most_parameters: int = 2000  # More parameters than these are texts of another kind.
    head_bytes: int = 1024  # Bytes by which a format is told.

    # `table.py`
    most_marks_told: int = 8  # Of marks of no reading, the usual ones first.
    # Names of columns that a message lists, and the characters of one.
    most_names_told: int = 60
    longest_name_told: int = 60

    # `text_cells.py`
    encoding_sample_bytes: int = 2**20  # By which an encoding is told.
    # Lines that losses of power may cut in a short file; in a long one, every 20th.
    most_cut_lines: int = 3
    sample_rows: int = 200  # Rows by which a file and its columns are judged.
    trust_in_one_column: float = 0.5

    # `text_table.py`
    most_footer_lines: int = 5  # More rows of words at the end of a file are damaged telemetry.
    least_digits: int = 6  # Significant digits of an output of 42 below which a note says so.
    few_rows: int = 4  # Rows; of fewer none tells how long the others should be.
    lossy_digits: int = 15  # More significant digits than these a 64-bit float may round.
    lossy_size: float = 1e6  # Smaller numbers keep 1e-10 whatever their digits.

    # `time_stamps.py`
    coarsest_stamp: float = 0.05  # Of the step between stamps: the most that their rounding may be.

    # `time_texts.py`
    years: tuple[int, int] = (1958, 2199)  # Nanoseconds of other years may not fit 64 bits.


LIMITS = Limits()
