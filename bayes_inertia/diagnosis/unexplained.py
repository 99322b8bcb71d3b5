"""What no candidate explains: the equivalent disturbance torque over time, and what it looks like.

The torque is inferred with its band (`free_signal`) from an estimate's residuals. Its axis,
spectrum and what it goes along with are then put into a sentence an engineer can act on
(`signal_wording`). Where no torque explains the residuals, the same is tried with an error of the
sensors, so that nobody looks for a torque that is not there.

The spectrum of a signal in all slews together, and whether it has a line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.diagnosis.driven_disturbances import driven_evidence, drivers
from bayes_inertia.diagnosis.free_signal import FreeSignal, infer_signal
from bayes_inertia.diagnosis.signal_basis import (
    body_torque,
    momentum_reading,
    rate_reading,
    wheel_torque,
)
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass

# p-value of what a torque leaves, above which nothing else is tried.
_SUFFICIENT_P_VALUE = 1e-4
# Log evidence by which another kind of signal must be better than a torque.
_SENSOR_MARGIN = 10.0
# Share of the excess of chi^2 above which a torque that is not sufficient still counts.
_LEAST_EXPLAINED_SHARE = 0.5
# Share of the torque's variance from which what is known explains it.
_NAMED_VARIANCE_SHARE = 0.9
# Effort of the wheels, as a share of the largest in the slew, from which they act.
_ACTIVE_WHEEL_SHARE = 0.2


@dataclass(frozen=True)
class Match:
    """How well the torque along its axis follows something known.

    Parameters
    ----------
    name : str
        What it may follow: a key of `drivers`.
    share : float
        Share of the torque's mean square that it explains, corrected for chance.
    correlation : float
        Of the best linear mix of its components.
    """

    name: str
    share: float
    correlation: float


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
        Of the torque along the axis, best first.
    driven_evidence : dict
        Log evidence for a disturbance in proportion to something known (`driven_disturbances`).
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
    driven_evidence: dict[tuple[str, str], float]
    quiet_before: float | None

    @property
    def frequency_hz(self) -> float | None:
        """Frequency of the ringing [Hz].

        None if there is no line in the spectrum, or something known explains the torque.
        """
        known = self.matches and self.matches[0].share > _NAMED_VARIANCE_SHARE
        ringing = self.spectrum.line and self.source == "body torque" and not known
        return self.spectrum.peak if ringing else None


def unexplained_signal(estimate: Estimate) -> UnexplainedSignal:
    """Infer the equivalent torque of what an estimate leaves unexplained.

    All that was fitted is integrated out with its priors, so that only what J, K, start states,
    bias and the effects of the model cannot produce is shown. To first order around the estimate.

    Returns: the torque, or the sensor's error, and what it looks like.
    """
    fit, response = estimate.linearised(), torque_response(estimate)
    torque = infer_signal(fit, body_torque(fit, response))
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
        matches=_matches(response, torque, along),
        driven_evidence=driven_evidence(response, fit),
        quiet_before=_quiet_before(estimate, torque.time, along),
    )


def _source(torque: FreeSignal, better: FreeSignal | None) -> str:
    if better is not None:
        return better.source
    explains = torque.p_left > _SUFFICIENT_P_VALUE or torque.explained > _LEAST_EXPLAINED_SHARE
    return "body torque" if explains else "nothing smooth"


def _better_signal(
    fit: LinearisedFit, response: TorqueResponse, torque: FreeSignal
) -> FreeSignal | None:
    """The signal other than a body torque with the best evidence, if that is far better."""
    if torque.p_left > _SUFFICIENT_P_VALUE:
        return None
    bases = [build(fit, response) for build in (rate_reading, wheel_torque, momentum_reading)]
    signals = [infer_signal(fit, basis) for basis in bases if basis is not None]
    best = max(signals, key=lambda s: s.log_evidence)
    return best if best.log_evidence > torque.log_evidence + _SENSOR_MARGIN else None


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


def _matches(response: TorqueResponse, torque: FreeSignal, along: np.ndarray) -> tuple[Match, ...]:
    """What the torque goes along with, best first."""
    duration = float(np.sum(torque.time[:, -1] - torque.time[:, 0]))
    independent = max(8.0, duration / (2.5 * torque.length))
    y = along.ravel()
    total = float(y @ y)
    matches = []
    for name, values in _drivers_at_knots(response, torque.time).items():
        x = values.reshape(len(y), -1)
        size = np.sqrt(np.mean(x**2, 0))
        x = x[:, size > 1e-12 * max(size.max(), 1e-300)]
        if not x.shape[1] or total <= 0:
            continue
        x = x / np.sqrt(np.mean(x**2, 0))
        left = y - x @ np.linalg.lstsq(x, y, rcond=1e-6)[0]
        ratio = float(left @ left) / total
        # No intercept: shares are of the mean square, corrected for how well chance would do.
        share = 1.0 - ratio * independent / max(independent - x.shape[1], 1.0)
        matches.append(Match(name, float(max(share, 0.0)), float(np.sqrt(max(1.0 - ratio, 0.0)))))
    return tuple(sorted(matches, key=lambda m: -m.share))


def _drivers_at_knots(response: TorqueResponse, time: np.ndarray) -> dict[str, np.ndarray]:
    """What a torque may go along with, at the knots: {name: (slews, knots, k)}."""
    first = np.array([slew.time[0] for slew in response.estimate.model.campaign.slews])
    grids = response.time + first[:, None]

    def at_knots(values: np.ndarray) -> np.ndarray:
        return np.stack(
            [
                np.stack([np.interp(t, grid, v) for v in x.T], -1)
                for t, grid, x in zip(time, grids, values, strict=True)
            ]
        )

    return {name: at_knots(values) for name, values in drivers(response).items()}


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
        early = t < slew.time[np.argmax(effort > _ACTIVE_WHEEL_SHARE * effort.max())]
        if np.count_nonzero(early) > 2:
            before.append(y[early])
            after.append(y[~early])
    if not before:
        return None
    power_before = np.mean(np.concatenate(before) ** 2)
    return float(np.sqrt(power_before / max(np.mean(np.concatenate(after) ** 2), 1e-300)))


# Share of the power near its peak from which a spectrum has a line (white noise: less than a
# tenth).
_LINE_SHARE = 0.3
_PADDING = 4  # times the length of the signal
# In units of 1 / duration: what is slower is no ringing; half the width of a line.
_SLOWEST, _HALF_WIDTH = 2.5, 3.0


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
    frequency = np.fft.rfftfreq(_PADDING * n, steps.max())
    swings = signal - signal.mean(1, keepdims=True)
    transforms = np.fft.rfft(swings * window, _PADDING * n, axis=1)
    periodograms = np.abs(transforms) ** 2 / np.sum(window**2)
    power = np.mean(
        [
            np.interp(frequency, np.fft.rfftfreq(_PADDING * n, step), p)
            for step, p in zip(steps, periodograms, strict=True)
        ],
        axis=0,
    )
    duration = n * float(np.median(steps))
    fast = frequency > _SLOWEST / duration
    peak = float(frequency[fast][np.argmax(power[fast])]) if fast.any() else 0.0
    near = np.abs(frequency - peak) < _HALF_WIDTH / duration
    concentrated = power[near].sum() > _LINE_SHARE * power.sum()
    swinging = float(np.mean(swings**2)) > 0.5 * float(np.mean(signal**2))
    return Spectrum(frequency, power, peak, bool(fast.any() and concentrated and swinging))
