"""Is an update the joint fit? Splits of simulated campaigns.

    python -m analyses.calibration.updates [SPLITS]

Each split is a campaign of six slews, flown anew with J and K drawn from the prior; its first
slews (two, three or four) are fitted, and are the prior of the rest. The joint fit holds all slews
and a rate bias of each part. All by Laplace's approximation, as the sampler begins. It writes
`results/calibration/updates.json` and `.md`. Twenty seconds a split; six unless told otherwise.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

import bayes_inertia as bi
from analyses import results_of
from bayes_inertia.design.comparison import likely_missions
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.version import __version__

SEED, SPLITS, FORMER = 45, 6, (2, 3, 4)
J_AND_K = slice(0, 9)


@dataclass(frozen=True)
class BiasOfEachPart(bi.Effect):
    """The rate bias of two campaigns that are fitted as one: each has its own."""

    first: int
    sigma: float
    name = "bias_of_each_part"

    def parameters(self, campaign: bi.Campaign) -> tuple[bi.Parameter, ...]:
        """Three numbers a part."""
        components = tuple(f"{part}{axis}" for part in "ab" for axis in "xyz")
        return (bi.vector("bias", components, unit="rad/s", prior=bi.Normal(0.0, self.sigma)),)

    def rate_output(self, p: Any, slew: Any, trajectory: Any, rate_S: Any) -> Any:
        """The bias of the part that the slew belongs to."""
        return rate_S + jnp.where(slew.index < self.first, p["bias"][:3], p["bias"][3:])


def six_slews() -> bi.Plan:
    """The paper's five slews and the first of them again."""
    plan = paper_like_plan()
    return replace(plan, slews=(*plan.slews, plan.slews[0]))


def split(index: int, former: int) -> dict[str, Any]:
    """Differences of an update from the joint fit, in sds of that."""
    plan = six_slews()
    mission = likely_missions(plan, most_like_mission(), 2, SEED + index)[1]
    campaign = bi.fly(plan, mission, SEED + index).campaign
    sensor = campaign.rate_sensor
    known = replace(campaign, rate_sensor=replace(sensor, bias_sigma=(1e-12,) * 3))
    effect = BiasOfEachPart(former, float(sensor.bias_sigma[0]))
    joint = bi.estimate(bi.Model(known, (effect,)))
    first = bi.estimate(campaign.subset(range(former)))
    names, covariance = first.model.space.names[J_AND_K], first.covariance[J_AND_K, J_AND_K]
    prior = bi.GaussianPrior(names, first.theta[J_AND_K], covariance)
    rest = campaign.subset(range(former, len(campaign.slews)))
    update = bi.estimate(replace(rest, prior=prior))
    sd = joint.sd[J_AND_K]
    return {
        "split": index,
        "former_slews": former,
        "mean_off_sd": ((update.theta - joint.theta[J_AND_K]) / sd).tolist(),
        "sd_ratio": (update.sd[J_AND_K] / sd).tolist(),
        "former_off_sd": ((first.theta - joint.theta[J_AND_K]) / sd).tolist(),
    }


def main(splits: int = SPLITS) -> None:
    """All splits, and the table."""
    rows = [split(i, FORMER[i % len(FORMER)]) for i in range(splits)]
    content = {"version": __version__, "seed": SEED, "rows": rows}
    target = results_of(__file__) / "updates.json"
    write_atomically(target, json.dumps(content, indent=1) + "\n")
    write_atomically(target.with_suffix(".md"), page(rows))


def page(rows: list[dict[str, Any]]) -> str:
    """The table as a page."""
    lines = [
        "# An update against the joint fit",
        "",
        "Simulated campaigns of six slews, each split in two: the first part is fitted and is the",
        "prior of the rest. The joint fit holds both, with a rate bias of each. Largest of nine.",
        "",
        "| slews of the former | splits | mean off [sd] | sd off | former alone off [sd] |",
        "|---|---|---|---|---|",
    ]
    for former in sorted({row["former_slews"] for row in rows}):
        own = [row for row in rows if row["former_slews"] == former]
        mean = max(np.abs(row["mean_off_sd"]).max() for row in own)
        sd = max(np.abs(np.array(row["sd_ratio"]) - 1.0).max() for row in own)
        alone = max(np.abs(row["former_off_sd"]).max() for row in own)
        lines.append(f"| {former} | {len(own)} | {mean:.4f} | {sd:.2%} | {alone:.1f} |")
    return "\n".join([*lines, "", "Made by `python -m analyses.calibration.updates`.", ""])


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
