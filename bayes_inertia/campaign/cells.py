"""Empty cells of columns: which are refused, and where."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.number_table import Table


def all_empty(table: Table, names: Sequence[str]) -> bool:
    """Whether columns hold no number."""
    return bool(np.isnan(table.stack(names)).all())


def refuse_empty_columns(table: Table, names: Sequence[str]) -> None:
    """Refuse a column that holds no number."""
    for name in names:
        if np.isnan(table.columns[name]).all():
            raise CampaignError(
                "every cell is empty",
                where=f"{table.label}, column {name}",
                advice="export it again, or leave the slew out",
            )


def refuse_half_empty_rows(table: Table, names: Sequence[str], advice: str) -> None:
    """Refuse columns that are empty everywhere, and rows of which some cells are given."""
    refuse_empty_columns(table, names)
    empty = np.isnan(table.stack(names))
    _refuse_empty_cells(table, names, empty & ~empty.all(axis=1, keepdims=True), advice)


def _refuse_empty_cells(table: Table, names: Sequence[str], empty: np.ndarray, advice: str) -> None:
    if empty.any():
        row = int(np.argmax(empty.any(axis=1)))
        raise CampaignError(
            "the cell is empty",
            where=table.place(row, names[int(np.argmax(empty[row]))]),
            advice=advice,
        )
