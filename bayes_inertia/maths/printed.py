"""Numbers and units as they are printed, and what an object shows of itself in a notebook.

Printed text has typographic signs: a real minus, superscripts, dashes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

NOT_GIVEN = "–"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# What an object says of itself at a prompt: more would hide what was asked before.
_MOST_LINES = 3


def exponent(mean: float, sd: float) -> int:
    """Power of ten that is factored out of a number in print.

    Returns: A multiple of three; 0 for numbers that read well as they are.

    Examples
    --------
    >>> exponent(3.3, 1e-4), exponent(1.6e-3, 1e-5), exponent(2e-6, 1e-5)
    (0, -3, -6)
    """
    size = max(abs(mean), sd)
    return 0 if size == 0 or 5e-3 <= size < 1e4 else 3 * math.floor(math.log10(size) / 3.0 + 1e-9)


def number(value: float, sd: float, power: int = 0) -> str:
    """A value, rounded where its uncertainty has its second digit.

    `sd`: its uncertainty, in the same unit; without a positive one, four digits are printed. A
    value that is not finite is a dash.

    Examples
    --------
    >>> number(3.3311733, 0.000196), number(0.0016886, 1.4e-5, -3), number(1234.5, 200.0)
    ('3.33117', '1.689', '1230')
    """
    if not math.isfinite(value):
        return NOT_GIVEN
    if not (sd > 0 and math.isfinite(sd)):
        return with_minus_sign(f"{value / 10.0**power:.4g}")
    decimals = 1 - math.floor(math.log10(sd / 10.0**power))
    rounded = round(value / 10.0**power, decimals) + 0.0  # no minus before a zero
    return with_minus_sign(f"{rounded:.{max(0, decimals)}f}")


def unit_text(unit: str, power: int = 0) -> str:
    """A unit, with the power of ten that was factored out of the number.

    `unit`: as parameters carry it, "kg m^2"; empty for a pure number. Returns: A dash where there
    is neither unit nor power.

    Examples
    --------
    >>> unit_text("kg m^2", -3), unit_text("")
    ('× 10⁻³ kg m²', '–')
    """
    factor = power_text(power) if power else ""
    parts = (factor, unit.replace("^2", "²").replace("^3", "³"))
    return " ".join(part for part in parts if part) or NOT_GIVEN


def power_text(power: int) -> str:
    """A power of ten behind a number.

    >>> power_text(-4)
    '× 10⁻⁴'
    """
    return f"× 10{str(power).translate(_SUPERSCRIPT)}"


def value_text(value: Mapping[str, Any]) -> str:
    """A value with its sd and its unit.

    Returns: all three, with a power of ten where that is shorter.

    Examples
    --------
    >>> value_text({"mean": 2.31e-6, "sd": 1.1e-7, "unit": "N m"})
    '(2.31 ± 0.11) × 10⁻⁶ N m'
    """
    mean, sd, unit = value["mean"], value["sd"], value["unit"]
    power = exponent(mean, sd)
    both = f"{number(mean, sd, power)} ± {number(sd, sd, power)}"
    if power:
        return f"({both}) {unit_text(unit, power)}"
    return f"{both} {unit_text(unit)}" if unit else both


def with_minus_sign(text: str) -> str:
    """The text of a number with a real minus in place of the hyphen.

    >>> with_minus_sign("-0.5")
    '−0.5'
    """
    return text.replace("-", "−")


def counted(n: int, noun: str) -> str:
    """How many there are of something.

    >>> counted(1, "slew"), counted(5, "slew")
    ('1 slew', '5 slews')
    """
    return f"{n} {noun}{'s' if n != 1 else ''}"


def listed(items: Sequence[str]) -> str:
    """Items as a list in a sentence.

    >>> listed(["a", "b", "c"]), listed(["a"])
    ('a, b and c', 'a')
    """
    return " and ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else list(items))


@dataclass(frozen=True)
class Card:
    """What an object shows of itself: lines at a prompt, and a table below them in a notebook."""

    lines: tuple[str, ...]
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()

    @property
    def text(self) -> str:
        """Three lines at most."""
        return "\n".join(self.lines[:_MOST_LINES])

    @property
    def html(self) -> str:
        """The lines and the table, without style of its own: a notebook has one."""
        first, *others = map(escape, self.lines)
        shown = [f"<div><strong>{first}</strong></div>", *(f"<div>{line}</div>" for line in others)]
        if self.rows:
            table = [_html_row("th", self.head), *(_html_row("td", row) for row in self.rows)]
            shown += ["<table>", *table, "</table>"]
        return "\n".join(shown)


def _html_row(tag: str, cells: Sequence[str]) -> str:
    """A row of a table."""
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def shown_as[T: type](card: Callable[[Any], Card]) -> Callable[[T], T]:
    """Let the objects of a class print as a card: short at a prompt, a table in a notebook.

    Examples
    --------
    >>> @shown_as(lambda wheel: Card((f"Wheel {wheel.name}", "at rest")))
    ... @dataclass(frozen=True)
    ... class Wheel:
    ...     name: str
    >>> Wheel("x")
    Wheel x
    at rest
    >>> Wheel("<x>")._repr_html_()
    '<div><strong>Wheel &lt;x&gt;</strong></div>\\n<div>at rest</div>'
    """

    def decorated(cls: T) -> T:
        for name, method in (
            ("__repr__", lambda self: card(self).text),
            ("_repr_html_", lambda self: card(self).html),
        ):
            setattr(cls, name, method)
        return cls

    return decorated


def parameter_lines(values: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """J and K in two lines, known logarithms in a third.

    `values`: {name: (mean, sd)}; an sd that is not finite is a dash.

    Examples
    --------
    >>> parameter_lines({"Jxx": (3.33117, 2e-4), "Jxy": (-0.0118, 9e-5), "K1": (1.01, 1e-4)})
    ('Jxx 3.33117 ± 0.00020 kg m²', 'K1 1.01000 ± 0.00010')
    """
    diagonal = ("Jxx", "Jyy", "Jzz")
    moments = {k: v for k, v in values.items() if k in diagonal}
    ratios = {k: v for k, v in values.items() if k.removesuffix("/trace") in diagonal}
    factors = {k: v for k, v in values.items() if k[0] == "K" and k[1:].isdigit()}
    logarithms = {k: v for k, v in values.items() if k.startswith("log ")}
    without_unit = ({} if moments else ratios, factors, logarithms)
    return tuple(
        ", ".join(f"{name} {_with_sd(*value)}" for name, value in part.items()) + unit
        for part, unit in ((moments, " kg m²"), *((part, "") for part in without_unit))
        if part
    )


def parameter_text(name: str, mean: float, sd: float, unit: str) -> str:
    """A parameter's value in a table: J and K without powers of ten, so that they compare."""
    if "." in name:
        return value_text({"mean": mean, "sd": sd, "unit": unit})
    return f"{_with_sd(mean, sd)} {unit_text(unit)}" if unit else _with_sd(mean, sd)


def parameter_card(
    first: str,
    head: str,
    parameters: Iterable[tuple[str, str, float, float]],
    **columns: Sequence[float],
) -> Card:
    """A card of parameters: J and K below the first line, all of them in the table.

    `head`: of their values; `parameters`: name, unit, mean and sd of each; `columns`: further
    numbers, one a parameter, by their heads.

    Examples
    --------
    >>> card = parameter_card("Prior", "mean ± sd", [("K1", "", 1.0, 0.03)], worth=[0.5])
    >>> card.lines, card.rows
    (('Prior', 'K1 1.000 ± 0.030'), (('K1', '1.000 ± 0.030', '0.5'),))
    """
    told = list(parameters)
    rows = tuple(
        (name, parameter_text(name, mean, sd, unit), *(f"{x[k]:.2g}" for x in columns.values()))
        for k, (name, unit, mean, sd) in enumerate(told)
    )
    lines = parameter_lines({name: (mean, sd) for name, _, mean, sd in told})
    return Card((first, *lines), ("parameter", head, *columns), rows)


def _with_sd(mean: float, sd: float) -> str:
    """A value and its sd."""
    return f"{number(mean, sd)} ± {number(sd, sd)}"
