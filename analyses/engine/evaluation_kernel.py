"""The yardstick of `evaluation_benchmark.py`: one posterior evaluation by hand, in numba.

The same marginal posterior as the package has, for commanded wheels and no effects: classical
Runge-Kutta from row to row, residuals, their squares, and their projection on the nuisances.
Walkers are the innermost loop of everything: the processor works on several at once.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(inline="always", fastmath=True)
def _slope(a, b, c, d, m0, m1, m2, g0, g1, g2, inv, w):
    """Rate of the quaternion's components, and the body rate."""
    n = 1.0 / np.sqrt(a * a + b * b + c * c + d * d)
    x, y, z, s = a * n, b * n, c * n, d * n
    tx, ty, tz = 2.0 * (y * m2 - z * m1), 2.0 * (z * m0 - x * m2), 2.0 * (x * m1 - y * m0)
    l0 = m0 - s * tx + (y * tz - z * ty) - g0
    l1 = m1 - s * ty + (z * tx - x * tz) - g1
    l2 = m2 - s * tz + (x * ty - y * tx) - g2
    p = inv[0, w] * l0 + inv[1, w] * l1 + inv[2, w] * l2
    q = inv[3, w] * l0 + inv[4, w] * l1 + inv[5, w] * l2
    r = inv[6, w] * l0 + inv[7, w] * l1 + inv[8, w] * l2
    da = 0.5 * (b * r - c * q + d * p)
    db = 0.5 * (c * p - a * r + d * q)
    dc = 0.5 * (a * q - b * p + d * r)
    dd = -0.5 * (a * p + b * q + c * r)
    return da, db, dc, dd, p, q, r


@numba.njit(fastmath=True, error_model="numpy")
def slew_kernel(
    attitude, momentum_N, offset, inverse, scale, bias, gained_B, step, rate, white_rate,
    columns, chi2, gradient, fix_of_row, fixes, white_fix, fix_columns,
    wheels, axes, spin, gained, start_wheel, momentum, white_momentum, momentum_columns,
):  # fmt: skip
    """Add one slew's squares (walkers,) and projections (k, walkers) for all walkers.

    Attitudes (4, walkers) are moved along the slew; `offset` (3, walkers) is the wheels' momentum
    at the start in body axes, `gained_B` (rows, 3) what the commands add.
    """
    walkers, n, k = attitude.shape[1], len(step), columns.shape[2]
    residual = np.empty((3 + wheels, walkers))
    turn = np.empty((3, walkers))
    for i in range(n):
        g = gained_B[i]
        for w in range(walkers):
            a, b, c, d = attitude[0, w], attitude[1, w], attitude[2, w], attitude[3, w]
            _, _, _, _, p, q, r = _slope(
                a, b, c, d, momentum_N[0, w], momentum_N[1, w], momentum_N[2, w],
                offset[0, w] + g[0], offset[1, w] + g[1], offset[2, w] + g[2], inverse, w,
            )  # fmt: skip
            residual[0, w] = white_rate[i, 0] * (rate[i, 0] - (p + bias[0, w]) / scale[0, w])
            residual[1, w] = white_rate[i, 1] * (rate[i, 1] - (q + bias[1, w]) / scale[1, w])
            residual[2, w] = white_rate[i, 2] * (rate[i, 2] - (r + bias[2, w]) / scale[2, w])
            for j in range(wheels):
                along = axes[0, j] * p + axes[1, j] * q + axes[2, j] * r
                predicted = start_wheel[j, w] + gained[i, j] - spin[j] * along
                residual[3 + j, w] = white_momentum[i, j] * (momentum[i, j] - predicted)
            for j in range(3 + wheels):
                chi2[w] += residual[j, w] ** 2
        for m in range(k):
            c0, c1, c2 = columns[i, 0, m], columns[i, 1, m], columns[i, 2, m]
            for w in range(walkers):
                gradient[m, w] += c0 * residual[0, w] + c1 * residual[1, w] + c2 * residual[2, w]
            for j in range(wheels):
                c0 = momentum_columns[i, j, m]
                for w in range(walkers):
                    gradient[m, w] += c0 * residual[3 + j, w]
        f = fix_of_row[i]
        if f >= 0:
            _compare_fix(attitude, fixes[f], white_fix, turn, chi2)
            for m in range(k):
                for j in range(3):
                    for w in range(walkers):
                        gradient[m, w] += fix_columns[f, j, m] * turn[j, w]
        if step[i] > 0.0:
            _advance(attitude, momentum_N, offset, inverse, g, gained_B[i + 1], step[i])


@numba.njit(fastmath=True, error_model="numpy")
def _compare_fix(attitude, fix, white, turn, chi2):
    for w in range(attitude.shape[1]):
        a, b, c, d = -attitude[0, w], -attitude[1, w], -attitude[2, w], attitude[3, w]
        x = d * fix[0] + fix[3] * a + (b * fix[2] - c * fix[1])
        y = d * fix[1] + fix[3] * b + (c * fix[0] - a * fix[2])
        z = d * fix[2] + fix[3] * c + (a * fix[1] - b * fix[0])
        s = d * fix[3] - a * fix[0] - b * fix[1] - c * fix[2]
        sign = 2.0 if s >= 0.0 else -2.0
        x, y, z = sign * x, sign * y, sign * z
        for j in range(3):
            turn[j, w] = white[j, 0] * x + white[j, 1] * y + white[j, 2] * z
            chi2[w] += turn[j, w] ** 2


@numba.njit(fastmath=True, error_model="numpy")
def _advance(attitude, momentum_N, offset, inverse, g, later, h):
    """One step of classical Runge-Kutta for all walkers."""
    mid0, mid1, mid2 = 0.5 * (g[0] + later[0]), 0.5 * (g[1] + later[1]), 0.5 * (g[2] + later[2])
    for w in range(attitude.shape[1]):
        a, b, c, d = attitude[0, w], attitude[1, w], attitude[2, w], attitude[3, w]
        m0, m1, m2 = momentum_N[0, w], momentum_N[1, w], momentum_N[2, w]
        o0, o1, o2 = offset[0, w], offset[1, w], offset[2, w]
        a1, b1, c1, d1, _, _, _ = _slope(
            a, b, c, d, m0, m1, m2, o0 + g[0], o1 + g[1], o2 + g[2], inverse, w
        )
        e = 0.5 * h
        a2, b2, c2, d2, _, _, _ = _slope(
            a + e * a1, b + e * b1, c + e * c1, d + e * d1, m0, m1, m2,
            o0 + mid0, o1 + mid1, o2 + mid2, inverse, w,
        )  # fmt: skip
        a3, b3, c3, d3, _, _, _ = _slope(
            a + e * a2, b + e * b2, c + e * c2, d + e * d2, m0, m1, m2,
            o0 + mid0, o1 + mid1, o2 + mid2, inverse, w,
        )  # fmt: skip
        a4, b4, c4, d4, _, _, _ = _slope(
            a + h * a3, b + h * b3, c + h * c3, d + h * d3, m0, m1, m2,
            o0 + later[0], o1 + later[1], o2 + later[2], inverse, w,
        )  # fmt: skip
        e = h / 6.0
        a += e * (a1 + 2.0 * (a2 + a3) + a4)
        b += e * (b1 + 2.0 * (b2 + b3) + b4)
        c += e * (c1 + 2.0 * (c2 + c3) + c4)
        d += e * (d1 + 2.0 * (d2 + d3) + d4)
        n = 1.0 / np.sqrt(a * a + b * b + c * c + d * d)
        attitude[0, w], attitude[1, w], attitude[2, w], attitude[3, w] = a * n, b * n, c * n, d * n
