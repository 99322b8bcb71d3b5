"""How large one unmodelled effect must be to leave a given correction slew, each alone (used by
`paper_tables.py`).
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

import numpy as np
from common import ARCSEC, DEG, FLIGHT, controller_of, prior_of, spacecraft_of
from scipy.optimize import brentq

from bayes_inertia.errors import EffectError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import fly
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


def _size(left, guess: float, wanted: float, most: float) -> float | None:
    """Size at which `left(size)` is `wanted`, None if it is not reached up to `most`."""
    high = guess
    while high < most and np.isfinite(x := left(high)) and x < wanted:
        high *= 2.0
    high = min(high, most)
    return (
        float(brentq(lambda x: left(x) - wanted, 0.0, high, rtol=1e-4))
        if np.isfinite(x := left(high)) and x >= wanted
        else None
    )


def single_effects(plan: Plan, wanted: float, quick: bool) -> list[list[str]]:
    """Rows (effect, size, remark) for a slew about x that leaves `wanted` [arcsec]."""
    truth = FLIGHT.new
    motion = plan.slews[0].motion_time
    x, y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    # The drift is counted from the campaign's middle: only what happens after the snapshot at rest
    # matters.
    cases = [
        (
            RateSensorMisalignment(),
            "angle",
            y,
            1e-3,
            0.2,
            "rate sensor turned about y",
            lambda v: f"{v / DEG:.2f} deg",
            "across the slew axis; 2 sin(angle/2) of it is left",
        ),
        (
            StarTrackerMisalignment(),
            "angle",
            y,
            1e-3,
            0.2,
            "star tracker turned about y",
            lambda v: f"{v / DEG:.2f} deg",
            "the same geometry",
        ),
        (
            RateBiasDrift(),
            "drift",
            x,
            1e-7,
            1e-4,
            "rate bias drift about x after the snapshot",
            lambda v: f"{v:.1e} rad/s² ({v * motion / DEG * 3600:.1f} deg/h over the motion)",
            "acts from the bias snapshot on",
        ),
        (
            WheelCommandLag(),
            "tau",
            1.0,
            0.05,
            2.0,
            "wheel command lag",
            lambda v: f"{v:.2f} s",
            "feedback removes what the lag does; it is gone at rest",
        ),
        (
            WheelTorqueGain(),
            "gain",
            x,
            0.05,
            1.0,
            "torque gain of wheel x",
            lambda v: f"{100 * v:.0f} %",
            "feedback removes it; no final error",
        ),
        (
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
    if quick:
        cases = cases[:1]
    K = np.array([0.0] * 6 + [1.0, 0.0, 0.0])
    size = _size(lambda k: _left(plan, truth + k * K), 1e-3, wanted, 0.1)
    rows = [
        [
            "scale factor K1",
            f"{100 * size:.2f} %",
            "error = angle times K error, along the slew axis",
        ]
    ]
    duration = plan.durations[0] - plan.rest_before
    rows.append(
        [
            "rate bias since a stale snapshot",
            f"{wanted * ARCSEC / duration:.1e} rad/s ({wanted / duration:.0f} deg/h)",
            f"{duration:.0f} s from the snapshot to the last fix; "
            "seconds of arc a second are degrees an hour",
        ]
    )
    for effect, key, along, guess, most, name, shown, remark in cases:

        def left(v, effect=effect, key=key, along=along):
            null = 1.0 if key == "gain" else 0.0
            return _left(plan, truth, (effect,), {effect.name: {key: null + v * np.asarray(along)}})

        size = _size(left, guess, wanted, most)
        reached = (
            np.nan
            if size is not None
            else np.nanmax([0.0, *(left(v) for v in (0.25 * most, 0.5 * most))])
        )
        says = shown(size) if size is not None else f"none up to {shown(most)}"
        rows.append(
            [name, says, remark if size is not None else f'{remark} (largest found {reached:.0f}")']
        )
    return rows


__all__ = ["single_effects"]
