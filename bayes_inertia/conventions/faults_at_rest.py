"""Faults of the telemetry that the check comes across: noise other than stated, a stale bias."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import SensorStream, series_of
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.noise_seen import noise_ratios
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.rotations import angle_of, composed, turned_back
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.limits import LIMITS as FAULTS
from bayes_inertia.maths.robust_scale import SD_OVER_MAD


def dirt_of(misfits: Misfits, stated: Reading, reading: Reading) -> tuple[dict[str, Any], ...]:
    """Everything that was found: by the reader, in the noise, and in the rests.

    `reading`: conventions that agree with it, perhaps with another rate bias. Returns: as
    `Dirt.json` writes them; a stale bias has the kind "stale_bias".
    """
    by_reader = [dirt.json() for dirt in misfits.campaign.dirt]
    series = series_of(misfits.campaign)
    levels = [dirt.json() for s in series if (dirt := _level(misfits.campaign, s)) is not None]
    return (*by_reader, *levels, *_stale_bias(misfits, stated, reading))


def _level(campaign: Campaign, stream: SensorStream) -> Dirt | None:
    ratio = noise_ratios(campaign, stream)
    off = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    if not len(off):
        return None
    worst = float(off[np.argmax(np.abs(np.log(off)))])
    if 1.0 / LIMITS.noise_ratio < worst < LIMITS.noise_ratio:
        return None
    note = f"the noise of the {stream.sensor} in smooth rows is {worst:.2g} times the stated one"
    if worst < 1.0:
        note += " (or it is filtered, and not white)"
    return Dirt("noise_level", stream.name, "", (), "ignored", note)


def _stale_bias(misfits: Misfits, stated: Reading, reading: Reading) -> list[dict[str, Any]]:
    """A rate bias far from the stated one, as the laws tell it, or star-tracker fixes at rest."""
    off = reading.bias_B - stated.bias_B
    if not off.any():
        off = _bias_at_rest(misfits, reading)
    if not off.any():
        return []
    axes = ", ".join(f"{off[k]:.2g} rad/s about {'xyz'[k]}" for k in np.flatnonzero(off))
    note = f"the rate bias is off the stated one by {axes} (body axes)"
    entry = {"kind": "stale_bias", "channel": "rate", "slew": "", "rows": []}
    return [{**entry, "treated": "ignored", "note": note}]


def _bias_at_rest(misfits: Misfits, reading: Reading) -> np.ndarray:
    """The rate bias (3,) that fixes at rest tell, 0 where it is not far from the stated one."""
    told = _rest_rates(misfits, reading)
    if not len(told):
        return np.zeros(3)
    bias = np.median(told, axis=0)
    spread = SD_OVER_MAD * np.median(np.abs(told - bias), axis=0) / np.sqrt(len(told))
    sensor = misfits.campaign.rate_sensor
    noise = np.asarray(sensor.sigma) / np.sqrt(FAULTS.rows_for_noise * len(told))
    sd = np.sqrt(np.square(sensor.bias_sigma) + spread**2 + noise**2)
    return np.where(np.abs(bias) > LIMITS.stale_bias_sds * sd, bias, 0.0)


def _rest_rates(misfits: Misfits, reading: Reading) -> np.ndarray:
    """Sensor's rate less the star tracker's (m, 3) between fixes of each rest [rad/s]."""
    slews, moving = misfits.slews, misfits.motion(reading)
    speed = np.sqrt((moving.rate_B**2).sum(axis=-1))
    told = []
    for k in range(len(slews.time)):
        limit = FAULTS.at_rest * speed[k].max()
        rows = np.flatnonzero(slews.fixes[k])
        for first, last in _rests(rows, speed[k] < limit):
            seconds = slews.time[k, last] - slews.time[k, first]
            q = slews.attitude[k, [first, last]] @ reading.attitude.T
            path = moving.path[k, [first, last]]
            turned = angle_of(composed(turned_back(path[0]), path[1]))
            true = angle_of(composed(turned_back(q[0]), q[1]))
            told.append((turned - true) / (reading.time * seconds))
    return np.array(told)


def _rests(rows: np.ndarray, at_rest: np.ndarray) -> list[tuple[int, int]]:
    """First and last fix of each stretch of moments that is all at rest."""
    # Two fixes share a stretch if no moment between them moves.
    moved = np.cumsum(~at_rest)
    stretches = []
    for number in np.unique(moved[rows[at_rest[rows]]]):
        within = rows[at_rest[rows] & (moved[rows] == number)]
        if len(within) > 1:
            stretches.append((int(within[0]), int(within[-1])))
    return stretches
