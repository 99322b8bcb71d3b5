"""Is a change of J dated, and none invented? Are fleets calibrated?

    python -m analyses.calibration.series_of_campaigns

Flown: twelve series of six simulated campaigns, half with a 1 % jump of one principal axis' moment
between two of them; each campaign is fitted (Laplace). Drawn: many more series and fleets, of which
each campaign tells what one of the flown did, with noise of its own. It writes
`results/calibration/series_of_campaigns.json` and `.md`. Ten minutes.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from analyses import results_of
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference.likelihood_summary import (
    LikelihoodSummary,
    product,
    summary_of,
)
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.series.fleet import fleet_of
from bayes_inertia.series.history import History, history_of
from bayes_inertia.version import __version__

SEED, CAMPAIGNS, FLOWN = 45, 6, 12
JUMPED, CONSTANT, JUMP = 100, 200, 0.01
TOLD = 0.95
# Crafts of a fleet and campaigns of each; fleets of each size.
FLEETS = ((5, 2, 40), (20, 3, 12), (200, 5, 1))
# Spread of the fleets drawn: J as a share of the mean moment of inertia, K.
SPREAD = 3e-3


def told_by(J: np.ndarray, K: np.ndarray, name: str, seed: int) -> LikelihoodSummary:
    """What one simulated campaign tells of a spacecraft."""
    mission = most_like_mission()
    craft = replace(mission.spacecraft, inertia_B=J, scale_factor=tuple(K))
    flight = fly(paper_like_plan(), replace(mission, spacecraft=craft), seed)
    fitted = estimate(Model(flight.campaign))
    space, part = fitted.model.space, slice(0, 9)
    covariance = fitted.covariance[part, part]
    return summary_of(name, fitted.theta[part], covariance, space.mean[part], space.sd[part])


def elements(J: np.ndarray, K: np.ndarray) -> np.ndarray:
    """J and K (9,)."""
    return np.array([*np.diag(J), J[0, 1], J[0, 2], J[1, 2], *K])


def flown_series(index: int) -> dict:
    """One series that is flown and fitted, every second with a jump."""
    rng = np.random.default_rng([SEED, index])
    mission = most_like_mission()
    J, K = mission.spacecraft.inertia_B.copy(), 1.0 + 0.02 * rng.standard_normal(3)
    axis, after = int(rng.integers(3)), int(rng.integers(CAMPAIGNS - 1))
    jumps, told, truth = index % 2 == 0, [], []
    for k in range(CAMPAIGNS):
        if jumps and k == after + 1:
            J[axis, axis] *= 1.0 + JUMP
        told.append(told_by(J, K, f"campaign {k + 1}", 1000 * index + k))
        truth.append(elements(J, K))
    history = history_of(told)
    return scored(history, np.array(truth), (after, axis) if jumps else None) | {
        "precision": [one.precision.tolist() for one in told]
    }


def scored(history: History, truth: np.ndarray, jump: tuple[int, int] | None) -> dict:
    """How a history compares with its truth."""
    seen = [(j.after, j.part) for j in history.jumps if j.probability > TOLD]
    row: dict = {"seen": seen, "z": ((history.mean - truth) / history.sd)[-1].tolist()}
    if jump is None:
        return row | {"right": not seen}
    after, axis = jump
    right = seen == [(after, "J")]
    first = history.jumps[0]
    size = truth[-1, axis] - truth[0, axis]
    z = float((first.size[axis] - size) / first.sd[axis]) if right else None
    return row | {"right": right, "size_z": z}


def drawn_series(precisions: np.ndarray, index: int, jumps: bool) -> dict:
    """One series of which each campaign tells what a flown one did."""
    rng = np.random.default_rng([SEED, index, jumps])
    prior = most_like_mission().prior
    mean = np.array([*prior.elements, 1.0, 1.0, 1.0])
    sd = np.array([*prior.sd, 0.03, 0.03, 0.03])
    now = mean + 0.5 * sd * rng.standard_normal(9)
    axis, after = int(rng.integers(3)), int(rng.integers(CAMPAIGNS - 1))
    told, truth = [], []
    for k in range(CAMPAIGNS):
        if jumps and k == after + 1:
            now = now.copy()
            now[axis] *= 1.0 + JUMP
        told.append(drawn(now, precisions, (mean, sd), rng, f"campaign {k + 1}"))
        truth.append(now)
    return scored(history_of(told), np.array(truth), (after, axis) if jumps else None)


def drawn(
    truth: np.ndarray,
    precisions: np.ndarray,
    prior: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
    name: str,
) -> LikelihoodSummary:
    """What a campaign tells: noise of the precision of one that was flown."""
    precision = precisions[rng.integers(len(precisions))]
    noise = np.linalg.cholesky(np.linalg.inv(precision)) @ rng.standard_normal(9)
    return LikelihoodSummary(name, truth + noise, precision, *prior)


def drawn_fleet(precisions: np.ndarray, crafts: int, campaigns: int, index: int) -> list[float]:
    """z of all J and K of all crafts of one fleet."""
    rng = np.random.default_rng([SEED, crafts, index])
    prior = most_like_mission().prior
    mean = np.array([*prior.elements, 1.0, 1.0, 1.0])
    sd = np.array([*prior.sd, 0.03, 0.03, 0.03])
    spread = SPREAD * np.repeat([mean[:3].mean(), 1.0], [6, 3])
    fleet = mean + 0.5 * sd * rng.standard_normal(9)
    truth = fleet + spread * rng.standard_normal((crafts, 9))
    told = [
        product([drawn(x, precisions, (mean, sd), rng, f"craft {k}") for _ in range(campaigns)])
        for k, x in enumerate(truth)
    ]
    found = fleet_of(told)
    return ((found.craft_mean - truth) / found.craft_sd).ravel().tolist()


def page(content: dict) -> str:
    """The result as a page."""
    flown, jumped, constant = (content[k] for k in ("flown", "jumped", "constant"))
    lines = [
        "# J and K over campaigns, and over sister spacecraft",
        "",
        "Made by `python -m analyses.calibration.series_of_campaigns`; six campaigns of five slews",
        f"a series, a jump of {100 * JUMP:.0f} % of one moment of inertia in half of them.",
        "",
        "| series | right | rms z of J and K at the last campaign |",
        "|---|---|---|",
        f"| flown and fitted, with a jump | dated: {flown['dated']} of {flown['with_jump']} | "
        f"{flown['rms_z']:.2f} (all {FLOWN}) |",
        f"| flown and fitted, constant | none invented: {flown['quiet']} of "
        f"{flown['without_jump']} | |",
        f"| drawn, with a jump | dated: {jumped['right']} of {JUMPED} | {jumped['rms_z']:.2f} |",
        f"| drawn, constant | none invented: {constant['right']} of {CONSTANT} | "
        f"{constant['rms_z']:.2f} |",
        "",
        f"Size of the jumps that were dated: rms z {jumped['size_rms_z']:.2f}.",
        "",
        "| fleet | campaigns each | fleets | rms z of J and K |",
        "|---:|---:|---:|---|",
        *(
            f"| {row['crafts']} | {row['campaigns']} | {row['fleets']} | {row['rms_z']:.3f} |"
            for row in content["fleets"]
        ),
        "",
        "z: error over the quoted sd; its rms should be one. A change is told above a probability",
        f"of {100 * TOLD:.0f} %.",
        "",
    ]
    return "\n".join(lines)


def rms(values: list) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Fly, draw, count, write."""
    flown = []
    for index in range(FLOWN):
        flown.append(flown_series(index))
        print(index, flown[-1]["seen"], flush=True)
    precisions = np.array([one for row in flown for one in row["precision"]])
    groups = {
        "jumped": [drawn_series(precisions, k, True) for k in range(JUMPED)],
        "constant": [drawn_series(precisions, k, False) for k in range(CONSTANT)],
    }
    with_jump, without = flown[::2], flown[1::2]
    content: dict = {
        "version": __version__,
        "flown": {
            "dated": sum(row["right"] for row in with_jump),
            "with_jump": len(with_jump),
            "quiet": sum(row["right"] for row in without),
            "without_jump": len(without),
            "rms_z": rms([z for row in flown for z in row["z"]]),
        },
    }
    for name, rows in groups.items():
        content[name] = {
            "right": sum(row["right"] for row in rows),
            "rms_z": rms([z for row in rows for z in row["z"]]),
        }
    sizes = [row["size_z"] for row in groups["jumped"] if row["right"]]
    content["jumped"]["size_rms_z"] = rms(sizes)
    content["fleets"] = []
    for crafts, campaigns, fleets in FLEETS:
        z = [x for k in range(fleets) for x in drawn_fleet(precisions, crafts, campaigns, k)]
        row = {"crafts": crafts, "campaigns": campaigns, "fleets": fleets, "rms_z": rms(z)}
        content["fleets"].append(row)
        print(row, flush=True)
    results = results_of(__file__)
    write_atomically(results / "series_of_campaigns.json", json.dumps(content, indent=1) + "\n")
    write_atomically(results / "series_of_campaigns.md", page(content))


if __name__ == "__main__":
    main()
