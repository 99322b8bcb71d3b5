"""The page and the picture of `ranks.py`, from the table of all fits."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from analyses.calibration.rank_statistics import (
    LEVELS,
    RANKED,
    RANKS,
    band,
    coverage,
    departure,
    scores,
    uniformity,
)
from bayes_inertia.report.pictures.style import COLORS, DASHES, INK, MUTED, PALE, styled

_CONTROLS = "errors put in"


@styled
def picture(table: pd.DataFrame) -> Figure:
    """ECDFs of the ranks minus that of uniform ones with their simultaneous 95 % band.

    Deliberate errors on the right.
    """
    names = list(dict.fromkeys(table.study))
    figure = Figure(figsize=(10.0, 2.7 * len(names) + 0.5), layout="constrained")
    axes = figure.subplots(len(names), 3, sharex=True, squeeze=False)
    for row, study in zip(axes, names, strict=True):
        _study_row(row, study, table[table.study == study])
    for ax in axes[-1]:
        ax.set_xlabel("rank of the truth / number of draws")
    return figure


def _study_row(row: np.ndarray, study: str, fits: pd.DataFrame) -> None:
    """The three panels of one study: J, K, deliberate errors."""
    x = np.arange(1, RANKED + 1) / (RANKED + 1)
    n = fits.campaign.nunique()
    error = np.sqrt(x * (1.0 - x) / n)
    half_width = band(n, 0.95 ** (1 / fits.parameter.nunique())) * error
    parameters = fits.parameter.unique()
    panels = (
        ("J", [(name, "rank", name) for name in parameters if name[0] == "J"]),
        ("K", [(name, "rank", name) for name in parameters if name[0] == "K"]),
        (_CONTROLS, _control_lines(fits)),
    )
    for ax, (title, lines) in zip(row, panels, strict=True):
        label = "95 % band of all nine" if title == "J" else None
        ax.fill_between(x, -half_width, half_width, color=PALE, lw=0, label=label)
        ax.axhline(0.0, color=MUTED, lw=0.6)
        for k, (parameter, key, label) in enumerate(lines):
            ranks = fits[fits.parameter == parameter][key].to_numpy()
            ax.plot(x, departure(ranks) * error, color=COLORS[k], ls=DASHES[k], label=label)
        ax.set_title(f"{study}, {n} campaigns: {title}", color=INK)
        corner = "lower left" if title != _CONTROLS else "upper right"
        ax.legend(ncols=2, fontsize=7.0, loc=corner)
    row[0].set_ylabel("ECDF of rank minus uniform")
    for ax in row[:2]:
        ax.set_ylim(-1.9 * half_width.max(), 1.9 * half_width.max())
    row[2].set_ylim(top=1.9 * row[2].get_ylim()[1])


def _control_lines(fits: pd.DataFrame) -> list[tuple[str, str, str]]:
    labels = {"rank_shrunk": "sd × 0.8", "rank_held": "starts held"}
    parameters = [p for p in ("Jxx", "Jyz", "K1") if p in set(fits.parameter)]
    return [(p, key, f"{p}, {label}") for key, label in labels.items() for p in parameters]


def report(table: pd.DataFrame, seconds: float | None, descriptions: Mapping[str, str]) -> str:
    """The result as Markdown; `descriptions` by study."""
    lines = [
        "# Calibration of J and K over simulated campaigns",
        "",
        *_introduction(table, seconds, descriptions),
        "",
        *_rank_lines(table),
        "",
        *_score_lines(table),
        "",
        *_overall(table),
        "",
        *_coverage_lines(table),
        "",
    ]
    return "\n".join(lines)


def _rank_lines(table: pd.DataFrame) -> list[str]:
    lines = [
        "## Ranks",
        "",
        "Largest departure of the rank's ECDF from uniform over the nine parameters, in standard "
        "errors, and the simultaneous",
        "95 % band for nine parameters; the last two rows of each study are deliberate errors that "
        "the test must notice.",
        "",
        "| study | ranks among | largest | band | parameters outside | verdict |",
        "|---|---|---|---|---|---|",
    ]
    for (study, key), group in uniformity(table).groupby(["study", "ranks"], sort=False):
        outside = ", ".join(group[group.leaves].parameter) or "none"
        verdict = "leaves the band" if group.leaves.any() else "inside the band"
        lines.append(
            f"| {study} | {RANKS[key]} | {group.largest.max():.2f} | {group.band.iloc[0]:.2f} | "
            f"{outside} | {verdict} |"
        )
    return lines


def _score_lines(table: pd.DataFrame) -> list[str]:
    lines = [
        "## Standardised errors z = (truth - mean) / sd",
        "",
        "| study | parameter | mean z | sd z | contraction |",
        "|---|---|---|---|---|",
    ]
    for _, row in scores(table).iterrows():
        n = table[table.study == row.study].campaign.nunique()
        lines.append(
            f"| {row.study} | {row.parameter} | {row.mean_z:+.3f} ± {1 / math.sqrt(n):.3f} | "
            f"{row.sd_z:.3f} ± {1 / math.sqrt(2 * n):.3f} | {row.contraction:.3f} |"
        )
    return lines


def _coverage_lines(table: pd.DataFrame) -> list[str]:
    covered = coverage(table)
    columns = " | ".join(
        f"{100 * level:g} %, {kind}" for level in LEVELS for kind in ("sd", "quantiles")
    )
    lines = [
        "## Coverage",
        "",
        "Share of campaigns whose interval contains the truth, in %, with its 95 % binomial "
        "interval.",
        "",
        f"| study | parameter | {columns} |",
        "|---" * 8 + "|",
    ]
    for (study, parameter), group in covered.groupby(["study", "parameter"], sort=False):
        cells = [
            f"{100 * row.share:.1f} [{100 * row.low:.1f}, {100 * row.high:.1f}]"
            for _, row in group.iterrows()
        ]
        lines.append(f"| {study} | {parameter} | {' | '.join(cells)} |")
    outside = covered[(covered.level < covered.low) | (covered.level > covered.high)]
    return [
        *lines,
        "",
        f"{len(outside)} of {len(covered)} binomial intervals miss their level (5 % of them would "
        "by chance; those of one parameter are alike).",
    ]


def _overall(table: pd.DataFrame) -> list[str]:
    """Mean z^2 over all parameters.

    Its standard error treats a campaign's nine errors as one number.
    """
    lines = []
    for study, group in table.assign(
        square=((table.truth - table["mean"]) / table.sd) ** 2
    ).groupby("study", sort=False):
        by_campaign = group.groupby("campaign").square.mean()
        error = by_campaign.std() / math.sqrt(len(by_campaign))
        lines.append(
            f"All nine parameters together, {study}: "
            f"mean z² = {by_campaign.mean():.3f} ± {error:.3f} (1 if sd is right)."
        )
    return lines


def _introduction(
    table: pd.DataFrame, seconds: float | None, descriptions: Mapping[str, str]
) -> list[str]:
    lines = [
        "Truth (J, K, rate bias) drawn from the prior, slews of 20 to 60 degrees with random "
        "senses and start attitudes flown in closed loop with noise at",
        "1 Hz telemetry, each campaign fitted in full (three starts of the optimizer, sampling in "
        "two ensembles of 64 walkers); the truth is ranked among",
        f"{RANKED} nearly independent draws. Made by `python -m analyses.calibration.ranks`.",
        "",
    ]
    for name, group in table.groupby("study", sort=False):
        fits = group.groupby("campaign").first()
        passed = stats.binomtest(int(fits.explained.sum()), len(fits)).proportion_ci(0.95)
        lines.append(
            f"- {name} ({descriptions[name]}): {len(fits)} campaigns; "
            f'the gate "explained" passes in {100 * fits.explained.mean():.1f} % '
            f"[{100 * passed.low:.1f}, {100 * passed.high:.1f}] of these perfect fits; "
            f"reduced chi² {fits.reduced_chi2.mean():.4f} on average; "
            f"nested R-hat of these short runs at most {fits.nested_rhat.max():.3f}."
        )
    if seconds is not None:
        lines += ["", f"This run took {seconds / 60:.1f} minutes on one core."]
    return lines
