"""What `benchmark.py` measures besides samplers: evaluations, starts, workers; ratios only."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import bayes_inertia
from analyses.engine.evaluation_benchmark import (
    BATCH,
    cost,
    frozen,
    measure,
    most_like_campaign,
    thetas_of,
)
from analyses.engine.throughput import gain, measured_throughput
from analyses.engine.timed_process import timed_process
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.marginal_posterior import log_density_of
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
EFFECTS = (
    "rate_bias_drift",
    "rate_sensor_misalignment",
    "rate_sensor_delay",
    "star_tracker_shift",
    "wheel_torque_gain",
    "wheel_friction",
    "constant_torque",
    "viscous_torque",
)
# Tasks a run of the throughput.
_TASKS = 40
_COMMAND = "from bayes_inertia.app.cli import main; main()"


def evaluation_ratios() -> dict[str, float]:
    """Against the kernel by hand, and how the cost grows with rows, slews and effects."""
    ratios = measure(None)["ratios"]
    seconds = _scaling_costs()
    return {
        "evaluation_over_kernel": ratios["ours over the kernel, 4 Hz"],
        "evaluation_4khz_over_400hz": ratios["4 kHz over 400 Hz"],
        "evaluation_8hz_over_2hz": seconds["8 Hz"] / seconds["2 Hz"],
        "evaluation_20_over_5_slews": seconds["20 slews"] / seconds["2 Hz"],
        "evaluation_8_effects_over_none": seconds["8 effects"] / seconds["2 Hz"],
    }


def _scaling_costs() -> dict[str, float]:
    """Processor seconds of an evaluation of campaigns that differ in one thing from the first."""
    kinds: dict[str, tuple[Campaign, tuple[Effect, ...]]] = {
        "2 Hz": (most_like_campaign(0.5), ()),
        "8 Hz": (most_like_campaign(0.125), ()),
        "20 slews": (_many_slews(4), ()),
        "8 effects": (most_like_campaign(0.5), by_name(EFFECTS)),
    }
    evaluate, thetas = {}, {}
    for name, (campaign, effects) in kinds.items():
        model = Model(campaign, effects)
        evaluate[name] = log_density_of(model.structure, frozen(model), batch=BATCH)
        thetas[name] = thetas_of(model)
    return cost(evaluate, thetas)


def _many_slews(times: int) -> Campaign:
    """The paper's five slews several times over, a row every half second."""
    plan = paper_like_plan()
    plan = replace(plan, slews=plan.slews * times, telemetry_period=0.5)
    return draw_flight(planned_campaign(plan, most_like_mission()), plan, 4, vary=False).campaign


def start_ratios() -> dict[str, float]:
    """Whole commands over importing JAX: nothing kept from runs before, and the second time."""
    with tempfile.TemporaryDirectory() as folder:
        runs = Path(folder)
        # The user's cache of compiled code is not touched.
        plain = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
        environment = plain | {"BAYES_INERTIA_CACHE": str(runs / "cache")}

        def fit(out: str) -> float:
            words = ["fit", str(EXAMPLE), "-o", str(runs / out), "--no-report"]
            return _seconds([_COMMAND, *words], environment)

        jax = min(_seconds(["import jax"], environment) for _ in range(3))
        check = min(_seconds([_COMMAND, "check", str(EXAMPLE)], environment) for _ in range(3))
        cold, warm = fit("cold"), min(fit("warm_1"), fit("warm_2"))
    return {
        "check_over_jax": check / jax,
        "cold_fit_over_jax": cold / jax,
        "warm_fit_over_jax": warm / jax,
    }


def _seconds(words: Sequence[str], environment: dict[str, str]) -> float:
    """Processor time of a Python process [s]."""
    ended = timed_process(words, environment)
    # 3: a result that says that it should not be trusted.
    if ended.exit_code not in (0, 3):
        raise SystemExit(ended.message)
    return ended.processor_seconds


def throughput_ratios() -> dict[str, float]:
    """Tasks a second of two workers over one, waits for cores that others had taken off."""
    runs = measured_throughput(_TASKS)
    return {f"two_{e}_workers_over_one": gain(runs, e)[0] for e in ("joblib", "dask")}
