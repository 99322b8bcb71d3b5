"""What `benchmark.py` promises, and its page and picture, from the results of all samplers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from benchmark_samplers import BATCH, LOOP, NUTS, OURS, Result
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


def claims(results: Sequence[Result]) -> list[dict]:
    """What the package promises, and what was measured.

    With and without warm-up: the less favourable for the package is taken.
    """
    by_name = {result.name: result for result in results}
    ours = by_name[OURS]

    def gain(name: str) -> float:
        return min(
            ours.per_second(warmup=w) / by_name[name].per_second(warmup=w) for w in (False, True)
        )

    per_evaluation = min(ours.per_evaluation(warmup=w) for w in (False, True))
    rows = [("effective samples per evaluation", 0.5, per_evaluation)]
    if NUTS in by_name:
        rows.append(("times the effective samples per second of NUTS", 10.0, gain(NUTS)))
    rows += [
        ("times those of the do-it-yourself baseline, slew by slew", 1000.0, gain(LOOP)),
        ("times those of the do-it-yourself baseline, 32 walkers at once", 1000.0, gain(BATCH)),
    ]
    return [
        {
            "claim": claim,
            "wanted": wanted,
            "measured": measured,
            "reached": bool(measured >= wanted),
        }
        for claim, wanted, measured in rows
    ]


def report(results: Sequence[Result], seed: int, seconds: float) -> str:
    """The result as Markdown."""
    lines = [
        "# Effective samples per second",
        "",
        *_INTRODUCTION,
        "",
        f"Made by `python analyses/benchmark.py` (seed {seed}) in {seconds:.0f} processor seconds, "
        "compiling included.",
        "Ratios are to this package; the absolute times are those of one core of one machine.",
        "",
        f"| {' | '.join(_HEADER)} |",
        "|---" * len(_HEADER) + "|",
        *(_sampler_row(result, results[0]) for result in results),
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
    both = (False, True)
    cells = [
        f"{result.milliseconds:.3g}",
        *(f"{result.per_evaluation(warmup=w):.3g}" for w in both),
        *(f"{result.per_second(warmup=w):.3g}" for w in both),
        *(f"{ours.per_second(warmup=w) / result.per_second(warmup=w):,.3g}" for w in both),
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
