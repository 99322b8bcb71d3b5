"""How large one unmodelled effect must be to leave a given correction slew, each alone (used by
`paper_tables.py`).
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import brentq

from analyses.paper.ferguson import ARCSEC, DEG, FLIGHT, controller_of, prior_of, spacecraft_of
from bayes_inertia.errors import EffectError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    RateBiasDrift,
    RateSensorDelay,
    RateSensorMisalignment,
    StarTrackerMisalignment,
    WheelCommandLag,
    WheelTorqueGain,
)


def _left(plan: Plan, theta, effects=(), values=None) -> float:
    """Correction slew [arcsec] after the plan's slew, without noise."""
    craft = spacecraft_of(theta, bias=(0.0, 0.0, 0.0), effects=effects, values=values or {})
    try:
        mission = Mission(craft, prior_of(FLIGHT.new))
        flight = fly(plan, mission, None, controller=controller_of(FLIGHT.new))
        return float(flight.correction_slews[-1]) / ARCSEC
    except EffectError:
        return np.nan


def _size(left, guess: float, wanted: float, largest: float) -> float | None:
    """Size at which `left(size)` is `wanted`, None if it is not reached up to `largest`."""
    high = guess
    while high < largest and np.isfinite(x := left(high)) and x < wanted:
        high *= 2.0
    high = min(high, largest)
    x = left(high)
    if not (np.isfinite(x) and x >= wanted):
        return None
    return float(brentq(lambda x: left(x) - wanted, 0.0, high, rtol=1e-4))


@dataclass(frozen=True)
class Case:
    """One parameter of an effect, changed along a direction from its null.

    `guess` and `largest` are sizes: where the search begins and ends. `shown` prints a size.
    """

    effect: Effect
    parameter: str
    along: np.ndarray | float
    guess: float
    largest: float
    name: str
    shown: Callable[[float], str]
    remark: str

    def left(self, plan: Plan, size: float) -> float:
        """Correction slew [arcsec] with the effect of this size."""
        null = 1.0 if self.parameter == "gain" else 0.0
        value = null + size * np.asarray(self.along)
        return _left(plan, FLIGHT.new, (self.effect,), {self.effect.name: {self.parameter: value}})

    def row(self, plan: Plan, wanted: float) -> list[str]:
        """Effect, size, remark."""
        size = _size(partial(self.left, plan), self.guess, wanted, self.largest)
        if size is not None:
            return [self.name, self.shown(size), self.remark]
        reached = np.nanmax([0.0, *(self.left(plan, part * self.largest) for part in (0.25, 0.5))])
        none = f"none up to {self.shown(self.largest)}"
        return [self.name, none, f'{self.remark} (largest found {reached:.0f}")']


def _sensor_cases(motion: float) -> list[Case]:
    """Of rate sensor and star tracker; `motion` is the time of the slew [s].

    The drift is counted from the campaign's middle: only what happens after the snapshot at rest
    matters.
    """
    x, y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    return [
        Case(
            RateSensorMisalignment(),
            "angle",
            y,
            1e-3,
            0.2,
            "rate sensor turned about y",
            lambda v: f"{v / DEG:.2f} deg",
            "across the slew axis; 2 sin(angle/2) of it is left",
        ),
        Case(
            StarTrackerMisalignment(),
            "angle",
            y,
            1e-3,
            0.2,
            "star tracker turned about y",
            lambda v: f"{v / DEG:.2f} deg",
            "the same geometry",
        ),
        Case(
            RateBiasDrift(),
            "drift",
            x,
            1e-7,
            1e-4,
            "rate bias drift about x after the snapshot",
            lambda v: f"{v:.1e} rad/s² ({v * motion / DEG * 3600:.1f} deg/h over the motion)",
            "acts from the bias snapshot on",
        ),
    ]


def _actuator_cases() -> list[Case]:
    """Of what the feedback loop sees or does."""
    return [
        Case(
            WheelCommandLag(),
            "tau",
            1.0,
            0.05,
            2.0,
            "wheel command lag",
            lambda v: f"{v:.2f} s",
            "feedback removes what the lag does; it is gone at rest",
        ),
        Case(
            WheelTorqueGain(),
            "gain",
            np.array([1.0, 0.0, 0.0]),
            0.05,
            1.0,
            "torque gain of wheel x",
            lambda v: f"{100 * v:.0f} %",
            "feedback removes it; no final error",
        ),
        Case(
            RateSensorDelay(),
            "tau",
            1.0,
            0.1,
            3.0,
            "rate sensor delay",
            lambda v: f"{v:.2f} s",
            "the integral of a delayed rate is late, not wrong",
        ),
    ]


def single_effects(plan: Plan, wanted: float, quick: bool) -> list[list[str]]:
    """Rows (effect, size, remark) for a slew about x that leaves `wanted` [arcsec]."""
    K1 = np.array([0.0] * 6 + [1.0, 0.0, 0.0])
    size = _size(lambda k: _left(plan, FLIGHT.new + k * K1), 1e-3, wanted, 0.1)
    if size is None:
        raise ValueError(f"no error of K1 up to 0.1 leaves {wanted} arcsec")
    duration = plan.durations[0] - plan.rest_before
    rows = [
        [
            "scale factor K1",
            f"{100 * size:.2f} %",
            "error = angle times K error, along the slew axis",
        ],
        [
            "rate bias since a stale snapshot",
            f"{wanted * ARCSEC / duration:.1e} rad/s ({wanted / duration:.0f} deg/h)",
            f"{duration:.0f} s from the snapshot to the last fix; "
            "seconds of arc a second are degrees an hour",
        ],
    ]
    cases = [*_sensor_cases(plan.slews[0].motion_time), *_actuator_cases()]
    return rows + [case.row(plan, wanted) for case in (cases[:1] if quick else cases)]


__all__ = ["single_effects"]
