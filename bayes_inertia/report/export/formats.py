"""The formats that a result is exported to: a table, handed in where it is used.

A format for another tool is a template beside this file, with what the tool does to signs and
spins; the upload sheet and the JSON document are written here.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Any
from unicodedata import combining, normalize

import numpy as np

from bayes_inertia.campaign.prior import EXPORT_FORMAT
from bayes_inertia.maths.values import array_dataclass, json_ready, picked
from bayes_inertia.report.formatting import arcsec, common_exponents, kind_of, number
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.words import templates_in

_TEX = {c: f"\\{c}" for c in "&%$#_{}"} | {"\\": "/", "~": "-", "^": "-"}
# What the decomposition of Unicode does not turn into ASCII.
_IN_ASCII = str.maketrans(
    {"ß": "ss", "μ": "u", "°": " deg", "×": "x", "·": " ", "–": "-", "—": "-", "−": "-", "⁄": "/"}
    | dict(zip("øØłŁđĐ", "oOlLdD", strict=True))
    | {"æ": "ae", "Æ": "AE", "œ": "oe", "Œ": "OE"}
)
_COLUMNS = (
    "parameter",
    "unit",
    "old",
    "new",
    "sd",
    "change",
    "change_in_old_sd",
    "change_in_new_sd",
    "low_90",
    "high_90",
    "determined",
)


@dataclass(frozen=True)
class ExportFormat:
    """One format."""

    text: Callable[[ExportedResult], str]  # from an `ExportedResult` to the content of the file
    # Whether the forecast of the correction slew is shown; it takes seconds to make.
    shows_correction: bool = False


def templated(template: str, result: ExportedResult) -> str:
    """A result as a template of this folder writes it."""
    environment = templates_in("export", keep_trailing_newline=True)
    environment.filters |= {
        "one_line": one_line,
        "matrix": _matlab_matrix,
        "quoted": lambda text: "'{}'".format(one_line(text).replace("'", "''")),
        "tex": lambda name: "".join(_TEX.get(c, c) for c in one_line(name)),
    }
    return environment.get_template(template).render(
        result=result,
        format=EXPORT_FORMAT,
        comments=lambda mark, more: "\n".join(
            f"{mark} {line}" for line in comment_lines(result, *more)
        ),
        tensor=partial(tensor_digits, result),
        K=[{"name": p.name, "digits": guarded_digits(p.new, p.sd)} for p in result.scale_factors],
        powers=common_exponents((p.name, p.unit, p.new, p.sd) for p in result.parameters),
        rounded_in=lambda p, power: [
            rounded(x / 10.0**power, p.sd / 10.0**power) for x in (p.old, p.new, p.sd)
        ],
        now=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S"),
    )


def _matlab_matrix(values: np.ndarray | list[list[float]]) -> str:
    rows = (" ".join(f"{x:.17g}" for x in row) for row in np.asarray(values).tolist())
    return f"[{'; '.join(rows)}]"


def csv_text(result: ExportedResult) -> str:
    """A row a parameter, rounded where its sd has its second digit; comments begin with `#`."""
    kind = "with" if result.includes_wheel_spin else "without"
    spin = f" {kind} the wheels' spin inertia" if result.wheels else ""
    quoted = "" if result.notes else "; sd: the quoted one"
    more = [f"old: known before this fit{quoted}; J{spin}: elements of the tensor"]
    if result.correction is not None:
        more.append(f"correction slew: {result.correction.says}")
    file = io.StringIO()
    file.writelines(f"# {line}\n" for line in comment_lines(result, *more))
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(_COLUMNS)
    writer.writerows(_parameter_cells(p) for p in result.parameters)
    if result.correction is not None:
        writer.writerows(_correction_rows(result.correction))
    return file.getvalue()


def _parameter_cells(p: ExportedParameter) -> list[str]:
    return [
        one_line(p.name),
        p.unit,
        *(rounded(x, p.sd) for x in (p.old, p.new, p.sd, p.change)),
        *(f"{p.change / sd:+.2f}" if sd > 0.0 else "" for sd in (p.old_sd, p.sd_of_change)),
        *(rounded(x, p.sd) for x in (p.low, p.high)),
        p.determined,
    ]


def _correction_rows(correction: ExportedCorrection) -> Iterator[list[str]]:
    """Rows "old" before and "new" after the upload."""
    pairs = zip(("median", "q95"), correction.before, correction.after, strict=True)
    for key, before, after in pairs:
        cells = [f"{arcsec(angle):.3g}" for angle in (before, after, after - before)]
        name = f"correction_slew_{correction.axis}_{key}"
        yield [name, "arcsec", cells[0], cells[1], "", cells[2], *[""] * 5]


def json_text(result: ExportedResult) -> str:
    """A document of the schema `bayes-inertia-export/1`, all digits."""
    content = {
        "format": EXPORT_FORMAT,
        "trusted": result.trusted,
        "warning": None if result.trusted else comment_lines(result)[0],
        **picked(result, "reasons", "notes", "campaign", "source", "includes_wheel_spin"),
        "J_kgm2": result.inertia_B,
        "J_locked_kgm2": result.inertia_locked_B,
        "K": [p.new for p in result.scale_factors],
        # In the order of the rows and columns of the covariance.
        "names": [p.name for p in result.parameters],
        "parameters": {
            p.name: {k: v for k, v in asdict(p).items() if k != "name"} for p in result.parameters
        },
        "covariance": result.covariance,
        **picked(result, "learnt_from", "scale_of_J"),
        "correction_slew_rad": result.correction,
    }
    return json.dumps(json_ready(content), indent=1, allow_nan=False) + "\n"


EXPORT_FORMATS: Mapping[str, ExportFormat] = {
    "json": ExportFormat(json_text, shows_correction=True),
    "csv": ExportFormat(csv_text, shows_correction=True),
    **{
        name: ExportFormat(partial(templated, f"{name}.txt"))
        for name in ("acm", "apm", "matlab", "latex", "basilisk", "42")
    },
}


@dataclass(frozen=True)
class ExportedParameter:
    """One parameter before and after the fit."""

    name: str  # as in summary.json
    unit: str  # unit of all numbers here
    old: float  # prior mean and sd: what was known before this fit
    old_sd: float
    # Estimate and quoted sd; the model's sd where none can be quoted, which `notes` says then.
    new: float
    sd: float
    low: float  # ends of the 90 % interval
    high: float
    # "determined", "partly determined" or "not determined"; "only its ratio" of J where nothing
    # ties its size
    determined: str

    @property
    def change(self) -> float:
        """From old to new, in the parameter's unit."""
        return self.new - self.old

    @property
    def sd_of_change(self) -> float:
        """What a change is held against; 0 where the size of J may have changed unseen."""
        return 0.0 if self.determined == "only its ratio" else self.sd


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
    wheels: bool  # whether there are wheels that this makes a difference for
    inertia_B: np.ndarray  # (3, 3) J without the wheels' spin inertia [kg m^2]
    inertia_locked_B: np.ndarray  # (3, 3) J_locked = J + sum Js g g^T [kg m^2]
    # None where it cannot be forecast, or the format does not show it.
    correction: ExportedCorrection | None = None
    notes: tuple[str, ...] = ()  # what must be known before the numbers are used
    begin_utc: str | None = None  # when the first slew began, a date in UTC; None if not known
    # `Slew.digest` of all slews that it was learnt from: as a prior it is refused where they are.
    learnt_from: tuple[str, ...] = ()
    # What ties the absolute size of J, as `GaussianPrior.scale_of_J`.
    scale_of_J: tuple[Mapping[str, Any], ...] = ()
    spacecraft: str = ""  # its name and who operates it, where the campaign states them
    operator: str = ""

    @property
    def scale_factors(self) -> tuple[ExportedParameter, ...]:
        """Those of K, one an axis of the rate sensor."""
        return tuple(p for p in self.parameters if kind_of(p.name) == "K")

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

    >>> one_line("a\\nb Größe é ø 10⁻⁵ µm ½ 卫")
    'a b Grosse e o 10-5 um 1/2 ?'
    """
    plain = normalize("NFKD", text).translate(_IN_ASCII)
    letters = (c for c in " ".join(plain.split()) if not combining(c))
    shown = "".join(c if c.isascii() and c.isprintable() else "?" for c in letters)
    most = LAYOUT.comment_line
    return shown if len(shown) <= most else f"{shown[: most - 6]} [...]"


def rounded(value: float, sd: float) -> str:
    """A value with as many decimals as its uncertainty supports, in ASCII.

    >>> rounded(-0.0123456, 0.000196), rounded(3.3311733, 0.0)
    ('-0.01235', '3.331')
    """
    return number(value, sd).replace("−", "-")


def guarded_digits(value: float, sd: float) -> str:
    """A value with two digits more than `rounded`, for machines.

    Returns: rounding moves it by less than a thousandth of its sd.

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
