"""Sessions of SUCHAI-3 that a fit has not seen: does it predict them?

    python -m analyses.suchai3.held_out

Every second session is fitted. In each of the others the first part of a slew tells its own start
and gyro bias; the rest is predicted, with tensor, scale factors and magnetometer of the fit. Then
the halves change places. It writes `results/suchai3/held_out.json`, then the page and the figure.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from analyses import results_of
from analyses.suchai3.campaign import Setup, campaign
from analyses.suchai3.page import write_page
from analyses.suchai3.tumble import fitted, numbers_of
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict

RESULTS = results_of(__file__)
HALVES = ("one half", "other half")
SHOWN = 1 / 3  # of a slew, from its begin on, that tells its start; the rest is predicted
INTERVAL = 1.6449  # sds of a 90 % interval
_APART = 3600.0  # [s] between sessions
_CHANNELS = {"rate": "gyro", "magnetometer": "magnetometer"}
_STEPS, _DAMPING = 30, 1e-3


@dataclass(frozen=True)
class Predicted:
    """One channel of one slew in its later part: n rows, three axes.

    Parameters
    ----------
    time : (n,) array
        On the slew's clock [s].
    measured, mean, sd : (n, 3) array
        Readings; what is predicted, and its sd, noise of a reading included [rad/s or T].
    """

    time: np.ndarray
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


def beginning(slew: Slew) -> Slew:
    """The slew without readings in its later part."""
    later = slew.time - slew.time[0] > SHOWN * slew.duration
    more = {k: np.where(later[:, None], np.nan, v) for k, v in (slew.more or {}).items()}
    return replace(slew, rate=np.where(later[:, None], np.nan, slew.rate), more=more)


def predicted(known: Estimate, whole: Campaign) -> list[dict[str, Predicted]]:
    """The later part of each slew: by its own beginning, and what a fit of other slews knows."""
    shown = replace(whole, slews=tuple(beginning(slew) for slew in whole.slews))
    model = Model(shown)
    begun, mean = estimate(model, starts=1).point, np.asarray(known.theta)
    scatter = known.slew_scatter
    widened = 1.0 if scatter is None else scatter.dispersion.factor
    covariance = widened**2 * known.covariance
    n, m = len(mean), model.structure.n_local
    precision = np.eye(n + m + model.n_bias)
    precision[:n, :n] = np.linalg.inv(covariance)
    names = [channel.name for channel in model.channels]
    places = [names.index(name) for name in _CHANNELS]

    def seen(x: jax.Array, slew: Any, telemetry: Any, reference: Any) -> jax.Array:
        nuisances = model.structure.nuisances(x[n : n + m])
        all_told = predict(
            model.structure, x[:n], nuisances, x[n + m :], slew, telemetry, reference, model.data
        )
        return jnp.stack([all_told[k] for k in places])

    value = jax.jit(seen)
    slope = jax.jit(jax.jacfwd(seen))
    results = []
    for k, slew in enumerate(whole.slews):
        one = jax.tree.map(lambda rows, k=k: rows[k], tuple(model.data.arrays))
        prior = np.concatenate([mean, np.zeros(m + model.n_bias)])
        start = np.concatenate([mean, begun.local[k], begun.bias])
        results.append(_of_slew(whole, slew, start, (prior, precision), one, (value, slope)))
    return results


def _of_slew(
    whole: Campaign, slew: Slew, start: np.ndarray, prior: Any, one: Any, functions: Any
) -> dict[str, Predicted]:
    """One slew: its start by least squares, then the rest."""
    (value, slope), (prior_mean, precision) = functions, prior
    sigma = np.stack([whole.gyro.sigma, dict(whole.more_sensors)["magnetometer"].sigma])[:, None]
    rows = len(slew.time)
    told = np.stack([slew.rate, (slew.more or {})["magnetometer"]])
    early = (slew.time - slew.time[0] <= SHOWN * slew.duration)[:, None] & np.isfinite(told)

    def gaps(x: np.ndarray) -> np.ndarray:
        return np.where(early, told - np.asarray(value(x, *one))[:, :rows], 0.0) / sigma

    def cost(x: np.ndarray) -> float:
        return float(np.sum(gaps(x) ** 2) + (x - prior_mean) @ precision @ (x - prior_mean))

    x, damping = start, _DAMPING
    for _ in range(_STEPS):
        columns = np.where(early[..., None], np.asarray(slope(x, *one))[:, :rows], 0.0)
        columns = (columns / sigma[..., None]).reshape(-1, len(x))
        information = columns.T @ columns + precision
        gradient = columns.T @ gaps(x).ravel() - precision @ (x - prior_mean)
        step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
        better = cost(x + step) < cost(x)
        x, damping = (x + step, 0.1 * damping) if better else (x, 10.0 * damping)
    columns = np.asarray(slope(x, *one))[:, :rows]
    spread = np.einsum("cria,ab,crib->cri", columns, np.linalg.inv(information), columns)
    sd, mean = np.sqrt(spread + sigma**2), np.asarray(value(x, *one))[:, :rows]
    later = ~early.any(axis=(0, 2)) & np.isfinite(told).all(axis=(0, 2))
    return {
        name: Predicted(slew.time[later], told[c, later], mean[c, later], sd[c, later])
        for c, name in enumerate(_CHANNELS)
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


def example(whole: Campaign, of_slews: list[dict[str, Predicted]]) -> dict[str, Any]:
    """The x rate of one slew, for the figure: that of the median share within its interval."""
    shares = [np.mean(np.abs(slew["rate"].z) < INTERVAL) for slew in of_slews]
    k = int(np.argsort(shares)[len(shares) // 2])
    slew, later = whole.slews[k], of_slews[k]["rate"]
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
    flown = campaign(Setup())
    parts = [flown.subset(rows) for rows in halves(flown)]
    fits = {name: fitted(part) for name, part in zip(HALVES, parts, strict=True)}
    numbers = {name: numbers_of(found) for name, found in fits.items()}
    print({name: fit["reduced_chi2"] for name, fit in numbers.items()}, flush=True)
    content: dict[str, Any] = {"fits": numbers, "predicted": {}, "shown": SHOWN}
    for name, part in zip(HALVES, reversed(parts), strict=True):
        of_slews = predicted(fits[name], part)
        content["predicted"][name] = summary(of_slews) | {"example": example(part, of_slews)}
        print(name, summary(of_slews), flush=True)
    write_atomically(RESULTS / "held_out.json", json.dumps(content, indent=1) + "\n")
    write_page()


if __name__ == "__main__":
    main()
