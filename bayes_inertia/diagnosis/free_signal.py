"""Signals over time inferred from what a fit leaves: linear Gaussian regression, a smooth prior.

A signal in every slew (a torque on the body or the wheels, an error of a sensor) is given by its
values at knots, a cubic spline between. To first order it moves the residuals linearly. The values
have a Gaussian-process prior with a squared-exponential kernel, whose length and size maximise the
marginal likelihood (Rasmussen and Williams 2006, section 5.4). Everything that the fit could move
is integrated out with it, so that no torque is claimed which J, K, start states or bias explain.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg, stats
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.torque_response import TorqueResponse, changes_of
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects.scales import torque_scale


@array_dataclass
class SignalBasis:
    """What unit values at the knots do to the residuals.

    Parameters
    ----------
    source : str
        What the signal is.
    unit : str
        Its unit.
    time : (slews, knots) array
        Times of the knots [s].
    columns : (slews, numbers, knots * components) array
        Changes of the whitened residuals, knot by knot.
    components : int
        Of the signal.
    scale : float
        Size of one unit of the columns, in `unit`.
    """

    source: str
    unit: str
    time: np.ndarray
    columns: np.ndarray
    components: int
    scale: float


def knots(fit: LinearisedFit, components: int) -> np.ndarray:
    """Place knots evenly over each slew, not closer than its rows.

    Returns (slews, knots) [s].
    """
    time = fit.channels["rate"].time
    rows = np.array([np.count_nonzero(np.diff(t) > 0) + 1 for t in time])
    affordable = int(LIMITS.basis_numbers / (fit.residual.size * components))
    k = int(np.clip(np.max(rows), 4, max(8, min(LIMITS.knots, affordable))))
    return np.linspace(time[:, 0], time[:, -1], k, axis=1)


def cardinal_splines(times: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Evaluate the cubic splines that are one at one knot and zero at the others.

    `time` (k,) [s]. `times` (n,): times of evaluation [s]; beyond the knots the value at the last
    one holds. Returns (n, k).

    Examples
    --------
    >>> values = cardinal_splines(np.array([0.0, 2.0]), np.arange(5.0))
    >>> values.round(9).tolist() == np.eye(5)[[0, 2]].tolist()
    True
    """
    return make_interp_spline(time, np.eye(len(time)), k=3)(np.clip(times, time[0], time[-1]))


# Where a signal may enter: hook and unit. The rate sensor's is in its own axes.
_SOURCES = {
    "body torque": ("body_torque", "N m"),
    "wheel torque": ("delivered_torque", "N m"),
    "rate sensor": ("rate_output", "rad/s"),
    "tachometers": ("momentum_output", "N m s"),
}
_OF_WHEELS = ("wheel torque", "tachometers")


def signal_basis(fit: LinearisedFit, response: TorqueResponse, source: str) -> SignalBasis | None:
    """Build the basis of a signal; one component a wheel or a body axis.

    Returns: none for what acts in wheels that are not predicted, or in no rate sensor.
    """
    campaign, (hook, unit) = response.estimate.model.campaign, _SOURCES[source]
    of_wheels, sigma = source in _OF_WHEELS, np.array(RATE.sigma(campaign), float)
    components = {"rate sensor": len(sigma)}.get(source, len(campaign.wheels) if of_wheels else 3)
    if components == 0 or (of_wheels and not fit.channels["momentum"].valid.any()):
        return None
    scale = {
        "rate_output": float(np.max(sigma, initial=0.0)),
        "momentum_output": max((w.momentum_sigma or 0.0 for w in campaign.wheels), default=0.0),
    }.get(hook) or torque_scale(campaign)
    time = knots(fit, components)
    splines, parts = _splines_on_grid(response, time), []
    for start in range(0, splines.shape[-1], LIMITS.knots_at_a_time):
        some = splines[..., start : start + LIMITS.knots_at_a_time]
        units = np.einsum("snk,ij->snikj", some, scale * np.eye(components))
        units = units.reshape(*some.shape[:2], components, -1)
        # What the data gain is what the residuals of the model without it gain.
        parts.append(-changes_of(response, {hook: units}, units.shape[-1]))
    return SignalBasis(source, unit, time, np.concatenate(parts, -1), components, scale)


def _splines_on_grid(response: TorqueResponse, time: np.ndarray) -> np.ndarray:
    """Splines (slews, n, knots) on the integration grid, which counts from each slew's zero."""
    first = [slew.time[0] for slew in response.estimate.model.campaign.slews]
    return np.stack(
        [
            cardinal_splines(grid + t0, t)
            for grid, t0, t in zip(response.time, first, time, strict=True)
        ]
    )


