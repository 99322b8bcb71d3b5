"""How large does the evidence for a random effect become where there is none?

    python analyses/random_null.py --count 150 [--without-tachometers]

Clean campaigns, each of another spacecraft with its own slews and noise. At the fit with nothing
added every effect without a fixed shape is weighed. Its p-value is bounded by Markov's inequality
(one over the Bayes factor); here stands how far below the bound the largest of all Bayes factors
stays. `diagnosis.search` counts these effects in its threshold by that. Rows in
analyses/results/random_null.jsonl are kept: what is there is not computed again. Three seconds of
processor time a campaign.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from diagnosis_campaigns import draw
from scipy import stats

from bayes_inertia.diagnosis.clean_start import clean_start
from bayes_inertia.diagnosis.stochastic_candidates import (
    STOCHASTIC_CANDIDATES,
    stochastic_candidates,
)
from bayes_inertia.files import write_atomically
from bayes_inertia.physics.forward_model import Model

RESULTS = Path(__file__).parent / "results" / "random_null.jsonl"
BOUNDS = (0.3, 0.2, 0.1, 0.05)


def clean_campaign(index: int, tachometers: bool) -> dict:
    """The log Bayes factor of each random effect in one clean campaign."""
    seed = np.random.SeedSequence(777, spawn_key=(index, int(tachometers)))
    campaign = draw(seed, (), {}, tachometers).campaign
    begin = clean_start(Model(campaign), seed=index, stochastic=STOCHASTIC_CANDIDATES)
    weighed = stochastic_candidates(begin.estimate, STOCHASTIC_CANDIDATES, nameless=False)
    evidence = {c.effect: round(c.log_bayes_factor, 4) for c in weighed if c.effect}
    return {"tachometers": tachometers, "index": index, "evidence": evidence}


def page(rows: list[dict]) -> str:
    """The rows in words and one table."""
    lines = [
        "# Evidence for random effects where there is none",
        "",
        "Made by `python analyses/random_null.py`. Clean campaigns of another spacecraft each; the "
        "largest Bayes factor of all effects without a fixed shape. Markov's inequality bounds the "
        "p-value of each by p = 1/B. Counted in full, seven effects may fall below p in 7 p of the "
        "campaigns. Ranges: 95 %, exact binomial.",
        "",
        "| tachometers | campaigns | p | campaigns with 1/B below p | as tests of full size |",
        "|---|---|---|---|---|",
    ]
    for tachometers in (True, False):
        largest = [max(r["evidence"].values()) for r in rows if r["tachometers"] == tachometers]
        if not largest:
            continue
        for p in BOUNDS:
            hits = int(np.sum(np.array(largest) > -np.log(p)))
            low, high = stats.binomtest(hits, len(largest)).proportion_ci(0.95)
            lines.append(
                f"| {'with' if tachometers else 'without'} | {len(largest)} | {p} | {hits} | "
                f"{hits / len(largest) / p:.2f} ({low / p:.2f} to {high / p:.2f}) |"
            )
    return "\n".join([*lines, ""])


def main() -> None:
    """Weigh what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=0)
    parser.add_argument("--without-tachometers", action="store_true")
    options = parser.parse_args()
    rows = [json.loads(x) for x in RESULTS.read_text().splitlines()] if RESULTS.exists() else []
    tachometers = not options.without_tachometers
    done = {row["index"] for row in rows if row["tachometers"] == tachometers}
    for index in (i for i in range(options.count) if i not in done):
        rows.append(clean_campaign(index, tachometers))
        write_atomically(RESULTS, "".join(f"{json.dumps(row)}\n" for row in rows))
    write_atomically(RESULTS.with_suffix(".md"), page(rows))


if __name__ == "__main__":
    main()
