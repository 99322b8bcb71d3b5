"""How reliable the stated probabilities are: of statements made at 90 %, are nine in ten true?

    python -m analyses.calibration.reliability

Takes the rows of `table_study.py`. A statement is one row of the table of hypotheses of one
campaign, with its probability; it is true if just that is hidden. Draws
`figures/diagnosis_reliability.png` and writes `results/calibration/reliability.md`: shares of true
statements by stated probability, with exact binomial bands of 95 %. Campaigns drawn from the prior
that the statements assume have a table of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from analyses import results_of
from analyses.naming import table_page
from bayes_inertia.files import write_atomically
from bayes_inertia.report.pictures import style

RESULTS = results_of(__file__)
FIGURES = Path(__file__).parents[2] / "figures"
_MARKERS = ("o", "s")


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


def reliability(rows: Sequence[table_page.Row]) -> list[Bin]:
    """Shares of true statements by what was stated; bins without statements are left out.

    >>> told = [["nothing", [], 0.95, 0.0], ["effects", ["rate_bias"], 0.05, -3.0]]
    >>> reliability([{"hidden": [], "rows": told}])
    [Bin(count=1, stated=0.05, hits=0), Bin(count=1, stated=0.95, hits=1)]
    """
    return [
        Bin(len(some), float(np.mean([x["p"] for x in some])), sum(x["true"] for x in some))
        for _, _, some in table_page.by_probability(rows)
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


def table(bins: Iterable[Bin]) -> list[str]:
    """Rows of a Markdown table."""
    lines = ["| stated, mean | statements | true | 95 % band |", "|---|---|---|---|"]
    for b in bins:
        low, high = b.band
        lines.append(
            f"| {100 * b.stated:.1f} % | {b.count} | {100 * b.share:.1f} % | "
            f"{100 * low:.1f} to {100 * high:.1f} % |"
        )
    return lines


def page(of_prior: Sequence[table_page.Row], others: Sequence[table_page.Row]) -> list[str]:
    """The lines of the page."""
    return [
        "# Are stated probabilities of answers reliable?",
        "",
        "A statement is one answer of one campaign, a row of its table of hypotheses, with its "
        "probability. Made by `analyses/calibration/reliability.py` of the campaigns of "
        "[table](../naming/table.md). Where the residuals fit no answer, a report says that the "
        "probabilities only compare answers with each other: such campaigns make no statement.",
        "",
        "## Campaigns drawn from the prior",
        "",
        f"{len(of_prior)} campaigns hide what the statements assume beforehand, of any size from "
        f"what cannot be seen up to the prior's. {table_page.misfits(of_prior)} make no statement.",
        "",
        *table(reliability(of_prior)),
        "",
        "## Campaigns of all other kinds",
        "",
        f"{len(others)} campaigns, of which {table_page.misfits(others)} make no statement. "
        "Hidden effects of most of them are as large as an ideal test "
        "finds in 99 %, or larger, and one effect is hidden far more often than several. The "
        "diagnosis cannot know that: it must be cautious here.",
        "",
        *table(reliability(others)),
        "",
        "![Reliability](../../../figures/diagnosis_reliability.png)",
    ]


def main() -> None:
    """Draw and write."""
    of_prior, others = table_page.of_prior_and_others(RESULTS.parent / "naming")
    series = {"drawn from the prior": of_prior, "other campaigns": others}
    drawn = picture({label: reliability(rows) for label, rows in series.items()})
    drawn.savefig(FIGURES / "diagnosis_reliability.png", dpi=130)
    lines = page(of_prior, others)
    write_atomically(RESULTS / "reliability.md", "\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
