"""What a calibration found: ranks, their bands and p-values, coverage, standardised errors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from bayes_inertia.errors import StudyError
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.studies.calibration import QUANTITIES, RANKED
from bayes_inertia.studies.calibration_cases import CalibrationCase
from bayes_inertia.studies.rank_statistics import (
    LEVELS,
    Coverage,
    Ranks,
)
from bayes_inertia.studies.work import TaskFailure, WorkResult

# Probability that a right pipeline is rejected, by any quantity of any case.
FALSE_ALARM = 0.01


@array_dataclass
class CaseCalibration:
    """The fits of one case.

    Parameters
    ----------
    name, says : str
        Of the case.
    ranks : (n, 14) array of int
        Of the truth among the draws, of each of `QUANTITIES`.
    z : (n, 14) array
        Truth minus mean, in sds of the draws.
    explained : (n,) array of bool
        Whether the residuals of these perfect fits pass their tests.
    nested_rhat : (n,) array
        Of the short chains.
    """

    name: str
    says: str
    ranks: np.ndarray
    z: np.ndarray
    explained: np.ndarray
    nested_rhat: np.ndarray

    @cached_property
    def p_values(self) -> np.ndarray:
        """Of the uniformity of the ranks (14,)."""
        return np.array([Ranks(ranks, RANKED).p_value for ranks in self.ranks.T])

    @property
    def departures(self) -> np.ndarray:
        """ECDFs minus that of uniform ranks, in standard errors (14, 199)."""
        return np.array([Ranks(ranks, RANKED).departure for ranks in self.ranks.T])

    def coverage(self, quantity: int) -> tuple[Coverage, ...]:
        """How often intervals of each level held the truth.

        Parameters
        ----------
        quantity : int
            Index in `QUANTITIES`.

        Returns
        -------
        tuple of Coverage
            Of 50, 90 and 95 %.
        """
        return tuple(map(Ranks(self.ranks[:, quantity], RANKED).coverage, LEVELS))


@array_dataclass
class Calibration:
    """A finished calibration.

    Parameters
    ----------
    cases : tuple of CaseCalibration
        In the order in which they were asked for.
    failures : tuple of TaskFailure
        Fits that failed; they count in nothing.
    """

    cases: tuple[CaseCalibration, ...]
    failures: tuple[TaskFailure, ...] = ()

    @property
    def fits(self) -> int:
        """Fits that were ranked."""
        return sum(len(case.ranks) for case in self.cases)

    @property
    def limit(self) -> float:
        """p-value below which ranks are not uniform: 1 % shared by all cases and quantities."""
        return FALSE_ALARM / (len(self.cases) * len(QUANTITIES))

    @property
    def rejected(self) -> tuple[tuple[str, str], ...]:
        """(case, quantity) of all ranks that are not uniform."""
        return tuple(
            (case.name, name)
            for case in self.cases
            for name, p in zip(QUANTITIES, case.p_values, strict=True)
            if p < self.limit
        )


def calibration_of(cases: Sequence[CalibrationCase], result: WorkResult) -> Calibration:
    """The rows of a calibration's fits, by case.

    Parameters
    ----------
    cases : sequence of CalibrationCase
        That were flown.
    result : WorkResult
        Of `calibration_work`.

    Returns
    -------
    Calibration
        With its failures.

    Raises
    ------
    StudyError
        If not one fit of a case succeeded.
    """
    parts = []
    for case in cases:
        rows = [row for row in result.rows if row["task"].partition("/")[0] == case.name]
        if not rows:
            reason = result.failures[0].reason if result.failures else "none was asked for"
            raise StudyError(
                f"no fit of the case {case.name} succeeded: {reason}",
                where="calibration",
                advice="leave the case out, or ask for more fits",
            )
        table = {
            key: np.array([row[key] for row in rows])
            for key in ("rank", "truth", "mean", "sd", "explained", "nested_rhat")
        }
        z = (table["truth"] - table["mean"]) / table["sd"]
        parts.append(
            CaseCalibration(
                case.name, case.says, table["rank"], z, table["explained"], table["nested_rhat"]
            )
        )
    return Calibration(tuple(parts), result.failures)
