"""A disturbance that follows something known: a formula in place of a name.

Where no effect of the library explains the data, a diagnosis looks for a formula: what acts
(`PLACES`), in proportion to what (`DRIVERS`, or an input of the user's own), and which components
follow which (`form`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.files import vocabulary
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.linear_algebra import fused_product
from bayes_inertia.physics.effect import RowByRow, require_of_effect
from bayes_inertia.physics.effects.scales import torque_scale
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.parameters import Normal, scalar, vector
from bayes_inertia.physics.slew_context import SlewContext, State


class Driver(NamedTuple):
    """What a disturbance may be in proportion to.

    Parameters
    ----------
    symbol : str
        In a formula; {w} stands for the wheel.
    value : callable
        (slew, t, state, wheel) -> (k,) at one instant, body axes, SI units.
    unit : dict
        Its unit: powers of "N m", "s", "T".
    columns : str
        Components: "one", "body" (x, y, z) or "wheels".
    needs : tuple of str
        Environment columns that it is made of.
    of_one_wheel : bool
        Whether it is one for each wheel.
    commands : bool
        Whether it follows the wheels' torque commands.
    switches : bool
        Whether it changes its sign at once.
    inputs : tuple of str
        Streams of `Slew.inputs` that it is made of.
    of_rate : bool
        Whether it is the body rate times its value, such as that of a temperature.
    words : str
        What it is in a sentence; empty where formulas alone follow it.
    """

    symbol: str
    value: Callable[[SlewContext, Array, State, int], Array]
    unit: Mapping[str, int]
    columns: str = "body"
    needs: tuple[str, ...] = ()
    of_one_wheel: bool = False
    commands: bool = False
    switches: bool = False
    inputs: tuple[str, ...] = ()
    of_rate: bool = False
    words: str = ""

    @property
    def abrupt(self) -> bool:
        """Whether it changes faster than the body moves."""
        return self.commands or self.switches or bool(self.inputs)


class Place(NamedTuple):
    """Where a disturbance may act.

    Parameters
    ----------
    symbol, unit : str
        In a formula.
    hook : str
        Of the effect.
    rows : str
        Components: "body", "inertial" or "wheels".
    size : callable
        campaign -> prior sd of the whole disturbance, in its unit.
    power : dict
        Its unit: powers of "N m", "s", "rad".
    """

    symbol: str
    hook: str
    rows: str
    size: Callable
    power: Mapping[str, int]


def _torque(campaign):
    return NUMERICS.formula_torque * torque_scale(campaign)


def _rate(campaign):
    return NUMERICS.formula_reading * campaign.scale_of_motion()[0]


def _momentum(campaign):
    rate, _, inertia = campaign.scale_of_motion()
    return NUMERICS.formula_reading * rate * inertia


def _turn(campaign):
    tracker = campaign.star_tracker
    return NUMERICS.formula_turn * tracker.sigma_cross if tracker else 5e-4


PLACES: Mapping[str, Place] = {
    "body_torque": Place("body torque", "body_torque", "body", _torque, {"N m": 1}),
    "inertial_torque": Place("inertial torque", "body_torque", "inertial", _torque, {"N m": 1}),
    "wheel_torque": Place("torque on the wheels", "wheel_torque", "wheels", _torque, {"N m": 1}),
    "rate_error": Place("rate error", "rate_output", "body", _rate, {"rad": 1, "s": -1}),
    "attitude_error": Place("attitude error", "attitude_output", "body", _turn, {"rad": 1}),
    "tachometer_error": Place(
        "tachometer error", "momentum_output", "wheels", _momentum, {"N m": 1, "s": 1}
    ),
}


def _norm(v):
    # Smooth where the body rests.
    return jnp.sqrt(jnp.sum(v * v) + 1e-24)


def _commanded(slew, t):
    row = jnp.clip(jnp.searchsorted(slew.time, t, side="right") - 1, 0, len(slew.time) - 1)
    return slew.torque[row]


def _stored(slew, state):
    return fused_product(slew.wheel_axes_B, state.wheel_momentum)


def _field(state):
    return quaternion.to_body(state.attitude, state.magnetic_field_N)


def _down(state):
    position = quaternion.to_body(state.attitude, state.position_N)
    return -position / jnp.maximum(jnp.linalg.norm(position), 1.0)


def _products(rate_B):
    x, y, z = rate_B
    return jnp.stack([y * z, x * z, x * y])


# Of (slew, t, state, wheel).
_VALUES: Mapping[str, Callable[[SlewContext, Array, State, int], Array]] = {
    "constant": lambda s, t, x, w: jnp.ones(1),
    "time_in_slew": lambda s, t, x, w: jnp.reshape(t, (1,)),
    "campaign_time": lambda s, t, x, w: jnp.reshape(s.start + t - s.middle, (1,)),
    "speed": lambda s, t, x, w: _norm(x.rate_B)[None],
    "speed_squared": lambda s, t, x, w: jnp.sum(x.rate_B**2)[None],
    "rate": lambda s, t, x, w: x.rate_B,
    "rate_times_speed": lambda s, t, x, w: _norm(x.rate_B) * x.rate_B,
    # A scale factor that drifts, where it is a sensor's error.
    "rate_times_time": lambda s, t, x, w: (s.start + t - s.middle) * x.rate_B,
    "rate_squares": lambda s, t, x, w: x.rate_B**2,
    "rate_products": lambda s, t, x, w: _products(x.rate_B),
    "momentum": lambda s, t, x, w: _stored(s, x),
    "gyroscopic": lambda s, t, x, w: jnp.cross(x.rate_B, _stored(s, x)),
    "command": lambda s, t, x, w: fused_product(s.wheel_axes_B, _commanded(s, t)),
    "field": lambda s, t, x, w: _field(x),
    "field_change": lambda s, t, x, w: jnp.cross(x.rate_B, _field(x)),
    "eddy": lambda s, t, x, w: jnp.cross(_field(x), jnp.cross(x.rate_B, _field(x))),
    "nadir": lambda s, t, x, w: _down(x),
    "wheel_momenta": lambda s, t, x, w: x.wheel_momentum,
    "wheel_speeds": lambda s, t, x, w: jnp.abs(x.wheel_momentum),
    "wheel_squares": lambda s, t, x, w: x.wheel_momentum**2,
    "wheel_signed_squares": lambda s, t, x, w: jnp.abs(x.wheel_momentum) * x.wheel_momentum,
    # As smooth as `wheel_friction`.
    "wheel_signs": lambda s, t, x, w: jnp.tanh(x.wheel_momentum / s.spin_inertia),
    "wheel_commands": lambda s, t, x, w: _commanded(s, t),
    "wheel_efforts": lambda s, t, x, w: jnp.abs(_commanded(s, t)),
    "wheel_rates": lambda s, t, x, w: fused_product(s.wheel_axes_B.T, x.rate_B),
    "momentum_times_rate": lambda s, t, x, w: x.wheel_momentum[w] * x.rate_B,
    "momentum_times_field": lambda s, t, x, w: x.wheel_momentum[w] * _field(x),
    "command_times_field": lambda s, t, x, w: _commanded(s, t)[w] * _field(x),
}
DRIVERS: Mapping[str, Driver] = {
    key: Driver(value=_VALUES[key], **row | {"needs": tuple(row.get("needs", ()))})
    for key, row in vocabulary("physics")["drivers"].items()
}

# Kinds of inputs: one number; a vector in body axes; one in inertial axes; a number times the rate.
_INPUT = re.compile(r"(input|vector|inertial|rate_with)_(\w+)")


def driver_of(key: str) -> Driver:
    """The driver of a key: one of `DRIVERS`, or an input of the user's own.

    >>> driver_of("input_temperature").words, driver_of("inertial_sun").columns
    ('temperature', 'body')
    """
    found = None if key in DRIVERS else _INPUT.fullmatch(key)
    if found is None:
        return DRIVERS[key]
    kind, name = found.groups()

    def value(slew, t, state, wheel):
        told = state.input(name)
        return quaternion.to_body(state.attitude, told) if kind == "inertial" else told

    words = name.replace("_", " ") + (" (inertial axes)" if kind == "inertial" else "")
    if kind == "rate_with":
        # A scale factor that follows it, where it is a sensor's error.
        return Driver(words, value, {name: 1, "s": -1}, inputs=(name,), of_rate=True)
    return Driver(
        words, value, {name: 1}, "one" if kind == "input" else "body", inputs=(name,), words=words
    )


def drivers_known(campaign) -> tuple[str, ...]:
    """Keys of the drivers that a campaign tells in every slew."""
    known = tuple(key for key, driver in DRIVERS.items() if _is_known(campaign, driver))
    first, *others = (slew.inputs or {} for slew in campaign.slews)
    kinds = {1: ("input", "rate_with"), 3: ("vector", "inertial")}
    told = tuple(
        f"{kind}_{name}"
        for name, stream in first.items()
        for kind in kinds.get(stream.width, ())
        if all(name in own and own[name].width == stream.width for own in others)
    )
    return known + tuple(key for key in told if _INPUT.fullmatch(key))


def _is_known(campaign, driver: Driver) -> bool:
    if (driver.columns == "wheels" or driver.of_one_wheel) and not campaign.wheels:
        return False
    if driver.commands and not campaign.has_commands:
        return False
    return all(getattr(s, need) is not None for s in campaign.slews for need in driver.needs)


_BODY = ("x", "y", "z")
FORMS = ("full", "diagonal", "scalar", "cross", "column", "entry", "hollow")
_NAMES = re.compile(
    f"formula_({'|'.join(PLACES)})_({'|'.join(DRIVERS)}|{_INPUT.pattern})_({'|'.join(FORMS)})((?:_[0-9]+)*)"
    "(?:_wheel([0-9]+))?"
)


@dataclass(frozen=True)
class Formula(RowByRow):
    """What acts is C d: a matrix of coefficients C times a driver d of the table `DRIVERS`.

    Parameters
    ----------
    place : str, optional
        What acts: a key of `PLACES`. Torques are in N m, on the body in body or inertial axes or
        on the wheels; errors are added to the readings of a sensor.
    driver : str, optional
        What it is in proportion to: a key of `DRIVERS`; or a stream of `Slew.inputs`, such as a
        temperature: "input_NAME" (one number), "vector_NAME" (x, y, z in body axes),
        "inertial_NAME" (in inertial axes) or "rate_with_NAME" (one number times the body rate).
    form : {"full", "diagonal", "scalar", "cross", "column", "entry", "hollow"}, optional
        All of C; its diagonal; one number times the unit matrix; c x d; one column; one entry; all
        of C but its diagonal.
    row, column : int, optional
        Which entry or column, from 0.
    wheel : int, optional
        Which wheel, from 0, where the driver is that of one wheel.
    rms : float or None, optional
        Typical size of the driver in the campaign, in its unit; None guesses it from the motion.
        The prior of C lets the disturbance be a tenth of the torque that makes the motion, or a
        hundredth of a reading.
    middle : float or None, optional
        What is taken off an input of one number; None takes the mean of its readings in the
        campaign. Counted from zero, a temperature would be a bias, and times the rate K.
    prior_scale : float, optional
        What the sds of its priors are multiplied by in a `Model`.
    device : str, optional
        As of `Effect`; nothing here.

    Raises
    ------
    EffectError
        If there is no such place, driver or form.

    Examples
    --------
    >>> Formula("rate_error", "rate_squares", "entry", row=2, column=0).text
    'rate error z = c ω² [x]'
    """

    place: str = "body_torque"
    driver: str = "rate_times_speed"
    form: str = "full"
    row: int = 0
    column: int = 0
    wheel: int = 0
    rms: float | None = field(default=None, kw_only=True)
    middle: float | None = field(default=None, kw_only=True)

    def __post_init__(self):
        for key, table in (("place", PLACES), ("driver", DRIVERS), ("form", FORMS)):
            given = getattr(self, key)
            known = given in table or (key == "driver" and bool(_INPUT.fullmatch(given)))
            advice = f"choose {', '.join(table)}"
            require_of_effect(known, "formula", f"no {key} {given!r}", advice)

    @property
    def name(self) -> str:  # type: ignore[override]
        """What tells this formula from others."""
        parts = ["formula", self.place, self.driver, self.form]
        parts += [str(self.row)] if self.form == "entry" else []
        parts += [str(self.column)] if self.form in ("entry", "column") else []
        parts += [f"wheel{self.wheel}"] if self._driver.of_one_wheel else []
        return "_".join(parts)

    @classmethod
    def of_name(cls, name: str) -> Formula:
        """The formula of a name.

        Parameters
        ----------
        name : str
            As `name` of a formula.

        Returns
        -------
        Formula
            With no `rms`.

        Raises
        ------
        KeyError
            If no formula has this name.

        Examples
        --------
        >>> Formula.of_name("formula_rate_error_rate_squares_entry_2_0").text
        'rate error z = c ω² [x]'
        """
        found = _NAMES.fullmatch(name)
        if found is None:
            raise KeyError(name)
        place, driver, _, _, form, numbers, wheel = found.groups()
        given = [int(number) for number in numbers.split("_")[1:]]
        if len(given) != {"entry": 2, "column": 1}.get(form, 0):
            raise KeyError(name)
        row, column = (0, 0, *given)[-2:]
        return cls(place, driver, form, row, column, int(wheel or 0))

    @property
    def needs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The environment columns of its driver."""
        return self._driver.needs

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The input that its driver is."""
        return self._driver.inputs

    @property
    def _driver(self) -> Driver:
        return driver_of(self.driver)

    @property
    def text(self) -> str:
        """The formula as it is printed."""
        place, driver = PLACES[self.place], self._driver
        symbol = driver.symbol.replace("{w}", str(self.wheel + 1))
        if driver.inputs and (driver.columns == "one" or driver.of_rate) and self.middle != 0.0:
            middle = "mean" if self.middle is None else f"{self.middle:.12g}"
            symbol = f"({symbol} − {middle})"
        symbol += " ω" if driver.of_rate else ""
        right = {
            "full": f"C {symbol}" if driver.columns != "one" else f"c {symbol}",
            "diagonal": f"diag(c) {symbol}",
            "scalar": f"c {symbol}",
            "cross": f"c × ({symbol})",
            "hollow": f"C {symbol} with no diagonal in C",
        }
        part = _part_of(driver.columns, self.column)
        left = f" {_part_of(place.rows, self.row)}" if self.form == "entry" else ""
        whole = right.get(self.form, f"c {symbol}{f' [{part}]' if part else ''}")
        return f"{place.symbol}{left} = {whole}"

    @property
    def K_holds(self) -> str:
        """Where the scale factors K hold if this changes them; else empty."""
        diagonal = self.form in ("full", "diagonal", "scalar", "column")
        diagonal = diagonal or (self.form == "entry" and self.row == self.column)
        if self.place != "rate_error" or not diagonal:
            return ""
        at = "the middle of the campaign" if self.driver == "rate_times_time" else ""
        return f"the mean of {self._driver.symbol}" if self._driver.of_rate else at

    def in_campaign(self, campaign):
        told = [(slew.inputs or {}).get(name) for slew in campaign.slews for name in self.inputs]
        readings = [stream.values for stream in told if stream is not None and stream.width == 1]
        if self.middle is not None or not readings:
            return self
        return replace(self, middle=middle_of(np.concatenate(readings)))

    def parameters(self, campaign):
        place, driver = PLACES[self.place], self._driver
        rows, columns = (_labels(kind, campaign) for kind in (place.rows, driver.columns))
        self._check(len(rows), len(columns), len(campaign.wheels))
        sigma = place.size(campaign) / (self.rms or _typical(driver.unit, campaign))
        labels = self._labels(rows, columns)
        if not labels:
            return ()
        unit, prior = _unit(place.power, driver.unit), Normal(0.0, sigma)
        if self.form == "scalar":
            return (scalar("c", unit=unit, prior=prior),)
        return (vector("c", labels, unit=unit, prior=prior),)

    def _check(self, rows: int, columns: int, wheels: int) -> None:
        """Raise unless C has this form."""
        given = {"row": (self.row, rows), "column": (self.column, columns)}
        if self._driver.of_one_wheel:
            given["wheel"] = self.wheel, wheels
        for key, (value, most) in given.items():
            there = not most or 0 <= value < most
            require_of_effect(there, self, f"there is no {key} {value}", f"0 to {most - 1}")
        what = f"errors of a sensor do not follow {self.driver!r}"
        advice = "choose a driver of rates, momenta, commands or time"
        require_of_effect(knows(self.place, self.driver), self, what, advice)
        square = ("diagonal", "scalar", "cross", "hollow")
        good = self.form not in square or rows == columns
        good = good and not (self.form == "hollow" and rows == 1)
        good = good and not (self.form == "cross" and rows and rows != 3)
        what = f"{rows} rows and {columns} columns of C have no form {self.form!r}"
        require_of_effect(good, self, what, "choose full, column or entry")

    def _labels(self, rows: tuple[str, ...], columns: tuple[str, ...]) -> tuple[str, ...]:
        """Of the coefficients."""
        if not rows or not columns:
            return ()
        if self.form == "entry":
            row, column = rows[self.row], columns[self.column]
            return (_entry(row, column) if len(columns) > 1 else rows[0],)
        if self.form in ("diagonal", "scalar", "cross", "column") or len(columns) == 1:
            return rows
        every = self.form == "full"
        return tuple(
            _entry(row, column)
            for i, row in enumerate(rows)
            for j, column in enumerate(columns)
            if every or i != j
        )

    def acts(self, hook):
        return hook == PLACES[self.place].hook

    def max_step(self, campaign):
        return None if self._driver.abrupt else math.inf

    def _of_driver(self, c: Array, d: Array) -> Array:
        """C d: (m,) of coefficients (k,) and a driver's values."""
        if self.form == "full":
            return fused_product(jnp.reshape(c, (-1, len(d))), d)
        if self.form == "hollow":
            beside = np.nonzero(~np.eye(len(d), dtype=bool))
            return fused_product(jnp.zeros((len(d), len(d))).at[beside].set(c), d)
        if self.form in ("diagonal", "scalar"):
            return c * d
        if self.form == "cross":
            return jnp.cross(c, d)
        return c * d[self.column]

    def _value(self, p, slew, t, state):
        """What acts at one instant (m,)."""
        told = self._driver.value(slew, t, state, self.wheel) - (self.middle or 0.0)
        acting = self._of_driver(p["c"], told * state.rate_B if self._driver.of_rate else told)
        if self.form == "entry":
            rows = 3 if PLACES[self.place].rows != "wheels" else len(state.wheel_momentum)
            acting = jnp.zeros(rows).at[self.row].set(acting[0])
        return acting

    # Hooks may be called whether they act or not.
    def body_torque(self, p, slew, t, state):
        if not self.acts("body_torque"):
            return super().body_torque(p, slew, t, state)
        torque = self._value(p, slew, t, state)
        if PLACES[self.place].rows == "inertial":
            return quaternion.to_body(state.attitude, torque)
        return torque

    def wheel_torque(self, p, slew, t, state):
        if not (p and self.acts("wheel_torque")):
            return super().wheel_torque(p, slew, t, state)
        return self._value(p, slew, t, state)

    def _along(self, p, slew, trajectory):
        """What acts along a slew (n, m)."""
        nothing = jnp.zeros(3)

        def at(t, attitude, rate_B, momentum, told):
            own = jnp.zeros(0), jnp.eye(3), nothing, nothing, told
            return self._value(p, slew, t, State(attitude, rate_B, momentum, *own))

        motion = trajectory.attitude, trajectory.rate_B, trajectory.wheel_momentum
        return jax.vmap(at)(trajectory.time, *motion, trajectory.inputs)

    def rate_output(self, p, slew, trajectory, rate_S):
        if not self.acts("rate_output"):
            return rate_S
        error = self._along(p, slew, trajectory)
        # Three axes have an error each; others that of the body's axes along them.
        return rate_S + (error if rate_S.shape[1] == 3 else error @ slew.rate_axes.T)

    def attitude_output(self, p, slew, trajectory, attitude):
        if not self.acts("attitude_output"):
            return attitude
        turn = self._along(p, slew, trajectory)
        return quaternion.turned(attitude, turn)

    def momentum_output(self, p, slew, trajectory, momentum):
        acts = p and self.acts("momentum_output")
        return momentum + self._along(p, slew, trajectory) if acts else momentum


