"""A fit, linearised: whitened residuals with the columns of everything that was fitted, slew by slew.

Around the optimum the data are r = J x + (what is asked about) + e with unit noise e and Gaussian priors on
x. With H = J^T J + prior the residuals of a perfect model have the covariance 1 - J H^-1 J^T: fitting has
taken its share. What a scan or a torque history may claim must be measured against that.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.likelihood import padded_sensitivities
from bayes_inertia.inference.objective import N_BIAS, block_index, normal_equations, prior_rows
from bayes_inertia.inference.optimizer import Estimate
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.packing import CHANNELS


@array_dataclass
class Rows:
    """One channel's measurements: `part` of the flat numbers it holds, `time` (slews, rows) [s], `valid` (slews, rows, components)."""

    part: slice
    time: np.ndarray
    valid: np.ndarray

    def shaped(self, flat: np.ndarray) -> np.ndarray:
        """This channel of flat numbers (slews, numbers, ...) as (slews, rows, components, ...)."""
        return flat[:, self.part].reshape(*self.valid.shape, *flat.shape[2:])


@array_dataclass
class Linearised:
    """Residuals and columns of a fit, all channels one after the other.

    Attributes
    ----------
    residual : (slews, numbers), whitened with the noise as used; zero where nothing was measured.
    shared : (slews, numbers, s) derivatives with respect to the fitted parameters and the bias.
    local : (slews, numbers, m) derivatives with respect to each slew's own whitened nuisances (prior sd 1).
    prior_precision : (s,) of the shared unknowns. covariance : of (shared, all local) given the data.
    weight : (slews, numbers) sqrt of the discount: noise as stated over noise as used.
    channels : where each channel's numbers are.
    """

    residual: np.ndarray
    shared: np.ndarray
    local: np.ndarray
    prior_precision: np.ndarray
    covariance: np.ndarray
    weight: np.ndarray
    channels: dict[str, Rows]

    @property
    def columns(self) -> np.ndarray:
        """(slews, numbers, s + m): shared and local columns side by side."""
        return np.concatenate([self.shared, self.local], -1)

    def block(self, s: int) -> np.ndarray:
        """Covariance (s + m, s + m) of what slew s depends on."""
        index = block_index(self.shared.shape[-1], self.local.shape[-1], s)
        return self.covariance[np.ix_(index, index)]

    @property
    def valid(self) -> np.ndarray:
        """(slews, numbers) whether a number was measured."""
        return np.concatenate(
            [rows.valid.reshape(len(self.residual), -1) for rows in self.channels.values()], 1
        )

    def unfitted(self, signal: np.ndarray) -> np.ndarray:
        """What is left of a signal (slews, numbers) in the residuals after everything is fitted again, to first order."""
        columns, shared, m = self.columns, self.shared.shape[-1], self.local.shape[-1]
        pull = np.zeros(shared + len(signal) * m)
        for s, change in enumerate(signal):
            pull[block_index(shared, m, s)] += columns[s].T @ change
        found = self.covariance @ pull
        return np.stack(
            [
                change - columns[s] @ found[block_index(shared, m, s)]
                for s, change in enumerate(signal)
            ]
        )

    def replicates(self, rng: np.random.Generator, n: int, noise: np.ndarray) -> np.ndarray:
        """Residuals (slews, numbers, n) that fits of a perfect model would leave.

        Parameters
        ----------
        noise : (slews, numbers) its standard deviation in units of the noise as used.
        """
        e = rng.standard_normal((*self.residual.shape, n)) * (noise * self.valid)[..., None]
        columns, shared, m = self.columns, self.shared.shape[-1], self.local.shape[-1]
        truth = np.concatenate(
            [
                rng.standard_normal((shared, n)) / np.sqrt(self.prior_precision)[:, None],
                rng.standard_normal((len(e) * m, n)),
            ]
        )
        pull = np.zeros_like(truth)
        for s in range(len(e)):
            index = block_index(shared, m, s)
            e[s] += columns[s] @ truth[index]
            pull[index] += columns[s].T @ e[s]
        found = self.covariance @ pull
        for s in range(len(e)):
            e[s] -= columns[s] @ found[block_index(shared, m, s)]
        return e


def linearise(at: Estimate) -> Linearised:
    """Residuals and columns of an estimate.

    What follows from them holds at the optimum only. Where the optimizer stopped short of it, at the end of a long narrow
    valley, one more step to first order is taken from the residuals, so that they are orthogonal to the columns (and prior).
    """
    model, point = at.model, at.point
    d, m = model.space.size, point.local.shape[1]
    s = padded_sensitivities(model, point.theta, point.bias, point.local, at.white, np.arange(d))
    # The derivatives are of "measured minus predicted": the unknowns' columns as the data see them have the other sign.
    jacobian = -np.concatenate([np.asarray(j)[..., : d + N_BIAS + m] for j in s.jacobian], 1)
    sizes = np.array([r.shape[1] for r in s.residuals])
    stops = np.cumsum(sizes)
    weight = np.repeat(np.sqrt(at.discount), sizes, axis=1)
    time, fix_time, valid = _times(at)
    channels = {
        c: Rows(slice(int(stop - size), int(stop)), fix_time if c == "attitude" else time, ok)
        for c, size, stop, ok in zip(CHANNELS, sizes, stops, valid, strict=True)
    }
    slope, _ = prior_rows(model, point.theta)
    shared, local = (
        jacobian[..., np.concatenate([at.free, np.arange(d, d + N_BIAS)])],
        jacobian[..., d + N_BIAS :],
    )
    residual = np.concatenate([np.asarray(r) for r in s.residuals], 1)
    _, gradient = normal_equations(model, point, at.information)
    step = -at.joint_covariance @ gradient
    for k, (common, own) in enumerate(zip(shared, local, strict=True)):
        residual[k] -= np.concatenate([common, own], -1) @ step[block_index(shared.shape[-1], m, k)]
    return Linearised(
        residual=residual,
        shared=shared,
        local=local,
        prior_precision=np.concatenate([slope[at.free] ** 2, np.ones(N_BIAS)]),
        covariance=at.joint_covariance,
        weight=weight,
        channels=channels,
    )


def _times(at: Estimate) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]:
    """Times of rows and fixes from each slew's zero, repeated at the end in padding, and what was measured."""
    telemetry = at.model.data.arrays.telemetry
    n = telemetry.rate.shape[1]
    time = np.stack(
        [
            np.concatenate([s.time, np.full(n - len(s.time), s.time[-1])])
            for s in at.model.campaign.slews
        ]
    )
    fixes = np.take_along_axis(time, np.asarray(telemetry.fix_row), axis=1)
    momentum = np.asarray(telemetry.momentum_valid)[
        ..., : 0 if at.model.structure.drive == "measured" else None
    ]
    valid = (
        np.asarray(telemetry.rate_valid),
        np.repeat(np.asarray(telemetry.fix_valid)[..., None], 3, -1),
        momentum,
    )
    return time, fixes, tuple(np.asarray(v, bool) for v in valid)
