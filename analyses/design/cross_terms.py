"""Why the cross terms are poorly observable.

    python -m analyses.design.cross_terms

Their sd against slew rate, number of slews, noise, tachometers and misalignment. It writes
`figures/cross_terms.png`, `results/design/cross_terms.json` and the page
`analyses/CROSS_TERMS.md` (about ten minutes). Every sd is that of the full model, linearised at the
truth of closed-loop flights with noise (`bayes_inertia.design.comparison`): the root mean
square over a few truths drawn from the prior.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from analyses import results_of
from analyses.design.cross_terms_cases import (
    CASES,
    CRAFT,
    DEGREE,
    MISALIGNMENT,
    MISSION,
    NOISES,
    NUMBERS,
    PRIOR,
    RATES,
)
from analyses.design.cross_terms_page import page, picture
from bayes_inertia.design.comparison import estimate_at_truth, likely_missions
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
)
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths.inertia_tensor import tensor
from bayes_inertia.observability.analysis import observe
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.parameters import BASE_NAMES

ROOT = Path(__file__).resolve().parents[2]
TRUTHS = 3  # drawn from the prior for each expected sd


def craft_with(tachometers: bool = True, noise: float = 1.0) -> Spacecraft:
    """The MOST-like spacecraft with all its sensors `noise` times as noisy."""
    sensor, tracker = CRAFT.rate_sensor, CRAFT.star_tracker
    return replace(
        CRAFT,
        wheels=tuple(
            replace(w, momentum_sigma=noise * w.momentum_sigma if tachometers else None)
            for w in CRAFT.wheels
        ),
        rate_sensor=replace(sensor, sigma=tuple(noise * s for s in sensor.sigma)),
        star_tracker=replace(
            tracker, sigma_cross=noise * tracker.sigma_cross, sigma_roll=noise * tracker.sigma_roll
        ),
    )


def plan_at(rate: float = 1.0, slews: int = 5) -> Plan:
    """The paper-like slews at another rate [deg/s], or another number of them (in turn).

    At another rate the whole motion is stretched in time.
    """
    base = paper_like_plan()
    stretched = tuple(
        replace(base.slews[i % 5], rate=rate * DEGREE, acceleration=0.05 * rate**2 * DEGREE)
        for i in range(slews)
    )
    return replace(base, slews=stretched, orbit=None)


def expected(plan: Plan, craft: Spacecraft, fitted: bool) -> list[float]:
    """Expected sds (9,) of J and K.

    The misalignment's angles are fitted with their prior of the library, or known.
    """
    effects = by_name((MISALIGNMENT,)) if fitted else ()
    mission = Mission(craft, PRIOR)
    controller, truths = mission.controller(), likely_missions(plan, mission, TRUTHS + 1, 1)[1:]
    sds = [
        estimate_at_truth(plan, truth, effects, controller=controller, seed=i).sd[:9]
        for i, truth in enumerate(truths)
    ]
    return np.sqrt(np.mean(np.square(sds), axis=0)).tolist()


def curves() -> dict:
    """sds (points, 9) of every case against rate, number of slews and noise."""
    sds: dict[str, dict[str, list]] = {
        name: {"rate": [], "number": [], "noise": []} for name in CASES
    }
    points = [("rate", plan_at(rate), 1.0) for rate in RATES]
    points += [("number", plan_at(slews=int(n)), 1.0) for n in NUMBERS]
    points += [("noise", plan_at(), noise) for noise in NOISES]
    # Cases inside points: they share compiled code.
    for key, plan, noise in points:
        for name, (tachometers, fitted) in CASES.items():
            sds[name][key].append(expected(plan, craft_with(tachometers, noise), fitted))
    return sds


def causes(estimate: Estimate) -> dict:
    """What limits each parameter at the paper-like slews.

    The signal of its own size, and the inflation of its sd by group.
    """
    return {
        p.name: {
            "value": p.value,
            "sd": p.sd,
            "signal_of_size": p.signal_of_size,
            "conditional_sd": p.conditional_sd,
            "lost": math.sqrt(p.variance_inflation),
            "inflation": {group: math.sqrt(factor) for group, factor in p.inflation.items()},
            "channels": dict(
                zip(("rate", "attitude", "momentum"), p.share.sum(0).tolist(), strict=True)
            ),
        }
        for p in observe(estimate).parameters
    }


def _telemetry(flight: Flight) -> dict[str, np.ndarray]:
    """All telemetry in units of its noise, and the commands [N m]."""
    sigma = {
        "rate": CRAFT.rate_sensor.sigma[0],
        "wheel_momentum": CRAFT.wheels[0].momentum_sigma,
        "wheel_torque": 1.0,
    }
    return {
        key: np.concatenate([getattr(slew, key).ravel() for slew in flight.campaign.slews]) / s
        for key, s in sigma.items()
    }


def _closed_loop_change(i: int, prior_sd: float) -> dict[str, np.ndarray]:
    """Change of the closed loop's telemetry if parameter i changes by its prior sd.

    By central differences. The controller goes on believing the prior.
    """
    controller = Controller(CRAFT.inertia_B, CRAFT.scale_factor)
    telemetry = []
    for sign in (1.0, -1.0):
        theta = MISSION.theta.copy()
        theta[i] += sign * 0.05 * prior_sd
        truth = replace(
            CRAFT, inertia_B=np.asarray(tensor(theta[:6])), scale_factor=tuple(theta[6:9])
        )
        mission = replace(MISSION, spacecraft=truth)
        telemetry.append(_telemetry(fly(plan_at(), mission, None, controller=controller)))
    plus, minus = telemetry
    return {key: (plus[key] - minus[key]) / 0.1 for key in plus}


def hidden_by_control(estimate: Estimate) -> dict:
    """Response of the telemetry to a change of each parameter by its prior sd.

    Of the motion with the recorded torque commands, as the fit sees it. And of the closed loop,
    where the controller answers with other commands.
    """
    observability, responses = observe(estimate), {}
    commands = sum(slew.wheel_torque.size for slew in estimate.model.campaign.slews)
    for i, name in enumerate(BASE_NAMES):
        change = _closed_loop_change(i, estimate.model.space.sd[i])
        closed_loop = {key: float(np.linalg.norm(x)) for key, x in change.items()}
        signal = observability[name].signal_by
        responses[name] = {
            "rate_with_given_commands": float(np.sqrt(np.sum(signal[:, 0] ** 2))),
            "rate_in_closed_loop": closed_loop["rate"],
            "commands_rms": closed_loop["wheel_torque"] / math.sqrt(commands),
        }
    return responses


def computed() -> dict:
    """All numbers."""
    estimate = estimate_at_truth(plan_at(), MISSION)
    misaligned = estimate_at_truth(plan_at(), MISSION, by_name((MISALIGNMENT,))).sd[9:]
    losses = {
        str(r): observe(estimate_at_truth(plan_at(r), MISSION))["Jxy"].inflation[
            "initial conditions"
        ]
        ** 0.5
        for r in (0.2, 0.5, 1.0, 2.0)
    }
    h = np.linalg.norm(plan_at().wheel_momentum)
    period = 2.0 * math.pi * np.trace(CRAFT.inertia_B) / 3.0 / h
    numbers = {"misalignment_sd": float(misaligned.max()), "lost": losses, "period": float(period)}
    return numbers | {
        "curves": curves(),
        "causes": causes(estimate),
        "hidden": hidden_by_control(estimate),
    }


def main() -> None:
    """Compute (unless the numbers are there: delete their file to begin again), draw, write."""
    numbers = results_of(__file__) / "cross_terms.json"
    if not numbers.exists():
        write_atomically(numbers, json.dumps(computed(), indent=1) + "\n")
    results = json.loads(numbers.read_text())
    write_atomically(
        ROOT / "figures" / "cross_terms.png",
        lambda path: picture(results).savefig(
            path, format="png", dpi=150, metadata={"Software": None}
        ),
    )
    text = page(results)
    write_atomically(ROOT / "analyses" / "CROSS_TERMS.md", text)
    print(text)


if __name__ == "__main__":
    main()
