"""Formulas for what has no name: every term of a grammar weighed at one fit.

A term says what acts, in proportion to what, and which components follow which (`Formula`). All
terms of one place and one driver are columns of one matrix of coefficients: one projection of
these columns weighs them all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.hardware import RateSensor
from bayes_inertia.diagnosis.hypothesis_table import log_evidence_of_columns
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.linear_system import LinearModel
from bayes_inertia.diagnosis.result import FormulaSearch, FormulaTerm
from bayes_inertia.diagnosis.torque_response import TorqueResponse
from bayes_inertia.inference.likelihood import of_all_slews, of_slew
from bayes_inertia.maths.device_arrays import repeated
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects.formula import (
    PLACES,
    Formula,
    Place,
    driver_of,
    drivers_known,
    knows,
    middle_of,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE
from bayes_inertia.physics.slew_context import SlewContext, State


def response_hook(place: Place) -> str:
    """The hook of the linear response that a place's hook of an effect is."""
    return "delivered_torque" if place.hook == "wheel_torque" else place.hook


def search_formulas(
    response: TorqueResponse, linear: LinearModel, named: Collection[str] = ()
) -> FormulaSearch:
    """Weigh every term of the grammar at a fit; what it holds is projected off.

    `named`: effects that have a name: a term that one of them can make is that effect.
    """
    effects = [_independent(linear, m.columns) for m in linear.members if m.name in named]
    return weighed(projected(block, linear, effects) for block in blocks(response))


@array_dataclass
class Block:
    """All coefficients of one place and one driver.

    Parameters
    ----------
    formula : Formula
        All of C.
    shape : tuple of int
        Rows and columns of C.
    columns : (slews, numbers, rows columns) array
        Changes of the whitened residuals, in units of the prior sd of a coefficient.
    """

    formula: Formula
    shape: tuple[int, int]
    columns: np.ndarray


# What effects of the library follow with the same freedom: constant_torque, wheel_torque_gain with
# wheel_misalignment, rate_bias and rate_bias_drift.
DRIVEN_BY_LIBRARY = (
    ("body_torque", "constant"),
    ("body_torque", "wheel_commands"),
    ("rate_error", "constant"),
    ("rate_error", "campaign_time"),
)


# The diagonal of its C is K, which is fitted anyway.
_OF_K = ("rate_error", "rate")


def told_blocks(response: TorqueResponse) -> Iterator[Block]:
    """Torques on the body and errors of the rates that follow what a sentence can say."""
    told = (d for d in drivers(response) if driver_of(d.key).words)
    return blocks(response, told, ("body_torque", "rate_error"))


def blocks(
    response: TorqueResponse,
    followed: Iterable[Followed] | None = None,
    places: Collection[str] = tuple(PLACES),
) -> Iterator[Block]:
    """Driver by driver and place by place."""
    model = response.estimate.model
    for key, wheel, values, middle in followed or drivers(response):
        rms = float(np.sqrt(np.mean(values**2, axis=(0, 1)).max()))
        for name in (p for p in places if rms > 0.0 and _allowed(p, key, model)):
            place = PLACES[name]
            form = "hollow" if (name, key) == _OF_K else "full"
            formula = Formula(name, key, form, wheel=wheel, rms=rms, middle=middle or None)
            rows = len(model.campaign.wheels) if place.rows == "wheels" else 3
            columns = _columns(response, name, place.size(model.campaign) / rms * values, rows)
            if columns.any():
                yield Block(formula, (rows, values.shape[-1]), columns)


class Followed(NamedTuple):
    """What a disturbance may follow, along all slews.

    `key` of the driver, `wheel` where it is that of one; `values` (slews, n, k) on the integration
    grid, SI units, less `middle`.
    """

    key: str
    wheel: int
    values: np.ndarray
    middle: float


def drivers(response: TorqueResponse) -> Iterator[Followed]:
    """Everything in proportion to which a disturbance may be: one list for all that ask."""
    campaign = response.estimate.model.campaign
    asked = tuple(
        (key, wheel)
        for key in drivers_known(campaign)
        for wheel in range(len(campaign.wheels) if driver_of(key).of_one_wheel else 1)
    )
    for (key, wheel), values in zip(asked, _along(response, asked), strict=True):
        driver, middle = driver_of(key), 0.0
        if driver.inputs and np.ptp(values, (0, 1)).max() <= LIMITS.stuck * np.abs(values).max():
            continue
        if driver.inputs and values.shape[-1] == 1:
            # Counted from zero a temperature would not differ from a constant.
            middle = middle_of(values)
        driven = values - middle
        if driver.of_rate:
            driven = driven * response.rate_B
        yield Followed(key, wheel, driven, middle)


