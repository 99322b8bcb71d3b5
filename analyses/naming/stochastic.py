"""How well the diagnosis names what has no fixed shape.

    python -m analyses.naming.stochastic --kind random --each 20 [--power 0.9] [--times 3]
        [--without-tachometers]
    python -m analyses.naming.stochastic --page

Campaigns of another simulator (`second_simulator.py`), each with its own J, K, bias, slews and
noise. `random`: every stochastic effect, as large as an ideal test finds in 99 % of such
campaigns (`--power`), or so many times as large. `outside`: disturbances from outside the library.
`clean`: nothing hidden; `stated`: noise that wanders as the campaign says. `beside`: an effect of a
fixed shape in such noise, with outliers, flown by the package's own simulator. `prior`: whatever
the prior of a diagnosis may hide, each as often (`prior_campaigns.py`). `--first`: number of the
first campaign of each, other campaigns have other numbers. `--work` keeps the rows of a killed
study. Writes `analyses/results/naming_KIND_TACHO.jsonl` and, with --page, `naming.md`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time

import numpy as np

from analyses import results_of
from analyses.naming.coloured_noise_campaigns import beside_campaign
from analyses.naming.fixed_shape import NAMES, quoted_z, truth_of
from analyses.naming.fixed_shape_campaigns import draw, without_tachometers
from analyses.naming.prior_campaigns import DrawnCampaign, prior_campaign
from analyses.naming.second_simulator import replayed
from analyses.naming.stochastic_campaigns import (
    OF_TACHOMETERS,
    POWER,
    RANDOM,
    SizeOfTest,
    random_campaign,
    stated_campaign,
)
from analyses.naming.stochastic_page import write_page
from analyses.naming.unlisted_disturbances import KINDS, outside
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.files import write_atomically
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.work import Row, Work

RESULTS = results_of(__file__)
KINDS_OF_CAMPAIGNS = ("random", "outside", "clean", "stated", "beside", "prior")


@dataclass(frozen=True)
class NamedOrNot:
    """The task: one campaign simulated and diagnosed. Ids are "label/index".

    `power`: of the ideal test of a random effect. `times`: the effect's size over that which the
    test finds with this power.
    """

    kind: str
    tachometers: bool
    power: float = POWER
    times: float = 1.0

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its row."""
        label, index = task_id.split("/")
        drawn = self._drawn(label, seed)
        truth, began = truth_of(drawn.flight), process_time()
        row = {
            "kind": self.kind,
            "label": label,
            "index": int(index),
            "hidden": list(drawn.hidden),
            "power": self.power,
            "times": self.times,
            "size": max(drawn.sizes, default=0.0),
        }
        try:
            diagnosis = diagnose(drawn.campaign, seed=int(index))
            answer = _summary(diagnosis, truth)
            if self.kind != "prior":
                # After "unknown" it takes minutes, and that study judges probabilities alone.
                answer["quoted_z"] = quoted_z(diagnosis, truth).tolist()
        except BayesInertiaError as error:
            answer = {"error": str(error)}
        row |= {"tachometers": self.tachometers, **answer, "seconds": process_time() - began}
        return {"line": json.dumps(row)}

    def _drawn(self, label: str, seed: np.random.SeedSequence) -> DrawnCampaign:
        """The campaign of a label, and what is hidden in it."""
        sizes: Sequence[float] = ()
        if self.kind == "prior":
            return prior_campaign(seed, self.tachometers)
        if self.kind == "outside":
            flown, noise, path = seed.spawn(3)
            flight = draw(flown, (), {}, True)
            missing = outside(label, np.random.default_rng(path))
            campaign = replayed(flight, missing, np.random.default_rng(noise))
            campaign = campaign if self.tachometers else without_tachometers(campaign)
        elif self.kind == "stated":
            flight, campaign = stated_campaign(seed, self.tachometers)
        elif self.kind == "beside":
            flight, campaign, *sizes = beside_campaign(label, seed, self.tachometers)
        else:
            of_test = SizeOfTest(self.power, self.times)
            flight, campaign, *sizes = random_campaign(label, of_test, seed, self.tachometers)
        return DrawnCampaign(flight, campaign, (label,), tuple(sizes))


def _summary(diagnosis: Diagnosis, truth: np.ndarray) -> dict:
    final = diagnosis.final
    values = zip(final.model.space.names[9:], final.theta[9:].tolist(), strict=True)
    z = (final.theta[:9] - truth) / final.sd[:9]
    return {
        "verdict": diagnosis.verdict,
        "why_unknown": diagnosis.why_unknown,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "hypotheses": [asdict(row) for row in diagnosis.hypotheses],
        "steps": [[step.added, step.log_bayes_factor] for step in diagnosis.steps],
        "lead": diagnosis.nameless_lead if diagnosis.steps else None,
        "source": diagnosis.nameless_source,
        "values": {k: v for k, v in values if k.split(".")[0] in diagnosis.named},
        "max_abs_z": float(np.abs(z).max()),
        "holds_90": int(np.count_nonzero(np.abs(z) < 1.6449)),
        "dirt": [dirt.kind for dirt in diagnosis.dirt],
    }


def labels(kind: str, tachometers: bool) -> tuple[str, ...]:
    """Labels of the campaigns of a kind."""
    if kind in ("clean", "stated", "prior"):
        return (kind,)
    if kind == "outside":
        return tuple(KINDS)
    if kind == "beside":
        return NAMES
    return tuple(name for name in RANDOM if tachometers or name not in OF_TACHOMETERS)


def main() -> None:
    """Simulate and diagnose."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kind", choices=KINDS_OF_CAMPAIGNS)
    parser.add_argument("--each", type=int, default=1, help="campaigns of each label")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--power", type=float, default=POWER, help="of the ideal test")
    parser.add_argument("--times", type=float, default=1.0, help="size over that of the ideal test")
    parser.add_argument("--without-tachometers", action="store_true")
    parser.add_argument("--work", type=Path, default=Path("naming_run"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.kind:
        tachometers = not options.without_tachometers
        factor = "" if options.times == 1.0 else f"_x{options.times:g}"
        factor += "" if options.power == POWER else f"_{options.power:g}"
        name = f"naming_{options.kind}{factor}_{'tacho' if tachometers else 'notacho'}"
        ids = tuple(
            f"{label}/{i}"
            for i in range(options.first, options.first + options.each)
            for label in labels(options.kind, tachometers)
        )
        task = NamedOrNot(options.kind, tachometers, options.power, options.times)
        work = Work("campaigns", task, ids, options={"name": name})
        execution = Execution(
            jobs=options.jobs, progress=lambda *told: print(*told, flush=True), notice=print
        )
        lines = [row["line"] for row in execution.run(work, options.work / name).rows]
        write_atomically(RESULTS / f"{name}.jsonl", "".join(f"{line}\n" for line in lines))
    if options.page:
        write_page(RESULTS)


if __name__ == "__main__":
    main()
