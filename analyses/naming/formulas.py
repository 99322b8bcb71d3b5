"""Laws outside the library, flown by another simulator: does a diagnosis find the formula?

    python -m analyses.naming.formulas --seeds 1 2 --times 1 3 [--laws "quadratic drag"]
    python -m analyses.naming.formulas --seeds 1 --times 1 --alone
    python -m analyses.naming.formulas --page

A law is as strong as an ideal test, which knows it, finds in 99 % of campaigns at the level of one
library effect, times 1, 3, ... The size comes from two flights of the second simulator with the
same noise, with and without the law; what a fit moves is projected off their difference. Appends to
`results/naming/formulas.jsonl`, a line a campaign; goes on where it stopped; with --page, writes
`formulas.md`. With --alone, what can be expected: formulas are weighed against nothing alone, as if
no effect of the library were possible (`formulas_alone.jsonl`).
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from dataclasses import replace
from time import process_time

import numpy as np

from analyses import made_rows, results_of, rows_of
from analyses.naming.fixed_shape import NAMES, RULES, hash_of, quoted_z, truth_of
from analyses.naming.fixed_shape_campaigns import draw, noncentrality
from analyses.naming.formula_laws import LAWS, Lawful
from analyses.naming.second_simulator import replayed
from analyses.pages.table import table_lines
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.diagnosis.clean_start import clean_start
from bayes_inertia.diagnosis.formulas import search_formulas
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.effects.formula import Formula
from bayes_inertia.physics.forward_model import Model

FOLDER = results_of(__file__)
ROWS, ALONE = FOLDER / "formulas.jsonl", FOLDER / "formulas_alone.jsonl"
POWER, LEVEL = 0.99, RULES.false_alarm_probability / len(NAMES)
_KEY = 44_06


def size_of(flown: Callable[[float], Campaign], power: float = POWER) -> float:
    """Size of a disturbance at which the ideal test has a power, by flights of any size."""
    fit = estimate(Model(flown(0.0)), starts=1)
    still = fit.linearised()
    other = Model(flown(1.0))
    moved = replace(fit, model=other).linearised().residual - still.residual
    imitated = still.imitated(moved[..., None])[:, 0]
    seen = float(np.sum(moved**2) - imitated @ imitated)
    return float(np.sqrt(noncentrality(power, 1, LEVEL) / seen))


def flown_law(law: str, seed: int, times: float) -> tuple[Flight, Campaign, float]:
    """A campaign with a law; how it was flown, and the law's size."""
    draws = np.random.SeedSequence(_KEY, spawn_key=(hash_of(law), seed))
    flight = draw(draws, (), {}, True)

    def flown(size: float) -> Campaign:
        return replayed(flight, Lawful(size, law), np.random.default_rng(seed))

    size = times * size_of(flown)
    return flight, flown(size), size


def row_of(law: str, seed: int, times: float) -> dict:
    """One campaign simulated and diagnosed."""
    flight, campaign, size = flown_law(law, seed, times)
    began = process_time()
    diagnosis = diagnose(campaign, seed=seed)
    seconds = process_time() - began
    return {
        "law": law,
        "seed": seed,
        "times": times,
        "size": size,
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "formulas": _listed(diagnosis),
        "quoted_z": quoted_z(diagnosis, truth_of(flight)).tolist(),
        "seconds": seconds,
    }


def alone(law: str, seed: int, times: float) -> dict:
    """One campaign simulated, formulas weighed against nothing alone."""
    campaign = flown_law(law, seed, times)[1]
    begin = clean_start(Model(campaign, candidate_effects(campaign, LIBRARY).linear), seed=seed)
    search = search_formulas(torque_response(begin.base), linear_model(begin.base))
    terms = [(term.formula.name, term.log_weight) for term in search.terms]
    right = next(k for k, (name, _) in enumerate(terms) if is_right(name, law))
    return {
        "law": law,
        "seed": seed,
        "times": times,
        "terms": len(terms),
        "rank": right,
        "log_weight": terms[right][1],
        "log_weight_of_best": terms[0][1],
    }


def is_clear(row: dict) -> bool:
    """Whether the right formula is clear: against nothing, and not far behind another."""
    margin = RULES.log_evidence_margin
    return row["log_weight"] > max(margin, row["log_weight_of_best"] - margin)


