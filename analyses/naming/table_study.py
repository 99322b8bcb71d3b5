"""One table of hypotheses over campaigns that nobody had seen: names, and J and K as quoted.

    python -m analyses.naming.table_study [--part 0 --of 2] [--kinds single/tacho pair/tacho]
        [--rounds 4] [--page]

Each round flies campaigns of all kinds (`kinds.py`), so that a study that is interrupted counts as
far as it came; campaigns whose rows are there are left out. `--part`: of so many processes. Appends
to `results/naming/table_KIND_TACHO.jsonl`, one row a campaign; with --page, writes `table.md`
beside the numbers of the search of version 0.4. Three quarters of an hour a round.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from time import process_time

import numpy as np

from analyses import made_rows, results_of
from analyses.naming.fixed_shape import truth_of
from analyses.naming.kinds import Kind
from analyses.naming.table_page import LAST, write_page
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE

FOLDER = results_of(__file__)
# Campaigns of each kind in a round, spread over its labels; rounds go on from there.
PLAN = {
    "outside/tacho": 6,
    "outside/notacho": 6,
    "stated/tacho": 5,
    "stated/notacho": 5,
    "beside/tacho": 4,
    "pair/tacho": 7,
    "triple/tacho": 5,
    "single/tacho": 10,
    "single/notacho": 7,
    "single_0.9/tacho": 4,
    "clean/tacho": 5,
    "clean/notacho": 4,
    "random/tacho": 4,
    "random/notacho": 3,
    "random_0.9/tacho": 3,
    "random_x3/tacho": 1,
    "random_x10/tacho": 1,
    "random_x30/tacho": 1,
    "strong/tacho": 3,
    "strong/notacho": 2,
    "prior/tacho": 75,
}


def row_of(kind: str, label: str, index: int) -> dict:
    """One campaign simulated and diagnosed."""
    row: dict = {"kind": kind.partition("/")[0], "label": label, "index": index}
    drawn = Kind.of(kind).campaign(label, index)
    if isinstance(drawn, str):
        return row | {"skipped": drawn, "seconds": 0.0}
    row["hidden"], began = list(drawn.hidden), process_time()
    try:
        diagnosis = diagnose(drawn.campaign, seed=index)
        seconds = process_time() - began
        row |= _summary(diagnosis, row["hidden"], truth_of(drawn.flight))
    except BayesInertiaError as error:
        return row | {"error": str(error), "seconds": process_time() - began}
    return row | {"seconds": seconds}


def _summary(diagnosis: Diagnosis, hidden: list[str], truth: np.ndarray) -> dict:
    rows, quoted = diagnosis.hypotheses, quoted_parameters(diagnosis)
    own = [row for row in rows if set(row.effects) == set(hidden) and row.kind == "effects"]
    true_sd = _true_fit(diagnosis, hidden).sd[:N_BASE]
    return {
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "why_unknown": diagnosis.why_unknown,
        "nameless_source": diagnosis.nameless_source,
        "rows": [[row.kind, list(row.effects), row.probability, row.log_evidence] for row in rows],
        "probability_of_truth": sum(row.probability for row in own),
        "quoted_z": ((quoted.mean - truth) / quoted.sd).tolist(),
        "sd_ratio": (quoted.sd / true_sd).tolist(),
        "noise": diagnosis.noise,
    }


def _true_fit(diagnosis: Diagnosis, hidden: list[str]) -> Estimate:
    """The fit of the model that is true; of what the library lacks, the fit as if it were known."""
    base, final = diagnosis.base, diagnosis.final
    true = named_in_library(hidden)
    if {e.name for e in final.effects_fitted} == set(true):
        return final
    known = {e.name for e in base.model.effects}
    missing = tuple(e for e in by_name(true) if e.name not in known)
    if missing:
        old = base.model
        base = move_to(base, Model(old.campaign, (*old.effects, *missing), old.structure.drive))
    space = base.model.space
    free = [np.arange(N_BASE)[np.isin(np.arange(N_BASE), base.free)]]
    theta = base.theta.copy()
    for name in true:
        part = space.slice_of(name)
        free.append(np.arange(part.start, part.stop))
        inset = 1e-2 * space.sd[part]
        theta[part] = np.clip(theta[part], space.lower[part] + inset, space.upper[part] - inset)
    return re_estimate(base, theta, np.concatenate(free))


def named_in_library(hidden: Sequence[str]) -> list[str]:
    """What is hidden and in the library."""
    return [name for name in hidden if not name.startswith("outside")]


def planned(rounds: int) -> Iterator[tuple[str, str, int]]:
    """(kind/tachometers, label, number) of all campaigns, round by round."""
    for r in range(rounds):
        for kind, count in PLAN.items():
            labels = Kind.of(kind).labels
            for k in range(r * count, (r + 1) * count):
                yield kind, labels[k % len(labels)], LAST + k // len(labels)


def main() -> None:
    """Simulate and weigh."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kinds", nargs="+", default=list(PLAN))
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--part", type=int, default=0)
    parser.add_argument("--of", type=int, default=1)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.page:
        write_page(FOLDER)
        return
    wanted = [c for c in planned(options.rounds) if c[0] in options.kinds]
    for kind, label, index in wanted[options.part :: options.of]:
        path = FOLDER / f"table_{kind.replace('/', '_')}.jsonl"
        for row in made_rows(path, [{"label": label, "index": index}], partial(row_of, kind)):
            told = [row.get(key) for key in ("verdict", "named", "ambiguous_with", "error")]
            print(kind, label, index, *told, f"{row['seconds']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
