"""Sessions of SUCHAI-3 that a fit has not seen: does it predict them?

    python -m analyses.suchai3.held_out

Every second session is fitted. In each of the others the first part of a slew tells its own start
and gyro bias; the rest is predicted, with tensor, scale factors and magnetometer of the fit. Then
the halves change places. It writes `results/suchai3/held_out.json`, then the page and the figures.
Least squares on the forward model, each slew with a bias of its own; two minutes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from analyses import results_of
from analyses.suchai3.campaign import Setup, campaign
from analyses.suchai3.page import write_page
from analyses.suchai3.tumble import DRAWS, SEED, ratios_of
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.files import write_atomically
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict

RESULTS = results_of(__file__)
HALVES = ("one half", "other half")
SHOWN = 1 / 3  # of a slew, from its begin on, that tells its start; the rest is predicted
INTERVAL = 1.6449  # sds of a 90 % interval
_APART = 3600.0  # [s] between sessions
_CHANNELS = {"rate": "gyro", "magnetometer": "magnetometer"}
# Levenberg and Marquardt: most steps, first damping, and the gain in cost that ends it.
_STEPS, _DAMPING, _ENOUGH = 40, 1e-3, 1e-2
# Attitudes tried at the begin of a slew, on so many rows; the best few are followed.
_TRIED, _ROWS, _FOLLOWED = 256, 60, 2


@dataclass(frozen=True)
class Predicted:
    """One channel of one slew in its later part: n rows, three axes."""

    time: np.ndarray  # (n,) on the slew's clock [s]
    # (n, 3) readings; what is predicted, and its sd, noise of a reading included [rad/s or T].
    measured: np.ndarray
    mean: np.ndarray
    sd: np.ndarray

    @property
    def z(self) -> np.ndarray:
        """Errors (n, 3) in sds."""
        return (self.measured - self.mean) / self.sd


def halves(flown: Campaign) -> list[list[int]]:
    """Slews of every second session, and of the others."""
    starts = np.array([slew.start for slew in flown.slews])
    session = np.append(0, np.cumsum(np.diff(starts) > _APART))
    return [np.flatnonzero(session % 2 == k).tolist() for k in range(2)]


@dataclass(frozen=True)
class Gaussian:
    """What is known of the parameters that all slews share: mean (d,) and covariance (d, d)."""

    mean: np.ndarray
    covariance: np.ndarray


class Telemetry:
    """Readings of all slews, and the forward model of each with a start and a bias of its own."""

    def __init__(self, flown: Campaign) -> None:
        model = Model(flown)
        self.slews, self.model = flown.slews, model
        self.own = model.structure.n_local + model.n_bias
        self.prior = Gaussian(model.space.mean, np.diag(np.square(model.space.sd)))
        self.sigma = np.stack([sensor.sigma for sensor in _sensors(flown)])[:, None]
        names = [channel.name for channel in model.channels]
        places = [names.index(name) for name in _CHANNELS]
        n, m = model.space.size, model.structure.n_local

        def seen(x: jax.Array, arrays: Any) -> jax.Array:
            nuisances = model.structure.nuisances(x[n : n + m])
            told = predict(model.structure, x[:n], nuisances, x[n + m :], *arrays, data=model.data)
            return jnp.stack([told[k] for k in places])

        self._value, self._slope = jax.jit(seen), jax.jit(jax.jacfwd(seen))
        self._values = jax.jit(jax.vmap(seen, (0, None)))
        self._arrays = [
            jax.tree.map(lambda rows, k=k: rows[k], tuple(model.data.arrays))
            for k in range(len(flown.slews))
        ]

    def read(self, k: int) -> np.ndarray:
        """Readings of a slew (channels, rows, 3), NaN where there is none."""
        slew = self.slews[k]
        return np.stack([slew.rate, (slew.more or {})["magnetometer"]])

    def told(self, k: int, x: np.ndarray) -> np.ndarray:
        """What is predicted of them."""
        return np.asarray(self._value(x, self._arrays[k]))[:, : len(self.slews[k].time)]

    def slope(self, k: int, x: np.ndarray) -> np.ndarray:
        """By how much that changes with x (channels, rows, 3, x)."""
        return np.asarray(self._slope(x, self._arrays[k]))[:, : len(self.slews[k].time)]

    def residuals(self, k: int, x: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Readings that count minus predictions, in sigmas."""
        return (np.where(counts, self.read(k) - self.told(k, x), 0.0) / self.sigma).ravel()

    def begun(self, k: int, theta: np.ndarray) -> np.ndarray:
        """Own unknowns of a slew by its beginning, of many attitudes that it may begin at."""
        turns = Rotation.random(_TRIED, rng=np.random.default_rng(SEED)).as_rotvec()
        tried = np.zeros((_TRIED, len(theta) + self.own))
        tried[:, : len(theta)] = theta
        attitude = slice(len(theta) + 3, len(theta) + 6)
        tried[:, attitude] = turns / np.asarray(self.model.data.scale.local)[3:6]
        gaps = (
            self.read(k)[1, :_ROWS] - np.asarray(self._values(tried, self._arrays[k]))[:, 1, :_ROWS]
        )
        best = np.argsort(np.nansum(gaps**2, axis=(1, 2)))[:_FOLLOWED]
        shown = early(self.slews[k])[:, None] & np.isfinite(self.read(k))
        ends = [adjusted(self, [k], self.prior, [shown], tried[one]) for one in best]
        misfits = [np.sum(self.residuals(k, x, shown) ** 2) for x, _ in ends]
        return ends[int(np.argmin(misfits))][0][len(theta) :]


