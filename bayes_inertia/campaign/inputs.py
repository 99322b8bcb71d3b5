"""What devices were told to do, or did: a stream of numbers with its own clock."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from bayes_inertia.campaign.hardware import numbers, require_key
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.errors import is_one_of
from bayes_inertia.maths.values import array_dataclass

Between = Literal["hold", "line", "on_time", "mean"]


@array_dataclass
class InputStream:
    """What a device was told to do, or did, during one slew: n readings of k numbers.

    Before the first reading its value holds, after the last one that one; a pulse is over when it
    is over.

    Parameters
    ----------
    time : (n,) array
        Times of the readings on the slew's clock, strictly increasing, as `Slew.time` [s].
    values : (n, k) array
        Readings; k = 1 may be given as (n,). Times in seconds where `between` is "on_time".
    between : "hold", "line", "on_time" or "mean", optional
        What the device does from one reading to the next: it holds the value; it follows a straight
        line; it is fully on for the time that the value says, then off; or only the mean is known,
        and held.

    Raises
    ------
    CampaignError
        If times do not increase, shapes do not fit, a value is not finite, or a pulse is still on
        when the next one begins.

    Examples
    --------
    >>> pulses = InputStream(np.arange(3.0), np.array([0.2, 0.0, 1.0]), "on_time")
    >>> edges, first, last = pulses.pieces()
    >>> edges.tolist(), first[:, 0].tolist()
    ([0.0, 0.2, 2.0, 3.0], [0.0, 1.0, 0.0, 1.0, 0.0])
    """

    time: np.ndarray
    values: np.ndarray
    between: Between = "hold"

    def __post_init__(self) -> None:
        key, advice = "inputs", "give seconds on the slew's own clock, as Slew.time has them"
        # The slew's zero is not known here.
        time = numbers(self.time, f"{key}.time", advice)
        values = numbers(self.values, f"{key}.values")
        values = values[:, None] if values.ndim == 1 else values
        known, what = is_one_of(self.between, get_args(Between)), f"{self.between!r} is unknown"
        advice = f"choose one of {', '.join(get_args(Between))}"
        require_key(known, f"{key}.between", what, advice)
        fits = time.ndim == 1 and values.ndim == 2 and len(time) == len(values) > 0
        what = f"values of shape {values.shape} for times of shape {time.shape}"
        require_key(fits, f"{key}.values", what, "give (n,) times and (n, k) values, at least one")
        finite = bool(np.isfinite(time).all() and np.isfinite(values).all())
        advice = "leave the row out, or repair it"
        require_key(finite, key, "a time or a value is not a finite number", advice)
        increasing = bool(np.all(np.diff(time) > 0.0))
        what = "times do not increase strictly"
        require_key(increasing, f"{key}.time", what, "sort the rows and drop duplicates")
        if self.between == "on_time":
            _require_pulses(time, values, key)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "values", values)

    @property
    def width(self) -> int:
        """How many numbers a reading has, k."""
        return self.values.shape[1]

    def pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The input as straight lines: constants where it is held.

        Returns
        -------
        edges : (m,) array
            Where one piece ends and the next begins [s]; the first piece comes from minus
            infinity, the last goes on for ever.
        first : (m + 1, k) array
            The value of each piece at its beginning; a level of 0 or 1 where `between` is
            "on_time".
        last : (m + 1, k) array
            At its end.
        """
        if self.between == "line":
            first = np.concatenate([self.values[:1], self.values])
            return self.time, first, np.concatenate([self.values, self.values[-1:]])
        edges, levels = self._levels()
        changes = np.any(np.diff(levels, axis=0) != 0.0, axis=1)
        held = levels[np.concatenate([[True], changes])]
        return edges[changes], held, held

    def _levels(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges (m,) and what is held between them (m + 1, k)."""
        if self.between != "on_time":
            return self.time[1:], self.values
        ends = self.time[:, None] + self.values
        edges = np.unique(np.concatenate([self.time, ends.ravel()]))
        scale = LIMITS.same_time * max(1.0, float(np.abs(edges).max()))
        edges = edges[np.concatenate([[True], np.diff(edges) > scale])]
        middle = np.append(0.5 * (edges[1:] + edges[:-1]), np.inf)
        pulse = np.searchsorted(self.time, middle, side="right") - 1
        on = (middle[:, None] < ends[pulse]).astype(float)
        return edges, np.concatenate([np.zeros((1, self.width)), on])

    def within(self, begin: float, end: float) -> InputStream:
        """The readings that say what the device does from one time to another.

        Parameters
        ----------
        begin : float
            On the stream's own clock [s].
        end : float
            Likewise.

        Returns
        -------
        InputStream
            The same input between these times, without the readings that do not matter there.
        """
        first = max(int(np.searchsorted(self.time, begin, side="right")) - 1, 0)
        last = int(np.searchsorted(self.time, end, side="left")) + 1
        kept = slice(min(first, len(self.time) - 1), max(last, first + 1))
        return replace(self, time=self.time[kept], values=self.values[kept])


def held_integral(time: np.ndarray, values: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Integral (m, k), from the first time to moments (m,), of values (n, k) that are held."""
    added = values[:-1] * np.diff(time)[:, None]
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(added, axis=0)])
    found = np.zeros((len(moments), values.shape[1]))
    for k, column in enumerate(sums.T):
        found[:, k] = np.interp(moments, time, column)
    return found


def _require_pulses(time: np.ndarray, values: np.ndarray, key: str) -> None:
    """Raise `CampaignError` unless on-times (n, k) are times that end before the next reading."""
    on = bool((values >= 0.0).all())
    require_key(on, key, "an on-time is negative", "give the seconds that the device was on")
    if len(time) < 2:
        return
    step = np.diff(time)
    row, late = divmod(int(np.argmax(values[:-1] - step[:, None])), values.shape[1])
    longest = float(values[row, late])
    most = step[row] * (1.0 + 1e-6) + LIMITS.same_time * max(1.0, abs(float(time[-1])))
    advice = 'give one a command period, in the unit that is stated: unit = "ms" of milliseconds'
    what = f"the on-time {longest:.6g} s at {time[row]:.6g} s lasts beyond the next reading"
    require_key(longest <= most, key, what, advice)