def _listed(diagnosis: Diagnosis) -> list[str]:
    """Formulas that a diagnosis reports, the best first."""
    search = diagnosis.formulas
    if search is None:
        return []
    return [term.formula.name for term in search.equals(RULES.log_evidence_margin)]


def is_right(name: str, law: str) -> bool:
    """Whether a formula acts where the law does, in proportion to what the law follows."""
    formula, truth = Formula.of_name(name), LAWS[law]
    return formula.place == truth.place and formula.driver in (truth.driver, *truth.also)


def outcome(row: dict) -> str:
    """What a diagnosis says of a law."""
    named = [name for name in row["named"] if name.startswith("formula_")]
    right = any(is_right(name, row["law"]) for name in row["formulas"])
    if row["verdict"] == "formula":
        first = any(is_right(name, row["law"]) for name in named)
        return "formula" if first else "equal" if right else "false formula"
    if right:
        return "may be"
    if row["formulas"]:
        return "may be another"
    return "nothing" if row["verdict"] == "consistent" else row["verdict"]


OUTCOMES = {
    "formula": "the right formula",
    "equal": "a formula that explains the data as well, the right one listed beside it",
    "may be": "something without a name may be it; the right formula is listed",
    "may be another": "something without a name may be it; other formulas are listed",
    "false formula": "a wrong formula, the right one not listed",
    "named": "effects of the library alone",
    "ambiguous": "a set of effects of the library",
    "partial": "something has no name, beside effects of the library",
    "unknown": "something has no name",
    "nothing": "nothing is missing",
}


def page() -> str:
    """The page of all rows."""
    rows = rows_of(ROWS)
    strengths = sorted({row["times"] for row in rows})
    counts = {t: [outcome(r) for r in rows if r["times"] == t] for t in strengths}
    held = [abs(z) < 1.645 for row in rows for z in row["quoted_z"]]
    head = ["answer", *(f"{t:g} times" for t in strengths)]
    of_all = ["campaigns", *(str(len(counts[t])) for t in strengths)]
    body = [[text, *(str(counts[t].count(k)) for t in strengths)] for k, text in OUTCOMES.items()]
    each = [[law, *(_outcomes(rows, law, t) for t in strengths)] for law in LAWS]
    lines = [
        "# Laws outside the library",
        "",
        "Made by `python -m analyses.naming.formulas`. Each law was flown by another simulator, as",
        "strong as an ideal test that knows it finds in 99 % of campaigns, times 1, 3, ...",
        "",
        *table_lines(head, [of_all, *body]),
        "",
        _of_alone(),
        "",
        f"90 % intervals of J and K hold in {np.mean(held):.0%} of {len(held)}.",
        "",
        *table_lines(["law", *head[1:]], each),
        "",
    ]
    return "\n".join(lines)


def _of_alone() -> str:
    """What can be expected of a search that knows of no effect of the library."""
    rows = [row for row in rows_of(ALONE) if row["times"] == 1.0]
    clear = sum(map(is_clear, rows))
    return "\n".join(
        [
            "What can be expected at 1 times: weighed against nothing alone, among",
            f"{rows[0]['terms']:,} formulas or so, the right one is twenty times as probable as",
            f"nothing, and no other twenty times as probable as it, in {clear} of {len(rows)}.",
            "The ideal test asks about one law; who does not know which law it is looks for one of",
            "hundreds.",
        ]
    )


def _outcomes(rows: list[dict], law: str, times: float) -> str:
    found = [outcome(r) for r in rows if r["law"] == law and r["times"] == times]
    return ", ".join(found) or "not flown"


def main() -> None:
    """Fly and diagnose."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--laws", nargs="+", default=list(LAWS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[])
    parser.add_argument("--times", nargs="+", type=float, default=[1.0])
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    wanted = itertools.product(options.seeds, options.times, options.laws)
    cases = (dict(zip(("seed", "times", "law"), case, strict=True)) for case in wanted)
    file, of_case = (ALONE, alone) if options.alone else (ROWS, row_of)
    for row in made_rows(file, cases, of_case):
        told = row["law"], row["seed"], row["times"], row["rank"] if options.alone else outcome(row)
        print(*told, flush=True)
    if options.page:
        write_atomically(FOLDER / "formulas.md", page())


if __name__ == "__main__":
    main()
