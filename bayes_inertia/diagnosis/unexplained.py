"""What no candidate explains: the equivalent disturbance torque over time, and what it looks like, in words.

The torque is inferred with its band (`history`) from an estimate's residuals. Its axis, spectrum and what it goes
along with are then put into a sentence an engineer can act on. Where no torque explains the residuals, the
same is tried with an error of the sensors, so that nobody looks for a torque that is not there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.diagnosis.driven_disturbances import CONSTANT, drivers, log_evidence
from bayes_inertia.diagnosis.free_signal import (
    History,
    body_torque,
    infer,
    momentum_reading,
    rate_reading,
    wheel_torque,
)
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.values import array_dataclass

_LEFT = 1e-4  # probability of what a torque leaves, above which nothing else is tried
_MARGIN = 10.0  # of log evidence by which another kind of signal must be better than a torque
_LINE = 0.3  # share of the power near its peak from which a spectrum has a line (white: less than a tenth)
_TIE = 3.0  # of log evidence, below which two laws are as good


@dataclass(frozen=True)
class Match:
    """How well the torque along its axis follows something known: `share` of its variance, corrected for chance; `correlation` of the best linear mix."""

    name: str
    share: float
    correlation: float


@array_dataclass
class Spectrum:
    """Of the torque along its axis, all slews together: `frequency` (f,) [Hz], `power` (f,) [N^2 m^2]; `peak` [Hz] the strongest,
    `line` whether most of the power is there."""

    frequency: np.ndarray
    power: np.ndarray
    peak: float
    line: bool


@array_dataclass
class Unknown:
    """The answer.

    Attributes
    ----------
    source : "body torque" or where else the residuals come from ("rate sensor", "wheel torque", "tachometers", "nothing smooth").
    torque : the equivalent body torque over time with its band, whether it explains the residuals or not.
    other : the signal that explains them better, if it is not a torque on the body.
    axis_B : (3,) unit vector of the torque; `axis_share` of its power is along it.
    torque_rms : [N m]. spectrum, matches (best first) : of the torque along the axis.
    followed : log evidence for a torque or rate error in proportion to something known (`proportional`).
    description : all this in words.
    """

    source: str
    torque: History
    other: History | None
    axis_B: np.ndarray
    axis_share: float
    torque_rms: float
    spectrum: Spectrum
    matches: tuple[Match, ...]
    followed: dict[tuple[str, str], float]
    description: str

    @property
    def frequency_hz(self) -> float | None:
        """Frequency of the ringing [Hz], None if there is no line in the spectrum or something known explains it."""
        known = self.matches and self.matches[0].share > 0.9
        return (
            self.spectrum.peak
            if self.spectrum.line and self.source == "body torque" and not known
            else None
        )


def unknown_torque(at: Estimate) -> Unknown:
    """The equivalent torque of what an estimate leaves unexplained.

    All that was fitted is integrated out with its priors, so that only what J, K, start states, bias and the
    effects of the model cannot produce is shown. To first order around the estimate.
    """
    fit, response = at.linearised(), torque_response(at)
    torque = infer(fit, body_torque(fit, response))
    enough = torque.p_left > _LEFT
    other = None if enough else _other(fit, response, torque)
    source = (
        other.source
        if other is not None
        else "body torque"
        if enough or torque.explained > 0.5
        else "nothing smooth"
    )
    axis, share = _axis(torque.mean)
    along = torque.mean @ axis
    spectrum = _spectrum(torque.time, along)
    matches = _matches(at, response, torque, along)
    rms = float(np.sqrt(np.mean(np.sum(torque.mean**2, -1))))
    followed = log_evidence(at, response, fit)
    found = Unknown(source, torque, other, axis, share, rms, spectrum, matches, followed, "")
    quiet = _quiet_before(at, torque.time, along)
    return Unknown(**{**found.__dict__, "description": describe(found, quiet)})


def _other(fit: LinearisedFit, response: TorqueResponse, torque: History) -> History | None:
    """The signal other than a body torque with the best evidence, if that is far better than the torque's."""
    bases = [build(fit, response) for build in (rate_reading, wheel_torque, momentum_reading)]
    found = [infer(fit, basis) for basis in bases if basis is not None]
    best = max(found, key=lambda h: h.log_evidence)
    return best if best.log_evidence > torque.log_evidence + _MARGIN else None


