"""Do J and K stay right when something is missing that no effect describes?

    python -m analyses.calibration.unmodelled_disturbance --each 8 [--each-without 2]
        [--work FOLDER] [--jobs 1]
    python -m analyses.calibration.unmodelled_disturbance --page

Campaigns of another simulator (`second_simulator.py`) with a disturbance from outside the library,
with and without tachometers, and clean ones. Each is fitted as it is and with `--remainder both`,
at the optimum (Laplace approximation, a third of the cost of sampling). Do the 90 % intervals of J
and K hold the truth: those of the stated noise, those of the noise that residuals show (what a
refused fit quotes as `sd`), `robust_sd`, and those of the remainder? Writes
`results/calibration/unmodelled_disturbance.jsonl` and, with --page, the page.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from time import process_time

import numpy as np

from analyses import aloud, results_of
from analyses.calibration.unmodelled_disturbance_page import write_page
from analyses.naming.fixed_shape import truth_of
from analyses.naming.fixed_shape_campaigns import draw, without_tachometers
from analyses.naming.sample_paths import at_times
from analyses.naming.second_simulator import Disturbance, replayed
from analyses.naming.unlisted_disturbances import OUTSIDE
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.files import write_atomically
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.studies.work import Row, Work

RESULTS = results_of(__file__) / "unmodelled_disturbance.jsonl"
REMAINDERS = ("torque_remainder", "rate_remainder")
_SPACING = 0.5  # of the times at which random disturbances are drawn [s]
_GRID = np.arange(0.0, 20_000.0, _SPACING)


@lru_cache(maxsize=4)
def _wandering(seed: int, correlation_time: float) -> np.ndarray:
    """An Ornstein-Uhlenbeck process (n, 3) of sd 1 on `_GRID`."""
    kept = np.exp(-_SPACING / correlation_time)
    fresh = np.random.default_rng(seed).normal(size=(len(_GRID), 3)) * np.sqrt(1.0 - kept**2)
    path = np.zeros_like(fresh)
    for k in range(1, len(path)):
        path[k] = kept * path[k - 1] + fresh[k]
    return path


@dataclass(frozen=True)
class RandomTorque(Disturbance):
    """A torque on the body without any fixed shape."""

    seed: int = 0
    correlation_time: float = 20.0

    def body_torque(self, t, since, rate_B):
        path = _wandering(self.seed, self.correlation_time)
        return self.size * at_times(path, t, _SPACING)


@dataclass(frozen=True)
class RandomWalk(Disturbance):
    """The rate random walk of a gyro, `size` its density [rad/s^1.5]."""

    def rate_error(self, t, rng):
        steps = np.sqrt(np.diff(t, prepend=t[0]))
        return np.cumsum(self.size * steps[:, None] * rng.normal(size=(len(t), 3)), axis=0)


def disturbance(kind: str, seed: int) -> Disturbance:
    """What is missing from the model."""
    random = {
        "clean": Disturbance(0.0),
        "random-torque": RandomTorque(2e-6, seed),
        "fast-torque": RandomTorque(4e-6, seed, 4.0),
        "random-walk": RandomWalk(4e-6),
    }
    return random[kind] if kind in random else OUTSIDE[_name(kind)]


KINDS = (
    "clean",
    "random-torque",
    "fast-torque",
    "random-walk",
    *(name.removeprefix("outside_").replace("_", "-") for name in OUTSIDE),
)


def _name(kind: str) -> str:
    return "outside_" + kind.replace("-", "_")


@dataclass(frozen=True)
class FittedTwice:
    """The task: one campaign, fitted without and with what remains. Ids are "kind/index"."""

    tachometers: bool

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its row."""
        kind, _, _ = task_id.partition("/")
        flown, noise, path = seed.spawn(3)
        flight = draw(flown, (), {}, True)
        missing = disturbance(kind, int(path.generate_state(1)[0]))
        campaign = replayed(flight, missing, np.random.default_rng(noise))
        if not self.tachometers:
            campaign = without_tachometers(campaign)
        return {"line": json.dumps(_row(campaign, truth_of(flight)) | {"kind": kind})}


def _row(campaign: Campaign, truth: np.ndarray) -> dict:
    """Errors of J and K, and the sds that are quoted for them."""
    began = process_time()
    usual = optimizer.estimate(Model(campaign))
    stated = optimizer.with_noise(usual, dict.fromkeys(CHANNELS, 1.0))
    between = process_time()
    whole = optimizer.estimate(Model(campaign, by_name(REMAINDERS)))
    robust = usual.robust_sd
    return {
        "tachometers": bool(campaign.wheels[0].momentum_sigma),
        "errors": {
            "stated": _errors(stated, truth),
            "usual": _errors(usual, truth),
            "remainder": _errors(whole, truth),
        },
        "sds": {
            "stated": stated.sd[:9].tolist(),
            "usual": usual.sd[:9].tolist(),
            "robust": robust[:9].tolist() if robust is not None else None,
            "remainder": whole.sd[:9].tolist(),
        },
        "chi2": [usual.tests["total"].reduced_chi2, whole.tests["total"].reduced_chi2],
        "explained": [not any(t.too_large for t in e.tests.values()) for e in (usual, whole)],
        "sizes": dict(zip(whole.model.space.names[9:], whole.theta[9:].tolist(), strict=True)),
        "seconds": [between - began, process_time() - between],
    }


def _errors(estimate: Estimate, truth: np.ndarray) -> list[float]:
    return (estimate.theta[:9] - truth).tolist()


def main() -> None:
    """Simulate and fit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--each", type=int, default=0, help="campaigns of each kind and half")
    parser.add_argument(
        "--each-without", type=int, help="the same without tachometers, where a fit takes longer"
    )
    parser.add_argument("--work", type=Path, default=Path("remainder_run"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.each:
        few = options.each if options.each_without is None else options.each_without
        execution = aloud(options.jobs)
        lines = []
        for tachometers, each in ((True, options.each), (False, few)):
            ids = tuple(f"{kind}/{i}" for i in range(each) for kind in KINDS)
            work = Work(
                "campaigns", FittedTwice(tachometers), ids, options={"tachometers": tachometers}
            )
            folder = options.work / ("with" if tachometers else "without")
            lines += [row["line"] for row in execution.run(work, folder).rows]
        write_atomically(RESULTS, "".join(f"{line}\n" for line in lines))
    if options.page:
        write_page(RESULTS)


if __name__ == "__main__":
    main()
