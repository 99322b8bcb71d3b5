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

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.diagnosis.formulas import drivers
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
from bayes_inertia.physics.effects.formula import DRIVERS, driver_of
from bayes_inertia.physics.effects.scales import torque_scale

CONSTANT, COMMAND, CAMPAIGN_TIME = (
    DRIVERS[key].words for key in ("constant", "wheel_commands", "campaign_time")
)
# What effects of the library follow with the same freedom: constant_torque, wheel_torque_gain with
# wheel_misalignment, rate_bias and rate_bias_drift.
DRIVEN_BY_LIBRARY = (
    ("body torque", CONSTANT),
    ("body torque", COMMAND),
    ("rate sensor", CONSTANT),
    ("rate sensor", CAMPAIGN_TIME),
)


def told_drivers(response: TorqueResponse) -> dict[str, np.ndarray]:
    """What a disturbance may be proportional to and a sentence can say.

    Returns: {words: (slews, n, k) array} on the integration grid, in SI units.
    """
    told = {driver_of(d.key).words: d.values for d in drivers(response) if driver_of(d.key).words}
    return {words: values for words, values in told.items() if values.any()}


def driven_columns(
    response: TorqueResponse,
) -> Iterator[tuple[tuple[str, str], np.ndarray]]:
    """Columns (slews, numbers, k) of each disturbance in proportion to a driver, along any axes.

    Returns: (source, driver) with each; the source is "body torque" or "rate sensor".
    """
    campaign = response.estimate.model.campaign
    torque_size, axes = torque_scale(campaign), len(RATE.sigma(campaign))
    rate_size = LIMITS.rate_error_share * campaign.scale_of_motion()[0]
    for name, values in told_drivers(response).items():
        rms = np.sqrt(np.mean(values**2, axis=(0, 1)))
        if not rms.max() > 0.0:
            continue
        # Component by component along each axis: unit values are one rms of the driver.
        moving = rms > LIMITS.negligible_component * rms.max()
        scaled = values[..., moving] / rms[moving]
        along, error = (
            np.einsum("snk,ij->snikj", scaled, np.eye(n)).reshape(*scaled.shape[:2], n, -1)
            for n in (3, axes)
        )
        yield ("body torque", name), response.residual_change(torque_size * along)
        if axes:
            yield ("rate sensor", name), response.reading_change("rate", rate_size * error)


def driven_evidence(response: TorqueResponse, fit: LinearisedFit) -> dict[tuple[str, str], float]:
    """Weigh each disturbance in proportion to a driver against nothing.

    Returns: {(source, driver): log evidence}.
    """
    found = {}
    for key, columns in driven_columns(response):
        matrix, gradient = fit.projected(columns)
        found[key] = log_evidence_of_columns(gradient, matrix)
    return found


@dataclass(frozen=True)
class Match:
    """How well the torque along its axis follows something known.

    Parameters
    ----------
    name : str
        What it may follow: a key of `told_drivers`.
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
        Log evidence for a disturbance in proportion to something known (`told_drivers`).
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
        matches=_matches(response, torque, along),
        driven_evidence=driven_evidence(response, fit),
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

    return {name: at_knots(values) for name, values in told_drivers(response).items()}


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
    if driver == CONSTANT:
        return f"a torque constant {axis} in all slews ({size})"
    if driver is not None:
        word = "growing with" if driver.startswith("time") else "proportional to"
        return f"a torque {axis}, {word} the {driver} ({size})"
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
    torques = {
        driver: evidence
        for (source, driver), evidence in signal.driven_evidence.items()
        if source == "body torque"
    }
    best = max(torques, key=torques.__getitem__)
    # Squares of rates are nearly constant in a campaign of like slews: the simpler word wins a near
    # tie.
    chosen = CONSTANT if torques[CONSTANT] > torques[best] - LIMITS.tied else best
    return chosen if torques[chosen] > signal.torque.log_evidence - LIMITS.tied else None


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
