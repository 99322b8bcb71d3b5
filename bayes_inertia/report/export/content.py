"""Exported content of a fit, with the digits and comments that all formats share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.report.formatting import number
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.verdict import is_scale_factor

FORMAT = "bayes-inertia-export/1"


@dataclass(frozen=True)
class ExportedParameter:
    """One parameter before and after the fit."""

    name: str  # as in summary.json
    unit: str  # unit of all numbers here
    old: float  # prior mean and sd: what was known before flight
    old_sd: float
    # Estimate and quoted sd; the model's sd where none can be quoted, which `notes` says then.
    new: float
    sd: float
    low: float  # ends of the 90 % interval
    high: float
    determined: str  # "determined", "partly determined" or "not determined"

    @property
    def change(self) -> float:
        """From old to new, in the parameter's unit."""
        return self.new - self.old


@dataclass(frozen=True)
class ExportedCorrection:
    """The correction slew to expect after a slew of 60 degrees about one body axis."""

    axis: str  # "x", "y" or "z": the axis with the largest correction before
    # Median and 95 % quantile [rad] with the old and with the new J and K on board.
    before: tuple[float, float]
    after: tuple[float, float]
    says: str  # what the forecast takes into account


@array_dataclass
class ExportedResult:
    """A finished fit, as all formats see it."""

    campaign: str  # name of the campaign
    source: str  # version, seed and data behind the numbers, in one line
    trusted: bool  # whether every gate was passed
    reasons: tuple[str, ...]  # why not
    parameters: tuple[ExportedParameter, ...]  # J, K, then those of effects
    # (d, d) of the draws, widened to the sds that the parameters have, in their units.
    covariance: np.ndarray
    includes_wheel_spin: bool  # whether the parameters Jxx ... Jyz are elements of J_locked
    inertia_B: np.ndarray  # (3, 3) J without the wheels' spin inertia [kg m^2]
    inertia_locked_B: np.ndarray  # (3, 3) J_locked = J + sum Js g g^T [kg m^2]
    # None where it cannot be forecast, or the format does not show it.
    correction: ExportedCorrection | None = None
    notes: tuple[str, ...] = ()  # what must be known before the numbers are used

    @property
    def scale_factors(self) -> tuple[ExportedParameter, ...]:
        """Those of K, one an axis of the rate sensor."""
        return tuple(p for p in self.parameters if is_scale_factor(p.name))

    def parameter(self, name: str) -> ExportedParameter:
        """The parameter of a name."""
        return next(p for p in self.parameters if p.name == name)


def comment_lines(result: ExportedResult, *more: str) -> list[str]:
    """First comments of every file: its origin, and a warning if it is not trusted."""
    warning = []
    if not result.trusted:
        reasons = "; ".join(result.reasons) or "a gate failed"
        warning = [f"WARNING: DO NOT USE THIS RESULT AS IT STANDS: {reasons}"]
    notes = (f"NOTE: {note}" for note in result.notes)
    lines = [*warning, *notes, f"campaign: {result.campaign}", result.source, *more]
    return [one_line(line) for line in lines]


def one_line(text: str) -> str:
    """A text as one line of at most 200 printable ASCII letters: no name can end a comment.

    Examples
    --------
    >>> one_line("a\\nb µ")
    'a b ?'
    """
    shown = "".join(c if c.isascii() and c.isprintable() else "?" for c in " ".join(text.split()))
    return (
        shown if len(shown) <= LAYOUT.comment_line else f"{shown[: LAYOUT.comment_line - 6]} [...]"
    )


def rounded(value: float, sd: float) -> str:
    """A value with as many decimals as its uncertainty supports, in ASCII.

    Examples
    --------
    >>> rounded(-0.0123456, 0.000196), rounded(3.3311733, 0.0)
    ('-0.01235', '3.331')
    """
    return number(value, sd).replace("−", "-")


def guarded_digits(value: float, sd: float) -> str:
    """A value with two digits more than `rounded`, for machines.

    Returns: rounding moves it by less than a thousandth of its sd.

    Examples
    --------
    >>> guarded_digits(-0.01234567891, 0.000196)
    '-0.0123457'
    """
    return rounded(value, sd / 10.0**LAYOUT.guard_digits)


def tensor_digits(result: ExportedResult, tensor_B: np.ndarray) -> list[list[str]]:
    """Elements (3, 3) of a tensor [kg m^2], each with the digits that its sd supports."""
    axes: Sequence[str] = "xyz"
    names = [[f"J{min(a, b)}{max(a, b)}" for b in axes] for a in axes]
    return [
        [guarded_digits(float(tensor_B[i, j]), result.parameter(names[i][j]).sd) for j in range(3)]
        for i in range(3)
    ]