def _axis(vectors: np.ndarray) -> tuple[np.ndarray, float]:
    """Axis (3,) with the most power of vectors (..., 3), its largest component of the mean positive, and its share of the power."""
    flat = vectors.reshape(-1, 3)
    values, axes = np.linalg.eigh(flat.T @ flat)
    axis = axes[:, -1]
    mean = float(np.mean(flat @ axis))
    steady = abs(mean) > 0.5 * np.sqrt(np.mean((flat @ axis) ** 2))
    turned = np.sign(mean) if steady else np.sign(axis[np.argmax(np.abs(axis))])
    return axis * (turned or 1.0), float(values[-1] / max(values.sum(), 1e-300))


def axis_name(axis: np.ndarray, *, signed: bool = True) -> str:
    """A direction in words: "+x" where it is within 15 degrees of a body axis.

    >>> axis_name(np.array([0.0, -0.99, 0.1])), axis_name(np.array([0.0, -1.0, 0.0]), signed=False), axis_name(np.array([0.6, 0.8, 0.0]))
    ('-y', 'y', '(0.60, 0.80, 0.00)')
    """
    i = int(np.argmax(np.abs(axis)))
    if abs(axis[i]) > np.cos(np.radians(15.0)):
        return ("-" if axis[i] < 0 else "+") * signed + "xyz"[i]
    return "(" + ", ".join(f"{x + 0.0:.2f}" for x in np.round(axis, 2)) + ")"


def _spectrum(time: np.ndarray, along: np.ndarray) -> Spectrum:
    """Mean periodogram of all slews (Hann window, padded fourfold), each with its own knot spacing."""
    n = along.shape[1]
    steps = (time[:, -1] - time[:, 0]) / (n - 1)
    window = np.hanning(n)
    grid = np.fft.rfftfreq(4 * n, steps.max())
    own = np.abs(
        np.fft.rfft((along - along.mean(1, keepdims=True)) * window, 4 * n, axis=1)
    ) ** 2 / np.sum(window**2)
    power = np.mean(
        [
            np.interp(grid, np.fft.rfftfreq(4 * n, step), p)
            for step, p in zip(steps, own, strict=True)
        ],
        axis=0,
    )
    duration = n * float(np.median(steps))
    fast = grid > 2.5 / duration
    peak = float(grid[fast][np.argmax(power[fast])]) if fast.any() else 0.0
    near = np.abs(grid - peak) < 3.0 / duration
    raw = float(np.mean(along**2))
    swing = float(np.mean((along - along.mean(1, keepdims=True)) ** 2))
    line = bool(fast.any() and power[near].sum() > _LINE * power.sum() and swing > 0.5 * raw)
    return Spectrum(grid, power, peak, line)


def _matches(
    at: Estimate, response: TorqueResponse, torque: History, along: np.ndarray
) -> tuple[Match, ...]:
    """What the torque goes along with, best first."""
    known = _known(at, response, torque.time)
    points = max(8.0, float(np.sum(torque.time[:, -1] - torque.time[:, 0])) / (2.5 * torque.length))
    y = along.ravel()
    total = float(y @ y)
    found = []
    for name, values in known.items():
        x = values.reshape(len(y), -1)
        size = np.sqrt(np.mean(x**2, 0))
        x = x[:, size > 1e-12 * max(size.max(), 1e-300)]
        if not x.shape[1] or total <= 0:
            continue
        x = x / np.sqrt(np.mean(x**2, 0))
        left = y - x @ np.linalg.lstsq(x, y, rcond=1e-6)[0]
        ratio = float(left @ left) / total
        # No intercept: shares are of the mean square, corrected for how well chance would do.
        share = 1.0 - ratio * points / max(points - x.shape[1], 1.0)
        found.append(Match(name, float(max(share, 0.0)), float(np.sqrt(max(1.0 - ratio, 0.0)))))
    return tuple(sorted(found, key=lambda m: -m.share))


