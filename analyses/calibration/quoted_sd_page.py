"""The page and the figure of `quoted_sd.py`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from bayes_inertia.files import write_atomically
from bayes_inertia.report.pictures import style

_HALF = float(stats.norm.isf(0.05))  # half width of a 90 % interval [sd]
_CLASSES = {
    "clean": "clean, five slews",
    "designed": "clean, designed slews",
    "weak-library": "weak effect of the library",
    "weak-outside": "weak, outside the library",
    "dirty": "dirt in the telemetry",
    "refused": "refused",
}
_SHORT = ("clean", "designed", "weak,\nlibrary", "weak,\noutside", "dirt", "refused")
_Candidate = tuple[str, Callable[[dict], np.ndarray]]


def _of(row: dict, key: str) -> np.ndarray:
    return np.array(row[key])


# Name and half width (9,) of the 90 % interval, from a row.
CANDIDATES: tuple[_Candidate, ...] = (
    ("`sd` of the model", lambda r: _HALF * _of(r, "sd")),
    ("version 0.4: larger of `sd` and `hc3_sd`", lambda r: _HALF * _of(r, "robust_sd")),
    ("`hc3_sd` (jackknife)", lambda r: _HALF * _of(r, "hc3_sd")),
    (
        "`cr2_sd`, Satterthwaite's degrees of freedom",
        lambda r: stats.t.isf(0.05, _of(r, "cr2_dof")) * _of(r, "cr2_sd"),
    ),
    (
        "`sd`, one dispersion, always",
        lambda r: _HALF * _of(r, "sd") * np.sqrt(max(1.0, r["dispersion"]["ratio"])),
    ),
    (
        "`sd`, one dispersion where slews disagree",
        lambda r: _HALF * _of(r, "sd") * r["dispersion"]["factor"],
    ),
    ("averaged over undetected effects", lambda r: _HALF * _of(r, "averaged_sd")),
    (
        "**`quoted_sd`**: both",
        lambda r: _HALF * _of(r, "averaged_sd") * r["dispersion"]["factor"],
    ),
)


def write_page(results: Path) -> None:
    """Write `quoted_sd.md` beside the results, and `figures/quoted_sd.png`."""
    rows = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    rows = [row for row in rows if "error" in row and isinstance(row["error"], list)]
    text = "\n".join([*_HEAD, *_table(rows), *_refused(rows), *_TAIL])
    write_atomically(results.with_suffix(".md"), text)
    folder = results.parents[3] / "figures"
    figure = _draw(rows)
    write_atomically(
        folder / "quoted_sd.png",
        lambda path: figure.savefig(path, dpi=150, metadata={"Software": None}),
    )


def held(name: str, width: Callable[[dict], np.ndarray], rows: list[dict]) -> np.ndarray:
    """Whether the intervals (rows, 9) hold the truth."""
    centred = "averaged" in name or "quoted" in name
    error = np.array([row["averaged_error" if centred else "error"] for row in rows])
    return np.abs(error) <= np.array([width(row) for row in rows])


def _halves(rows: list[dict], kind: str) -> list[list[dict]]:
    return [
        [row for row in rows if row["kind"] == kind and row["tachometers"] == half]
        for half in (True, False)
    ]


def _table(rows: list[dict]) -> list[str]:
    lines = []
    for half, title in enumerate(("With tachometers", "Without tachometers")):
        groups = {kind: _halves(rows, kind)[half] for kind in _CLASSES}
        lines += [f"## {title}", ""]
        heads = [f"{_CLASSES[kind]} ({len(own)})" for kind, own in groups.items()]
        lines += [f"| 90 % interval | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
        for name, width in CANDIDATES:
            cells = [_cell(name, width, own) for own in groups.values()]
            lines.append(f"| {name} | {' | '.join(cells)} |")
        lines.append("")
    return lines


def _cell(name: str, width: Callable[[dict], np.ndarray], rows: list[dict]) -> str:
    if not rows:
        return "–"
    share = held(name, width, rows).mean(1)
    rng = np.random.default_rng(5)
    again = share[rng.integers(len(share), size=(2000, len(share)))].mean(1)
    low, high = np.quantile(again, [0.025, 0.975])
    wide = np.mean([width(row) / (_HALF * _of(row, "sd")) for row in rows])
    return f"{100 * share.mean():.0f} % ({100 * low:.0f} to {100 * high:.0f}), {wide:.2f}"


def _refused(rows: list[dict]) -> list[str]:
    kinds = {kind: [r for r in rows if r["kind"] == kind] for kind in _CLASSES}
    said = [
        f"{_CLASSES[kind]} {sum(not r['trusted'] for r in own)} of {len(own)}"
        for kind, own in kinds.items()
    ]
    return [f"Refused by the gates: {', '.join(said)}.", ""]


def _draw(rows: list[dict]) -> Figure:
    """Coverage of four uncertainties in each class, with and without tachometers."""
    shown = [CANDIDATES[i] for i in (0, 1, 3, 7)]
    labels = ("model's sd", "version 0.4", "CR2, Satterthwaite", "quoted sd")
    colors = (style.MUTED, style.ORANGE, "white", style.BLUE)
    figure, cells = style.grid(
        3.2, 1, 2, left=0.75, right=0.1, top=0.75, bottom=0.55, gap_x=0.35, gap_y=0.1
    )
    for half, (cell, title) in enumerate(
        zip(cells, ("with tachometers", "without tachometers"), strict=True)
    ):
        axes = figure.add_axes(cell)
        axes.axhspan(88, 92, color=style.PALE, lw=0)
        for k, ((name, width), color) in enumerate(zip(shown, colors, strict=True)):
            share = [
                100 * held(name, width, own).mean()
                if (own := _halves(rows, kind)[half])
                else np.nan
                for kind in _CLASSES
            ]
            axes.plot(
                np.arange(len(_CLASSES)) + 0.12 * (k - 1.5),
                share,
                "osD^"[k],
                color=color,
                mec=style.INK,
                mew=0.5,
                label=labels[k],
            )
        axes.set(ylim=(50, 101), title=title)
        axes.set_xticks(range(len(_CLASSES)), _SHORT)
        if half == 0:
            axes.set_ylabel("90 % intervals that\nhold the truth [%]")
            figure.legend(loc="upper left", ncols=4, bbox_to_anchor=(0.05, 1.0))
    return figure


_HEAD = [
    "# Which uncertainty of J and K to quote",
    "",
    "Made by `python -m analyses.calibration.quoted_sd`. Campaigns of six kinds, fitted as "
    "`fit` does at "
    "the optimum (Laplace approximation), against the truth.",
    "Each cell: share of J and K (nine numbers a campaign) whose 90 % interval holds the truth, "
    "with its 95 % range (bootstrap over campaigns),",
    "and how wide the interval is on average, in those of the model's `sd`. Wanted: 88 to 92 % at "
    "the least width.",
    "",
    "- Weak effect of the library: one that an ideal test at the level of 1 % finds every second "
    "time. Weak, outside: three tenths of the size at which something is found missing.",
    "- Dirt: the random combinations of `telemetry_faults.py`. Refused: disturbances from "
    "outside the "
    "library at their usual size.",
    "- Designed: plans for the four goals, and one of four slews.",
    "",
    "![Coverage by kind of campaign](../../../figures/quoted_sd.png)",
    "",
]
_TAIL = [
    "## What follows",
    "",
    "- The quoted sd counts effects that may act although they were too weak to be found, each by "
    "its probability, and is wider where slews disagree by more than chance.",
    "  It comes nearest to 90 % in every kind that is trusted, at the least width that does.",
    "- The jackknife of version 0.4 is up to dozens of times too wide where one slew alone "
    "determines an element, as designed slews do.",
    "- Of a refused fit no candidate holds in 88 % both with and without tachometers, and an error "
    "that all slews share shows in none: no sd is quoted.",
    "  `diagnose` averages over what may be missing (`unmodelled_disturbance.md`), and "
    "quotes that.",
    "- The other candidates stand in `summary.json` under their names, for comparison.",
    "",
]
