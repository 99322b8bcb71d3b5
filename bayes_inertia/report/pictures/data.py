"""What the pictures draw, read out of a posterior's tree: padding becomes NaN, quaternions become small angles."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.values import array_dataclass

ARCSEC = np.pi / (180.0 * 3600.0)  # [rad]


@array_dataclass
class Channel:
    """One channel of all slews.

    Attributes
    ----------
    time : (slews, rows) [s]. measured, predicted, spread : (slews, rows, components), `spread` the standard deviation of the
    predictive draws. residual : the same shape, in stated sigmas. NaN wherever nothing was measured.
    """

    slews: list[str]
    components: list[str]
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    spread: np.ndarray
    residual: np.ndarray


def channel(posterior: Posterior, name: str) -> Channel | None:
    """The `rate` or `momentum` channel; None where the fit did not predict it (no data, or it was the model's input)."""
    tree = posterior.tree
    if name not in tree["posterior_predictive"] or name not in tree["observed_data"]:
        return None
    measured = tree["observed_data"][name]
    values = measured.values
    if not np.isfinite(values).any():
        return None
    draws = tree["posterior_predictive"][name].values
    draws = draws.reshape(-1, *draws.shape[2:])
    residual = tree["estimate"][f"residual_{name}"].values.reshape(values.shape)
    last = measured.dims[-1]
    components = (
        [str(w) for w in measured[last].values]
        if last == "wheel"
        else [f"axis {i + 1}" for i in range(values.shape[-1])]
    )
    return Channel(
        slews=[str(s) for s in measured["slew"].values],
        components=components,
        time=tree["constant_data"]["time"].values,
        measured=values,
        predicted=draws.mean(0, dtype=float),
        spread=draws.std(0, dtype=float),
        residual=np.where(np.isfinite(values), residual, np.nan),
    )


@array_dataclass
class Misfit:
    """Star-tracker misfits at the fixes of all slews.

    Attributes
    ----------
    time : (slews, fixes) [s]. angle_B : (slews, fixes, 3) measured minus predicted attitude as a small rotation in body axes [rad].
    whitened : the same in stated sigmas. after : (slews, fixes) whether the fix lies in the second half of its slew. NaN in padding.
    """

    slews: list[str]
    time: np.ndarray
    angle_B: np.ndarray
    whitened: np.ndarray
    after: np.ndarray


def attitude_misfit(posterior: Posterior) -> Misfit | None:
    """Measured against predicted attitude, q_meas = q dq(e); None without star-tracker fixes."""
    tree = posterior.tree
    if "attitude" not in tree["posterior_predictive"] or "fix_time" not in tree["constant_data"]:
        return None
    measured = tree["observed_data"]["attitude"].values
    time = tree["constant_data"]["fix_time"].values
    valid = np.isfinite(time) & np.isfinite(measured).all(-1)
    if not valid.any():
        return None
    draws = tree["posterior_predictive"]["attitude"].values
    draws = draws.reshape(-1, *draws.shape[2:])[:, valid]
    angle = np.full((*time.shape, 3), np.nan)
    # scipy rather than `rotation.log`: nothing to compile, and its q is body-to-inertial, so that q^-1 q_meas is in body axes too.
    angle[valid] = np.mean(
        [
            (Rotation.from_quat(q).inv() * Rotation.from_quat(measured[valid])).as_rotvec()
            for q in draws
        ],
        axis=0,
    )
    rows = tree["constant_data"]["time"].values
    middle = 0.5 * (np.nanmin(rows, 1) + np.nanmax(rows, 1))
    whitened = tree["estimate"]["residual_attitude"].values.reshape(angle.shape)
    slews = [str(s) for s in tree["observed_data"]["attitude"]["slew"].values]
    return Misfit(
        slews, time, angle, np.where(valid[..., None], whitened, np.nan), time > middle[:, None]
    )


def ensembles(posterior: Posterior) -> int:
    """How many independent ensembles the chains come from (chains are ordered by ensemble)."""
    return int(posterior.tree["posterior_predictive"].sizes["chain"])


def robust_covariance(posterior: Posterior) -> np.ndarray | None:
    """Covariance that the slews themselves support (d, d); None from too few slews."""
    covariance = posterior.tree["estimate"]["robust_covariance"].values
    return covariance if np.isfinite(covariance).all() else None


def worst_slews(posterior: Posterior, most: int) -> list[int]:
    """Indices of at most `most` slews, in flown order: those whose data fit worst."""
    estimate = posterior.tree["estimate"]
    per_datum = estimate["slew_chi2"].values.sum(-1) / np.maximum(
        estimate["slew_n_data"].values.sum(-1), 1
    )
    return sorted(np.argsort(-per_datum, kind="stable")[:most].tolist())
