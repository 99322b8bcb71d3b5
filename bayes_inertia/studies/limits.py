"""Numbers of studies and of the engine that runs them, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Fields by the file that reads them."""

    # `calibration.py`
    # Nearly independent draws that the truth is ranked among: ranks 0 to 199. With 199 the central
    # intervals of 50, 90 and 95 % are whole numbers of ranks.
    ranked_draws: int = 199
    # Axis of the slew whose correction is predicted: all of J and K bear on it.
    corrected_axis: tuple[float, float, float] = (1.0, 1.0, 1.0)
    # Between rows of telemetry [s]: slow telemetry, so that a fit takes a second.
    period_s: float = 1.0
    # The spacecraft of the paper; its constant torque [N m].
    torque_sigma: float = 5e-6
    # Probability that a right pipeline is rejected, by any quantity of any case.
    false_alarm: float = 0.01

    # `engine.py`
    # How often the driver looks whether workers came or went [s].
    driver_looks_every_s: float = 1.0
    # A task whose worker died beside others is done again alone, so often: then it is the guilty
    # one.
    tries_alone: int = 2

    # `rank_statistics.py`
    levels: tuple[float, ...] = (0.5, 0.9, 0.95)
    # Bands are looked for between these many standard errors.
    narrowest_band: float = 0.5
    widest_band: float = 12.0

    # `workers.py`
    # Calls submitted for every worker: the next one waits there already.
    calls_a_worker: int = 2
    # How often a worker looks whether its driver lives [s].
    worker_looks_every_s: float = 0.5
    # How long a scheduler may take to be found, to have its first worker, and to answer, and how
    # long workers may take to end [s].
    connect_seconds: float = 20.0
    first_worker_seconds: float = 300.0
    answer_seconds: float = 10.0
    close_seconds: float = 2.0


LIMITS = Limits()
