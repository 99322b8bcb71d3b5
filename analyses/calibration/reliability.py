"""How reliable the stated probabilities are: of statements made at 90 %, are nine in ten true?

    python -m analyses.calibration.reliability [--rows FILE ...]

Takes rows of `fixed_shape.py` and `stochastic.py` (all of `analyses/results` by default) that
hold the hypotheses of each diagnosis. A statement is one hypothesis of one campaign, with its
probability; it is true if just that is hidden. Draws `figures/diagnosis_reliability.png` and writes
`results/calibration/reliability.md`: shares of true statements by stated probability, with exact
binomial bands of 95 %. Campaigns drawn from the prior that the statements assume
(`stochastic.py --kind prior`) have a table of their own. The temperature of the evidence that
describes the other rows best is fitted to one half of the campaigns. If it is not one, the other
half judges.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import optimize, stats
from scipy.special import logsumexp

from analyses import results_of
from bayes_inertia.files import write_atomically
from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC
from bayes_inertia.report.pictures import style

RESULTS = results_of(__file__)
FIGURES = Path(__file__).parents[2] / "figures"
NAMES = {effect.name for effect in (*LIBRARY, *STOCHASTIC)}
# Bins of the stated probability.
EDGES = np.array([0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.0])
_TEMPERATURES = (1.0, 20.0)
OF_PRIOR = "prior"  # the kind of rows whose campaigns are drawn from it
_MARKERS = ("o", "s")
# Flown by another simulator, and yet an effect of the library since it was written.
_SAME = {"outside_wander": "star_tracker_low_frequency"}


@dataclass(frozen=True)
class Campaign:
    """The hypotheses of one diagnosis: log prior, log evidence, and which of them is true."""

    log_prior: np.ndarray
    log_evidence: np.ndarray
    true: np.ndarray

    def probabilities(self, temperature: float) -> np.ndarray:
        """Probabilities at a temperature of the evidence."""
        weights = self.log_prior + self.log_evidence / temperature
        return np.exp(weights - logsumexp(weights))


def hidden_in(row: Mapping[str, Any]) -> set[str]:
    """Names of what acts in the campaign of a row, of either study."""
    names = row["hidden"] if "hidden" in row else [row["label"]]
    return {_SAME.get(name, name) for name in names if name not in ("clean", "stated")}


def campaign_of(row: Mapping[str, Any]) -> Campaign:
    """The hypotheses of a row and which of them is true.

    >>> row = {"hidden": ["rate_bias"], "hypotheses": [
    ...     {"kind": "nothing", "effects": [], "log_prior": -0.7, "log_evidence": 0.0},
    ...     {"kind": "effects", "effects": ["rate_bias"], "log_prior": -4.0, "log_evidence": 9.0}]}
    >>> campaign_of(row).true.tolist()
    [False, True]
    """
    hidden, rows = hidden_in(row), row["hypotheses"]
    listed = {frozenset(h["effects"]) for h in rows if h["kind"] == "effects"}
    outside = bool(hidden - NAMES)
    truth = {
        "nothing": lambda _: not hidden,
        "nameless": lambda _: outside,
        "others": lambda _: bool(hidden) and not outside and frozenset(hidden) not in listed,
        "effects": lambda h: set(h["effects"]) == hidden,
    }
    return Campaign(
        np.array([h["log_prior"] for h in rows]),
        np.array([h["log_evidence"] for h in rows]),
        np.array([truth[h["kind"]](h) for h in rows]),
    )


def best_temperature(campaigns: Sequence[Campaign]) -> float:
    """The temperature at which the truths are most probable.

    A truth that no hypothesis states counts as one of probability 1e-6.
    """

    def loss(temperature: float) -> float:
        told = [float(c.probabilities(temperature) @ c.true) for c in campaigns]
        return -float(np.sum(np.log(np.maximum(told, 1e-6))))

    return float(optimize.minimize_scalar(loss, bounds=_TEMPERATURES, method="bounded").x)


@dataclass(frozen=True)
class Bin:
    """Statements of about one probability: how many, what was stated, how many are true."""

    count: int
    stated: float
    hits: int

    @property
    def share(self) -> float:
        """Share of true statements."""
        return self.hits / self.count

    @property
    def band(self) -> tuple[float, float]:
        """Its 95 % interval (Clopper and Pearson)."""
        interval = stats.binomtest(self.hits, self.count).proportion_ci(0.95)
        return float(interval.low), float(interval.high)


def reliability(campaigns: Iterable[Campaign], temperature: float = 1.0) -> list[Bin]:
    """Shares of true statements by what was stated; bins without statements are left out."""
    pairs = [(c.probabilities(temperature), c.true) for c in campaigns]
    stated = np.concatenate([p for p, _ in pairs])
    true = np.concatenate([t for _, t in pairs])
    which = np.clip(np.searchsorted(EDGES, stated, side="right") - 1, 0, len(EDGES) - 2)
    return [
        Bin(int(n), float(stated[which == k].mean()), int(true[which == k].sum()))
        for k in range(len(EDGES) - 1)
        if (n := np.count_nonzero(which == k))
    ]


@style.styled
def picture(series: Mapping[str, Sequence[Bin]]) -> Figure:
    """The reliability diagram of several sets of campaigns, by what each is called."""
    figure = Figure(figsize=(5.2, 4.8), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=style.MUTED, lw=1.0)
    for (label, bins), marker in zip(series.items(), _MARKERS, strict=False):
        low, high = np.array([b.band for b in bins]).T
        share = np.array([b.share for b in bins])
        errors = np.clip([share - low, high - share], 0.0, None)
        stated = [b.stated for b in bins]
        axes.errorbar(stated, share, errors, fmt=marker, ms=4, capsize=2, label=label)
    axes.set(xlabel="stated probability", ylabel="share of true statements")
    axes.legend(title="bars: 95 % intervals")
    return figure


def table(bins: Sequence[Bin]) -> list[str]:
    """Rows of a Markdown table."""
    lines = ["| stated, mean | statements | true | 95 % band |", "|---|---|---|---|"]
    for b in bins:
        low, high = b.band
        lines.append(
            f"| {100 * b.stated:.1f} % | {b.count} | {100 * b.share:.1f} % | "
            f"{100 * low:.1f} to {100 * high:.1f} % |"
        )
    return lines


@dataclass(frozen=True)
class Rows:
    """Campaigns drawn from the prior, and those of all other studies."""

    of_prior: list[Campaign]
    others: list[Campaign]


def read(paths: Iterable[Path]) -> Rows:
    """All campaigns of files of rows that hold hypotheses."""
    rows = [json.loads(line) for path in paths for line in path.read_text().splitlines()]
    rows = [row for row in rows if row.get("hypotheses")]
    return Rows(
        [campaign_of(row) for row in rows if row.get("kind") == OF_PRIOR],
        [campaign_of(row) for row in rows if row.get("kind") != OF_PRIOR],
    )


def fitted_temperature(campaigns: Sequence[Campaign]) -> float:
    """The best temperature; exactly one where that is best."""
    temperature = best_temperature(campaigns)
    return temperature if temperature > _TEMPERATURES[0] + 0.01 else _TEMPERATURES[0]


def of_prior_section(bins: Sequence[Bin], count: int) -> list[str]:
    """What campaigns drawn from the prior say."""
    return [
        "## Campaigns drawn from the prior",
        "",
        f"{count} campaigns hide what the statements assume beforehand: nothing in half of them, "
        "one thing in 45 %, several in the rest; any effect of the library, or a disturbance from "
        "outside of it, of any size from what cannot be seen up to the prior's "
        "(`prior_campaigns.py`).",
        "They are fewer than planned. The study was stopped in a campaign with a strong random "
        "torque, which the other simulator flew for minutes: strong ones may be too rare here.",
        "They were judged by the search before the table of hypotheses; more campaigns, judged by "
        "it, are in [table](../naming/table.md).",
        "",
        *table(bins),
        "",
    ]


def page(rows: Rows, bins_of_prior: Sequence[Bin], temperature: float) -> list[str]:
    """The lines of the page."""
    changed = temperature != _TEMPERATURES[0]
    # At a temperature of one nothing was taken from any campaign: all may judge.
    judged = rows.others[1::2] if changed else rows.others
    at_fitted = [
        f"### At temperature {temperature:.2f}",
        "",
        *table(reliability(judged, temperature)),
        "",
    ]
    return [
        "# Are stated probabilities of answers reliable?",
        "",
        "A statement is one answer of one campaign with its probability. Made by "
        "`analyses/calibration/reliability.py`.",
        "",
        *(of_prior_section(bins_of_prior, len(rows.of_prior)) if bins_of_prior else []),
        "## Campaigns of all other studies",
        "",
        f"{len(rows.others)} campaigns. Hidden effects of most of them are as large as an ideal "
        "test finds in 99 %, or larger, and one effect is hidden far more often than several. "
        "The diagnosis cannot know that: it must be cautious here.",
        f"The temperature of the evidence that fits one half of the campaigns best is "
        f"{temperature:.2f} (from {_TEMPERATURES[0]:g}: evidence is never sharpened); the tables "
        f"are of {'the other half' if changed else 'all'}.",
        "114 earlier campaigns with random effects of other sizes are not among them. With those, "
        "34 of 39 statements at 99 % were true; walks of bias and tachometers were mended since.",
        "",
        *table(reliability(judged)),
        "",
        *(at_fitted if changed else []),
        "![Reliability](../../../figures/diagnosis_reliability.png)",
    ]


def main() -> None:
    """Draw and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--rows", type=Path, nargs="+", default=sorted(RESULTS.parent.rglob("*_*.jsonl"))
    )
    rows = read(parser.parse_args().rows)
    if len(rows.others) < 2:
        raise SystemExit("no rows hold hypotheses: run analyses.naming.fixed_shape first")
    bins_of_prior = reliability(rows.of_prior) if rows.of_prior else []
    series = {"other studies": reliability(rows.others)}
    series |= {"drawn from the prior": bins_of_prior} if bins_of_prior else {}
    picture(series).savefig(FIGURES / "diagnosis_reliability.png", dpi=130)
    lines = page(rows, bins_of_prior, fitted_temperature(rows.others[::2]))
    write_atomically(RESULTS / "reliability.md", "\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