@array_dataclass
class FreeSignal:
    """A signal over time.

    Parameters
    ----------
    source, unit : str
        What it is, and its unit.
    time : (slews, knots) array
        Times of the knots [s].
    mean, sd : (slews, knots, components) arrays
        Of the posterior.
    length : float
        Correlation length of the prior [s].
    log_evidence : float
        Against no such signal.
    chi2_before, chi2_after : float
        Of all residuals without and with it.
    dof_before, dof_after : float
        Their degrees of freedom.
    residual : (slews, numbers) array
        What it leaves.
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
        """Share of the excess of chi^2 over its degrees of freedom that it removes, 0 to 1."""
        excess = max(self.chi2_before - self.dof_before, 1e-9)
        return float(np.clip(1.0 - (self.chi2_after - self.dof_after) / excess, 0.0, 1.0))

    @property
    def p_left(self) -> float:
        """Probability of residuals as large as those that it leaves."""
        return float(stats.chi2.sf(self.chi2_after, max(self.dof_after, 1.0)))

    @property
    def rms(self) -> float:
        """Root mean square of its magnitude, in `unit`."""
        return float(np.sqrt(np.mean(np.sum(self.mean**2, -1))))


def infer_signal(fit: LinearisedFit, basis: SignalBasis) -> FreeSignal:
    """Infer the signal over time that explains the residuals best, with its band.

    Returns: at the length scale and size of the highest marginal likelihood.
    """
    evidence, log_size, smooth = _most_likely(_normal_equations(fit, basis), basis)
    means, variances, effective = smooth.solution(log_size)
    left = _left(fit, basis, means)
    dof = np.count_nonzero(fit.valid) - _effective_parameters(fit)
    shape = (len(means), basis.time.shape[1], basis.components)
    return FreeSignal(
        source=basis.source,
        unit=basis.unit,
        time=basis.time,
        mean=basis.scale * np.array(means).reshape(shape),
        sd=basis.scale * np.sqrt(np.array(variances)).reshape(shape),
        length=smooth.length,
        log_evidence=evidence,
        chi2_before=float(np.sum(fit.settled_residual**2)),
        chi2_after=float(np.sum(left**2)),
        dof_before=float(dof),
        dof_after=float(dof - effective),
        residual=left,
    )


@array_dataclass
class _NormalEquations:
    """Of the knots, start states integrated out.

    By slew `knots` (K, K), `cross` (K, s) with the shared unknowns, `gradient` (K,); `shared` (s,
    s) of all slews.
    """

    knots: list[np.ndarray]
    cross: list[np.ndarray]
    gradient: list[np.ndarray]
    shared: np.ndarray


def _normal_equations(fit: LinearisedFit, basis: SignalBasis) -> _NormalEquations:
    knots, cross, gradient, shared = [], [], [], fit.prior_precision
    for B, L, S, r in zip(basis.columns, fit.local, fit.shared, fit.settled_residual, strict=True):
        factor = linalg.cho_factor(L.T @ L + np.eye(L.shape[1]))
        by_knots, by_shared = linalg.cho_solve(factor, L.T @ B), linalg.cho_solve(factor, L.T @ S)
        knots.append(B.T @ B - (B.T @ L) @ by_knots)
        cross.append(B.T @ S - (B.T @ L) @ by_shared)
        # At the optimum the residuals are already the projected ones.
        gradient.append(B.T @ r)
        shared = shared + S.T @ S - (S.T @ L) @ by_shared
    return _NormalEquations(knots, cross, gradient, shared)


@array_dataclass
class _SmoothPrior:
    """The same in the eigenbasis of each slew, for one length scale [s].

    `back` (slews of (K, q)) leads to the knots; `power` (Q,), `cross` (Q, s) and `gradient` (Q,)
    are of all slews, one after the other.
    """

    length: float
    back: list[np.ndarray]
    power: np.ndarray
    cross: np.ndarray
    gradient: np.ndarray
    shared: np.ndarray

    def evidence(self, log_size: float) -> float:
        """Log marginal likelihood against no signal, for a prior of sd exp(log_size)."""
        a2 = np.exp(2.0 * log_size)
        M = 1.0 + a2 * self.power
        left = self.shared - a2 * (self.cross.T / M) @ self.cross
        v = (self.cross.T / M) @ self.gradient
        fit = a2 * np.sum(self.gradient**2 / M) + a2**2 * v @ np.linalg.solve(left, v)
        volume = np.sum(np.log(M)) + np.linalg.slogdet(left)[1] - np.linalg.slogdet(self.shared)[1]
        return float(0.5 * (fit - volume))

    def solution(self, log_size: float) -> tuple[list[np.ndarray], list[np.ndarray], float]:
        """Mean and variance of the values at the knots by slew, and effective parameters."""
        a = np.exp(log_size)
        M = 1.0 + a**2 * self.power
        left = np.linalg.cholesky(self.shared - a**2 * (self.cross.T / M) @ self.cross)
        spread = a * np.linalg.solve(left, (self.cross / M[:, None]).T).T
        z = a * (self.gradient / M + spread @ (spread.T @ self.gradient))
        effective = float(np.sum(1.0 - 1.0 / M) - np.sum(spread**2))
        means, variances, start = [], [], 0
        for back in self.back:
            part = slice(start, start + back.shape[1])
            means.append(a * back @ z[part])
            variances.append(
                a**2 * (np.sum(back**2 / M[part], 1) + np.sum((back @ spread[part]) ** 2, 1))
            )
            start += back.shape[1]
        return means, variances, effective


def _smooth_prior(normal: _NormalEquations, basis: SignalBasis, length: float) -> _SmoothPrior:
    backs, powers, crosses, gradients = [], [], [], []
    for time, knots, cross, gradient in zip(
        basis.time, normal.knots, normal.cross, normal.gradient, strict=True
    ):
        kernel = np.exp(-0.5 * ((time[:, None] - time[None, :]) / length) ** 2)
        values, vectors = np.linalg.eigh(kernel)
        keep = values > LIMITS.eigenvalue_floor * values[-1]
        root = np.kron(vectors[:, keep] * np.sqrt(values[keep]), np.eye(basis.components))
        power, turn = np.linalg.eigh(root.T @ knots @ root)
        back = root @ turn
        backs.append(back)
        powers.append(np.maximum(power, 0.0))
        crosses.append(back.T @ cross)
        gradients.append(back.T @ gradient)
    return _SmoothPrior(
        length,
        backs,
        np.concatenate(powers),
        np.concatenate(crosses),
        np.concatenate(gradients),
        normal.shared,
    )


def _most_likely(normal: _NormalEquations, basis: SignalBasis) -> tuple[float, float, _SmoothPrior]:
    """The highest log evidence, and the log size and length scale that it is reached at."""
    durations = basis.time[:, -1] - basis.time[:, 0]
    spacing = float(np.median(durations)) / (basis.time.shape[1] - 1)
    lengths = np.geomspace(1.5 * spacing, 2.0 * float(durations.max()), LIMITS.length_scales)
    best: tuple[float, float, _SmoothPrior] | None = None
    for length in lengths:
        smooth = _smooth_prior(normal, basis, float(length))
        evidence, log_size = _best_size(smooth)
        if best is None or evidence > best[0]:
            best = (evidence, log_size, smooth)
    assert best is not None
    return best


def _best_size(smooth: _SmoothPrior) -> tuple[float, float]:
    """The highest log evidence at one length scale, and its log size.

    The evidence has several maxima: slow and fast parts of a signal differ by orders of magnitude
    in what they do.
    """
    smallest = -0.5 * np.log(max(smooth.power.max(), 1e-30))
    low, high, points = LIMITS.log_sizes
    sizes = np.linspace(smallest + low, smallest + high, points)
    top = float(sizes[np.argmax([smooth.evidence(x) for x in sizes])])
    optimum = minimize_scalar(
        lambda x: -smooth.evidence(x), bounds=(top - 0.5, top + 0.5), method="bounded"
    )
    return -float(optimum.fun), float(optimum.x)


def _left(fit: LinearisedFit, basis: SignalBasis, means: list[np.ndarray]) -> np.ndarray:
    """Residuals after the signal is taken out and everything else is fitted again."""
    signal = np.stack([B @ m for B, m in zip(basis.columns, means, strict=True)])
    return fit.settled_residual - fit.unfitted(signal)


def _effective_parameters(fit: LinearisedFit) -> float:
    """Of the fit itself: trace of its hat matrix."""
    traces = [
        np.einsum("np,pq,nq->", J, fit.covariance_of(s), J, optimize=True)
        for s, J in enumerate(fit.columns)
    ]
    return float(sum(traces))
