"""What happens to a folder as `fit` and `diagnose` treat it, without sampling.

`judged` is the Laplace estimate with all of the package's gates but that of the chains, which
cannot fail here; `fitted` and `diagnosed` are the package's own calls.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.conventions.check import refuse_impossible
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import clean_fit
from bayes_inertia.inference.gates import Diagnostics, check_gates
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.physics.forward_model import Model

NAMES = (*ELEMENTS, "K1", "K2", "K3")
# Chains that are perfect: their gate is another study's matter.
PERFECT = Diagnostics(True, 1.0, 1e4, 1e4, 1.0, 1, 1.0, 0.0, 1.0, 0, 10**6)


@dataclass(frozen=True)
class Outcome:
    """What became of a folder.

    `status` is "trusted", "untrusted", "error" (refused with a message) or "crash" (anything else
    than the package's own errors); theta and sd (9,) are None without an estimate.
    """

    status: str
    says: str
    dirt: tuple[dict, ...] = ()
    theta: np.ndarray | None = None
    sd: np.ndarray | None = None
    seconds: float = 0.0
    verdict: str = ""
    named: tuple[str, ...] = ()

    @property
    def policy(self) -> str:
        """In one word: error, crash, masked, modelled, recorded, or silent (no record of dirt)."""
        if self.theta is None:
            return self.status
        treated = {d["treated"] for d in self.dirt}
        words = [w for w in ("masked", "modelled") if w in treated]
        return " and ".join(words) or ("recorded" if treated else "silent")


def guarded(work: Callable[[Path], Outcome], folder: Path) -> Outcome:
    """The outcome with its processor time; errors become outcomes."""
    began = time.process_time()
    try:
        outcome = work(folder)
    except BayesInertiaError as error:
        outcome = Outcome("error", str(error))
    except Exception as error:
        outcome = Outcome("crash", f"{type(error).__name__}: {error}")
    return Outcome(**(vars(outcome) | {"seconds": time.process_time() - began}))


def judged(folder: Path) -> Outcome:
    """By the Laplace estimate, cleaned as `fit` cleans it."""
    campaign = read_campaign(folder)
    refuse_impossible(folder)
    estimate = clean_fit(optimizer.estimate(Model(campaign))).estimate
    return outcome_of(estimate, check_gates(estimate, PERFECT), dirt_of(estimate.model.campaign))


def uncleaned(folder: Path) -> Outcome:
    """As `judged`, with the cleaning turned off: the negative control."""
    campaign = read_campaign(folder)
    estimate = optimizer.estimate(Model(campaign))
    return outcome_of(estimate, check_gates(estimate, PERFECT), dirt_of(campaign))


def dirt_of(campaign) -> tuple[dict, ...]:
    """The records of dirt that a campaign or a diagnosis carries."""
    return tuple(d.json() for d in campaign.dirt)


def outcome_of(estimate: Estimate, gates: list[dict], dirt: tuple[dict, ...]) -> Outcome:
    """Of an estimate and its gates."""
    failed = [gate["says"] for gate in gates if not gate["passed"]]
    return Outcome(
        "untrusted" if failed else "trusted",
        "; ".join(failed),
        dirt,
        estimate.theta[:9],
        quoted(estimate),
    )


def quoted(estimate: Estimate) -> np.ndarray:
    """The sd (9,) that a result quotes."""
    return quoted_parameters(estimate).sd


def fitted(folder: Path) -> Outcome:
    """By the package's own `fit`."""
    from bayes_inertia.app.fit_campaign import fit

    summary = fit(read_campaign(folder), seed=1).summary()
    return _of_summary(summary)


def _of_summary(summary: dict) -> Outcome:
    rows = [summary["parameters"][name] for name in NAMES]
    return Outcome(
        "trusted" if summary["trusted"] else "untrusted",
        "; ".join(summary["reasons"]),
        tuple(summary.get("dirt", ())),
        np.array([row["mean"] for row in rows]),
        np.array([row["quoted_sd"] or row["sd"] for row in rows]),
    )


def diagnosed(folder: Path) -> Outcome:
    """By the package's own `diagnose`, without the questions that follow it."""
    from bayes_inertia.diagnosis.search import diagnose

    campaign = read_campaign(folder)
    diagnosis = diagnose(campaign)
    final, noise = diagnosis.final, {k: round(v, 2) for k, v in diagnosis.noise.items() if v > 1}
    trusted = diagnosis.verdict != "unknown"
    return Outcome(
        "trusted" if trusted else "untrusted",
        f"noise {noise}" if noise else "",
        dirt_of(diagnosis),
        final.theta[:9],
        quoted(final),
        verdict=diagnosis.verdict,
        named=tuple(diagnosis.named),
    )
