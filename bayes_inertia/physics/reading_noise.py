"""What a first-order process adds to the readings of a sensor."""

from __future__ import annotations

from typing import NamedTuple

from jax import Array


class ReadingNoise(NamedTuple):
    """A Gauss-Markov process or a random walk beside the white noise of readings.

    Parameters
    ----------
    channel : {"rate", "momentum"}
        Of which readings; each component has a process of its own.
    size : float or () array
        Sd of the Gauss-Markov process; of a random walk the density, its sd after one second. SI.
    time : float or () array, optional
        Correlation time [s]; infinite: a random walk. It is zero in the middle of the campaign: a
        slew begins with what it became since (or before).
    knots : int, optional
        Where an effect's coefficients are its values on so many evenly spaced knots of each slew,
        with straight lines between; 0: they are not. What is left between knots begins and ends at
        zero there: a Brownian bridge, whose density is that of the change from knot to knot.

    Examples
    --------
    >>> ReadingNoise("rate", 1e-6).time
    inf
    """

    channel: str
    size: float | Array
    time: float | Array = float("inf")
    knots: int = 0
