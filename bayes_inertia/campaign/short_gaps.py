"""Torque commands lost in a few rows between smooth commands: a cubic fills them.

How wrong it may be is measured: the same curve across rows of the slew that were not lost. A step
of the commands inside a gap shows in its neighbours. The errors of all gaps of a slew add up in
quadrature, and are doubled. What rates and star tracker could tell is not filled. The noise of a
closed loop is no smooth curve: 1.5e-5 N m at 4 Hz turn a microsatellite, by one lost row, 20 times
the noise of its star tracker away.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.slew_parts import Channels, with_rows_at
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.gaps import missing_rows, unbroken_rows


def with_short_gaps_filled(
    channels: Channels, negligible: float
) -> tuple[Channels, list[tuple[Dirt, np.ndarray]]]:
    """Channels with rows for the commands that were lost, where a smooth curve is as good.

    `channels`: channels (n, width) by the name of `Slew`, with "wheel_torque" and "time"; NaN where
    no command was recorded. `negligible`: error of the wheels' momentum that does not matter [N m
    s]. Returns `channels`: the same where nothing is filled; else with new rows, NaN but for their
    time and commands; `dirt`: A record without slew and rows, and the times [s] before and after
    the gaps.

    Examples
    --------
    >>> time = np.delete(np.arange(60.0), 30)
    >>> given = {"time": time, "wheel_torque": time[:, None] * 1e-4}
    >>> filled, dirt = with_short_gaps_filled(given, 1e-6)
    >>> len(filled["time"]), filled["wheel_torque"][30].round(6).tolist(), dirt[0][0].treated
    (60, [0.003], 'modelled')
    """
    torque = channels["wheel_torque"]
    rows = np.flatnonzero(np.isfinite(torque).all(axis=1))
    at, commands = channels["time"][rows], torque[rows]
    before, step = missing_rows(at)
    gaps, errors = [], []
    usual: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]] = {}
    for k in before.tolist():
        nodes = _nodes(at[k - 1 : k + 3], step) if 0 < k < len(at) - 2 else None
        if nodes is not None:
            gaps.append((k, nodes))
            if tuple(nodes) not in usual:
                usual[tuple(nodes)] = _usual(at, commands, nodes)
            errors.append(
                _error_of_curve(commands[k - 1 : k + 3], nodes, step, *usual[tuple(nodes)])
            )
    order = np.argsort(errors)
    total = LIMITS.curve_error_safety * np.sqrt(np.cumsum(np.array(errors)[order] ** 2))
    accepted = order[total <= LIMITS.times_negligible * negligible]
    if not len(accepted):
        return channels, []
    ends = np.sort(np.array([at[gaps[i][0] + n] for i in accepted for n in (0, 1)]))
    count = sum(len(_lost(gaps[i][1])) for i in accepted)
    note = (
        f"commands of {count} lost row{'' if count == 1 else 's'} lie on a smooth curve through "
        f"their neighbours; momentum errs by less than {total[len(accepted) - 1]:.2g} N m s"
    )
    chosen = [gaps[i] for i in np.sort(accepted)]
    times = [at[k] + step * (_lost(nodes) - nodes[1]) for k, nodes in chosen]
    curves = [_weights(nodes) @ commands[k - 1 : k + 3] for k, nodes in chosen]
    channels = _with_commands(channels, np.concatenate(times), np.concatenate(curves), step)
    return channels, [(Dirt("gap", "torque", "", (), "modelled", note), ends)]


def _nodes(around: np.ndarray, step: float) -> np.ndarray | None:
    """Two rows before a gap and two after, counted in steps; None if too much is missing."""
    steps = (around - around[0]) / step
    nodes = np.round(steps).astype(int)
    whole = np.all(np.abs(np.diff(steps) - np.diff(nodes)) <= LIMITS.whole_step)
    near = (
        len(_lost(nodes)) <= LIMITS.most_rows_on_a_curve
        and nodes[3] <= 2 * LIMITS.most_rows_on_a_curve + 2
    )
    return nodes if whole and near and np.all(np.diff(nodes) > 0) else None


def _lost(nodes: np.ndarray) -> np.ndarray:
    return np.arange(nodes[1] + 1, nodes[2])


def _weights(nodes: np.ndarray) -> np.ndarray:
    """Weights of the four rows around a gap, in the cubic through them at the lost rows."""
    return np.vander(_lost(nodes).astype(float), 4) @ np.linalg.inv(np.vander(nodes * 1.0, 4))


def _bends(rows: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Deviation of four rows (..., 4, wheels) from a smooth change across the gap.

    Returns (..., 2 wheels): what the change across the gap exceeds that of the slopes beside it
    by, and the difference of these slopes over half the gap.
    """
    change = np.diff(rows, axis=-2)
    slopes = change / np.diff(nodes)[:, None]
    half = 0.5 * (nodes[2] - nodes[1])
    step = change[..., 1, :] - half * (slopes[..., 0, :] + slopes[..., 2, :])
    corner = half * (slopes[..., 2, :] - slopes[..., 0, :])
    return np.abs(np.concatenate([step, corner], axis=-1))


def _usual(
    at: np.ndarray, commands: np.ndarray, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rms error (wheels,) [N m s] of such gaps, and largest bends of smooth commands [N m]."""
    step = float(np.median(np.diff(at)))
    trials = unbroken_rows(at, int(nodes[3]), step)
    none = np.full(commands.shape[1], np.inf), np.zeros(2 * commands.shape[1])
    if len(trials) < LIMITS.fewest_trials:
        return none
    bends = _bends(commands[trials[:, None] + nodes], nodes)
    # The rounding of equal numbers is no bend.
    limit = (
        LIMITS.smooth_factor * np.quantile(bends, LIMITS.smooth_quantile, axis=0)
        + 1e-12 * np.abs(commands).max()
    )
    smooth = trials[(bends <= limit).all(axis=1), None]
    if len(smooth) < LIMITS.fewest_trials:
        return none
    errors = commands[smooth + _lost(nodes)] - _weights(nodes) @ commands[smooth + nodes]
    return step * np.sqrt(np.mean(np.square(errors.sum(axis=1)), axis=0)), limit


def _error_of_curve(
    rows: np.ndarray, nodes: np.ndarray, step: float, usual: np.ndarray, limit: np.ndarray
) -> float:
    """Momentum [N m s] by which the curve through four rows around a gap may be wrong."""
    bends = _bends(rows, nodes)
    unusual = np.where(bends > limit, bends, 0.0).reshape(2, -1).max(axis=0)
    hidden = 0.5 * len(_lost(nodes)) * step * unusual
    return float(np.linalg.norm(np.maximum(usual, hidden)))


def _with_commands(
    channels: Channels, times: np.ndarray, commands: np.ndarray, step: float
) -> Channels:
    """Channels with commands at increasing times, in rows that are there or new."""
    grown = with_rows_at(channels, times, step)
    grown["wheel_torque"][np.searchsorted(grown["time"], times - LIMITS.same_row * step)] = commands
    return grown
