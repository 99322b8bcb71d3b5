"""What one evaluation of the posterior costs: against a kernel by hand, and at several rates.

    python -m analyses.engine.evaluation_benchmark [--throws FOLDER] [--out FOLDER]

writes `results/engine/evaluation_benchmark.{md,json}`. Everything runs on one core, in batches of
32 walkers as the sampler's; processor time, the smallest of several tries taken in turns, so that
other work on the machine counts little. Compiling is not in it.

`--throws` names the campaign of thrown bodies at 4 kHz (not in the repository); without it the
block means of real telemetry are left out.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import jax
import jax.numpy as jnp
import numpy as np

from analyses import results_of
from analyses.engine.evaluation_kernel import slew_kernel
from bayes_inertia.campaign.block_means import longest_block, reduced
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, Wheel
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.laplace import Estimate, Starts, marginal
from bayes_inertia.inference.likelihood import Point, information_blocks
from bayes_inertia.inference.marginal_posterior import Marginal, log_density_of
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.objective import normal_equations
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.integration_plan import longest_smooth_step, motion_scales
from bayes_inertia.physics.prediction import start_of
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start, idle_slew

BATCH = 32
TRIES = 7


def most_like_campaign(period: float) -> Campaign:
    """Five simulated slews of a MOST-like spacecraft, a row every `period` seconds."""
    plan = replace(paper_like_plan(), telemetry_period=period)
    return draw_flight(planned_campaign(plan, most_like_mission()), plan, 4, vary=False).campaign


def thrown_campaign(rows_a_second: int, throws: int = 4) -> Campaign:
    """Free tumbles of one second; the same motion whatever the rate of the telemetry."""
    inertia, rng = np.diag([1.5e-3, 3.8e-4, 1.7e-3]), np.random.default_rng(1)
    time = np.arange(4000) / 4000.0
    fly = jax.jit(lambda slew, start: simulate_slew(slew, start, jnp.asarray(inertia))[0])
    wheel = Wheel("z", (0.0, 0.0, 1.0), 1.7e-6, momentum_sigma=9.6e-6)
    every = 4000 // rows_a_second
    slews = []
    for k in range(throws):
        direction = rng.normal(size=3)
        start = Start(
            jnp.asarray(9.0 * direction / np.linalg.norm(direction)),
            jnp.array([0.0, 0.0, 0.0, 1.0]),
            jnp.array([-3e-4]),
        )
        idle = idle_slew(time, wheel_axes_B=np.eye(3)[:, 2:], spin_inertia=np.array([1.7e-6]))
        path = fly(idle, start)
        noise = rng.normal(size=(len(time), 4)) * [0.0153, 0.0153, 0.0153, 9.6e-6]
        rate, momentum = np.array(path.rate_B), np.array(path.wheel_momentum)
        rate, momentum = rate + noise[:, :3], momentum + noise[:, 3:]
        at = slice(None, None, every)
        slews.append(Slew(f"{k}", 9.0 * k, time[at], rate[at], None, None, momentum[at]))
    prior = InertiaPrior(inertia, 0.1, 5e-5)
    return Campaign("throws", prior, (wheel,), RateSensor(sigma=0.0153), None, tuple(slews))


def frozen(model: Model) -> Marginal:
    """The marginal posterior, linearised at the prior mean: what it costs does not depend on it."""
    theta = np.array(model.space.mean)
    point = Point(theta, np.zeros(3), np.zeros((model.n_slews, model.structure.n_local)))
    white = whitening(model, theta)
    information = information_blocks(model, point, white)
    hessian, _ = normal_equations(model, point, information)
    discount = np.ones((model.n_slews, 3))
    parts = (model, point, white, white, discount, information, hessian, 0.0, Starts(1, 1))
    return marginal(Estimate(*parts))


def by_hand(model: Model, at: Marginal) -> Callable[[np.ndarray], np.ndarray]:
    """The same density from the kernel, for thetas (walkers, d); walkers are its last axis."""
    campaign, arrays, white = model.campaign, model.data.arrays, at.white
    axes, spin = campaign.wheel_axes_B, campaign.spin_inertias
    start = jax.jit(
        jax.vmap(
            jax.vmap(lambda r, x: start_of(model.structure, model.data.scale, r, x)), (None, 0)
        )
    )
    to_inertial = jax.jit(quaternion.to_inertial)
    tensors = jax.jit(jax.vmap(inertia_tensor.tensor))
    column_parts = [np.asarray(c) for c in at.columns]
    rows = [_rows_of(model, at, s, column_parts) for s in range(model.n_slews)]
    optimum = jax.tree.map(np.asarray, at.ridge.optimum)
    root, ridge, ridge_bias = (np.asarray(x) for x in (at.root, at.ridge.local, at.ridge.bias))
    mean, sd = model.space.mean, model.space.sd
    fixes = np.asarray(white[1].factors)

    def density(thetas: np.ndarray) -> np.ndarray:
        walkers, shift = len(thetas), thetas - optimum.theta
        bias = optimum.bias + shift @ ridge_bias.T
        local = optimum.local + np.einsum("sld,wd->wsl", ridge, shift)
        J = np.asarray(tensors(thetas[:, :6]))
        inverse = np.ascontiguousarray(np.linalg.inv(J).reshape(walkers, 9).T)
        begin = jax.tree.map(np.asarray, start(arrays.reference, local))
        absolute = begin.wheel_momentum + spin * (begin.rate_B @ axes)
        total = np.einsum("wij,wsj->wsi", J, begin.rate_B) + absolute @ axes.T
        momentum_N = np.asarray(to_inertial(begin.attitude, total))
        physical = np.asarray(model.data.sensors[0].bias) + bias * np.asarray(model.data.scale.bias)
        chi2, gradients = np.zeros(walkers), []
        for s, (measured, wheels) in enumerate(rows):
            gradient = np.zeros((measured[4].shape[2], walkers))
            slew_kernel(
                np.ascontiguousarray(begin.attitude[:, s].T),
                np.ascontiguousarray(momentum_N[:, s].T),
                np.ascontiguousarray((absolute[:, s] @ axes.T).T),
                inverse,
                np.ascontiguousarray(thetas[:, 6:9].T),
                np.ascontiguousarray(physical.T),
                *measured[:5],
                chi2,
                gradient,
                *measured[5:7],
                np.ascontiguousarray(fixes[s, 0]),
                measured[7],
                *wheels[:4],
                np.ascontiguousarray(absolute[:, s].T),
                *wheels[4:],
            )
            gradients.append(gradient.T)
        of_local = [g[:, 3:] + local[:, s] for s, g in enumerate(gradients)]
        of_bias = sum(g[:, :3] for g in gradients) + bias
        explained = np.concatenate([of_bias, *of_local], 1) @ root.T
        chi2 += np.sum(bias**2, 1) + np.sum(local**2, (1, 2)) - np.sum(explained**2, 1)
        return -0.5 * chi2 - 0.5 * np.sum(((thetas - mean) / sd) ** 2, 1)

    return density


def _rows_of(model: Model, at: Marginal, s: int, columns: Sequence[np.ndarray]) -> tuple:
    """One slew's rows without padding, as the kernel wants them."""
    campaign, telemetry = model.campaign, model.data.arrays.telemetry
    slew, wheels = campaign.slews[s], len(campaign.wheels)
    n, k = len(slew.time), columns[0].shape[-1]
    step = np.append(np.diff(slew.time), 0.0)
    gained = np.cumsum(slew.wheel_torque * step[:, None], axis=0)
    gained = np.concatenate([np.zeros((1, wheels)), gained[:-1]])
    fix_of_row = np.full(n, -1)
    rates, attitudes, momenta = telemetry.readings
    valid = np.flatnonzero(np.asarray(attitudes.valid[s]).all(-1))
    fix_of_row[np.asarray(attitudes.row[s])[valid]] = valid
    white_rate = np.ascontiguousarray(np.diagonal(at.white[0].factors[s], axis1=1, axis2=2)[:n])
    axes = campaign.wheel_axes_B
    measured = (
        gained @ axes.T,
        step,
        np.array(rates.values[s, :n]),
        white_rate,
        np.ascontiguousarray(columns[0][s].reshape(-1, 3, k)[:n]),
        fix_of_row,
        np.array(attitudes.values[s]),
        np.ascontiguousarray(columns[1][s].reshape(-1, 3, k)),
    )
    of_wheels = (
        wheels,
        np.ascontiguousarray(axes),
        campaign.spin_inertias,
        gained,
        np.array(momenta.values[s, :n]),
        np.array(at.white[2].factors[s, :n]),
        np.ascontiguousarray(columns[2][s].reshape(-1, wheels, k)[:n]),
    )
    return measured, of_wheels


