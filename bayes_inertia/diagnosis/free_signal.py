"""Unknown signals over time, inferred from what a fit leaves: linear Gaussian regression with a smooth prior.

A signal in every slew (a torque on the body, an error of a sensor) moves the residuals linearly; its values at
knots, a cubic spline between, have a Gaussian-process prior with a squared-exponential kernel. Length
scale and size maximise the marginal likelihood (Rasmussen and Williams 2006, section 5.4). Everything that the fit
could move is integrated out together with it, with its priors, so that no torque is claimed which J, K, start
states or bias explain as well.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg, stats
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

from bayes_inertia.diagnosis.torque_response import TorqueResponse
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects.scales import torque_scale

_MOST_KNOTS = 200
_MOST_NUMBERS = 2e7  # of one basis, so that it stays below 200 MB
_CHUNK = 24
_LENGTHS = 7


@array_dataclass
class Basis:
    """What unit values at the knots do to the residuals.

    `source` names the signal, `unit` its unit; `time` (slews, knots) [s]; `columns` (slews, numbers, knots * components), knot by knot;
    `scale` the size of one unit of the columns.
    """

    source: str
    unit: str
    time: np.ndarray
    columns: np.ndarray
    components: int
    scale: float


@array_dataclass
class History:
    """A signal over time.

    Attributes
    ----------
    source, unit, time : see `Basis`. mean, sd : (slews, knots, components).
    length : correlation length of the prior [s]. log_evidence : against no such signal.
    chi2_before, chi2_after, dof_before, dof_after : of all residuals without and with it.
    residual : (slews, numbers) what it leaves.
    """

    source: str
    unit: str
    time: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    length: float
    log_evidence: float
    chi2_before: float
    chi2_after: float
    dof_before: float
    dof_after: float
    residual: np.ndarray

    @property
    def explained(self) -> float:
        """Share of the excess of chi^2 over its degrees of freedom that the signal removes, from 0 to 1."""
        excess = max(self.chi2_before - self.dof_before, 1e-9)
        return float(np.clip(1.0 - (self.chi2_after - self.dof_after) / excess, 0.0, 1.0))

    @property
    def p_left(self) -> float:
        """Probability of residuals as large as those that it leaves."""
        return float(stats.chi2.sf(self.chi2_after, max(self.dof_after, 1.0)))


def knots(fit: LinearisedFit, components: int) -> np.ndarray:
    """Knot times (slews, k) [s]: evenly over each slew, not closer than its rows."""
    time = fit.channels["rate"].time
    rows = np.array([np.count_nonzero(np.diff(t) > 0) + 1 for t in time])
    most = int(_MOST_NUMBERS / (fit.residual.size * components))
    k = int(np.clip(np.max(rows), 4, max(8, min(_MOST_KNOTS, most))))
    return np.linspace(time[:, 0], time[:, -1], k, axis=1)


def cardinal(at: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Values (n, k) at times `at` (n,) of the cubic splines that are one at one knot of `time` (k,) and zero at the others.

    >>> cardinal(np.array([0.0, 2.0]), np.arange(5.0)).round(9).tolist() == np.eye(5)[[0, 2]].tolist()
    True
    """
    return make_interp_spline(time, np.eye(len(time)), k=3)(np.clip(at, time[0], time[-1]))


def body_torque(fit: LinearisedFit, response: TorqueResponse) -> Basis:
    """An external torque on the body [N m], body axes."""
    scale = torque_scale(response.at.model.campaign)
    time = knots(fit, 3)
    shapes = _on_grid(response, time)
    columns = _moved(
        response,
        lambda hat: np.einsum("snk,ij->snikj", hat, scale * np.eye(3)).reshape(
            *hat.shape[:2], 3, -1
        ),
        shapes,
    )
    return Basis("body torque", "N m", time, columns, 3, scale)


def wheel_torque(fit: LinearisedFit, response: TorqueResponse) -> Basis | None:
    """A torque between body and wheels beyond the commanded one [N m], counted on the wheel; None where wheels are not predicted."""
    campaign = response.at.model.campaign
    momentum = fit.channels["momentum"]
    if not momentum.valid.any():
        return None
    scale, wheels = torque_scale(campaign), len(campaign.wheels)
    time = knots(fit, wheels)
    shapes = _on_grid(response, time)
    axes = campaign.wheel_axes_B
    columns = _moved(
        response,
        lambda hat: np.einsum("snk,iw->snikw", hat, -scale * axes).reshape(*hat.shape[:2], 3, -1),
        shapes,
    )
    # The wheel's own momentum takes up the torque.
    step = np.diff(response.time, axis=1)[..., None]
    taken = np.concatenate(
        [
            np.zeros_like(shapes[:, :1]),
            np.cumsum(0.5 * (shapes[:, 1:] + shapes[:, :-1]) * step, axis=1),
        ],
        axis=1,
    )
    rows = taken[
        np.arange(len(taken))[:, None], np.asarray(response.at.model.data.arrays.telemetry.sample)
    ]
    own = scale * np.einsum(
        "snw,snk,wv->snwkv", np.asarray(response.at.white.momentum), rows, np.eye(wheels)
    )
    columns[:, momentum.part] += own.reshape(*own.shape[:1], -1, columns.shape[-1])
    return Basis("wheel torque", "N m", time, columns, wheels, scale)


