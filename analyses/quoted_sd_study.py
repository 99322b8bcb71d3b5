"""Which uncertainty of J and K to quote: intervals of candidates against truth, by kind of campaign.

    python analyses/quoted_sd_study.py --each 60 [--work FOLDER] [--kinds clean,designed]
    python analyses/quoted_sd_study.py --page

Each campaign is fitted as `fit` does, without sampling (Laplace approximation). Kept are what each
slew says of J, K and bias once its own unknowns are eliminated, so that candidates of an
uncertainty are compared on the same fits. Writes `analyses/results/quoted_sd.jsonl` and, with
--page, `quoted_sd.md`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from dirt_pipeline import _PERFECT
from quoted_sd_campaigns import CLASSES, Case, case_of, library_of

from bayes_inertia.diagnosis.score_test import score_tests
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.files import write_atomically
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import clean_fit
from bayes_inertia.inference.gates import check_gates
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.work import Row, Work


@dataclass(frozen=True)
class Fitted:
    """The task: one campaign, fitted. Ids are "class/index"."""

    tachometers: bool
    work: Path

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its row."""
        kind, _, index = task_id.partition("/")
        try:
            case = case_of(kind, int(index), seed, self.tachometers, self.work)
            row = _row(case)
        except BayesInertiaError as error:
            row = {"error": str(error)[:200]}
        return {"line": json.dumps({"kind": kind, "tachometers": self.tachometers} | row)}


def _row(case: Case) -> dict:
    estimate = clean_fit(optimizer.estimate(Model(case.campaign))).estimate
    gates = check_gates(estimate, _PERFECT)
    shares = estimate.linearised().shares
    return {
        "hidden": case.hidden,
        "trusted": all(gate["passed"] for gate in gates),
        "truth": case.truth.tolist(),
        "theta": estimate.theta[:9].tolist(),
        "covariance": estimate.covariance[:9, :9].tolist(),
        "robust": None if estimate.robust_sd is None else estimate.robust_sd[:9].tolist(),
        "matrix": shares.matrix.tolist(),
        "gradient": shares.gradient.tolist(),
        "prior_matrix": np.diag(shares.prior_matrix).tolist(),
        "prior_gradient": shares.prior_gradient.tolist(),
        "chi2": {k: t.reduced_chi2 for k, t in estimate.tests.items()},
        "discount": estimate.discount.tolist(),
        "undetected": _undetected(estimate),
    }


def _undetected(estimate: Estimate) -> dict:
    """J and K with each effect of the library beside them, to first order, and its evidence."""
    model = estimate.model
    effects = library_of(model.campaign)
    moved = optimizer.move_to(estimate, Model(model.campaign, effects, model.structure.drive))
    fit = moved.linearised()
    tests = score_tests(moved, tuple(e.name for e in effects), fit=fit)
    space = moved.model.space
    answer = {}
    for k, name in enumerate(tests.names):
        part, index = space.slice_of(name), tests.indices[k]
        columns = fit.parameters[..., part] * space.sd[part]
        projected = np.zeros((len(fit.covariance), columns.shape[-1]))
        for s, change in enumerate(columns):
            projected[fit.index(s)] += fit.columns[s].T @ change
        answer[name] = {
            "shift": (fit.covariance @ projected)[:9].tolist(),  # per prior sd left out
            "matrix": tests.matrix[np.ix_(index, index)].tolist(),
            "gradient": tests.gradient[index].tolist(),
            "one_sided": bool(tests.one_sided[k]),
            "log_bayes_factor": float(tests.log_bayes_factor(k)),
            "amplitude": tests.amplitude(k).tolist(),
        }
    return answer


def main() -> None:
    """Simulate and fit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--each", type=int, default=0, help="campaigns of each class and half")
    parser.add_argument("--work", type=Path, default=Path("quoted_sd_run"))
    parser.add_argument("--kinds", default=",".join(CLASSES))
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    execution = Execution(
        jobs=options.jobs, progress=lambda *told: print(*told, flush=True), notice=print
    )
    options.work.mkdir(parents=True, exist_ok=True)
    for kind in options.kinds.split(","):
        for tachometers in (True, False):
            ids = tuple(f"{kind}/{i}" for i in range(options.each))
            work = Work(
                "campaigns",
                Fitted(tachometers, options.work),
                ids,
                seed=41,
                options={"tachometers": tachometers},
            )
            name = f"{kind}_{'with' if tachometers else 'without'}"
            rows = execution.run(work, options.work / name).rows
            write_atomically(
                options.work / f"{name}.jsonl", "".join(f"{row['line']}\n" for row in rows)
            )


if __name__ == "__main__":
    main()
