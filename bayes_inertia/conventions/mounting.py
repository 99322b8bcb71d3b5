"""A rate sensor along axes that are no permutation of the stated ones: its frame is estimated.

From fixes: where the true rate is R times the stated one with a constant rotation R, the rotation
between two fixes is exactly R times the rotation that the stated rates integrate to, so that R is a
problem of Wahba's. Without fixes R follows from conservation of momentum: its free matrix of
inertia, F = J R, has R as its rotational part.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.conventions.candidates import axes_mistake
from bayes_inertia.conventions.hypothesis import Mistake
from bayes_inertia.conventions.laws import wheel_momentum_B
from bayes_inertia.conventions.linear_fit import worst
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.rotations import angle_of, composed, turned_back
from bayes_inertia.conventions.stale_bias import with_own_bias

# Two directions of rotation are told apart if the smaller holds this share of the larger's.
_SECOND_DIRECTION = 0.15
# Decimals of axes as they are proposed: a hundredth of a degree is better than they are known.
_DECIMALS = 4
# A rotation this close to a signed permutation [rad] is one, and a misaligned sensor.
_MISALIGNED = 0.15
_ROUNDS = 6
_RARITY = 5


def turned_sensor(misfits: Misfits, reading: Reading) -> list[Mistake]:
    """The rotation of the rate sensor's frame that the data themselves propose.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions as stated, perhaps with other mistakes mended.

    Returns
    -------
    list of Mistake
        One from the fixes, one from the wheels' momentum, as far as the telemetry tells.
    """
    axes = misfits.campaign.rate_sensor.axes
    words = "the rates are along other axes"
    rotations = [_from_fixes(misfits, reading), _from_momentum(misfits, reading)]
    return [
        axes_mistake(axes, np.round(axes @ rotation.T, _DECIMALS), _RARITY, words)
        for rotation in rotations
        if rotation is not None and not _whole(rotation) and not _whole(axes @ rotation.T)
    ]


def turned_beside_bias(misfits: Misfits, reading: Reading) -> list[Mistake]:
    """The rotation that the data propose where the rate bias is stale as well.

    Rotation and bias are estimated by turns.

    Parameters
    ----------
    misfits : Misfits
        The telemetry and its laws.
    reading : Reading
        Conventions as stated.

    Returns
    -------
    list of Mistake
        One at most.
    """
    best: list[Mistake] = []
    for _ in range(_ROUNDS):
        proposed = turned_sensor(misfits, reading)
        if not proposed:
            break
        mended = [with_own_bias(misfits, mistake.mend(reading)) for mistake in proposed]
        k = int(np.argmin([worst(misfits.of(m)) for m in mended]))
        best = [proposed[k]]
        back = reading.rate @ np.linalg.inv(mended[k].rate)
        reading = replace(reading, bias_B=back @ mended[k].bias_B)
    return best


def _whole(rotation: np.ndarray) -> bool:
    """Whether a rotation is a signed permutation but for a misalignment; those are tried anyway."""
    return bool(np.abs(rotation - np.round(rotation)).max() < _MISALIGNED)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix.

    Parameters
    ----------
    matrix : (3, 3) array
        Any matrix.

    Returns
    -------
    (3, 3) array
        A proper rotation.

    Examples
    --------
    >>> nearest_rotation(np.diag([2.0, 3.0, 0.5])).round(6).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    left, _, right = np.linalg.svd(matrix)
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def _from_fixes(misfits: Misfits, reading: Reading) -> np.ndarray | None:
    fixes = misfits.slews.fixes
    some = np.flatnonzero(fixes.sum(axis=1) >= 2)
    path = misfits.motion(reading).path
    seen, told = [], []
    for slew in some:
        rows = np.flatnonzero(fixes[slew])
        attitude = misfits.slews.attitude[slew, rows] @ reading.attitude.T
        seen.append(angle_of(composed(turned_back(attitude[:1]), attitude[1:])) / len(rows) ** 0.5)
        part = path[slew, rows]
        told.append(angle_of(composed(turned_back(part[:1]), part[1:])) / len(rows) ** 0.5)
    if not len(some):
        return None
    products = np.concatenate(seen).T @ np.concatenate(told)
    sizes = np.linalg.svd(products, compute_uv=False)
    if sizes[1] <= _SECOND_DIRECTION**2 * sizes[0]:
        return None
    return nearest_rotation(products)


def _from_momentum(misfits: Misfits, reading: Reading) -> np.ndarray | None:
    """R by turns: estimate F = J R with the path of the last R, and take the rotation in F."""
    slews = misfits.slews
    stored = wheel_momentum_B(misfits.told(reading))
    if stored is None or not reading.axes_B.shape[1]:
        return None
    rotation = np.eye(3)
    for _ in range(_ROUNDS):
        turned = replace(reading, rate=rotation @ reading.rate)
        moving = misfits.motion(turned)
        rate = np.einsum("snij,snj->sni", moving.to_start, moving.rate_B)
        columns = np.einsum("snia,snb->sniab", moving.to_start, moving.rate_B)
        columns = columns.reshape(*rate.shape, 9)
        target = -np.einsum("snij,snj->sni", moving.to_start, stored)
        weight = slews.valid[..., None]
        columns = _without_mean(columns, weight[..., None]).reshape(-1, 9)
        target = _without_mean(target, weight).reshape(-1)
        normal = columns.T @ columns
        if not normal.any():
            return None
        ridge = 1e-6 * np.trace(normal) / 9.0 * np.eye(9)
        prior = reading.inertia.ravel()
        free = prior + np.linalg.solve(normal + ridge, columns.T @ (target - columns @ prior))
        rotation = nearest_rotation(np.linalg.solve(reading.inertia, free.reshape(3, 3))) @ rotation
    return rotation


def _without_mean(rows: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Rows (S, N, ...) less their mean in each slew, zero where they do not count."""
    mean = (rows * weight).sum(axis=1, keepdims=True) / weight.sum(axis=1, keepdims=True)
    return (rows - mean) * weight