def middle_of(values: np.ndarray) -> float:
    """From where an input of one number is counted: its mean, to a thousandth of its spread.

    >>> middle_of(np.array([293.0, 294.0001])), middle_of(1.7e9 + np.arange(8.0))
    (293.5, 1700000003.5)
    """
    spread = float(np.ptp(values))
    digits = 3 - int(np.floor(np.log10(spread))) if spread else 15
    return round(float(np.mean(values)), digits)


def knows(place: str, driver: str) -> bool:
    """Whether what acts at a place can follow a driver: sensors see neither field nor position.

    >>> knows("body_torque", "field"), knows("rate_error", "field")
    (True, False)
    """
    return not (driver_of(driver).needs and PLACES[place].hook.endswith("output"))


def _entry(row: str, column: str) -> str:
    """The name of an entry of C.

    >>> _entry("x", "y"), _entry("wheel 1", "wheel 2")
    ('xy', 'wheel 1_wheel 2')
    """
    return f"{row}{column}" if max(len(row), len(column)) < 2 else f"{row}_{column}"


def _labels(kind: str, campaign) -> tuple[str, ...]:
    """Components of a place or of a driver."""
    if kind == "one":
        return ("",)
    return tuple(wheel.name for wheel in campaign.wheels) if kind == "wheels" else _BODY


