"""The benchmark's table remembers ratios, and its check sees what became worse."""

from __future__ import annotations

from pathlib import Path

import pytest

NAMES = ("evaluation_over_kernel", "ess_per_evaluation")


@pytest.fixture
def history(analysis):
    """The module that keeps the table."""
    return analysis("engine.benchmark_history")


def rows_of(history, path: Path, *values: tuple[float, ...]) -> list[dict[str, str]]:
    """A table with these rows of `NAMES`."""
    for number, row in enumerate(values):
        history.append_row(path, f"0.{number}", "2026-11-22", dict(zip(NAMES, row, strict=False)))
    return history.read_history(path)


@pytest.mark.parametrize(
    ("before", "after", "worse"),
    [
        ((2.0, 0.7), (2.0, 0.7), []),
        ((2.0, 0.7), (2.38, 0.59), []),
        ((2.0, 0.7), (2.42, 0.7), ["evaluation_over_kernel"]),
        ((2.0, 0.7), (2.0, 0.57), ["ess_per_evaluation"]),
        ((2.0, 0.7), (0.5, 7.0), []),
        ((2.0, 0.7), (2.0,), []),
        ((2.0,), (9.0, 0.1), ["evaluation_over_kernel"]),
    ],
    ids=["equal", "a sixth", "slower", "fewer samples", "better", "not measured", "not before"],
)
def test_what_became_worse_by_more_than_a_fifth_is_reported(
    history, tmp_path, before, after, worse
):
    rows = rows_of(history, tmp_path / "history.csv", (1.0, 1.0), before, after)
    assert [line.partition(":")[0] for line in history.worse_ratios(rows)] == worse


def test_rows_are_added_and_none_is_lost(history, tmp_path):
    path = tmp_path / "history.csv"
    assert history.worse_ratios(history.read_history(path)) == []
    rows = rows_of(history, path, (2.0, 0.7), (1.23456789,))
    assert [row["version"] for row in rows] == ["0.0", "0.1"]
    assert rows[1]["evaluation_over_kernel"] == "1.235"
    assert rows[1]["ess_per_evaluation"] == ""
    with pytest.raises(ValueError, match="no column seconds"):
        history.append_row(path, "0.2", "2026-11-22", {"seconds": 3.0})
    assert history.read_history(path) == rows
    assert "| effective samples an evaluation | more | 0.7 |  |" in history.history_table(rows)


def test_the_committed_table_holds_the_columns_that_are_measured(history):
    rows = history.read_history(
        Path(history.__file__).parents[1] / "results/engine/benchmark_history.csv"
    )
    assert rows
    assert list(rows[0]) == [*history.HEAD, *(ratio.name for ratio in history.RATIOS)]
    assert history.worse_ratios(rows) == []
