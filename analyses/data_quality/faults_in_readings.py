"""Injectors of dirt in single readings and sensors: outliers, stuck, saturated, noise."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from analyses.data_quality.faults import (
    Injector,
    RawCampaign,
    a_file,
    changed,
    described,
    everywhere,
    numbers,
    slewing,
    window,
    with_table,
)

# Share of readings that are outliers at size 1, and their sizes [sigma].
_OUTLIER_SHARE = 0.005
_OUTLIER_SIZES = (5.0, 1000.0)
# A stuck value at size 1 lasts so long [s].
_STUCK_SECONDS = 3.0


def _spikes(values: np.ndarray, share: float, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Values with a share of spikes (at least two), log-uniform in size."""
    rows, width = values.shape
    count = max(2, round(share * values.size))
    picked = rng.choice(values.size, count, replace=False)
    size = sigma * np.exp(rng.uniform(*np.log(_OUTLIER_SIZES), count))
    spiked = values.copy().ravel()
    spiked[picked] += size * rng.choice([-1.0, 1.0], count)
    return spiked.reshape(rows, width)


def outliers(channel: str) -> Injector:
    """Spikes of 5 to 1000 sigma in 0.5 % of the readings (times size)."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        share = size * _OUTLIER_SHARE
        return everywhere(
            raw, channel, partial(_spikes, share=share, sigma=raw.sigma(channel), rng=rng)
        )

    return inject


def outlier_fixes(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """Fixes that are 5 to 1000 sigma off (twice size of them)."""
    for _ in range(max(1, round(2 * size))):
        file = a_file(raw, rng)
        q = numbers(raw.tables[file], raw.names("attitude"))
        row = int(rng.choice(np.flatnonzero(np.isfinite(q).all(axis=1))))
        sigma = raw.sigma("attitude") * np.exp(rng.uniform(*np.log(_OUTLIER_SIZES)))
        off = rng.normal(size=3)
        turn = Rotation.from_rotvec(sigma * off / np.linalg.norm(off))
        q[row] = (Rotation.from_quat(q[row]) * turn).as_quat()
        raw = changed(raw, file, "attitude", lambda _, q=q: q)
    return raw


def zeros(channel: str) -> Injector:
    """A channel lost and written as 0 (1 % of the rows while slewing, times size)."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        file = a_file(raw, rng)
        rows = slewing(raw, file)
        lost = rng.choice(rows, max(1, round(0.01 * size * len(rows))), replace=False)

        def change(values: np.ndarray) -> np.ndarray:
            values = values.copy()
            values[lost] = 0.0
            return values

        return changed(raw, file, channel, change)

    return inject