def _typical(unit: Mapping[str, int], campaign) -> float:
    """Size of what has this unit, from the motion."""
    rate, duration, inertia = campaign.scale_of_motion()
    torque, field, time = (unit.get(name, 0) for name in ("N m", "T", "s"))
    size = (inertia * rate / duration) ** torque * NUMERICS.formula_field**field
    return size * (duration if time > 0 else 1.0 / rate) ** time


def _part_of(kind: str, index: int) -> str:
    return {"one": "", "wheels": f"wheel {index + 1}"}.get(kind, _BODY[index % 3])


def _unit(place: Mapping[str, int], driver: Mapping[str, int]) -> str:
    """Unit of a coefficient: of what acts, over the driver's.

    >>> _unit({"N m": 1}, {"N m": 1, "s": 1}), _unit({"N m": 1}, {"s": -2})
    ('1/s', 'N m s^2')
    """
    names = dict.fromkeys([*place, *driver])
    powers = {name: place.get(name, 0) - driver.get(name, 0) for name in names}

    def text(sign: int) -> str:
        parts = [
            name if n == 1 else f"{name if ' ' not in name else '(' + name + ')'}^{n}"
            for name, power in powers.items()
            if (n := sign * power) > 0
        ]
        return " ".join(parts)

    above, below = text(1), text(-1)
    if not below:
        return above
    return f"{above or '1'}/{f'({below})' if ' ' in below else below}"
