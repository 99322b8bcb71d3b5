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
    """One parameter before and after the fit.

    Parameters
    ----------
    name : str
        As in summary.json.
    unit : str
        Unit of all numbers here.
    old, old_sd : float
        Prior mean and sd: what was known before flight.
    new, sd : float
        Estimate and quoted sd; the model's sd where none can be quoted, which `notes` says then.
    low, high : float
        Ends of the 90 % interval.
    determined : str
        "determined", "partly determined" or "not determined"; "only its ratio" of J where nothing
        ties its size.
    """

    name: str
    unit: str
    old: float
    old_sd: float
    new: float
    sd: float
    low: float
    high: float
    determined: str

    @property
    def change(self) -> float:
        """From old to new, in the parameter's unit."""
        return self.new - self.old


@dataclass(frozen=True)
class ExportedCorrection:
    """The correction slew to expect after a slew of 60 degrees about one body axis.

    Parameters
    ----------
    axis : str
        "x", "y" or "z": the axis with the largest correction before.
    before, after : (float, float)
        Median and 95 % quantile [rad] with the old and with the new J and K on board.
    says : str
        What the forecast takes into account.
    """

    axis: str
    before: tuple[float, float]
    after: tuple[float, float]
    says: str


@array_dataclass
class ExportedResult:
    """A finished fit, as all formats see it.

    Parameters
    ----------
    campaign : str
        Name of the campaign.
    source : str
        Version, seed and data behind the numbers, in one line.
    trusted : bool
        Whether every gate was passed.
    reasons : tuple of str
        Why not.
    parameters : tuple of ExportedParameter
        J, K, then those of effects.
    covariance : (d, d) array
        Of the draws, widened to the sds that the parameters have, in their units.
    includes_wheel_spin : bool
        Whether the parameters Jxx ... Jyz are elements of J_locked.
    wheels : bool
        Whether there are wheels that this makes a difference for.
    inertia_B : (3, 3) array
        J without the wheels' spin inertia [kg m^2].
    inertia_locked_B : (3, 3) array
        J_locked = J + sum Js g g^T [kg m^2].
    correction : ExportedCorrection or None
        None where it cannot be forecast, or the format does not show it.
    notes : tuple of str
        What must be known before the numbers are used.
    """

    campaign: str
    source: str
    trusted: bool
    reasons: tuple[str, ...]
    parameters: tuple[ExportedParameter, ...]
    covariance: np.ndarray
    includes_wheel_spin: bool
    wheels: bool
    inertia_B: np.ndarray
    inertia_locked_B: np.ndarray
    correction: ExportedCorrection | None = None
    notes: tuple[str, ...] = ()

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
    """A text as one line of printable ASCII, so that no name can end a comment.

    Parameters
    ----------
    text : str
        Any.

    Returns
    -------
    str
        At most 200 characters.

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
    """The elements of a tensor in print, each with the digits that its sd supports.

    `tensor_B` (3, 3) [kg m^2].
    """
    axes: Sequence[str] = "xyz"
    names = [[f"J{min(a, b)}{max(a, b)}" for b in axes] for a in axes]
    return [
        [guarded_digits(float(tensor_B[i, j]), result.parameter(names[i][j]).sd) for j in range(3)]
        for i in range(3)
    ]
