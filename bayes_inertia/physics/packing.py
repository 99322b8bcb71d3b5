"""A campaign as padded arrays for compiled code: integration grids, measurements, masks, noise.

Slews of different length are padded to one shape (steps of zero length, weights of zero), so that
one compiled function serves all slews, and all campaigns of similar size. Large programs are
compiled for one slew and run for each: how many slews a campaign has decides nothing, and rows,
fixes and grid points are rounded up to `padded_size`. A campaign of another length then runs the
programs of the last one.
"""

# The arrays are NumPy's until all slews are stacked, then JAX's, which is what the types say.
# mypy: disable-error-code="arg-type"

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import axes_to_body
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.slew import Slew, between_fix_groups
from bayes_inertia.errors import CampaignError
from bayes_inertia.maths.device_arrays import filled, on_device, padded_size, repeated
from bayes_inertia.physics.channels import Channel, Readings
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.slew_context import Environment, SlewContext
from bayes_inertia.physics.slew_input import InputRows, SlewInput, Start
from bayes_inertia.physics.slow_tachometers import FreeMomentum


class Telemetry(NamedTuple):
    """Measurements of one slew of n rows (leading axis: slews, when stacked).

    Parameters
    ----------
    sample : (n,) array of int
        Index of each row in the integration grid.
    readings : tuple of Readings
        Of each channel of the model.
    tachometer_shapes : (grid, shapes) array
        Orthonormal shapes of tachometer noise, slow ones and those near the nutation.
    """

    sample: Array
    readings: tuple[Readings, ...]
    tachometer_shapes: Array


class Arrays(NamedTuple):
    """All slews of a campaign, stacked.

    Parameters
    ----------
    slews : SlewInput
        What the simulator is given.
    telemetry : Telemetry
        What was measured.
    reference : Start
        Where nuisances are counted from.
    """

    slews: SlewInput
    telemetry: Telemetry
    reference: Start


def refined_grid(time: np.ndarray, max_step: float) -> tuple[np.ndarray, np.ndarray]:
    """Integration times that contain every sample time.

    `time` (n,) [s]. `max_step`: longest step of the grid [s]. Returns `grid` (m,) [s]; `sample`
    (n,): index of each sample in the grid.

    Examples
    --------
    >>> refined_grid(np.array([0.0, 1.0, 1.5]), 0.5)
    (array([0. , 0.5, 1. , 1.5]), array([0, 2, 3]))
    """
    most = NUMERICS.most_grid_points
    wanted = np.maximum(1.0, np.ceil(np.diff(time) / max_step - 1e-9))
    if not len(time) < most:
        what, advice = f"a slew has {len(time):,} rows", f"give fewer than {most:,.0f} a slew"
        raise CampaignError(what, where="time column", advice=advice)
    if not wanted.sum() < most:
        what = f"integrating {time[-1] - time[0]:.6g} s in steps of {max_step:.3g} s is too much"
        advice = "check the unit of the rates and of time: such fast rotation is not plausible"
        raise CampaignError(what, where="rate columns", advice=advice)
    parts = wanted.astype(int)
    sample = np.concatenate([[0], np.cumsum(parts)])
    steps = np.repeat(np.diff(time) / parts, parts)
    grid = np.concatenate([[time[0]], time[0] + np.cumsum(steps)])
    grid[sample] = time
    return grid, sample


def longest_step(campaign: Campaign) -> float:
    """Grid step on which straight lines between the rows follow the campaign's fastest rotation.

    That is 0.05 rad of it: for sensors that look back between rows, and for integration by
    Runge-Kutta's fourth order. The fastest rotation is twice the 95th percentile of the readings,
    so that a few glitches do not refine the whole campaign.

    Returns: A power of two [s], so that the grid does not change with every reading.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> longest_step(small_campaign())
    0.5
    """
    seen = campaign.with_body_rates
    readings = np.concatenate([s.complete_rates()[1] for s in seen.slews])
    rates = np.linalg.norm(readings @ axes_to_body(seen.gyro.axes).T, axis=1)
    high = float(np.quantile(rates, NUMERICS.largest_quantile)) if len(rates) else 0.0
    fastest = max(NUMERICS.fastest_over_quantile * high, 1e-9)
    return float(2.0 ** np.floor(np.log2(NUMERICS.straight_turn / fastest)))


