"""The page of `unmodelled_disturbance.py`: coverage and size of the quoted uncertainties."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from analyses.pages.table import table_lines
from bayes_inertia.files import write_atomically

_LEVEL = 0.90
# Which estimate a quoted sd belongs to, and how the page calls it.
_METHODS = (
    ("stated", "stated", "`sd`, noise as stated"),
    ("usual", "usual", "`sd` of a refused fit (discounted)"),
    ("robust", "usual", "`robust_sd`"),
    ("remainder", "remainder", "`fit --remainder both`, and `diagnose` after `unknown`"),
)


def write_page(rows: Path) -> None:
    """Write `unmodelled_disturbance.md` beside the rows."""
    content = [json.loads(line) for line in rows.read_text().splitlines()]
    write_atomically(rows.with_suffix(".md"), "\n".join(_lines(content)) + "\n")


def coverage_of(rows: Sequence[dict]) -> dict[bool, dict[str, float]]:
    """Share of the 90 % intervals that hold where something is missing, {tachometers: {method}}."""
    hidden = [row for row in rows if row["kind"] != "clean"]
    return {
        half: {
            method: float(
                _inside([r for r in hidden if r["tachometers"] is half], method, e).mean()
            )
            for method, e, _ in _METHODS
        }
        for half in (True, False)
    }


def _lines(rows: Sequence[dict]) -> list[str]:
    clean = [row for row in rows if row["kind"] == "clean"]
    hidden = [row for row in rows if row["kind"] != "clean"]
    seconds = np.array([row["seconds"] for row in rows])
    return [
        "# J and K when an unmodelled disturbance is missing",
        "",
        "Made by `python -m analyses.calibration.unmodelled_disturbance`. Five slews of "
        "another simulator with a",
        "disturbance from outside the library, fitted at the optimum (Laplace approximation).",
        f"{len(hidden)} campaigns with a disturbance, {len(clean)} clean ones. Counted are J",
        "and K, nine numbers a campaign: how often the 90 % interval",
        "holds the truth. The nine are correlated: ranges are of campaigns (bootstrap, 95 %).",
        "",
        *_coverage("With tachometers", [row for row in hidden if row["tachometers"]]),
        *_coverage("Without tachometers", [row for row in hidden if not row["tachometers"]]),
        *_by_kind(hidden),
        *_clean(clean),
        "## Cost",
        "",
        f"A plain estimate {np.median(seconds[:, 0]):.1f} s, one with both remainders "
        f"{np.median(seconds[:, 1]):.1f} s of processor time (medians, on a busy machine).",
    ]


def _z(row: dict, method: str, estimate: str) -> np.ndarray:
    return np.array(row["errors"][estimate]) / np.array(row["sds"][method])


def _inside(rows: Iterable[dict], method: str, estimate: str) -> np.ndarray:
    """Share of the nine whose interval holds the truth, by campaign."""
    limit = stats.norm.isf(0.5 * (1.0 - _LEVEL))
    return np.array([np.mean(np.abs(_z(row, method, estimate)) < limit) for row in rows])


def _range(shares: np.ndarray) -> str:
    """Mean share with its bootstrap interval over campaigns."""
    rng = np.random.default_rng(1)
    means = rng.choice(shares, (2000, len(shares))).mean(1)
    low, high = 100.0 * np.quantile(means, [0.025, 0.975])
    return f"{100.0 * shares.mean():.0f} % ({low:.0f} to {high:.0f})"


def _coverage(title: str, rows: list[dict]) -> list[str]:
    """One row a way to quote an uncertainty."""
    if not rows:
        return []
    stated = np.array([row["sds"]["stated"] for row in rows])
    table = []
    for method, estimate, words in _METHODS:
        z = np.array([_z(row, method, estimate) for row in rows])
        sds = np.array([row["sds"][method] for row in rows])
        table.append(
            [
                words,
                _range(_inside(rows, method, estimate)),
                f"{np.sqrt(np.mean(z**2)):.2f}",
                f"{np.abs(z).max():.1f}",
                f"{np.median(sds / stated):.2f}",
            ]
        )
    columns = ("uncertainty", "90 % intervals hold", "rms z", "largest z", "sd over stated sd")
    return [f"## {title}, {len(rows)} campaigns", "", *table_lines(columns, table), ""]


def _by_kind(rows: list[dict]) -> list[str]:
    """Coverage with and without the remainder, by what was hidden."""
    table = []
    for kind in sorted({row["kind"] for row in rows}):
        of_kind = [row for row in rows if row["kind"] == kind]
        explained = sum(row["explained"][1] for row in of_kind)
        table.append(
            [
                kind.replace("-", " "),
                str(len(of_kind)),
                *(f"{100.0 * _inside(of_kind, m, e).mean():.0f} %" for m, e, _ in _METHODS),
                f"{explained} of {len(of_kind)}",
            ]
        )
    columns = (
        "disturbance",
        "campaigns",
        "stated",
        "discounted",
        "robust",
        "remainder",
        "residuals explained with it",
    )
    return ["## By disturbance, 90 % intervals that hold", "", *table_lines(columns, table), ""]


def _clean(rows: list[dict]) -> list[str]:
    """What the remainder costs where nothing is missing."""
    if not rows:
        return []
    lines = ["## Clean campaigns", ""]
    for tachometers, words in ((True, "with"), (False, "without")):
        half = [row for row in rows if row["tachometers"] is tachometers]
        if half:
            ratio = np.array([row["sds"]["remainder"] for row in half]) / np.array(
                [row["sds"]["stated"] for row in half]
            )
            lines.append(
                f"- {words} tachometers, {len(half)}: the remainder costs "
                f"{100.0 * (np.median(ratio) - 1.0):.0f} % in sd (median of J and K; largest "
                f"{100.0 * (ratio.max() - 1.0):.0f} %); 90 % intervals hold "
                f"{_range(_inside(half, 'remainder', 'remainder'))}, those without it "
                f"{_range(_inside(half, 'stated', 'stated'))}."
            )
    return [*lines, ""]
