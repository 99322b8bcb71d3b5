"""What no candidate explains: the equivalent disturbance torque over time, and what it looks like.

The torque is inferred with its band (`free_signal`) from an estimate's residuals. Its axis,
spectrum and what it goes along with are put into a sentence an engineer can act on. Where no torque
explains the residuals, the same is tried with an error of the sensors, so that nobody looks for a
torque that is not there.

Disturbances that no effect of the library describes still follow something as a rule, a driver: the
square of the body rate, the momentum of the wheels, the field, the time. Along any axes they are
linear in a few numbers; in the table they show that a name would be an imitation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.diagnosis.formulas import told_blocks
from bayes_inertia.diagnosis.free_signal import (
    FreeSignal,
    infer_signal,
    signal_basis,
)
from bayes_inertia.diagnosis.hypothesis_table import log_evidence_of_columns
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects.formula import driver_of


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


def unexplained_signal(estimate: Estimate) -> UnexplainedSignal:
    """Infer the equivalent torque of what an estimate leaves unexplained.

    All that was fitted is integrated out with its priors, so that only what J, K, start states,
    bias and the effects of the model cannot produce is shown. To first order around the estimate.

    Returns: the torque, or the sensor's error, and what it looks like.
    """
    fit, response = estimate.linearised(), torque_response(estimate)
    torque = _inferred(fit, response, "body torque")
    assert torque is not None
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
    signals = [_inferred(fit, response, source) for source in sources]
    found = (signal for signal in signals if signal is not None)
    best = max(found, key=lambda s: s.log_evidence, default=torque)
    return best if best.log_evidence > torque.log_evidence + LIMITS.sensor_margin else None


def _inferred(fit: LinearisedFit, response: TorqueResponse, source: str) -> FreeSignal | None:
    basis = signal_basis(fit, response, source)
    return infer_signal(fit, basis) if basis is not None else None


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
    before, after = [], []
    for slew, t, y in zip(campaign.slews, time, along, strict=True):
        if slew.wheel_torque is None:
            continue
        effort = np.linalg.norm(slew.wheel_torque, axis=1)
        early = t < slew.time[np.argmax(effort > LIMITS.active_share * effort.max())]
        if np.count_nonzero(early) > 2:
            before.append(y[early])
            after.append(y[~early])
    if not before:
        return None
    power_before = np.mean(np.concatenate(before) ** 2)
    return float(np.sqrt(power_before / max(np.mean(np.concatenate(after) ** 2), 1e-300)))


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
    steps = (time[:, -1] - time[:, 0]) / (n - 1)
    window = np.hanning(n)
    frequency = np.fft.rfftfreq(LIMITS.padding * n, steps.max())
    swings = signal - signal.mean(1, keepdims=True)
    transforms = np.fft.rfft(swings * window, LIMITS.padding * n, axis=1)
    periodograms = np.abs(transforms) ** 2 / np.sum(window**2)
    power = np.mean(
        [
            np.interp(frequency, np.fft.rfftfreq(LIMITS.padding * n, step), p)
            for step, p in zip(steps, periodograms, strict=True)
        ],
        axis=0,
    )
    duration = n * float(np.median(steps))
    fast = frequency > LIMITS.slowest / duration
    peak = float(frequency[fast][np.argmax(power[fast])]) if fast.any() else 0.0
    near = np.abs(frequency - peak) < LIMITS.half_width / duration
    concentrated = power[near].sum() > LIMITS.line_share * power.sum()
    swinging = float(np.mean(swings**2)) > 0.5 * float(np.mean(signal**2))
    return Spectrum(frequency, power, peak, bool(fast.any() and concentrated and swinging))


def describe(signal: UnexplainedSignal) -> str:
    """Put a signal into a sentence.

    Returns: where it comes from, its axis, what it follows and its size; no full stop.
    """
    if signal.source == "nothing smooth":
        removed = f"{100.0 * signal.torque.explained:.0f} %"
        return (
            f"no torque explains it (one that varies smoothly removes {removed} of the misfit), "
            "nor does a smooth error of the rate sensor: look at single readings"
        )
    if signal.better_signal is not None:
        return _other_source(signal.source, signal.better_signal)
    if signal.frequency_hz is not None:
        return _ringing(signal)
    return _torque(signal)


def _other_source(source: str, signal: FreeSignal) -> str:
    """A signal that is no torque on the body."""
    size = f"{signal.rms:.2g} {signal.unit} rms"
    if source == "wheel torque":
        return (
            f"a torque between wheels and body that was not commanded ({size}): "
            "the wheels do not deliver what they are told"
        )
    name = "rate sensor's" if source == "rate sensor" else "tachometers'"
    return f"no torque explains it: it is in the sensors, an error of the {name} readings ({size})"


def _ringing(signal: UnexplainedSignal) -> str:
    """A torque with a line in its spectrum."""
    axis, size = axis_name(signal.axis_B, signed=False), f"{signal.torque_rms:.2g} N m rms"
    said = f"{signal.frequency_hz:.2g} Hz ringing about {axis}"
    if signal.quiet_before is None:
        return f"{said} ({size}): appendage, slosh or a wheel's imbalance"
    if signal.quiet_before < LIMITS.quiet_ratio:
        return f"{said} that begins when the wheels act ({size}): appendage or slosh"
    return (
        f"{said} all the time, also before the wheels act ({size}): "
        "something that runs by itself, such as a wheel's imbalance or a pump"
    )


def _torque(signal: UnexplainedSignal) -> str:
    """A torque without a line in its spectrum."""
    size = f"{signal.torque_rms:.2g} N m rms"
    one_axis = signal.axis_share > LIMITS.one_axis_share
    axis = f"about {axis_name(signal.axis_B)}" if one_axis else "about changing axes"
    driver = _driver(signal)
    if driver == "constant":
        return f"a torque constant {axis} in all slews ({size})"
    if driver is not None:
        words = driver_of(driver).words
        follows = "growing with" if words.startswith("time") else "proportional to"
        return f"a torque {axis}, {follows} the {words} ({size})"
    best = signal.matches[0] if signal.matches else None
    nearest = (
        f"; it goes along best with the {best.name} ({100.0 * best.share:.0f} % of it)"
        if best is not None and best.share > LIMITS.mentioned_share
        else ""
    )
    return (
        f"a torque {axis} that changes within about {float(f'{signal.torque.length:.2g}'):g} s, "
        f"without a line in its spectrum ({size}){nearest}"
    )


def _driver(signal: UnexplainedSignal) -> str | None:
    """What the torque is proportional to.

    The best by evidence, if that is not worse than a torque of any shape.
    """
    of_all = {match.driver: match.log_evidence for match in signal.matches}
    if not of_all:
        return None
    best = max(of_all, key=of_all.__getitem__)
    # Squares of rates are nearly constant in a campaign of like slews: the simpler word wins a near
    # tie.
    steady = of_all.get("constant", -np.inf) > of_all[best] - LIMITS.tied
    chosen = "constant" if steady else best
    return chosen if of_all[chosen] > signal.torque.log_evidence - LIMITS.tied else None


def axis_name(axis_B: np.ndarray, *, signed: bool = True) -> str:
    """Put a direction into words.

    `axis_B` (3,). Returns: "+x" where it is within 15 degrees of a body axis, its components
    elsewhere.

    Examples
    --------
    >>> axis_name(np.array([0.0, -0.99, 0.1])), axis_name(np.array([0.6, 0.8, 0.0]))
    ('-y', '(0.60, 0.80, 0.00)')
    >>> axis_name(np.array([0.0, -1.0, 0.0]), signed=False)
    'y'
    """
    i = int(np.argmax(np.abs(axis_B)))
    if abs(axis_B[i]) > np.cos(np.radians(LIMITS.named_axis)):
        return ("-" if axis_B[i] < 0 else "+") * signed + "xyz"[i]
    return "(" + ", ".join(f"{x + 0.0:.2f}" for x in np.round(axis_B, 2)) + ")"