def pack(
    campaign: Campaign,
    channels: Sequence[Channel],
    *,
    max_step: float | None = None,
    half_periods: np.ndarray | None = None,
    rows_per_step: int = 1,
    inputs: Collection[str] = (),
    free: FreeMomentum | None = None,
) -> Arrays:
    """The campaign as stacked, padded arrays.

    `max_step`: longest step of the grid [s]; by default what resolves the fastest rotation.
    `half_periods` (slews, shapes): of the shapes of tachometer noise (measured drive).
    `rows_per_step`: grid points that one integration step spans; the grid is padded to a multiple
    of it. `inputs`: names of the inputs that effects ask for; the grid has a point wherever one of
    them jumps or bends. `free`: what is free of the momentum between readings of slow tachometers;
    its shapes come after those of the noise.

    Examples
    --------
    >>> from bayes_inertia.physics.channels import channels_of
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> telemetry = pack(small_campaign(), channels_of(small_campaign(), "commanded")).telemetry
    >>> telemetry.readings[0].values.shape
    (3, 64, 3)
    """
    step = longest_step(campaign) if max_step is None else max_step
    grids = [_grid(slew, step, inputs) for slew in campaign.slews]
    multiple = rows_per_step * -(-NUMERICS.row_multiple // rows_per_step)
    n_grid = _next_multiple(max(len(g) for g, _ in grids), multiple)
    n_rows = _next_multiple(max(len(s.time) for s in campaign.slews), multiple)
    slews = [_slew_input(campaign, i, *grid, n_grid, inputs) for i, grid in enumerate(grids)]
    if half_periods is None:
        half_periods = np.zeros((len(grids), 0), int)
    triples = zip(campaign.slews, grids, half_periods, strict=True)
    shapes = [_shapes_on_grid(s, len(grid), own) for s, (grid, _), own in triples]
    if free is not None:
        for i, slew in enumerate(campaign.slews):
            momentum, of_knots = free.on_grid(slew, grids[i][0])
            slews[i] = slews[i]._replace(momentum=repeated(momentum, n_grid, 0))
            # White noise of few readings has no more shapes than these.
            told = half_periods[i] < len(slew.time[np.isfinite(slew.wheel_momentum).all(axis=1)])
            shapes[i] = np.concatenate([shapes[i] * told, of_knots], axis=1)
    readings = [_stacked_readings(campaign, channel, n_rows) for channel in channels]
    shapes = [repeated(shape, n_grid, 0) for shape in shapes]
    telemetry = [
        Telemetry(repeated(sample, n_rows, 0), tuple(x[i] for x in readings), shapes[i])
        for i, (_, sample) in enumerate(grids)
    ]
    starts = [_reference(campaign, channels, slew) for slew in campaign.slews]
    every = [Arrays(*parts) for parts in zip(slews, telemetry, starts, strict=True)]
    return jax.tree.map(lambda *of_slews: on_device(np.stack(of_slews)), *every)


def _grid(slew: Slew, step: float, inputs: Collection[str]) -> tuple[np.ndarray, np.ndarray]:
    """The grid (m,) of a slew from its first row [s], and where its rows stand in it (n,)."""
    time = slew.time - slew.time[0]
    if not inputs:
        return refined_grid(time, step)
    edges = np.concatenate([_stream(slew, name).pieces()[0] for name in inputs]) - slew.time[0]
    edges = np.unique(edges[(edges > 0.0) & (edges < time[-1])])
    shortest = NUMERICS.shortest_step * float(np.abs(slew.time).max())
    after = np.searchsorted(time, edges)
    apart = np.minimum(edges - time[after - 1], time[after] - edges) > shortest
    apart &= np.append(True, np.diff(edges) > shortest)[: len(edges)]
    points = np.sort(np.concatenate([time, edges[apart]]))
    grid, at = refined_grid(points, step)
    return grid, at[np.searchsorted(points, time)]


def _stream(slew: Slew, name: str) -> InputStream:
    """An input of a slew, or `CampaignError`."""
    stream = (slew.inputs or {}).get(name)
    if stream is None:
        what = f"an effect asks for the input {name!r}, which the slew does not have"
        advice = "give it as Slew(inputs={name: InputStream(...)}), or leave the effect out"
        raise CampaignError(what, where=f"slews.{slew.name}.inputs", advice=advice)
    return stream


def _on_steps(slew: Slew, name: str, grid: np.ndarray, n: int) -> InputRows:
    """An input as a line over each step of the grid (m,), padded to n steps."""
    edges, first, last = _stream(slew, name).pieces()
    begin, end = slew.time[0] + grid, slew.time[0] + np.append(grid[1:], grid[-1])
    piece = np.searchsorted(edges, 0.5 * (begin + end), side="right")
    lower = edges[np.maximum(piece - 1, 0)] if len(edges) else begin
    upper = edges[np.minimum(piece, len(edges) - 1)] if len(edges) else end
    width = np.where(upper > lower, upper - lower, 1.0)

    def at(time: np.ndarray) -> np.ndarray:
        share = np.clip((time - lower) / width, 0.0, 1.0)[:, None]
        return first[piece] + share * (last[piece] - first[piece])

    return InputRows(repeated(at(begin), n, 0), repeated(at(end), n, 0))


def _next_multiple(n: int, multiple: int) -> int:
    return -(-n // multiple) * multiple


def on_grid(slew: Slew, key: str, grid: np.ndarray, width: int) -> np.ndarray:
    """What a slew has of this name on a grid (m,) from its first row [s], (m, width)."""
    values = getattr(slew, key)
    if values is None or not width:
        return np.zeros((len(grid), width))
    time = slew.time - slew.time[0]
    return np.stack([bridged(grid, time, column) for column in values.T], -1)


def bridged(grid: np.ndarray, time: np.ndarray, column: np.ndarray) -> np.ndarray:
    """One column on the grid, straight across its gaps; zero where nothing was measured.

    `grid` (m,) [s]; `time` (n,) [s]; `column` (n,). Returns (m,).

    Examples
    --------
    >>> bridged(np.array([1.0]), np.array([0.0, 1.0, 2.0]), np.array([3.0, np.nan, 5.0])).tolist()
    [4.0]
    """
    given = np.isfinite(column)
    return np.interp(grid, time[given], column[given]) if given.any() else np.zeros(len(grid))


def _slew_input(
    campaign: Campaign, index: int, grid, sample, n_grid: int, inputs: Collection[str]
) -> SlewInput:
    slew, wheels = campaign.slews[index], len(campaign.wheels)
    held = np.searchsorted(sample, np.arange(len(grid)), side="right") - 1
    torque = np.zeros((len(grid), wheels)) if slew.wheel_torque is None else slew.wheel_torque[held]
    step = np.append(np.diff(grid), 0.0)
    boresight = campaign.star_tracker.boresight_B if campaign.star_tracker else (0.0, 0.0, 1.0)
    context = SlewContext(
        index=np.array(index),
        slews=np.array(len(campaign.slews)),
        start=np.array(slew.start),
        middle=np.array(0.5 * sum(campaign.span)),
        time=repeated(grid, n_grid, 0),
        step=filled(step, n_grid, 0),
        torque=repeated(torque, n_grid, 0),
        wheel_axes_B=campaign.wheel_axes_B,
        spin_inertia=campaign.spin_inertias,
        boresight_B=np.array(boresight),
        rate_axes=campaign.rate_sensor.axes if campaign.rate_sensor else np.eye(3),
        **_lost_commands(campaign, slew, held, n_grid),
        fix_group=repeated(np.searchsorted(between_fix_groups(slew, slew.fixes), grid), n_grid, 0),
    )
    environment = (repeated(on_grid(slew, key, grid, 3), n_grid, 0) for key in Environment._fields)
    momentum = repeated(on_grid(slew, "wheel_momentum", grid, wheels), n_grid, 0)
    given = {name: _on_steps(slew, name, grid, n_grid) for name in inputs} if inputs else None
    return SlewInput(context, momentum, Environment(*environment), inputs=given)


def _lost_commands(campaign: Campaign, slew: Slew, held: np.ndarray, n: int) -> dict:
    """Pieces of gaps in the commands, and sds there, on the grid; empty if nothing was lost."""
    if all(s.lost_command is None for s in campaign.slews):
        return {}
    pieces, sd = np.zeros(n, dtype=int), np.zeros((n, len(campaign.wheels)))
    if slew.lost_command is not None and slew.lost_command_sd is not None:
        pieces[: len(held)] = slew.lost_command[held]
        sd[: len(held)] = np.where(pieces[: len(held), None] > 0, slew.lost_command_sd[held], 0.0)
    return {"lost_command": pieces, "lost_command_sd": sd}


def _stacked_readings(campaign: Campaign, channel: Channel, n_rows: int) -> list[Readings]:
    """One channel's readings of each slew, padded to one length."""
    of_slews = [channel.readings(campaign, slew) for slew in campaign.slews]
    n = n_rows
    if not channel.stream.is_series:
        n = _next_multiple(max(len(readings.row) for readings in of_slews), NUMERICS.fix_multiple)

    def padded(values: np.ndarray, blank: Any) -> np.ndarray:
        spare = np.broadcast_to(blank, (n - len(values), *values.shape[1:]))
        return np.concatenate([values, spare.astype(values.dtype)])

    def last(row: np.ndarray) -> int:
        return row[-1] if channel.stream.is_series else 0

    return [
        Readings(padded(values, channel.blank), padded(valid, False), padded(row, last(row)))
        for values, valid, row in of_slews
    ]


def _shapes_on_grid(slew: Slew, n: int, half_periods: np.ndarray) -> np.ndarray:
    """Orthonormal shapes (n, shapes) of noise on the grid, of so many half periods each."""
    # The mean of few readings errs most: the wheel that is read least decides.
    given = slew.wheel_momentum is not None and np.isfinite(slew.wheel_momentum).sum(axis=0)
    read = max(1, int(np.min(given, initial=len(slew.time))))
    fraction = (np.arange(n) + 0.5) / n
    shapes = np.cos(np.pi * half_periods * fraction[:, None])
    return shapes * np.where(half_periods == 0, 1.0, np.sqrt(2.0)) / np.sqrt(read)


def _reference(campaign: Campaign, channels: Sequence[Channel], slew: Slew) -> Start:
    """Rough start state from the first readings; what is not measured starts from zero."""
    known: dict[str, np.ndarray] = {}
    for channel in channels:
        known = channel.start(campaign, slew) | known
    still = Start(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(len(campaign.wheels)))
    return still._replace(**known)


class Nuisances(NamedTuple):
    """Whitened nuisances of one slew.

    Parameters
    ----------
    start : (n_start,) array
        Start rate and attitude, then start momentum or tachometer shapes.
    coefficients : tuple of (k,) arrays
        Of each effect, or empty where all effects have a fixed shape.
    """

    start: Array
    coefficients: tuple[Array, ...]


class NuisanceScale(NamedTuple):
    """Prior sd that turns whitened nuisances into physical ones.

    Parameters
    ----------
    local : (n_start,) array
        Of one slew's nuisances without coefficients [rad/s, rad, N m s].
    bias : (axes,) array
        Of the rate bias [rad/s].
    """

    local: Array
    bias: Array


# What a slew's context holds at each grid point.
_ON_GRID = ("time", "step", "torque", "lost_command", "lost_command_sd", "fix_group")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Data:
    """All arrays of a model.

    Parameters
    ----------
    arrays : Arrays
        Inputs and measurements, with the slews as leading axis.
    sensors : tuple
        Constants of each channel.
    scale : NuisanceScale
        Prior sd of the nuisances.
    """

    arrays: Arrays
    sensors: tuple[Any, ...]
    scale: NuisanceScale

    @cached_property
    def pieces(self) -> tuple[Data, ...]:
        """Each slew alone (the leading axis stays), its last row and fix repeated up to a size."""
        arrays = jax.tree.map(np.asarray, self.arrays)
        slews = with_longer_grids(arrays.slews, _padded)
        padded = Arrays(slews, jax.tree.map(_padded, arrays.telemetry), arrays.reference)
        each = range(len(slews.momentum))
        alone = (jax.tree.map(lambda x, k=k: on_device(x[k : k + 1]), padded) for k in each)
        return tuple(Data(of_slew, self.sensors, self.scale) for of_slew in alone)

    @cached_property
    def contexts(self) -> SlewContext:
        """The contexts of all slews, their grids padded."""
        alone = (piece.arrays.slews.context for piece in self.pieces)
        return jax.tree.map(lambda *rows: np.concatenate(rows), *alone)


def _padded(rows: Any) -> Any:
    return repeated(rows, padded_size(rows.shape[1])) if rows.shape[1] else rows


def with_longer_grids(slews: SlewInput, longer: Callable[[Any], Any]) -> SlewInput:
    """Slews whose grids go on at their end, where time stands still: `longer` of each array."""
    given = {key: getattr(slews.context, key) for key in _ON_GRID}
    on_grid = {key: longer(rows) for key, rows in given.items() if rows is not None}
    return slews._replace(
        context=slews.context._replace(**on_grid),
        momentum=longer(slews.momentum),
        environment=jax.tree.map(longer, slews.environment),
        inputs=jax.tree.map(longer, slews.inputs),
    )
