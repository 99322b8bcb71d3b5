"""How large does the evidence for a random effect become where there is none?

    python -m analyses.naming.null_distribution --count 150 [--without-tachometers]

Clean campaigns, each of another spacecraft with its own slews and noise. At the fit with nothing
added every stochastic effect is weighed. The p-value of the largest Bayes factor B is
simulated (`diagnosis.random_signals`); beside it stands the bound by Markov's inequality, 1/B.
Rows in results/naming/random_null.jsonl are kept: what is there is not computed again. Five
seconds of processor time a campaign.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy import stats
from scipy.special import logsumexp

from analyses import made_rows, results_of, rows_of
from analyses.naming.fixed_shape_campaigns import draw
from bayes_inertia.diagnosis.clean_start import clean_start
from bayes_inertia.diagnosis.hypothesis_table import log_evidence_of_random
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.random_signals import STOCHASTIC_CANDIDATES, random_members
from bayes_inertia.diagnosis.score_test import random_candidates, with_p_values
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.files import write_atomically
from bayes_inertia.physics.forward_model import Model

RESULTS = results_of(__file__) / "random_null.jsonl"
LEVELS = (0.5, 0.3, 0.2, 0.1, 0.05)


def clean_campaign(index: int, tachometers: bool) -> dict:
    """Log Bayes factors and p-values of the random effects in one clean campaign."""
    seed = np.random.SeedSequence(777, spawn_key=(index, int(tachometers)))
    campaign = draw(seed, (), {}, tachometers).campaign
    begin = clean_start(Model(campaign), seed=index)
    response, effects = torque_response(begin.base), STOCHASTIC_CANDIDATES
    linear = linear_model(begin.base)
    members = random_members(linear, response, effects, nameless=False)
    alone = {frozenset([m.name]): float(logsumexp(log_evidence_of_random(m))) for m in members}
    weighed = random_candidates(members, alone)
    weighed = with_p_values(weighed, members, np.random.default_rng(index))
    evidence = {c.effect: round(c.log_bayes_factor, 4) for c in weighed}
    p_value = round(max(weighed, key=lambda c: c.log_bayes_factor).p_value, 5)
    return {"tachometers": tachometers, "index": index, "evidence": evidence, "p_value": p_value}


def page(rows: list[dict]) -> str:
    """The rows in words and one table."""
    lines = [
        "# P-values of random effects where there is none",
        "",
        "Made by `python -m analyses.naming.null_distribution`. Clean campaigns of another "
        "spacecraft each; the "
        "largest Bayes factor B of all stochastic effects. Its p-value is simulated for "
        "each campaign. If that is right, a share p of the campaigns is below p. Markov's "
        "inequality bounds it by 1/B. Ranges: 95 %, exact binomial.",
        "",
        "| tachometers | campaigns | p | simulated p-value below p | 1/B below p |",
        "|---|---|---|---|---|",
    ]
    for tachometers in (True, False):
        some = [row for row in rows if row["tachometers"] == tachometers]
        simulated = np.array([row["p_value"] for row in some])
        bound = np.exp([-max(row["evidence"].values()) for row in some])
        for p in LEVELS if some else ():
            told = " | ".join(_share(values < p) for values in (simulated, bound))
            lines.append(f"| {'with' if tachometers else 'without'} | {len(some)} | {p} | {told} |")
    return "\n".join([*lines, ""])


def _share(below: np.ndarray) -> str:
    count = int(below.sum())
    low, high = stats.binomtest(count, len(below)).proportion_ci(0.95)
    return f"{count / len(below):.2f} ({low:.2f} to {high:.2f})"


def main() -> None:
    """Weigh what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=0)
    parser.add_argument("--without-tachometers", action="store_true")
    options = parser.parse_args()
    tachometers = not options.without_tachometers
    cases = ({"index": index, "tachometers": tachometers} for index in range(options.count))
    for row in made_rows(RESULTS, cases, clean_campaign):
        print(row["index"], flush=True)
    write_atomically(RESULTS.with_suffix(".md"), page(rows_of(RESULTS)))


if __name__ == "__main__":
    main()