def thetas_of(model: Model) -> np.ndarray:
    """One batch of walkers around the prior mean."""
    noise = np.random.default_rng(0).normal(size=(BATCH, model.space.size))
    return np.array(model.space.mean) + 0.1 * model.space.sd * noise


def cost(evaluate: dict[str, Callable[[np.ndarray], object]], thetas: dict) -> dict[str, float]:
    """Processor seconds of one evaluation each: the best of several tries, taken in turns."""
    repeats, best = {}, dict.fromkeys(evaluate, np.inf)
    for name, function in evaluate.items():
        function(thetas[name])
        begin = process_time()
        function(thetas[name])
        repeats[name] = max(1, int(0.3 / max(process_time() - begin, 1e-4)))
    for _ in range(TRIES):
        for name, function in evaluate.items():
            begin = process_time()
            for _ in range(repeats[name]):
                function(thetas[name])
            each = (process_time() - begin) / repeats[name] / BATCH
            best[name] = min(best[name], each)
    return best


def described(campaign: Campaign, model: Model) -> dict:
    """Rows of a campaign, and the integration steps that the model takes."""
    grid = model.data.arrays.slews.context.time.shape
    return {
        "slews": len(campaign.slews),
        "rows": int(sum(len(s.time) for s in campaign.slews)),
        "steps": int(grid[0] * grid[1] / model.structure.rows_per_step),
    }


