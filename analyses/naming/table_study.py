"""One table of hypotheses over campaigns that nobody had seen: names, and J and K as quoted.

    python -m analyses.naming.table_study [--part 0 --of 2] [--kinds single/tacho pair/tacho]
        [--rounds 8] [--page]

Kinds are those of `fixed_shape.py` (clean, single, strong, pair, triple) and of `stochastic.py`
(`outside`, `random`, `random_x10`, `stated`, `prior`); numbers begin far beyond those studies:
the code had seen none. Each round flies campaigns of all kinds, so that a study that is interrupted
counts as far as it came; campaigns whose rows are there are left out. `--part`: of so many
processes. Appends to `results/naming/table_KIND_TACHO.jsonl`, one row a campaign; with --page,
writes `table.md` beside the numbers of the search of version 0.4. About an hour and a half of
processor time.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from time import process_time

import numpy as np

from analyses import made_rows
from analyses.naming.fixed_shape import (
    FOLDER,
    NAMES,
    RULES,
    Case,
    hidden_in,
    tasks,
    truth_of,
    why_skipped,
)
from analyses.naming.fixed_shape_campaigns import draw
from analyses.naming.physical_limits import why_not_flown
from analyses.naming.stochastic import NamedOrNot, labels
from analyses.naming.table_page import LAST, write_page
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE
from bayes_inertia.studies.work import task_seed

FIXED_KINDS = ("clean", "single", "strong", "pair", "triple")
POWER = 0.99
LEVEL = RULES.false_alarm_probability / len(NAMES)
LISTED = 8  # rows of a table that are kept
# Campaigns of each kind in a round, spread over its labels; rounds go on from there.
PLAN = {
    "clean/tacho": 5,
    "clean/notacho": 4,
    "single/tacho": 14,
    "single/notacho": 10,
    "pair/tacho": 5,
    "triple/tacho": 3,
    "random/tacho": 4,
    "random/notacho": 2,
    "outside/tacho": 3,
    "strong/tacho": 4,
    "strong/notacho": 3,
    "random_x10/tacho": 1,
    "stated/tacho": 3,
}


def campaign_of(
    kind: str, label: str, index: int, tachometers: bool
) -> tuple[Campaign, list[str], np.ndarray]:
    """The campaign of a number, what is hidden in it, and J and K."""
    if kind not in FIXED_KINDS:
        base, _, times = kind.partition("_x")
        task = NamedOrNot(base, tachometers, POWER, float(times or 1.0))
        drawn = task._drawn(label, task_seed(0, f"{label}/{index}"))
        hidden = [] if kind in ("clean", "stated") else list(drawn.hidden)
        return drawn.campaign, hidden, truth_of(drawn.flight)
    (effects,) = (e for name, i, e in tasks(kind, index + 1) if (name, i) == (label, index))
    case = Case(kind, label, index, effects, tachometers)
    sizes = hidden_in(case, POWER, LEVEL).values
    flight = draw(case.seed, case.effects, sizes, tachometers)
    return flight.campaign, case.hidden, truth_of(flight)


def _why_skipped(kind: str, label: str, index: int, tachometers: bool) -> str:
    """Why an effect is not flown at that size; empty if it is."""
    if kind != "strong":
        return ""
    (effects,) = (e for name, i, e in tasks(kind, index + 1) if (name, i) == (label, index))
    case = Case(kind, label, index, effects, tachometers)
    hidden = hidden_in(case, POWER, LEVEL)
    flight = draw(case.seed, case.effects, hidden.values, tachometers)
    return why_skipped(case, hidden) or why_not_flown(flight) or ""


def row_of(kind: str, label: str, index: int, tachometers: bool) -> dict:
    """One campaign simulated and diagnosed."""
    row: dict = {"kind": kind, "label": label, "index": index}
    if reason := _why_skipped(kind, label, index, tachometers):
        return row | {"skipped": reason, "seconds": 0.0}
    campaign, hidden, truth = campaign_of(kind, label, index, tachometers)
    row["hidden"] = hidden
    began = process_time()
    try:
        diagnosis = diagnose(campaign, seed=index)
        seconds = process_time() - began
        row |= _summary(diagnosis, hidden, truth)
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
        "rows": [
            [row.kind, list(row.effects), row.probability, row.log_evidence]
            for row in rows[:LISTED]
        ],
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
        for of_kind, count in PLAN.items():
            kind, measured = of_kind.split("/")
            names = all_labels(kind, measured == "tacho")
            for k in range(r * count, (r + 1) * count):
                yield of_kind, names[k % len(names)], LAST + k // len(names)


def all_labels(kind: str, tachometers: bool) -> list[str]:
    """Labels of the campaigns of a kind."""
    if kind in FIXED_KINDS:
        return list(dict.fromkeys(label for label, *_ in tasks(kind, 1)))
    return list(labels(kind.partition("_x")[0], tachometers))


def main() -> None:
    """Simulate and weigh."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kinds", nargs="+", default=list(PLAN))
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--part", type=int, default=0)
    parser.add_argument("--of", type=int, default=1)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.page:
        write_page(FOLDER)
        return
    wanted = [c for c in planned(options.rounds) if c[0] in options.kinds]
    for of_kind, label, index in wanted[options.part :: options.of]:
        kind, measured = of_kind.split("/")
        path = FOLDER / f"table_{kind}_{measured}.jsonl"
        case = {"label": label, "index": index}
        fly = partial(row_of, kind, tachometers=measured == "tacho")
        for row in made_rows(path, [case], fly):
            told = [row.get(key) for key in ("verdict", "named", "ambiguous_with", "error")]
            print(of_kind, label, index, *told, f"{row['seconds']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