def rate_reading(fit: LinearisedFit, response: TorqueResponse) -> Basis:
    """An error of the rate sensor's readings [rad/s], sensor axes."""
    rate, white = fit.channels["rate"], np.asarray(response.at.white.rate)
    return _reading(
        fit,
        "rate sensor",
        "rad/s",
        rate,
        white,
        float(np.max(response.at.model.campaign.rate_sensor.sigma)),
    )


def momentum_reading(fit: LinearisedFit, response: TorqueResponse) -> Basis | None:
    """An error of the tachometers' readings [N m s]; None where wheels are not predicted."""
    momentum, white = fit.channels["momentum"], np.asarray(response.at.white.momentum)
    if not momentum.valid.any():
        return None
    diagonal = white[..., None] * np.eye(white.shape[-1])
    sigma = max(w.momentum_sigma or 0.0 for w in response.at.model.campaign.wheels)
    return _reading(fit, "tachometers", "N m s", momentum, diagonal, sigma)


def _reading(
    fit: LinearisedFit, source: str, unit: str, rows, white: np.ndarray, scale: float
) -> Basis:
    width = white.shape[-1]
    time = knots(fit, width)
    shapes = np.stack([cardinal(at, t) for at, t in zip(rows.time, time, strict=True)])
    own = scale * np.einsum("snij,snk->snikj", white, shapes)
    columns = np.zeros((*fit.residual.shape, time.shape[1] * width))
    columns[:, rows.part] = own.reshape(len(time), -1, columns.shape[-1])
    return Basis(source, unit, time, columns, width, scale)


def _on_grid(response: TorqueResponse, time: np.ndarray) -> np.ndarray:
    begin = [s.time[0] for s in response.at.model.campaign.slews]
    return np.stack(
        [cardinal(grid + t0, t) for grid, t0, t in zip(response.time, begin, time, strict=True)]
    )


def _moved(
    response: TorqueResponse, torques: Callable[[np.ndarray], np.ndarray], shapes: np.ndarray
) -> np.ndarray:
    parts = []
    for begin in range(0, shapes.shape[-1], _CHUNK):
        change = response.residual_change(torques(shapes[..., begin : begin + _CHUNK]))
        # What the data gain is what the residuals of the model without it gain.
        parts.append(-np.concatenate([np.asarray(c) for c in change], axis=1))
    return np.concatenate(parts, -1)


@array_dataclass
class _Normal:
    """Normal equations of a basis, start states integrated out: by slew `own` (K, K), `cross` (K, s), `pull` (K,); `shared` (s, s) of all."""

    own: list[np.ndarray]
    cross: list[np.ndarray]
    pull: list[np.ndarray]
    shared: np.ndarray


def _normal(fit: LinearisedFit, basis: Basis) -> _Normal:
    own, cross, pull, shared = [], [], [], np.diag(fit.prior_precision)
    for B, L, S, r in zip(basis.columns, fit.local, fit.shared, fit.settled_residual, strict=True):
        factor = linalg.cho_factor(L.T @ L + np.eye(L.shape[1]))
        by_own, by_shared = linalg.cho_solve(factor, L.T @ B), linalg.cho_solve(factor, L.T @ S)
        own.append(B.T @ B - (B.T @ L) @ by_own)
        cross.append(B.T @ S - (B.T @ L) @ by_shared)
        # At the optimum the residuals are already the projected ones.
        pull.append(B.T @ r)
        shared = shared + S.T @ S - (S.T @ L) @ by_shared
    return _Normal(own, cross, pull, shared)