def wrong_commands(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """Commands of three rows (times size) are off by 0.1 to 100 % of the largest torque."""
    names = raw.names("wheel_torque")
    largest = max(np.abs(numbers(t, names)).max() for t in raw.tables.values())
    for _ in range(max(1, round(3 * size))):
        file = a_file(raw, rng)
        row, wheel = rng.integers(len(raw.tables[file])), rng.integers(len(names))
        off = largest * np.exp(rng.uniform(np.log(1e-3), 0.0)) * rng.choice([-1.0, 1.0])

        def change(values: np.ndarray, row=row, wheel=wheel, off=off) -> np.ndarray:
            values = values.copy()
            values[row, wheel] += off
            return values

        raw = changed(raw, file, "wheel_torque", change)
    return raw


def stuck(channel: str, axes: int | None) -> Injector:
    """A channel that repeats its value for 3 s (times size); `axes` of it, None for all."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        file = a_file(raw, rng)
        rows = window(raw, file, rng, size * _STUCK_SECONDS)

        def change(values: np.ndarray) -> np.ndarray:
            values, width = values.copy(), values.shape[1]
            which = np.arange(width) if axes is None else rng.choice(width, axes, replace=False)
            values[np.ix_(rows, which)] = values[rows[0], which]
            return values

        return changed(raw, file, channel, change)

    return inject


def saturated(stated: bool) -> Injector:
    """Rates clipped at 85 % of the fastest (less for larger sizes); is the range stated?"""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        fastest = max(np.nanmax(np.abs(numbers(t, raw.names("rate")))) for t in raw.tables.values())
        limit = float(f"{fastest * (1.0 - 0.15 * size):.4g}")
        raw = everywhere(raw, "rate", lambda v: np.clip(v, -limit, limit))
        if stated:
            raw = described(raw, lambda d: d["rate_sensor"].update(range=limit))
        return raw

    return inject


def coloured(phi: float) -> Injector:
    """AR(1) noise of `size` sigma added to the rates."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        def change(values: np.ndarray) -> np.ndarray:
            noise = np.zeros(values.shape)
            steps = rng.normal(size=values.shape)
            noise[0] = steps[0]
            for k in range(1, len(noise)):
                noise[k] = phi * noise[k - 1] + np.sqrt(1.0 - phi**2) * steps[k]
            return values + size * raw.sigma("rate") * noise

        return everywhere(raw, "rate", change)

    return inject


def quantised(channel: str) -> Injector:
    """Readings rounded to 6 sigma (times size)."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        step = 6.0 * size * raw.sigma(channel)
        return everywhere(raw, channel, lambda v: np.round(v / step) * step)

    return inject


def wrong_noise(channel: str, factor: float) -> Injector:
    """The noise stated `factor` times what it is; size 2 squares the factor."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        times = factor**size

        def change(d: dict) -> None:
            if channel == "rate":
                d["rate_sensor"]["sigma"] = (np.array(d["rate_sensor"]["sigma"]) * times).tolist()
            elif channel == "attitude":
                for key in ("sigma_cross", "sigma_roll"):
                    d["star_tracker"][key] *= times
            else:
                for wheel in d["wheels"]:
                    wheel["momentum_sigma"] *= times

        return described(raw, change)

    return inject


def text_cells(channel: str, text: str) -> Injector:
    """0.5 % of the cells (times size, at least two) hold a text or number that means "nothing"."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        for file, table in raw.tables.items():
            table = table.copy()
            for name in raw.names(channel):
                count = max(1, round(size * _OUTLIER_SHARE * len(table)))
                table.loc[rng.choice(len(table), count, replace=False), name] = text
            raw = with_table(raw, file, table)
        return raw

    return inject


def unsigned_tachometer(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """Tachometers that show |speed|: the crossing of zero is unseen."""
    return everywhere(raw, "wheel_momentum", np.abs)


def axis_missing(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """One axis of the rates empty in 40 % of one slew (times size)."""
    file = a_file(raw, rng)
    n, axis = len(raw.tables[file]), int(rng.integers(3))
    length = min(n - 2, round(0.4 * size * n))
    first = int(rng.integers(n - length))

    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[first : first + length, axis] = np.nan
        return values

    return changed(raw, file, "rate", change)


def fixes_while_slewing(blur: float) -> Injector:
    """Fixes every 5 rows (divided by size) while slewing, `blur` s late and as much noisier."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        for file, truth in raw.attitude.items():
            raw = changed(raw, file, "attitude", partial(_with_fixes, raw, file, truth, rng=rng,
                          every=max(1, round(5 / size)), blur=blur))  # fmt: skip
        return raw

    return inject


def _with_fixes(raw, file, truth, q, *, rng, every, blur) -> np.ndarray:
    """The fixes and some more on the rows that turn."""
    rows, q = slewing(raw, file)[::every], q.copy()
    d, rates = raw.description["star_tracker"], numbers(raw.tables[file], raw.names("rate"))
    cross, roll = d["sigma_cross"], d["sigma_roll"]
    noise = rng.normal(size=(len(rows), 3)) * np.array([cross, cross, roll])
    smear = np.nan_to_num(rates[rows]) * blur
    smear = smear * rng.uniform(-1.5, -0.5, (len(rows), 1))
    q[rows] = (Rotation.from_quat(truth[rows]) * Rotation.from_rotvec(noise + smear)).as_quat()
    return q
