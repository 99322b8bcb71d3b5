"""What is named against what was hidden: the figure of `table_page.py`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from analyses.naming.fixed_shape import NAMES
from bayes_inertia.report.pictures import style

FIGURES = Path(__file__).parents[2] / "figures"
_OTHER = "other name"  # of an effect without a fixed shape, or a formula
_SET, _NOTHING, _UNKNOWN = "one of several", "nothing found", "unknown"
_COLUMNS = (*NAMES, _OTHER, _SET, _NOTHING, _UNKNOWN)
_DARK = 0.55  # share from which a number is written in white


def named(row: Mapping) -> str:
    """The column of a campaign with one hidden effect: its name, a wrong one, or none.

    >>> told = {"hidden": ["rate_bias"], "verdict": "ambiguous", "named": ["rate_bias"]}
    >>> named(told | {"ambiguous_with": [["rate_bias", "nothing"]]})
    'one of several'
    """
    (truth,), sets = row["hidden"], row["ambiguous_with"]
    if row["verdict"] == "unknown":
        return _UNKNOWN
    if any(truth in names for names in sets):
        return _SET
    told = row["named"]
    name = truth if truth in told else next(iter(told), _NOTHING)
    return name if name in _COLUMNS else _OTHER


@style.styled
def confusion(rows: Sequence[Mapping]) -> Figure:
    """Share of campaigns by hidden effect (row) and by what was named (column)."""
    counts, table = Counter(row["label"] for row in rows), np.zeros((len(NAMES), len(_COLUMNS)))
    for row in rows:
        place = NAMES.index(row["label"]), _COLUMNS.index(named(row))
        table[place] += 1.0 / counts[row["label"]]
    figure = Figure(figsize=(style.WIDTH, 7.6))
    axes = figure.add_axes((0.2, 0.06, 0.76, 0.66))
    axes.imshow(table, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(table), strict=True):
        color = "white" if table[i, j] > _DARK else style.INK
        text = f"{100 * table[i, j]:.0f}"
        axes.text(j, i, text, ha="center", va="center", color=color, fontsize=8)
    axes.axvline(len(NAMES) - 0.5, color=style.MUTED, lw=1.0)
    labels = [name.replace("_", " ") for name in _COLUMNS]
    axes.set_xticks(range(len(_COLUMNS)), labels, rotation=55, ha="left", rotation_mode="anchor")
    axes.xaxis.tick_top()
    labels = [f"{name.replace('_', ' ')} ({counts[name]})" for name in NAMES]
    axes.set_yticks(range(len(NAMES)), labels)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    _title(figure)
    return figure


def _title(figure: Figure) -> None:
    title = "What is named, where an ideal test would find the hidden effect in 99 % of campaigns"
    figure.text(0.02, 0.965, title, fontsize=11)
    subtitle = (
        "per cent of campaigns; row: the hidden effect (campaigns); column: "
        "the name given, with and without tachometers together"
    )
    figure.text(0.02, 0.94, subtitle, color=style.MUTED)


def write_confusion(rows: Sequence[Mapping]) -> None:
    """Draw the figure."""
    confusion(rows).savefig(FIGURES / "diagnosis_confusion.png", dpi=130)