def _sensors(flown: Campaign) -> tuple[Any, Any]:
    return flown.gyro, dict(flown.more_sensors)["magnetometer"]


def early(slew: Slew) -> np.ndarray:
    """Which rows of a slew (n,) tell its start."""
    return slew.time - slew.time[0] <= SHOWN * slew.duration


def adjusted(
    flown: Telemetry,
    rows: Sequence[int],
    prior: Gaussian,
    counted: Sequence[np.ndarray],
    start: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters and own unknowns of some slews together, and the inverse of their covariance."""
    n, own = len(prior.mean), flown.own
    size = n + own * len(rows)
    mean = np.concatenate([prior.mean, np.zeros(size - n)])
    precision = np.eye(size)
    precision[:n, :n] = np.linalg.inv(prior.covariance)
    at = [np.r_[:n, n + own * i : n + own * (i + 1)] for i in range(len(rows))]

    def cost(x: np.ndarray) -> float:
        misfit = sum(
            np.sum(flown.residuals(k, x[of], c) ** 2)
            for k, of, c in zip(rows, at, counted, strict=True)
        )
        return float(misfit + (x - mean) @ precision @ (x - mean))

    x, damping, information, gradient = start, _DAMPING, precision, np.zeros(size)
    now, stale = cost(x), True
    for _ in range(_STEPS):
        if stale:
            information, gradient = precision.copy(), -precision @ (x - mean)
            for k, of, c in zip(rows, at, counted, strict=True):
                columns = np.where(c[..., None], flown.slope(k, x[of]), 0.0)
                columns = (columns / flown.sigma[..., None]).reshape(-1, len(of))
                information[np.ix_(of, of)] += columns.T @ columns
                gradient[of] += columns.T @ flown.residuals(k, x[of], c)
        damped = information + damping * np.diag(np.diag(information))
        trial = x + np.linalg.solve(damped, gradient)
        after = cost(trial)
        stale = after < now
        if stale:
            gained, x, now, damping = now - after, trial, after, 0.1 * damping
            if gained < _ENOUGH:
                break
        else:
            damping *= 10.0
    return x, information


def fitted(
    flown: Telemetry, rows: Sequence[int], theta: np.ndarray, begun: Sequence[np.ndarray]
) -> tuple[Gaussian, dict[str, float]]:
    """Some slews fitted whole, and what is left of each channel in squares of sigma."""
    n = flown.model.space.size
    start = np.concatenate([theta, *(begun[k] for k in rows)])
    counted = [np.isfinite(flown.read(k)) for k in rows]
    x, information = adjusted(flown, rows, flown.prior, counted, start)
    left = [
        flown.residuals(k, np.r_[x[:n], x[n + flown.own * i : n + flown.own * (i + 1)]], c)
        for i, (k, c) in enumerate(zip(rows, counted, strict=True))
    ]
    squares = np.concatenate([np.square(one).reshape(2, -1) for one in left], axis=1)
    chi2 = dict(zip(_CHANNELS, squares.mean(axis=1).tolist(), strict=True))
    return Gaussian(x[:n], np.linalg.inv(information)[:n, :n]), chi2


def predicted(flown: Telemetry, k: int, known: Gaussian, begun: np.ndarray) -> dict[str, Predicted]:
    """The later part of a slew: by its own beginning, and what a fit of other slews knows."""
    slew, read = flown.slews[k], flown.read(k)
    shown = early(slew)[:, None] & np.isfinite(read)
    start = np.concatenate([known.mean, begun])
    x, information = adjusted(flown, [k], known, [shown], start)
    columns = flown.slope(k, x)
    spread = np.einsum("cria,ab,crib->cri", columns, np.linalg.inv(information), columns)
    mean, sd = flown.told(k, x), np.sqrt(spread + flown.sigma**2)
    later = ~early(slew) & np.isfinite(read).all(axis=(0, 2))
    return {
        name: Predicted(slew.time[later], read[c, later], mean[c, later], sd[c, later])
        for c, name in enumerate(_CHANNELS)
    }


def numbers_of(flown: Telemetry, found: Gaussian, factor: float) -> dict[str, Any]:
    """What the page says of a half."""
    rng = np.random.default_rng(SEED)
    drawn = rng.multivariate_normal(found.mean, found.covariance, size=DRAWS, method="svd")
    tensors = np.asarray(jax.vmap(inertia_tensor.tensor)(jnp.asarray(drawn[:, :6])))
    sd = np.sqrt(np.diag(found.covariance))
    rows = zip(flown.model.space.names, found.mean.tolist(), sd.tolist(), strict=True)
    return {
        "ratios": ratios_of(tensors).summary(),
        "parameters": {name: {"mean": mean, "sd": s} for name, mean, s in rows},
        "spread_of_slews": {"factor": factor},
    }


def summary(of_slews: list[dict[str, Predicted]]) -> dict[str, Any]:
    """Share of readings within 90 % intervals, and rms of errors in sds, by channel."""
    numbers: dict[str, Any] = {}
    for name in _CHANNELS:
        z = np.concatenate([slew[name].z for slew in of_slews])
        numbers[name] = {
            "readings": z.size,
            "within_90": float(np.mean(np.abs(z) < INTERVAL)),
            "rms": float(np.sqrt(np.mean(z**2))),
            "within_90_by_slew": [
                float(np.mean(np.abs(slew[name].z) < INTERVAL)) for slew in of_slews
            ],
        }
    return numbers


def example(slew: Slew, later: Predicted) -> dict[str, Any]:
    """The x rate of a slew, for the figure."""
    return {
        "slew": slew.name,
        "time": slew.time.round(2).tolist(),
        "measured": np.asarray(slew.rate)[:, 0].round(6).tolist(),
        "later": later.time.round(2).tolist(),
        "mean": later.mean[:, 0].round(6).tolist(),
        "sd": later.sd[:, 0].round(6).tolist(),
    }


def main() -> None:
    """Fit each half, predict the other, and write the page."""
    whole = campaign(Setup())
    flown, parts = Telemetry(whole), halves(whole)
    of_all = json.loads((RESULTS / "tumble.json").read_text())["fits"]["all sessions"]
    factor = of_all["spread_of_slews"]["factor"]
    # Only where least squares begin.
    theta = np.array([row["mean"] for row in of_all["parameters"].values()])
    begun = [flown.begun(k, theta) for k in range(len(whole.slews))]
    print("begun", flush=True)
    content: dict[str, Any] = {"fits": {}, "predicted": {}, "shown": SHOWN}
    for name, part, others in zip(HALVES, parts, reversed(parts), strict=True):
        found, chi2 = fitted(flown, part, theta, begun)
        content["fits"][name] = numbers_of(flown, found, factor) | {"reduced_chi2": chi2}
        print(name, chi2, flush=True)
        known = replace(found, covariance=factor**2 * found.covariance)
        of_slews = [predicted(flown, k, known, begun[k]) for k in others]
        # The slew whose x rate moves most shows most.
        shown = int(np.argmax([np.std(slew["rate"].measured[:, 0]) for slew in of_slews]))
        picture = example(whole.slews[others[shown]], of_slews[shown]["rate"])
        content["predicted"][name] = summary(of_slews) | {"example": picture}
        print(name, content["fits"][name]["ratios"], summary(of_slews), flush=True)
    write_atomically(RESULTS / "held_out.json", json.dumps(content, indent=1) + "\n")
    write_page()


if __name__ == "__main__":
    main()