def _allowed(place: str, key: str, model: Model) -> bool:
    """Whether a place goes with a driver in a campaign."""
    driver, campaign = driver_of(key), model.campaign
    if not knows(place, key):
        return False
    if PLACES[place].rows == "wheels":
        # Where tachometers drive the model, torques on the wheels do nothing.
        acts = bool(campaign.wheels) and model.structure.drive == "commanded"
        return acts and not (driver.of_one_wheel or driver.needs)
    if place == "rate_error":
        sensor = campaign.rate_sensor
        if sensor is None or key == "wheel_rates":  # The body's rates once more.
            return False
        # Of other axes K is no diagonal of C: free once more it would not be known.
        return (place, key) != _OF_K or _is_along_body_axes(sensor)
    turns = place == "inertial_torque" and driver.columns not in ("one", "wheels")
    return not (turns or driver.of_rate)


def _is_along_body_axes(sensor: RateSensor) -> bool:
    """Whether a gyro's three axes are those of the body, in either sense."""
    return sensor.axes.shape == (3, 3) and np.allclose(np.abs(sensor.axes), np.eye(3), atol=1e-9)


def _along(response: TorqueResponse, asked: tuple[tuple[str, int], ...]) -> tuple[np.ndarray, ...]:
    """Drivers, of wheels, along all slews (slews, n, k) of the integration grid."""
    data = response.estimate.model.data
    slews, n = response.time.shape
    contexts, environment = data.contexts, data.arrays.slews.environment
    path = response.attitude, response.rate_B, response.wheel_momentum
    told = dict.fromkeys(name for key, _ in asked for name in driver_of(key).inputs)
    inputs = [_input_along(response, name) for name in told]
    shape = contexts.time.shape
    padded = [repeated(np.asarray(x), shape[1]) for x in (*path, *environment, *inputs)]
    attitude, rate_B, momentum, field, position, *own = padded
    eye = np.broadcast_to(np.eye(3), (*shape, 3, 3))
    devices = dict(zip(told, own, strict=True))
    states = State(attitude, rate_B, momentum, np.zeros((*shape, 0)), eye, field, position, devices)  # type: ignore[arg-type]
    parts = [_values(asked, *of_slew(k, (contexts, states))) for k in range(slews)]
    return of_all_slews(parts, (n,) * len(asked))


# Compiled without optimization: called once for each slew.
@partial(KeptProgram, compiler_options={"xla_backend_optimization_level": 0})
def _values(
    asked: tuple[tuple[str, int], ...], contexts: SlewContext, states: State
) -> tuple[Array, ...]:
    """Drivers (slews, n, k), by key and wheel."""

    def of_slew(slew: SlewContext, states: State) -> tuple[Array, ...]:
        def at(t: Array, state: State) -> tuple[Array, ...]:
            return tuple(driver_of(key).value(slew, t, state, wheel) for key, wheel in asked)

        return jax.vmap(at)(slew.time, states)

    return jax.vmap(of_slew)(contexts, states)


def _input_along(response: TorqueResponse, name: str) -> np.ndarray:
    """A stream of `Slew.inputs` (slews, n, k) on the integration grid."""
    found = []
    for slew, grid in zip(response.estimate.model.campaign.slews, response.time, strict=True):
        edges, first, last = slew.inputs[name].pieces()  # type: ignore[index]
        # Each edge twice, with the value before it and the one after it.
        bends, at = np.repeat(edges, 2), slew.time[0] + grid
        values = np.hstack([last[:-1], first[1:]]).reshape(-1, first.shape[1])
        if not len(edges):
            bends, values = np.zeros(1), first
        found.append(np.stack([np.interp(at, bends, x) for x in values.T], -1))
    return np.stack(found)


def _columns(response: TorqueResponse, place: str, values: np.ndarray, rows: int) -> np.ndarray:
    """Changes of the residuals (slews, numbers, rows k) by all coefficients."""
    unit = np.einsum("snk,ij->snijk", values, np.eye(rows))
    unit = unit.reshape(*values.shape[:2], rows, -1)
    if PLACES[place].rows == "inertial":
        turn = Rotation.from_quat(response.attitude.reshape(-1, 4)).as_matrix()
        turn = turn.reshape(*response.attitude.shape[:2], 3, 3)
        unit = np.einsum("snji,snjk->snik", turn, unit)
    hook = response_hook(PLACES[place])
    if hook == "rate_output" and response.estimate.model.n_base != N_BASE:
        # As `Formula` has it: along each of other than three axes the error of the body's.
        unit = response.estimate.model.campaign.gyro.axes @ unit
    return response.changes({hook: unit})


