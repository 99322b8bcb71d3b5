"""The spectrum of a signal in all slews together, and whether it has a line."""

from __future__ import annotations

import numpy as np

from bayes_inertia.maths.values import array_dataclass

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

    Parameters
    ----------
    time : (slews, n) array
        Evenly spaced in each slew [s].
    signal : (slews, n) array
        Its values.

    Returns
    -------
    Spectrum
        With its strongest frequency.

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
