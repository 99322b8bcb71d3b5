"""Numbers, units and lists as they are printed, by the page, the pictures and the terminal alike.

Printed text has typographic signs: a real minus, superscripts, dashes.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bayes_inertia.campaign.sensors import STREAMS
from bayes_inertia.maths.printed import NOT_GIVEN as NOT_GIVEN
from bayes_inertia.maths.printed import exponent as exponent
from bayes_inertia.maths.printed import listed as listed
from bayes_inertia.maths.printed import number as number
from bayes_inertia.maths.printed import power_text as power_text
from bayes_inertia.maths.printed import unit_text as unit_text
from bayes_inertia.maths.printed import value_text as value_text
from bayes_inertia.maths.printed import with_minus_sign as with_minus_sign
from bayes_inertia.report.layout import LAYOUT

_CHANNEL_NAMES = {**{stream.name: stream.title for stream in STREAMS}, "total": "all channels"}
# What the last letter of a quantity's name says of its frame: `torque_N`, `rate_B`.
_FRAMES = {"N": "inertial axes", "B": "body axes"}


def channel_name(channel: str) -> str:
    """A channel in print; a further sensor has its own name.

    >>> channel_name("attitude"), channel_name("rate_2")
    ('star tracker', 'rate_2')
    """
    return _CHANNEL_NAMES.get(channel, channel)


def common_exponents(rows: Iterable[tuple[str, str, float, float]]) -> dict[str, int]:
    """Powers of ten of the parameters of one table, by name: one for all of a kind.

    `rows`: name, unit, mean and sd of each; a name may have several, as of several results.
    Moments of inertia, products of inertia, scale factors and the parameters of one effect in one
    unit are a kind each. The largest of a kind decides.

    >>> unit = "kg m^2"
    >>> common_exponents([("Jxx", unit, 3.3, 0.1), ("Jxy", unit, 0.01, 1e-4),
    ...                   ("Jxz", unit, 0.002, 1e-4)])
    {'Jxx': 0, 'Jxy': 0, 'Jxz': 0}
    """
    kinds, sizes = {}, defaultdict[tuple[str, str], float](float)
    for name, unit, mean, sd in rows:
        kinds[name] = kind = (kind_of(name), unit)
        sizes[kind] = max(sizes[kind], abs(mean), sd)
    return {name: exponent(sizes[kind], 0.0) for name, kind in kinds.items()}


def kind_of(name: str) -> str:
    """Kind of a parameter: moment or product of inertia, K, or the effect that it belongs to.

    >>> [kind_of(name) for name in ("Jxx", "Jxy", "K4", "mems.K1", "Jxy/trace")]
    ['moment of inertia', 'product of inertia', 'K', 'mems', 'product of inertia']
    """
    name = name.removesuffix("/trace")
    effect, dot, _ = name.partition(".")
    if dot:
        return effect
    if name[:1] == "J" and len(name) == 3:
        return "moment of inertia" if name[1] == name[2] else "product of inertia"
    return name.rstrip("0123456789")


def axis_name(axis_B: Sequence[float], *, signed: bool = True) -> str:
    """A direction (3,): "+x" within 15 degrees of a body axis, its components elsewhere.

    >>> axis_name([0.0, -0.99, 0.1]), axis_name([0.6, 0.8, 0.0])
    ('-y', '(0.60, 0.80, 0.00)')
    >>> axis_name([0.0, -1.0, 0.0], signed=False)
    'y'
    """
    i = max(range(3), key=lambda k: abs(axis_B[k]))
    if abs(axis_B[i]) > math.cos(math.radians(LAYOUT.named_axis)):
        return ("-" if axis_B[i] < 0 else "+") * signed + "xyz"[i]
    return "(" + ", ".join(f"{round(x, 2) + 0.0:.2f}" for x in axis_B) + ")"


def two_digits(value: float) -> str:
    """Two significant digits, with a power of ten where the number is small.

    >>> two_digits(8.96e-5), two_digits(0.0121), two_digits(321.0)
    ('9.0 × 10⁻⁵', '0.012', '321')
    """
    if not math.isfinite(value) or value == 0.0 or value >= LAYOUT.smallest_plain:
        return f"{value:#.2g}".rstrip(".") if value < 100.0 else f"{value:.0f}"
    digits, power = f"{value:.1e}".split("e")
    return f"{digits} {power_text(int(power))}"


def brief(value: float, digits: int = 2) -> str:
    """A number in a sentence: significant digits, in full above one, never as 1.06e+03.

    >>> brief(1063.2, 3), brief(0.5), brief(-0.0000123), brief(12345.0, 4)
    ('1,063', '0.5', '−1.2 × 10⁻⁵', '12,345')
    """
    if abs(value) >= 10.0**digits:
        return with_minus_sign(f"{value:,.0f}")
    text, _, power = f"{value:.{digits}g}".partition("e")
    return with_minus_sign(f"{text} {power_text(int(power))}" if power else text)


def sd_column(sds: Sequence[float]) -> tuple[int, list[str]]:
    """Sds [any units] of one column of a table: the column's power of ten, and its cells.

    >>> sd_column([6.2e-5, 7.3e-5, 1.8e-4])
    (-5, ['6.2', '7.3', '18'])
    >>> sd_column([0.13, 0.03])
    (0, ['0.13', '0.030'])
    """
    known = [sd for sd in sds if 0.0 < sd < math.inf]
    power = math.floor(math.log10(np.median(known))) if known else 0
    power = 0 if -2 <= power <= 3 else power
    return power, [number(sd, sd, power) for sd in sds]


def sd_head(name: str, power: int) -> str:
    """Heading of a column of `sd_column`: its name and power of ten."""
    return f"{name} {power_text(power)}" if power else name


def unit_powers(sds: Iterable[tuple[str, float]]) -> dict[str, int]:
    """Power of ten, a multiple of three, in which all (unit, sd) of a unit read best.

    >>> unit_powers([("kg m^2", 2e-4), ("kg m^2", 9e-5), ("rad", 0.1)])
    {'kg m^2': -3, 'rad': 0}
    """
    sizes: dict[str, list[float]] = {}
    for unit, sd in sds:
        sizes.setdefault(unit, []).append(math.log10(sd))
    return {unit: 3 * round(float(np.median(logs)) / 3.0) for unit, logs in sizes.items()}


def tenths(value: float) -> str:
    """A score or log Bayes factor: nobody decides anything by its second decimal.

    >>> tenths(2254.3), tenths(602.94), tenths(-1.0748), tenths(-0.0056)
    ('2,254', '602.9', '−1.1', '0.0')
    """
    text = f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.1f}"
    return "0.0" if text == "-0.0" else with_minus_sign(text)


def p_value_text(p: float) -> str:
    """A p-value as a cell of a table.

    >>> p_value_text(0.03), p_value_text(1e-300), p_value_text(2.3e-7)
    ('0.03', '< 10⁻¹⁰⁰', '2 × 10⁻⁷')
    """
    if p < LAYOUT.smallest_p_value:
        return f"< {power_text(round(math.log10(LAYOUT.smallest_p_value)))[2:]}"
    digit, power = f"{p:.0e}".split("e")
    return f"{digit} {power_text(int(power))}" if p < LAYOUT.smallest_plain else f"{p:.1g}"


def probability(p: float) -> str:
    """A p-value in a sentence.

    >>> probability(0.03), probability(1e-300)
    ('p = 0.03', 'p < 10⁻¹⁰⁰')
    """
    text = p_value_text(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


_DRIVES = {
    "commanded": "commanded: torque commands are the input",
    "measured": "measured: wheel momentum is the input",
}


def drive_text(drive: str, wheels: int) -> str:
    """What drives the model, of a spacecraft with so many wheels.

    >>> drive_text("commanded", 0)
    'there are no wheels'
    """
    return _DRIVES[drive] if wheels else "there are no wheels"


def vector_text(components: Sequence[float], decimals: int = 2) -> str:
    """The components of a unit vector.

    >>> vector_text([0.0, 0.6, -0.8])
    '0.00, 0.60, −0.80'
    """
    return with_minus_sign(", ".join(f"{x:.{decimals}f}" for x in components))


def arcsec(angle: Any) -> Any:
    """Angles [rad] in arc seconds.

    >>> round(arcsec(math.pi / 180.0))
    3600
    """
    return angle / (math.pi / (180.0 * 3600.0))


def arcsec_text(angle: float) -> str:
    """An angle [rad] in whole arc seconds, below ten with two digits.

    >>> arcsec_text(8e-5), arcsec_text(8e-6)
    ('17', '1.7')
    """
    seconds = arcsec(angle)
    return f"{seconds:,.0f}" if seconds >= 10.0 else f"{seconds:.2g}"


def plain(name: str) -> str:
    """The name of an effect or a parameter in print; of several, joined by "and", each.

    Returns: words with spaces; the frame that a name ends its quantity with is spelt out.

    >>> plain("wheel_command_lag"), plain("solar_pressure.torque_N_x")
    ('wheel command lag', 'solar pressure: torque x (inertial axes)')
    >>> plain("formula_body_torque_speed_squared_full")
    'body torque = c |ω|²'
    >>> plain("noise.rate_degrees")
    'noise: rate degrees of freedom'
    >>> plain("formula_rate_error_rate_times_time_full and wheel_friction")
    'rate error = C t_campaign ω and wheel friction'
    """
    if " and " in name:
        return " and ".join(map(plain, name.split(" and ")))
    effect, dot, parameter = name.rpartition(".")
    if (effect or name).startswith("formula_"):
        # Formulas bring JAX along, which the printing of other names does without.
        from bayes_inertia.physics.effects.formula import Formula

        formula = Formula.of_name(effect or name).text
        return f"{formula}: {parameter.replace('_', ' ')}" if dot else formula
    words = parameter.split("_")
    # Beside angles, degrees alone would be read as a unit.
    words += ["of", "freedom"] if effect == "noise" and words[-1] == "degrees" else []
    frames = [f" ({_FRAMES[word]})" for word in words[1:] if word in _FRAMES]
    quantity = " ".join(word for word in words if word not in _FRAMES or word == words[0])
    prefix = f"{effect.replace('_', ' ')}: " if dot else ""
    return f"{prefix}{quantity}{''.join(frames)}"


def K_holds(name: str) -> str:
    """Where the scale factors K hold beside an effect of this name; empty where it leaves them.

    >>> K_holds("formula_rate_error_rate_with_temperature_full"), K_holds("wheel_friction")
    ('the mean of temperature', '')
    """
    if not name.startswith("formula_"):
        return ""
    from bayes_inertia.physics.effects.formula import Formula

    return Formula.of_name(name).K_holds


def either_or(items: Sequence[str]) -> str:
    """Alternatives in a sentence.

    >>> either_or(["a", "b", "c"])
    'either a, b or c'
    """
    return f"either {', '.join(items[:-1])} or {items[-1]}" if len(items) > 1 else "".join(items)


def typeset(text: str) -> str:
    """A sentence written for a terminal, as the page prints it.

    >>> typeset("reduced chi^2 2.7: use `diagnose` and robust_sd")
    'reduced χ² 2.7: use diagnose and robust sd'
    >>> typeset("by -0.035 kg m^2: 2026-11-27")
    'by −0.035 kg m²: 2026-11-27'
    """
    text = re.sub(r"(?<= )-(?=\d)", "−", text.replace("`", "").replace("robust_sd", "robust sd"))
    return text.replace("^2", "²").replace("^3", "³").replace("chi²", "χ²")
