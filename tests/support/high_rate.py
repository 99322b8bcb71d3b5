"""Campaigns whose integration steps span many rows of telemetry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, Wheel
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.physics.small_campaign import small_campaign


def thrown(rows_a_second: int = 1000, duration: float = 0.7) -> Campaign:
    """Two throws of a small body with a wheel, tachometer and gyro as noisy as real ones."""
    rng = np.random.default_rng(5)
    inertia = np.array([1.5e-3, 3.8e-4, 1.7e-3])
    step = 1.0 / rows_a_second
    time = np.arange(round(duration * rows_a_second)) * step
    slews = []
    for k in range(2):
        rate, rows = rng.normal(size=3) * 6.0, []
        for _ in time:
            rows.append(rate)
            momentum = inertia * rate + [0.0, 0.0, -3e-4]
            rate = rate - step * np.cross(rate, momentum) / inertia
        noise = 0.0153 * rng.normal(size=(len(time), 3))
        wheel = -3e-4 + 9.6e-6 * rng.normal(size=(len(time), 1))
        slews.append(Slew(f"throw {k}", 60.0 * k, time, np.array(rows) + noise, None, None, wheel))
    wheels = (Wheel("z", (0.0, 0.0, 1.0), 1.7e-6, momentum_sigma=9.6e-6),)
    prior = InertiaPrior(np.diag(inertia), 0.1, 5e-5)
    return Campaign("throws", prior, wheels, RateSensor(sigma=0.0153), None, tuple(slews))


def dense(rows_a_second: int = 8) -> Campaign:
    """The small campaign with rows in between; fixes, field and position at all of them."""
    campaign, slews = small_campaign(), []
    for slew in campaign.slews:
        time = np.arange(0.0, slew.time[-1], 1.0 / rows_a_second)
        held = np.floor(time).astype(int)
        rows = {
            key: np.stack([np.interp(time, slew.time, column) for column in values.T], -1)
            for key, values in (
                ("rate", slew.rate),
                ("wheel_momentum", slew.wheel_momentum),
                ("magnetic_field_N", slew.magnetic_field_N),
                ("position_N", slew.position_N),
            )
        }
        attitude = slew.attitude[held]
        torque = slew.wheel_torque[held]
        slews.append(replace(slew, time=time, attitude=attitude, wheel_torque=torque, **rows))
    return replace(campaign, slews=tuple(slews))
