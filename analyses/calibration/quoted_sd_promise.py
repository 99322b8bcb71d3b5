"""Is what `design` promises what `fit` quotes? Ten flights of one designed plan.

    python -m analyses.calibration.quoted_sd_promise

Writes `results/calibration/quoted_sd_promise.json`: for each flight the quoted sd of J and K over
the promised one, and the error in quoted sds (Laplace approximation). Two minutes.
"""

from __future__ import annotations

import json

import numpy as np

from analyses import results_of
from analyses.design.cases import MISSION
from analyses.naming.fixed_shape import truth_of
from bayes_inertia.design.designer import design_plan
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model

FLIGHTS = 10


def main() -> None:
    """Design once, fly and fit ten times."""
    design = design_plan(MISSION)
    promised = np.array(list(design.sd.values()))
    template, rows = planned_campaign(design.plan, MISSION), []
    for index in range(FLIGHTS):
        seed = np.random.SeedSequence(411, spawn_key=(index,))
        flight = draw_flight(template, design.plan, seed, vary=False)
        fitted = estimate(Model(flight.campaign))
        quoted = quoted_parameters(fitted)
        rows.append(
            {
                "quoted_over_promised": (quoted.sd / promised).round(3).tolist(),
                "old_over_promised": (fitted.robust_sd[:9] / promised).round(3).tolist(),
                "error_in_quoted_sd": ((quoted.mean - truth_of(flight)) / quoted.sd)
                .round(2)
                .tolist(),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    path = results_of(__file__) / "quoted_sd_promise.json"
    write_atomically(path, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
