"""What no candidate explains: the equivalent disturbance torque over time, and what it looks like.

The torque is inferred from an estimate's residuals, with its band, its axis, its spectrum and what
it goes along with: a report makes of these a sentence an engineer can act on. Where no torque
explains the residuals, the same is tried with an error of the sensors, so that nobody looks for a
torque that is not there.

A signal in every slew (a torque on the body or the wheels, an error of a sensor) is given by its
values at knots, a cubic spline between. To first order it moves the residuals linearly. The values
have a Gaussian-process prior with a squared-exponential kernel, whose length and size maximise the
marginal likelihood (Rasmussen and Williams 2006, section 5.4). A torque may as well be one that
rings: the derivative of such a signal, whose impulse stays bounded. Slow parts of any other would
show in the rates a thousand times more, and an error of the rates would explain ringing better.
Everything that the fit could move is integrated out with it, so that no torque is claimed which J,
K, start states or bias explain.

Disturbances that no effect of the library describes still follow something as a rule, a driver: the
square of the body rate, the momentum of the wheels, the field, the time. Along any axes they are
linear in a few numbers; in the table they show that a name would be an imitation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import linalg, stats
from scipy.interpolate import make_interp_spline

from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.diagnosis.formulas import response_hook, told_blocks
from bayes_inertia.diagnosis.hypothesis_table import (
    RandomMember,
    Signal,
    System,
    given_random,
    log_evidence_of_columns,
)
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.residual_tests import effective_parameters
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects.formula import PLACES, driver_of


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


# Where a signal may enter: the place of a formula, and its unit. The rate sensor's is in its own
# axes.
_SOURCES = {
    "body torque": ("body_torque", "N m"),
    "wheel torque": ("wheel_torque", "N m"),
    "rate sensor": ("rate_error", "rad/s"),
    "tachometers": ("tachometer_error", "N m s"),
}


def signal_basis(fit: LinearisedFit, response: TorqueResponse, source: str) -> SignalBasis | None:
    """Build the basis of a signal; one component a wheel or a body axis.

    Returns: none for what acts in wheels that are not predicted, or in no rate sensor.
    """
    campaign, (key, unit) = response.estimate.model.campaign, _SOURCES[source]
    place, components = PLACES[key], 3
    if place.rows == "wheels":
        predicted = fit.channels["momentum"].valid.any()
        components = len(campaign.wheels) if predicted else 0
    elif source == "rate sensor":
        components = len(RATE.sigma(campaign))
    if components == 0:
        return None
    scale, time, parts = place.size(campaign), knots(fit, components), []
    # The integration grid counts from each slew's zero.
    grids = [slew.time[0] + t for slew, t in zip(campaign.slews, response.time, strict=True)]
    splines = np.stack([cardinal_splines(g, t) for g, t in zip(grids, time, strict=True)])
    for start in range(0, splines.shape[-1], LIMITS.knots_at_a_time):
        some = splines[..., start : start + LIMITS.knots_at_a_time]
        units = np.einsum("snk,ij->snikj", some, scale * np.eye(components))
        units = units.reshape(*some.shape[:2], components, -1)
        # What the data gain is what the residuals of the model without it gain.
        parts.append(-response.changes({response_hook(place): units}))
    return SignalBasis(source, unit, time, np.concatenate(parts, -1), components, scale)


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
    found = (_most_likely(form) for form in _forms(fit, basis))
    evidence, size, form = max(found, key=lambda each: each[0])
    means, variances, effective = form.solution(size)
    signal = np.stack([B @ m for B, m in zip(basis.columns, means, strict=True)])
    left = fit.settled_residual - fit.unfitted(signal)
    taken = effective_parameters(fit.model, fit.point, fit.information, fit.covariance)
    dof = np.count_nonzero(fit.valid) - taken.sum()
    shape = (len(means), basis.time.shape[1], basis.components)
    return FreeSignal(
        source=basis.source,
        unit=basis.unit,
        time=basis.time,
        mean=basis.scale * np.array(means).reshape(shape),
        sd=basis.scale * np.sqrt(np.array(variances)).reshape(shape),
        length=form.length,
        log_evidence=evidence,
        chi2_before=float(np.sum(fit.settled_residual**2)),
        chi2_after=float(np.sum(left**2)),
        dof_before=float(dof),
        dof_after=float(dof - effective),
        residual=left,
    )


@array_dataclass
class _Form:
    """A smooth signal of one length scale [s], along independent directions of each slew.

    `back` (slews of (K, q)) leads to the knots; `power` (Q,), `cross` (Q, s) with the shared
    unknowns and `gradient` (Q,) are of all slews, one after the other; `shared` (s, s).
    """

    length: float
    back: list[np.ndarray]
    power: np.ndarray
    cross: np.ndarray
    gradient: np.ndarray
    shared: np.ndarray

    def evidence(self, sizes: np.ndarray) -> np.ndarray:
        """Log marginal likelihood (g,) against no signal, for priors of such sds."""
        none, even = np.zeros((0, len(self.power))), np.ones(len(sizes))
        signal = Signal(self.power, none, self.cross, self.gradient, sizes, even)
        known = System(self.shared, np.zeros(len(self.shared)))
        given = given_random(known, RandomMember("", [signal], np.zeros(1)))
        moved = np.linalg.solve(given.matrix, given.gradient[..., None])[..., 0]
        volume = np.linalg.slogdet(given.matrix)[1] - np.linalg.slogdet(self.shared)[1]
        return given.log_weight + 0.5 * (np.sum(given.gradient * moved, 1) - volume)

    def solution(self, a: float) -> tuple[list[np.ndarray], list[np.ndarray], float]:
        """Mean and variance of the values at the knots by slew, and effective parameters."""
        M = 1.0 + a**2 * self.power
        left = np.linalg.cholesky(self.shared - a**2 * (self.cross.T / M) @ self.cross)
        spread = a * np.linalg.solve(left, (self.cross / M[:, None]).T).T
        z = a * (self.gradient / M + spread @ (spread.T @ self.gradient))
        effective = float(np.sum(1.0 - 1.0 / M) - np.sum(spread**2))
        ends = np.cumsum([back.shape[1] for back in self.back])[:-1]
        parts = zip(*(np.split(x, ends) for x in (z, M, spread)), strict=True)
        means, variances = [], []
        for back, (own, seen, with_shared) in zip(self.back, parts, strict=True):
            means.append(a * back @ own)
            variance = np.sum(back**2 / seen, 1) + np.sum((back @ with_shared) ** 2, 1)
            variances.append(a**2 * variance)
        return means, variances, effective


def _forms(fit: LinearisedFit, basis: SignalBasis) -> Iterator[_Form]:
    """Smooth signals of all length scales; torques that ring as well."""
    durations = basis.time[:, -1] - basis.time[:, 0]
    spacing = float(np.median(durations)) / (basis.time.shape[1] - 1)
    lengths = np.geomspace(1.5 * spacing, 2.0 * float(durations.max()), LIMITS.length_scales)
    slews, shared = [], fit.prior_precision
    for B, L, S, r in zip(basis.columns, fit.local, fit.shared, fit.settled_residual, strict=True):
        # Start states are integrated out. At the optimum the residuals are the projected ones.
        factor = linalg.cho_factor(L.T @ L + np.eye(L.shape[1]))
        by_knots, by_shared = linalg.cho_solve(factor, L.T @ B), linalg.cho_solve(factor, L.T @ S)
        slews.append((B.T @ B - (B.T @ L) @ by_knots, B.T @ S - (B.T @ L) @ by_shared, B.T @ r))
        shared = shared + S.T @ S - (S.T @ L) @ by_shared
    for rings, length in product((False, True) if basis.unit == "N m" else (False,), lengths):
        backs, parts = [], []
        for time, (matrix, cross, gradient) in zip(basis.time, slews, strict=True):
            root = np.kron(_kernel_root(time / length, rings), np.eye(basis.components))
            power, turn = np.linalg.eigh(root.T @ matrix @ root)
            back = root @ turn
            backs.append(back)
            parts.append((np.maximum(power, 0.0), back.T @ cross, back.T @ gradient))
        power, cross, gradient = (np.concatenate(x) for x in zip(*parts, strict=True))
        yield _Form(float(length), backs, power, cross, gradient, shared)


def _kernel_root(time: np.ndarray, rings: bool) -> np.ndarray:
    """Root (k, q) of a smooth signal's covariance at knots, their times (k,) in length scales.

    `rings`: of the derivative of such a signal, of unit variance too.
    """
    apart = (time[:, None] - time[None, :]) ** 2
    kernel = np.exp(-0.5 * apart) * (1.0 - apart if rings else 1.0)
    values, vectors = np.linalg.eigh(kernel)
    keep = values > LIMITS.eigenvalue_floor * values[-1]
    return vectors[:, keep] * np.sqrt(values[keep])


def _most_likely(form: _Form) -> tuple[float, float, _Form]:
    """The highest log evidence at one length scale, and its size.

    The evidence has several maxima: slow and fast parts of a signal differ by orders of magnitude
    in what they do. Sizes are tried ever closer around the best.
    """
    low, high, points = LIMITS.log_sizes
    half, smallest = 0.5 * (high - low), -0.5 * np.log(max(form.power.max(), 1e-30))
    best, evidence = smallest + low + half, np.zeros(1)
    for _ in range(LIMITS.rounds_of_size):
        log_sizes = np.linspace(best - half, best + half, points)
        evidence = form.evidence(np.exp(log_sizes))
        best, half = float(log_sizes[np.argmax(evidence)]), 2.0 * half / (points - 1)
    return float(evidence.max()), float(np.exp(best)), form


@dataclass(frozen=True)
class Match:
    """A torque in proportion to something known, along any axes.

    Parameters
    ----------
    driver : str
        What it follows: a key of `DRIVERS`, or an input of the user's own.
    name : str
        The same in words.
    log_evidence : float
        Against nothing.
    share : float
        Share of the misfit that it removes, 0 to 1.
    """

    driver: str
    name: str
    log_evidence: float
    share: float


def matches(response: TorqueResponse, fit: LinearisedFit, excess: float) -> tuple[Match, ...]:
    """Torques in proportion to something known, best evidence first; `excess`: of chi^2."""
    found = []
    for block in told_blocks(response):
        if block.formula.place != "body_torque":
            continue
        driver, (matrix, gradient) = block.formula.driver, fit.projected(block.columns)
        gained = gradient @ np.linalg.solve(matrix + np.eye(len(gradient)), gradient)
        share = float(np.clip(gained / max(excess, 1e-9), 0.0, 1.0))
        value = log_evidence_of_columns(gradient, matrix)
        found.append(Match(driver, driver_of(driver).words, value, share))
    return tuple(sorted(found, key=lambda match: -match.log_evidence))


@array_dataclass
class UnexplainedSignal:
    """What an estimate leaves unexplained.

    Parameters
    ----------
    source : str
        "body torque", or where else the residuals come from: "rate sensor", "wheel torque",
        "tachometers", "nothing smooth".
    torque : FreeSignal
        The equivalent body torque over time, whether it explains the residuals or not.
    better_signal : FreeSignal or None
        The signal that explains them better, if it is not a torque on the body.
    axis_B : (3,) array
        Unit vector of the torque.
    axis_share : float
        Share of its power along that axis.
    torque_rms : float
        [N m].
    spectrum : Spectrum
        Of the torque along the axis.
    matches : tuple of Match
        What it may follow, best first.
    quiet_before : float or None
        rms of the torque before the wheels first act over its rms afterwards, where known.
    """

    source: str
    torque: FreeSignal
    better_signal: FreeSignal | None
    axis_B: np.ndarray
    axis_share: float
    torque_rms: float
    spectrum: Spectrum
    matches: tuple[Match, ...]
    quiet_before: float | None

    @property
    def frequency_hz(self) -> float | None:
        """Frequency of the ringing [Hz].

        None if there is no line in the spectrum, or something known explains the torque.
        """
        known = self.matches and self.matches[0].share > LIMITS.known_share
        ringing = self.spectrum.line and self.source == "body torque" and not known
        return self.spectrum.peak if ringing else None

    @property
    def follows(self) -> Match | None:
        """What the torque is proportional to.

        The best by evidence, if that is not worse than a torque of any shape.
        """
        least = max((m.log_evidence for m in self.matches), default=np.inf) - LIMITS.tied
        # Squares of rates are nearly constant in a campaign of like slews: the simpler word wins a
        # near tie.
        steady = (m for m in self.matches if m.driver == "constant" and m.log_evidence > least)
        best = next(iter((*steady, *self.matches)), None)
        known = best and best.log_evidence > self.torque.log_evidence - LIMITS.tied
        return best if known else None


def unexplained_signal(estimate: Estimate) -> UnexplainedSignal:
    """Infer the equivalent torque of what an estimate leaves unexplained.

    All that was fitted is integrated out with its priors, so that only what J, K, start states,
    bias and the effects of the model cannot produce is shown. To first order around the estimate.

    Returns: the torque, or the sensor's error, and what it looks like.
    """
    fit, response = estimate.linearised(), torque_response(estimate)
    basis = signal_basis(fit, response, "body torque")
    assert basis is not None
    torque = infer_signal(fit, basis)
    better = _better_signal(fit, response, torque)
    axis_B, share = _main_axis(torque.mean)
    along = torque.mean @ axis_B
    return UnexplainedSignal(
        source=_source(torque, better),
        torque=torque,
        better_signal=better,
        axis_B=axis_B,
        axis_share=share,
        torque_rms=torque.rms,
        spectrum=spectrum_of(torque.time, along),
        matches=matches(response, fit, torque.chi2_before - torque.dof_before),
        quiet_before=_quiet_before(estimate, torque.time, along),
    )


def _source(torque: FreeSignal, better: FreeSignal | None) -> str:
    if better is not None:
        return better.source
    explains = torque.p_left > LIMITS.sufficient or torque.explained > LIMITS.least_explained
    return "body torque" if explains else "nothing smooth"


def _better_signal(
    fit: LinearisedFit, response: TorqueResponse, torque: FreeSignal
) -> FreeSignal | None:
    """The signal other than a body torque with the best evidence, if that is far better."""
    if torque.p_left > LIMITS.sufficient:
        return None
    sources = ("rate sensor", "wheel torque", "tachometers")
    bases = (signal_basis(fit, response, source) for source in sources)
    found = (infer_signal(fit, basis) for basis in bases if basis is not None)
    best = max(found, key=lambda s: s.log_evidence, default=torque)
    return best if best.log_evidence > torque.log_evidence + LIMITS.sensor_margin else None


def _main_axis(vectors: np.ndarray) -> tuple[np.ndarray, float]:
    """Axis (3,) with the most power of vectors (..., 3), and its share of the power.

    It points along the mean where there is one, else its largest component is positive.
    """
    flat = vectors.reshape(-1, 3)
    values, axes = np.linalg.eigh(flat.T @ flat)
    axis = axes[:, -1]
    mean = float(np.mean(flat @ axis))
    steady = abs(mean) > 0.5 * np.sqrt(np.mean((flat @ axis) ** 2))
    sign = np.sign(mean) if steady else np.sign(axis[np.argmax(np.abs(axis))])
    return axis * (sign or 1.0), float(values[-1] / max(values.sum(), 1e-300))


def _quiet_before(estimate: Estimate, time: np.ndarray, along: np.ndarray) -> float | None:
    """rms of the torque before the wheels first act, over its rms afterwards.

    None without commands or without a rest before them.
    """
    campaign = estimate.model.campaign
    if not campaign.has_commands:
        return None
    before, after = list[np.ndarray](), list[np.ndarray]()
    for slew, t, y in zip(campaign.slews, time, along, strict=True):
        if slew.wheel_torque is not None:
            effort = np.linalg.norm(slew.wheel_torque, axis=1)
            early = t < slew.time[np.argmax(effort > LIMITS.active_share * effort.max())]
            if np.count_nonzero(early) > 2:
                before.append(y[early])
                after.append(y[~early])
    if not before:
        return None
    powers = [float(np.mean(np.concatenate(part) ** 2)) for part in (before, after)]
    return float(np.sqrt(powers[0] / max(powers[1], 1e-300)))


@array_dataclass
class Spectrum:
    """Of a signal, all slews together.

    Parameters
    ----------
    frequency : (f,) array
        [Hz].
    power : (f,) array
        In squares of the signal's unit.
    peak : float
        The strongest frequency [Hz].
    line : bool
        Whether most of the power is there.
    """

    frequency: np.ndarray
    power: np.ndarray
    peak: float
    line: bool


def spectrum_of(time: np.ndarray, signal: np.ndarray) -> Spectrum:
    """Average the periodograms of all slews (Hann window, padded), each with its own spacing.

    `time` (slews, n) [s]; `signal` (slews, n).

    Examples
    --------
    >>> time = np.arange(200.0)[None]
    >>> spectrum = spectrum_of(time, np.sin(2.0 * np.pi * 0.1 * time))
    >>> round(spectrum.peak, 2), spectrum.line
    (0.1, True)
    """
    n = signal.shape[1]
    padded = LIMITS.padding * n
    steps = (time[:, -1] - time[:, 0]) / (n - 1)
    window = np.hanning(n)
    frequency = np.fft.rfftfreq(padded, steps.max())
    swings = signal - signal.mean(1, keepdims=True)
    transforms = np.fft.rfft(swings * window, padded, axis=1)
    periodograms = np.abs(transforms) ** 2 / np.sum(window**2)
    own = zip((np.fft.rfftfreq(padded, step) for step in steps), periodograms, strict=True)
    power = np.mean([np.interp(frequency, *periodogram) for periodogram in own], axis=0)
    duration = n * float(np.median(steps))
    fast = frequency > LIMITS.slowest / duration
    peak = float(frequency[fast][np.argmax(power[fast])]) if fast.any() else 0.0
    near = np.abs(frequency - peak) < LIMITS.half_width / duration
    concentrated = power[near].sum() > LIMITS.line_share * power.sum()
    swinging = float(np.mean(swings**2)) > 0.5 * float(np.mean(signal**2))
    return Spectrum(frequency, power, peak, bool(fast.any() and concentrated and swinging))