@array_dataclass
class _Smooth:
    """The same in the eigenbasis of each slew for one length scale: `back` (slews of (K, q)), `power` g, `cross`, `pull` (all slews, one after the other)."""

    length: float
    back: list[np.ndarray]
    power: np.ndarray
    cross: np.ndarray
    pull: np.ndarray
    shared: np.ndarray

    def evidence(self, log_size: float) -> float:
        """Log marginal likelihood against no signal, for a prior of sd exp(log_size)."""
        a2 = np.exp(2.0 * log_size)
        M = 1.0 + a2 * self.power
        left = self.shared - a2 * (self.cross.T / M) @ self.cross
        v = (self.cross.T / M) @ self.pull
        fit = a2 * np.sum(self.pull**2 / M) + a2**2 * v @ np.linalg.solve(left, v)
        volume = np.sum(np.log(M)) + np.linalg.slogdet(left)[1] - np.linalg.slogdet(self.shared)[1]
        return float(0.5 * (fit - volume))

    def solution(self, log_size: float) -> tuple[list[np.ndarray], list[np.ndarray], float]:
        """Posterior mean and variance of the values at the knots by slew, and the effective number of parameters."""
        a = np.exp(log_size)
        M = 1.0 + a**2 * self.power
        left = np.linalg.cholesky(self.shared - a**2 * (self.cross.T / M) @ self.cross)
        spread = a * np.linalg.solve(left, (self.cross / M[:, None]).T).T
        z = a * (self.pull / M + spread @ (spread.T @ self.pull))
        effective = float(np.sum(1.0 - 1.0 / M) - np.sum(spread**2))
        means, variances, begin = [], [], 0
        for back in self.back:
            part = slice(begin, begin + back.shape[1])
            means.append(a * back @ z[part])
            variances.append(
                a**2 * (np.sum(back**2 / M[part], 1) + np.sum((back @ spread[part]) ** 2, 1))
            )
            begin += back.shape[1]
        return means, variances, effective


def _smooth(normal: _Normal, basis: Basis, length: float) -> _Smooth:
    backs, powers, crosses, pulls = [], [], [], []
    for t, own, cross, pull in zip(basis.time, normal.own, normal.cross, normal.pull, strict=True):
        values, vectors = np.linalg.eigh(np.exp(-0.5 * ((t[:, None] - t[None, :]) / length) ** 2))
        keep = values > 1e-7 * values[-1]
        root = np.kron(vectors[:, keep] * np.sqrt(values[keep]), np.eye(basis.components))
        power, turn = np.linalg.eigh(root.T @ own @ root)
        back = root @ turn
        backs.append(back)
        powers.append(np.maximum(power, 0.0))
        crosses.append(back.T @ cross)
        pulls.append(back.T @ pull)
    return _Smooth(
        length,
        backs,
        np.concatenate(powers),
        np.concatenate(crosses),
        np.concatenate(pulls),
        normal.shared,
    )


def infer(fit: LinearisedFit, basis: Basis) -> History:
    """The signal over time that explains the residuals best, with its band."""
    normal = _normal(fit, basis)
    durations = basis.time[:, -1] - basis.time[:, 0]
    spacing = float(np.median(durations)) / (basis.time.shape[1] - 1)
    best: tuple[float, float, _Smooth] | None = None
    for length in np.geomspace(1.5 * spacing, 2.0 * float(durations.max()), _LENGTHS):
        smooth = _smooth(normal, basis, float(length))
        floor = -0.5 * np.log(max(smooth.power.max(), 1e-30))
        # The evidence has several maxima: slow and fast parts of a signal differ by orders of magnitude in what they do.
        sizes = np.linspace(floor - 2.0, floor + 18.0, 41)
        top = float(sizes[np.argmax([smooth.evidence(x) for x in sizes])])
        found = minimize_scalar(
            lambda x, s=smooth: -s.evidence(x), bounds=(top - 0.5, top + 0.5), method="bounded"
        )
        if best is None or -found.fun > best[0]:
            best = (-float(found.fun), float(found.x), smooth)
    evidence, size, smooth = best
    means, variances, effective = smooth.solution(size)
    left = _left(fit, basis, means)
    n, paid = np.count_nonzero(fit.valid), _paid(fit)
    shape = (len(means), basis.time.shape[1], basis.components)
    return History(
        source=basis.source,
        unit=basis.unit,
        time=basis.time,
        mean=basis.scale * np.array(means).reshape(shape),
        sd=basis.scale * np.sqrt(np.array(variances)).reshape(shape),
        length=smooth.length,
        log_evidence=evidence,
        chi2_before=float(np.sum(fit.settled_residual**2)),
        chi2_after=float(np.sum(left**2)),
        dof_before=float(n - paid),
        dof_after=float(n - paid - effective),
        residual=left,
    )


def _left(fit: LinearisedFit, basis: Basis, means: list[np.ndarray]) -> np.ndarray:
    """Residuals after the signal is taken out and everything else is fitted again."""
    signal = np.stack([B @ m for B, m in zip(basis.columns, means, strict=True)])
    return fit.settled_residual - fit.unfitted(signal)


def _paid(fit: LinearisedFit) -> float:
    """Effective parameters of the fit itself: trace of its hat matrix."""
    columns = fit.columns
    return float(
        sum(
            np.einsum("np,pq,nq->", J, fit.covariance_of(s), J, optimize=True)
            for s, J in enumerate(columns)
        )
    )
