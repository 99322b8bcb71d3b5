"""Dirt for `conventions.py`: what telemetry suffers although every convention is right."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import lfilter

from analyses.imports.conventions_folder import RawCampaign, changed, stated

Dirty = Callable[[RawCampaign, np.random.Generator], RawCampaign]


def _sigma(raw: RawCampaign) -> np.ndarray:
    """Noise of the gyro (3,) [rad/s]."""
    return np.broadcast_to(np.array(raw.description["rate_sensor"]["sigma"], dtype=float), 3)


def _momentum_sigma(raw: RawCampaign) -> np.ndarray:
    """Noise of the tachometers in the table's unit."""
    sigma = np.array([wheel["momentum_sigma"] for wheel in raw.wheels])
    if raw.has("wheel_speed"):
        sigma = sigma / np.array([wheel["spin_inertia"] for wheel in raw.wheels])
    return sigma


def outliers(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """0.5 % of the gyro's readings are wrong by up to 1000 sigma, and as many of the others."""
    sigma = _sigma(raw)

    def spoil(values: np.ndarray, scale: np.ndarray) -> np.ndarray:
        hit = rng.random(values.shape) < 0.005
        size = 10.0 ** rng.uniform(1.0, 3.0, values.shape) * rng.choice([-1.0, 1.0], values.shape)
        return np.where(hit, values + size * scale, values)

    raw = changed(raw, "rate", lambda w: spoil(w, sigma))
    if raw.has(raw.momentum_channel):
        h_sigma = _momentum_sigma(raw)
        raw = changed(raw, raw.momentum_channel, lambda h: spoil(h, h_sigma))
    return raw


def wild_fixes(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """3 % of the star tracker's fixes are any attitude whatever, at least one in each slew."""
    if not raw.has("attitude"):
        return outliers(raw, rng)

    def spoil(q: np.ndarray) -> np.ndarray:
        fixed = np.flatnonzero(np.isfinite(q).all(axis=1))
        n = max(1, round(0.03 * len(fixed)))
        rows = rng.choice(fixed, n, replace=False)
        wild = rng.normal(size=(n, 4))
        q = q.copy()
        q[rows] = wild / np.linalg.norm(wild, axis=1, keepdims=True)
        return q

    return changed(raw, "attitude", spoil)


def stuck(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """Every reading of the gyro stays for 3 s (or a fiftieth of the rows), in each slew."""
    time = raw.stacked("time")[0][:, 0]
    period = float(np.median(np.diff(time)))
    rows = max(2, min(round(3.0 / period), len(time) // 50))

    def hold(w: np.ndarray) -> np.ndarray:
        first, w = int(rng.integers(len(w) // 4, 3 * len(w) // 4)), w.copy()
        w[first : first + rows] = w[first]
        return w

    return changed(raw, "rate", hold)


def stuck_tachometer(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """One tachometer stays as it is for a twentieth of the rows, in each slew."""
    if not raw.has(raw.momentum_channel):
        return stuck(raw, rng)

    def hold(h: np.ndarray) -> np.ndarray:
        first, k, h = int(rng.integers(len(h) // 2)), int(rng.integers(h.shape[1])), h.copy()
        h[first : first + len(h) // 20, k] = h[first, k]
        return h

    return changed(raw, raw.momentum_channel, hold)


def dropped_rows(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """5 % of the rows are missing."""

    def kept(n: int) -> np.ndarray:
        keep = rng.random(n) > 0.05
        keep[[0, -1]] = True
        return keep

    return _rows(raw, kept)


def gap(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """A twelfth of each slew's rows is missing, somewhere in its middle."""

    def kept(n: int) -> np.ndarray:
        first = int(rng.integers(n // 4, n // 2))
        return ~np.isin(np.arange(n), np.arange(first, first + n // 12))

    return _rows(raw, kept)


def _rows(raw: RawCampaign, kept: Callable[[int], np.ndarray]) -> RawCampaign:
    tables = {}
    for file, table in raw.tables.items():
        keep = kept(len(next(iter(table.values()))))
        tables[file] = {name: column[keep] for name, column in table.items()}
    return RawCampaign(raw.description, tables)


def empty_cells(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """A third of the gyro's cells are empty, and one axis for a tenth of each slew."""

    def drop(w: np.ndarray) -> np.ndarray:
        w = np.where(rng.random(w.shape) < 0.33, np.nan, w)
        first, axis = int(rng.integers(len(w) // 2)), int(rng.integers(3))
        w[first : first + len(w) // 10, axis] = np.nan
        return w

    return changed(raw, "rate", drop)


def quantised(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """The gyro counts in steps of 2 to 8 sigma, the tachometers in steps of 1 to 5 sigma."""
    step = rng.uniform(2.0, 8.0) * _sigma(raw)
    raw = changed(raw, "rate", lambda w: step * np.round(w / step))
    if raw.has(raw.momentum_channel):
        h_step = rng.uniform(1.0, 5.0) * _momentum_sigma(raw)
        raw = changed(raw, raw.momentum_channel, lambda h: h_step * np.round(h / h_step))
    return raw


def coloured(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """The gyro has a noise of 1 to 4 sigma beside its own that forgets over 10 rows."""
    size, memory = rng.uniform(1.0, 4.0) * _sigma(raw), 0.9

    def add(w: np.ndarray) -> np.ndarray:
        noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.normal(size=w.shape), 0)
        return w + size * noise

    return changed(raw, "rate", add)


def random_walk(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """The gyro's bias walks by 2 sigma over each slew."""
    sigma = _sigma(raw)

    def add(w: np.ndarray) -> np.ndarray:
        return w + 2.0 * sigma / np.sqrt(len(w)) * np.cumsum(rng.normal(size=w.shape), axis=0)

    return changed(raw, "rate", add)


def understated_noise(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """All noises are 3 times as large as stated."""
    third = (_sigma(raw) / 3.0).tolist()
    raw = stated(raw, rate_sensor__sigma=third)
    for i, wheel in enumerate(raw.wheels):
        if "momentum_sigma" in wheel:
            raw = stated(raw, **{f"wheels__{i}__momentum_sigma": wheel["momentum_sigma"] / 3.0})
    if raw.has("attitude"):
        tracker = raw.description["star_tracker"]
        raw = stated(
            raw,
            star_tracker__sigma_cross=tracker["sigma_cross"] / 3.0,
            star_tracker__sigma_roll=tracker["sigma_roll"] / 3.0,
        )
    return raw


def overstated_noise(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """The gyro's noise is stated 10 times too large."""
    return stated(raw, rate_sensor__sigma=(10.0 * _sigma(raw)).tolist())


def saturated(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """The gyro's readings end at three quarters of the largest, which is its stated range."""
    largest = max(float(np.nanmax(np.abs(w))) for w in raw.stacked("rate"))
    limit = 0.75 * largest
    raw = changed(raw, "rate", lambda w: np.clip(w, -limit, limit))
    return stated(raw, rate_sensor__range=limit)


def stale_bias(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """The stated bias is old: the gyro's is 30 stated sds (at least half a sigma) off."""
    sd = np.array(raw.description["rate_sensor"].get("bias_sigma", 1e-5))
    off = np.maximum(30.0 * sd, 0.5 * _sigma(raw)) * rng.choice([-1.0, 1.0], 3)
    return changed(raw, "rate", lambda w: w + off)


def single_precision(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """All readings were stored with 32 bits."""
    for channel in ("rate", raw.momentum_channel, "wheel_torque"):
        if raw.has(channel):
            raw = changed(raw, channel, lambda x: x.astype(np.float32).astype(float))
    return raw


def jittered_time(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """Stamps are wrong by 2 % of the time between rows."""

    def jitter(t: np.ndarray) -> np.ndarray:
        return t + 0.02 * np.median(np.diff(t[:, 0])) * rng.uniform(-1.0, 1.0, t.shape)

    return changed(raw, "time", jitter)


def rare_fixes(raw: RawCampaign, rng: np.random.Generator) -> RawCampaign:
    """Of each slew only the first and the last fix are left."""
    if not raw.has("attitude"):
        return dropped_rows(raw, rng)

    def thin(q: np.ndarray) -> np.ndarray:
        fixed = np.flatnonzero(np.isfinite(q).all(axis=1))
        out = np.full_like(q, np.nan)
        out[fixed[[0, -1]]] = q[fixed[[0, -1]]]
        return out

    return changed(raw, "attitude", thin)


DIRT: Mapping[str, Dirty] = {
    function.__name__.replace("_", " "): function
    for function in (
        outliers,
        wild_fixes,
        stuck,
        stuck_tachometer,
        dropped_rows,
        gap,
        empty_cells,
        quantised,
        coloured,
        random_walk,
        understated_noise,
        overstated_noise,
        saturated,
        stale_bias,
        single_precision,
        jittered_time,
        rare_fixes,
    )
}
