"""Layout of the terminal's output, and limits of what the commands keep."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Layout:
    """Fields by the file that reads them."""

    # `commands/check.py`
    slews_shown: int = 20  # so that the rest of the answer stays on the screen

    # `commands/plans.py`
    margins_of_design: int = 3  # the tightest; broken ones are shown besides

    # `commands/import_raw.py`
    longest_list: int = 200  # Letters of the columns of one file; the mapping has them all.
    spans_shown: int = 6
    files_named: int = 6  # Of more the next command names none.
    # [s]; shorter parts of a log that no slew needs are not worth a word.
    shortest_span_s: float = 1.0

    # `commands/plans.py`, of `observe`
    # parameters of which is said why they are not determined, the least known first
    weak_parameters_shown: int = 3

    # `commands/many.py`
    # Campaigns of a study: an achieved sd is then known to 5 %.
    campaigns_of_study: int = 200
    # Fits of a calibration, over all cases: a coverage of 90 % is then known to 1 %.
    fits_of_calibration: int = 1000

    # `compiled_code.py`
    # [bytes] of one version: some thirty shapes. What was not used for longest goes first; JAX
    # looks at every entry when it writes one, so that a larger cache would be slow.
    largest_cache_bytes: int = 2**27
    least_compile_seconds: float = 0.05  # What compiles faster is not kept.
    unused_after_s: float = 30 * 86_400.0  # [s] after which the code of another version is deleted.

    # `plan_folder.py`
    margins_of_folder: int = 6

    # `diagnosis_json.py`
    quantile_95: float = 1.959964  # half the width of a central 95 % interval [sd]

    # `export_run.py`
    forecast_draws: int = 48  # of the posterior, in the forecast of the correction slew

    # `commands/check.py`, the installation
    # Relative change of the energy of a free tumble over 100 s that the integrator may make.
    energy_drift_allowed: float = 1e-9

    # `interruption.py`
    grace_s: float = 3.0  # [s] in which the main thread may save and end by itself.
    workers_grace_s: float = 0.5  # [s] for worker processes.

    # `finished_runs.py`
    # Slews of plan.toml and design.json agree to rounding.
    same_slew: float = 1e-9

    # `study_folder.py`
    study_levels: tuple[float, ...] = (0.68, 0.95)
    # Probability that sound uncertainties are called too small, any of the nine.
    study_false_alarm: float = 0.01

    # `terminal.py`
    # In fewer columns, tables are made as narrow as they can be.
    narrow_columns: int = 100
    # The first column keeps one part of so many of the width; what finds no room follows below.
    widest_first_column: int = 4
    heading_width: int = 12  # of a line of a column's heading there
    # Characters of a message, and how many of them are its end, which says what to do.
    longest_message: int = 4000
    message_end: int = 1000


LAYOUT = Layout()
