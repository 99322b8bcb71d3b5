"""Two runs side by side: how far their parameters differ, and what they were made with.

A difference is counted in the combined sd, the root of the sum of squares of the two quoted
uncertainties: what noise makes of the difference where the two runs share no data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

from bayes_inertia.maths.values import picked
from bayes_inertia.report.criteria import ratios_told, scale_factors
from bayes_inertia.report.formatting import kind_of
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.words import phrase

_ROW_KEYS = ("mean", "sd", "quoted_sd")
_RUN_KEYS = ("campaign", "verdict_sentence", "trusted", "gates")


@dataclass(frozen=True)
class ComparedRun:
    """One of two runs."""

    folder: str  # where it is
    label: str  # what the page calls it
    summary: Mapping[str, Any]  # the content of summary.json, with `verdict_sentence`
    settings: Mapping[str, str]  # what it was made with, by name

    @property
    def trusted(self) -> bool:
        """Whether every gate is passed."""
        return bool(self.summary["trusted"])


@dataclass(frozen=True)
class ParameterDifference:
    """One parameter in two runs."""

    name: str  # of the parameter
    unit: str
    first: Mapping[str, Any] | None  # its rows in the two summaries; None in a run without it
    second: Mapping[str, Any] | None

    @property
    def difference(self) -> float | None:
        """Second minus first, in the parameter's unit; None where one is absent."""
        if self.first is None or self.second is None:
            return None
        return self.second["mean"] - self.first["mean"]

    @property
    def combined_sd(self) -> float | None:
        """Root of the sum of squares of the quoted sds; None where a run has none."""
        if self.first is None or self.second is None:
            return None
        sds = (self.first["quoted_sd"], self.second["quoted_sd"])
        return None if None in sds else math.hypot(*sds)

    @property
    def in_sd(self) -> float | None:
        """The difference in combined sd."""
        if self.difference is None or not self.combined_sd:
            return None
        return self.difference / self.combined_sd

    @property
    def noticeable(self) -> bool:
        """Whether it differs by more than noise makes of it."""
        return abs(self.in_sd or 0.0) > LAYOUT.noticeable_sd

    def json(self) -> dict[str, Any]:
        """As it stands in a JSON document."""
        first, second = (
            None if row is None else {key: row[key] for key in _ROW_KEYS}
            for row in (self.first, self.second)
        )
        told = picked(self, "unit", "difference", "combined_sd")
        return told | {"first": first, "second": second, "difference_in_sd": self.in_sd}


@dataclass(frozen=True)
class RunComparison:
    """Two runs side by side."""

    first: ComparedRun  # the runs
    second: ComparedRun
    # Of all parameters and principal moments that one of them has.
    parameters: tuple[ParameterDifference, ...]

    @property
    def rows(self) -> tuple[Mapping[str, Mapping[str, Any]], ...]:
        """Rows of each run, see `_rows`."""
        return _rows(self.first.summary, self.second.summary)

    @property
    def same_telemetry(self) -> bool:
        """Whether both were made from the same files."""
        digests = [run.summary.get("campaign_sha256") for run in (self.first, self.second)]
        return digests[0] is not None and digests[0] == digests[1]

    @property
    def differing_settings(self) -> tuple[tuple[str, str, str], ...]:
        """Name and both values of the settings that are not the same."""
        first, second = self.first.settings, self.second.settings
        both = ((name, first.get(name, ""), second.get(name, "")) for name in {**first, **second})
        return tuple(row for row in both if row[1] != row[2])

    @property
    def J_and_K(self) -> tuple[ParameterDifference, ...]:
        """Those of J, and of K of every rate sensor, that both runs have."""
        kinds = ("moment of inertia", "product of inertia")
        factors = {*chain.from_iterable(scale_factors(self.first.summary).values())}
        both = (p for p in self.parameters if p.in_sd is not None)
        return tuple(p for p in both if kind_of(p.name) in kinds or p.name in factors)

    @property
    def lettered(self) -> dict[str, ComparedRun]:
        """The runs as the page calls them, A and B."""
        return {"A": self.first, "B": self.second}

    @property
    def refused(self) -> tuple[str, ...]:
        """A and B, if they quote no sd: nothing can be said to agree with them."""
        return tuple(letter for letter, run in self.lettered.items() if not run.trusted)

    @property
    def worst(self) -> ParameterDifference | None:
        """The element of J and K that differs most, in combined sd."""
        return max(self.J_and_K, key=lambda p: abs(p.in_sd or 0.0), default=None)

    @property
    def sentence(self) -> str:
        """The largest difference of J and K in one sentence."""
        return phrase("fit", "comparison", self)


def _rows(*summaries: Mapping[str, Any]) -> tuple[Mapping[str, Mapping[str, Any]], ...]:
    """Parameters and principal moments; before them ratios of J where a run has no size of its."""
    untied = any(ratios_told(summary) for summary in summaries)
    return tuple(
        (summary["ratios"] if untied else {}) | summary["parameters"] | summary["derived"]
        for summary in summaries
    )


def compare_runs(first: ComparedRun, second: ComparedRun) -> RunComparison:
    """Put two runs side by side."""
    rows = _rows(first.summary, second.summary)
    units = {name: row["unit"] for of_run in reversed(rows) for name, row in of_run.items()}
    differences = tuple(
        ParameterDifference(name, units[name], *(of_run.get(name) for of_run in rows))
        for name in dict.fromkeys([*rows[0], *rows[1]])
    )
    return RunComparison(first, second, differences)


def comparison_json(comparison: RunComparison) -> dict[str, Any]:
    """A comparison as a JSON document."""
    return {
        "sentence": comparison.sentence,
        "same_telemetry": comparison.same_telemetry,
        "runs": [
            {"run": run.folder} | {key: run.summary[key] for key in _RUN_KEYS}
            for run in (comparison.first, comparison.second)
        ],
        "parameters": {p.name: p.json() for p in comparison.parameters},
        "settings": [
            {"name": name, "first": first, "second": second}
            for name, first, second in comparison.differing_settings
        ],
    }