def _known(at: Estimate, response: TorqueResponse, time: np.ndarray) -> dict[str, np.ndarray]:
    """What a torque may go along with, at the knots: {name: (slews, knots, k)}."""
    begin = np.array([s.time[0] for s in at.model.campaign.slews])
    grids = response.time + begin[:, None]

    def at_knots(values: np.ndarray) -> np.ndarray:
        return np.stack(
            [
                np.stack([np.interp(t, g, v) for v in x.T], -1)
                for t, g, x in zip(time, grids, values, strict=True)
            ]
        )

    return {name: at_knots(values) for name, values in drivers(response).items()}


def _quiet_before(at: Estimate, time: np.ndarray, along: np.ndarray) -> float | None:
    """rms of the torque before the wheels first act, over its rms afterwards; None without commands or without a rest before them."""
    campaign = at.model.campaign
    if not campaign.has_commands:
        return None
    before, after = [], []
    for slew, t, y in zip(campaign.slews, time, along, strict=True):
        effort = np.linalg.norm(slew.wheel_torque, axis=1)
        first = slew.time[np.argmax(effort > 0.2 * effort.max())]
        early = t < first
        if np.count_nonzero(early) > 2:
            before.append(y[early])
            after.append(y[~early])
    if not before:
        return None
    return float(
        np.sqrt(
            np.mean(np.concatenate(before) ** 2) / max(np.mean(np.concatenate(after) ** 2), 1e-300)
        )
    )


def describe(found: Unknown, quiet_before: float | None = None) -> str:
    """The finding in a sentence.

    Parameters
    ----------
    quiet_before : rms of the torque before the wheels first act over its rms afterwards, where known.
    """
    if found.source == "nothing smooth":
        share = f"{100.0 * found.torque.explained:.0f} %"
        return (
            f"no torque explains it (one that varies smoothly removes {share} of the misfit), nor does a smooth error of the rate sensor: "
            "look at single readings"
        )
    if found.source in ("rate sensor", "tachometers"):
        size = f"{_rms(found.other):.2g} {found.other.unit} rms"
        name = (
            "rate sensor's readings" if found.source == "rate sensor" else "tachometers' readings"
        )
        return f"no torque explains it: it is in the sensors, an error of the {name} ({size})"
    if found.source == "wheel torque":
        return f"a torque between wheels and body that was not commanded ({_rms(found.other):.2g} N m rms): the wheels do not deliver what they are told"
    size = f"{found.torque_rms:.2g} N m rms"
    best = found.matches[0] if found.matches else None
    if found.frequency_hz is not None:
        return _ringing(found, quiet_before, size)
    axis = axis_name(found.axis_B)
    about = f"about {axis}" if found.axis_share > 0.8 else "about changing axes"
    law = _law(found)
    if law == CONSTANT:
        return f"a torque constant {about} in all slews ({size})"
    if law is not None:
        word = "growing with" if law.startswith("time") else "proportional to"
        return f"a torque {about}, {word} the {law} ({size})"
    nearest = (
        f"; it goes along best with the {best.name} ({100.0 * best.share:.0f} % of it)"
        if best is not None and best.share > 0.3
        else ""
    )
    return f"a torque {about} that changes within about {found.torque.length:.2g} s, without a line in its spectrum ({size}){nearest}"


def _law(found: Unknown) -> str | None:
    """What the torque is proportional to: the best by evidence, if that is not worse than a torque of any shape."""
    torques = {
        name: evidence
        for (source, name), evidence in found.followed.items()
        if source == "body torque"
    }
    best = max(torques, key=torques.__getitem__)
    # Squares of rates are nearly constant in a campaign of like slews: the simpler word wins a near tie.
    chosen = CONSTANT if torques[CONSTANT] > torques[best] - _TIE else best
    return chosen if torques[chosen] > found.torque.log_evidence - _TIE else None


def _ringing(found: Unknown, quiet_before: float | None, size: str) -> str:
    axis = axis_name(found.axis_B, signed=False)
    said = f"{found.frequency_hz:.2g} Hz ringing about {axis}"
    if quiet_before is None:
        return f"{said} ({size}): appendage, slosh or a wheel's imbalance"
    if quiet_before < 0.4:
        return f"{said} that begins when the wheels act ({size}): appendage or slosh"
    return f"{said} all the time, also before the wheels act ({size}): something that runs by itself, such as a wheel's imbalance or a pump"


def _rms(history: History) -> float:
    return float(np.sqrt(np.mean(np.sum(history.mean**2, -1))))