class Projected(NamedTuple):
    """The coefficients of a block, everything fitted projected off.

    Parameters
    ----------
    block : Block
        The block.
    matrix : (c, c) array
        Gram matrix of its columns.
    gradient : (c,) array
        Their products with the residuals.
    named : sequence of (c, r) arrays
        Their products with independent columns of each effect that has a name.
    """

    block: Block
    matrix: np.ndarray
    gradient: np.ndarray
    named: Sequence[np.ndarray] = ()

    def has_a_name(self, basis: np.ndarray) -> bool:
        """Whether one effect can make a form (c, coefficients) of the block."""
        least = LIMITS.same_effect * np.trace(basis.T @ self.matrix @ basis)
        return any(np.sum((basis.T @ cross) ** 2) > least for cross in self.named)


def _independent(linear: LinearModel, columns: np.ndarray) -> np.ndarray:
    """Combinations (c, r) of an effect's columns, orthonormal once everything fitted is projected
    off; what that leaves nothing of is out.
    """
    powers, directions = np.linalg.eigh(linear.system.matrix[np.ix_(columns, columns)])
    kept = powers > LIMITS.jitter * np.sum(linear.columns[..., columns] ** 2)
    chosen = np.zeros((len(linear.system.matrix), np.count_nonzero(kept)))
    chosen[columns] = directions[:, kept] / np.sqrt(powers[kept])
    return chosen


def projected(block: Block, linear: LinearModel, named: Sequence[np.ndarray] = ()) -> Projected:
    """Project everything fitted off a block."""
    signal = linear.projected(block.columns).repeated()
    cross = [signal.cross[0] @ effect for effect in named]
    return Projected(block, signal.matrix[0, :, 0], signal.gradient[0], cross)


def weighed(projections: Iterable[Projected]) -> FormulaSearch:
    """Weigh all terms of all blocks."""
    found = [(own.block.formula.place, _weighed(own)) for own in projections]
    # Places, and drivers of a place, are each as probable.
    drivers_of = Counter(place for place, _ in found)
    terms = [
        term._replace(log_prior=term.log_prior - np.log(len(drivers_of) * drivers_of[place]))
        for place, terms in found
        for term in terms
    ]
    return FormulaSearch(tuple(sorted(terms, key=lambda term: -term.log_weight)))


def _weighed(own: Projected) -> list[FormulaTerm]:
    """All terms of one place and driver; forms and members of a form are each as probable."""
    found = [(f, basis) for f, basis in _terms(own.block) if not own.has_a_name(basis)]
    members = Counter(formula.form for formula, _ in found)
    terms = []
    for formula, basis in found:
        value = log_evidence_of_columns(own.gradient @ basis, basis.T @ own.matrix @ basis)
        prior = -np.log(len(members) * members[formula.form])
        terms.append(FormulaTerm(formula, value, float(prior)))
    return terms


def _terms(block: Block) -> Iterator[tuple[Formula, np.ndarray]]:
    """Each form of a matrix of coefficients, and its basis (rows columns, coefficients)."""
    rows, columns = block.shape
    unit = np.eye(rows * columns).reshape(rows, columns, -1)
    whole = block.formula.form == "full"
    free = np.full((rows, columns), True) if whole else ~np.eye(rows, dtype=bool)
    yield block.formula, unit[free].T
    for i, j in np.argwhere(free).tolist():
        yield _form(block, "entry", row=i, column=j), unit[i, j][:, None]
    if columns > 1 and whole:
        for j in range(columns):
            yield _form(block, "column", column=j), unit[:, j].T
    kinds = PLACES[block.formula.place].rows, driver_of(block.formula.driver).columns
    if rows == columns > 1 and kinds[0] == kinds[1]:
        own = np.arange(rows)
        if whole:
            diagonal = unit[own, own].T
            yield _form(block, "diagonal"), diagonal
            yield _form(block, "scalar"), diagonal.sum(1, keepdims=True)
        if kinds[1] == "body":
            a, b = np.roll(own, -1), np.roll(own, 1)
            # c x d: row i is c_{i+1} d_{i+2} - c_{i+2} d_{i+1}.
            yield _form(block, "cross"), (unit[b, a] - unit[a, b]).T


def _form(block: Block, form: str, row: int = 0, column: int = 0) -> Formula:
    return replace(block.formula, form=form, row=row, column=column)
