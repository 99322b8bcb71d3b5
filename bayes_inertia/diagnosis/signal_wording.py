"""An unexplained signal in a sentence that an engineer can act on."""

from __future__ import annotations

import numpy as np

from bayes_inertia.diagnosis.driven_disturbances import CONSTANT
from bayes_inertia.diagnosis.free_signal import FreeSignal
from bayes_inertia.diagnosis.unexplained import UnexplainedSignal

_TIED_LOG_EVIDENCE = 3.0  # of log evidence, below which two laws are as good
_NAMED_AXIS = np.radians(15.0)  # angle to a body axis within which a direction has its name
_ONE_AXIS_SHARE = 0.8  # of the power, above which the torque has one axis
_MENTIONED_SHARE = 0.3  # of the torque, above which what it goes along with is mentioned
_MAX_QUIET_RMS_RATIO = 0.4  # rms before the wheels act over rms afterwards, below which it does


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
    if signal.quiet_before < _MAX_QUIET_RMS_RATIO:
        return f"{said} that begins when the wheels act ({size}): appendage or slosh"
    return (
        f"{said} all the time, also before the wheels act ({size}): "
        "something that runs by itself, such as a wheel's imbalance or a pump"
    )


def _torque(signal: UnexplainedSignal) -> str:
    """A torque without a line in its spectrum."""
    size = f"{signal.torque_rms:.2g} N m rms"
    one_axis = signal.axis_share > _ONE_AXIS_SHARE
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
        if best is not None and best.share > _MENTIONED_SHARE
        else ""
    )
    return (
        f"a torque {axis} that changes within about {signal.torque.length:.2g} s, "
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
    chosen = CONSTANT if torques[CONSTANT] > torques[best] - _TIED_LOG_EVIDENCE else best
    return chosen if torques[chosen] > signal.torque.log_evidence - _TIED_LOG_EVIDENCE else None


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
    if abs(axis_B[i]) > np.cos(_NAMED_AXIS):
        return ("-" if axis_B[i] < 0 else "+") * signed + "xyz"[i]
    return "(" + ", ".join(f"{x + 0.0:.2f}" for x in np.round(axis_B, 2)) + ")"
