"""What `benchmark.py` promises, its page and its picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from benchmark_history import history_table
from benchmark_samplers import BATCH, DE, LOOP, NUTS, OURS, STRETCH, Result
from matplotlib.figure import Figure

from bayes_inertia.report.pictures.style import BLUE, INK, MUTED, ORANGE, styled

_INTRODUCTION = (
    "The campaign: five simulated slews of a MOST-like spacecraft with telemetry at 2 Hz; "
    "the posterior: J and K, nine parameters.",
    "",
    "Times are processor seconds of this process, so that other work on the machine does not "
    "enter; compiling is not in them, nor is",
    "the optimizer, which gives every sampler its start and scale. "
    "Effective samples are those of the worst parameter, the",
    "smaller of ArviZ's bulk count and emcee's draws over autocorrelation time.",
)
_HEADER = (
    "sampler",
    "ms per evaluation",
    "ESS per evaluation",
    "with warm-up",
    "ESS per second",
    "with warm-up",
    "this package is faster by",
    "with warm-up",
)


_TITLES = (
    "effective samples per posterior evaluation",
    "effective samples per second, relative to this package",
)


# Without and with warm-up.
_BOTH = (False, True)


def claims(results: Sequence[Result]) -> list[dict]:
    """What the package promises, and what was measured.

    With and without warm-up: the less favourable for the package is taken.
    """
    measured = sampler_ratios(results)
    rows = [("effective samples per evaluation", 0.5, measured["ess_per_evaluation"])]
    if "ess_per_second_over_nuts" in measured:
        nuts = measured["ess_per_second_over_nuts"]
        rows.append(("times the effective samples per second of NUTS", 10.0, nuts))
    for words, name in (("slew by slew", LOOP), ("32 walkers at once", BATCH)):
        claim = f"times those of the do-it-yourself baseline, {words}"
        rows.append((claim, 1000.0, _gain(results, name)))
    return [
        {
            "claim": claim,
            "wanted": wanted,
            "measured": measured,
            "reached": bool(measured >= wanted),
        }
        for claim, wanted, measured in rows
    ]


def sampler_ratios(results: Sequence[Result]) -> dict[str, float]:
    """The samplers' columns of the table that remembers."""
    names = {result.name for result in results}
    ratios = {"ess_per_evaluation": min(results[0].per_evaluation(warmup=w) for w in _BOTH)}
    for column, name in (("nuts", NUTS), ("stretch", STRETCH), ("de", DE)):
        if name in names:
            ratios[f"ess_per_second_over_{column}"] = _gain(results, name)
    return ratios


def _gain(results: Sequence[Result], name: str) -> float:
    """Effective samples a second of this package over another sampler."""
    by_name = {result.name: result for result in results}
    ours, other = by_name[OURS], by_name[name]
    return min(ours.per_second(warmup=w) / other.per_second(warmup=w) for w in _BOTH)


def history_page(rows: Sequence[Mapping[str, str]]) -> str:
    """The rows of the table that remembers."""
    lines = [
        "",
        "## Earlier runs",
        "",
        "`benchmark_history.csv` gets a row of ratios with every run of `python "
        "analyses/benchmark.py`; here are the last.",
        "`--check` compares the last two and fails where one became worse by more than 20 %.",
        "A worker's wait for cores that others had is taken off the throughput of workers.",
        "The first two rows are what benchmark.json and evaluation_benchmark.json of then held.",
        "",
        *history_table(rows),
    ]
    return "\n".join(lines) + "\n" if rows else ""


def report(results: Sequence[Result], seed: int) -> str:
    """The result as Markdown."""
    lines = [
        "# Effective samples per second",
        "",
        *_INTRODUCTION,
        "",
        f"Made by `python analyses/benchmark.py` (seed {seed}). Ratios are to this package; the "
        "absolute times are those of one core of one machine.",
        "",
        f"| {' | '.join(_HEADER)} |",
        "|---" * len(_HEADER) + "|",
        *(_sampler_row(result, results[0]) for result in results),
        "",
        "![Effective samples per evaluation and per second](../../figures/benchmark.png)",
        "",
        "How each was run:",
        "",
        *(f"- {r.name}: {r.note}; {r.ess:.0f} effective samples." for r in results),
        "",
        "| promised | wanted | measured | reached |",
        "|---|---|---|---|",
        *(
            f"| {c['claim']} | {c['wanted']:g} | {c['measured']:,.3g} | "
            f"{'yes' if c['reached'] else 'NO'} |"
            for c in claims(results)
        ),
        "",
        "Measured figures are the smaller of those with and without warm-up. "
        "One evaluation is one posterior density, for NUTS one density with its",
        "gradient. The do-it-yourself baseline is treated kindly: "
        "it is given the sampling efficiency of nine dimensions, although its start states,",
        "held at the first readings, do not fit the data and would have to be sampled along.",
        "",
    ]
    return "\n".join(lines)


def _sampler_row(result: Result, ours: Result) -> str:
    cells = [
        f"{result.milliseconds:.3g}",
        *(f"{result.per_evaluation(warmup=w):.3g}" for w in _BOTH),
        *(f"{result.per_second(warmup=w):.3g}" for w in _BOTH),
        *(f"{ours.per_second(warmup=w) / result.per_second(warmup=w):,.3g}" for w in _BOTH),
    ]
    return f"| {result.name} | {' | '.join(cells)} |"


@styled
def picture(results: Sequence[Result]) -> Figure:
    """How many times fewer effective samples others give, on logarithmic bars.

    Left per evaluation, right per second.
    """
    ours = results[0]
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    labels = [r.name.replace(", ", ",\n").replace(": ", ":\n", 1) for r in results]
    y = np.arange(len(results))
    colors = [BLUE, *[ORANGE] * (len(results) - 1)]
    per_evaluation = np.array([r.per_evaluation(warmup=True) for r in results])
    gain = np.array([r.per_second(warmup=True) / ours.per_second(warmup=True) for r in results])
    texts = [f"{v:.2g}" for v in per_evaluation], ["1", *(f"1 / {1 / g:,.0f}" for g in gain[1:])]
    for ax, values, text, title in zip(
        (left, right), (per_evaluation, gain), texts, _TITLES, strict=True
    ):
        floor = 10.0 ** (np.floor(np.log10(values.min())) - 0.5)
        ax.barh(
            y,
            values - floor,
            left=floor,
            color=colors,
            edgecolor=INK,
            lw=0.5,
            hatch=["", *["//"] * (len(results) - 1)],
            height=0.62,
        )
        ax.set_xscale("log")
        ax.set_xlim(floor, values.max() * 12.0)
        ax.grid(axis="x", color=MUTED, alpha=0.25, lw=0.5)
        ax.set_axisbelow(True)
        for k, (value, label) in enumerate(zip(values, text, strict=True)):
            ax.text(value * 1.25, k, label, va="center", color=INK)
        ax.set_title(title)
    left.set_yticks(y, labels)
    left.invert_yaxis()
    return figure