def fewest_steps(campaign: Campaign) -> int:
    """Integration steps if all were as long as the motion and the sensors' noise allow."""
    longest = longest_smooth_step(campaign, motion_scales(campaign))
    return int(sum(np.ceil(slew.duration / longest) for slew in campaign.slews))


def measure(throws: Path | None) -> dict:
    """All costs, in microseconds an evaluation, and their ratios."""
    campaigns = {
        "4 Hz": most_like_campaign(0.25),
        "throws 400 Hz": thrown_campaign(400),
        "throws 4 kHz": thrown_campaign(4000),
    }
    campaigns["throws 4 kHz, block means"] = reduced(campaigns["throws 4 kHz"])
    blocks = {"throws 4 kHz": longest_block(campaigns["throws 4 kHz"])}
    if throws is not None:
        campaigns["real throws"] = read_campaign(throws)
        campaigns["real throws, block means"] = reduced(campaigns["real throws"])
        blocks["real throws"] = longest_block(campaigns["real throws"])
    evaluate, thetas, sizes = {}, {}, {}
    for name, campaign in campaigns.items():
        model = Model(campaign)
        at = frozen(model)
        evaluate[name] = log_density_of(model.structure, at, batch=BATCH)
        thetas[name], sizes[name] = thetas_of(model), described(campaign, model)
        if name == "4 Hz":
            evaluate["4 Hz, by hand"] = by_hand(model, at)
            thetas["4 Hz, by hand"] = thetas[name]
            ours, theirs = (evaluate[k](thetas[name]) for k in ("4 Hz", "4 Hz, by hand"))
            gap = (ours - theirs) - (ours - theirs)[0]
            agreement = float(np.abs(gap).max() / np.std(theirs))
    seconds = cost(evaluate, thetas)
    ratios = {
        "ours over the kernel, 4 Hz": seconds["4 Hz"] / seconds["4 Hz, by hand"],
        "4 kHz over 400 Hz": seconds["throws 4 kHz"] / seconds["throws 400 Hz"],
        "block means over 4 kHz": seconds["throws 4 kHz, block means"] / seconds["throws 4 kHz"],
    }
    if throws is not None:
        ratio = seconds["real throws, block means"] / seconds["real throws"]
        ratios["block means over real throws"] = ratio
    return {
        "microseconds": {name: 1e6 * value for name, value in seconds.items()},
        "ratios": ratios,
        "sizes": sizes,
        "readings a block": blocks,
        "fewest steps of block means": fewest_steps(campaigns["throws 4 kHz, block means"]),
        "largest difference from the kernel, over the spread of the batch": agreement,
    }


def page(result: dict) -> str:
    """The page of the results."""
    lines = [
        "# What one evaluation of the posterior costs",
        "",
        "Made by `python -m analyses.engine.evaluation_benchmark`. Batches of 32 walkers on "
        "one core;",
        "processor time, the best of seven tries in turns. Only the ratios hold elsewhere.",
        "",
        "| campaign | slews | rows | integration steps | microseconds |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, value in result["microseconds"].items():
        empty = {"slews": "", "rows": "", "steps": "every row"}
        size = result["sizes"].get(name, empty)
        cells = " | ".join(str(size[k]) for k in ("slews", "rows", "steps"))
        cells += f" | {value:.0f}"
        lines.append(f"| {name} | {cells} |")
    lines += ["", "| ratio | |", "| --- | ---: |"]
    lines += [f"| {name} | {value:.2f} |" for name, value in result["ratios"].items()]
    key = "largest difference from the kernel, over the spread of the batch"
    lines += [
        "",
        "Block means are integrated from mean to mean. Steps as long as the motion and the means'",
        "noise allow (error below a hundredth of it) would be "
        f"{result['fewest steps of block means']}; that is the bound of their cost.",
        "",
        f"Log densities are the kernel's but for {result[key]:.1g} of their spread.",
    ]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write both files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--throws", type=Path)
    parser.add_argument("--out", type=Path, default=results_of(__file__))
    options = parser.parse_args(arguments)
    result = measure(options.throws)
    options.out.mkdir(parents=True, exist_ok=True)
    name = options.out / "evaluation_benchmark"
    write_atomically(name.with_suffix(".json"), json.dumps(result, indent=1) + "\n")
    write_atomically(name.with_suffix(".md"), page(result))
    print(page(result))


if __name__ == "__main__":
    main()
