"""Data of the pictures, read out of a posterior's tree.

Padding becomes NaN, quaternions become small angles.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.report.layout import LAYOUT


def values_of(posterior: Posterior, group: str, name: str) -> np.ndarray:
    """The values of one variable of a posterior's tree."""
    return np.asarray(posterior.tree[group][name])


def time_in_slew(posterior: Posterior, name: str) -> np.ndarray:
    """Times (slews, ...) of a variable from each slew's first row on [s]."""
    start = np.nanmin(values_of(posterior, "constant_data", "time"), axis=1)
    return values_of(posterior, "constant_data", name) - start[:, None]


@array_dataclass
class ChannelSeries:
    """One channel of all slews; NaN wherever nothing was measured."""

    slews: list[str]  # names of the slews and of the channel's components
    components: list[str]
    time: np.ndarray  # (slews, rows) time from the slew's first row [s]
    measured: np.ndarray  # (slews, rows, components) in the unit of the channel
    predicted: np.ndarray
    # (slews, rows, components) standard deviation of the predictive draws, in the unit of the
    # channel.
    spread: np.ndarray
    # (slews, rows, components) measured minus predicted at the optimum, in stated sigmas;
    # rotations where quaternions are measured.
    residual: np.ndarray


def channel_series(posterior: Posterior, name: str) -> ChannelSeries | None:
    """One channel of the telemetry, as measured and as predicted.

    Returns: none where the fit did not predict it: no data, or it was the model's input.
    """
    tree = posterior.tree
    if name not in tree["posterior_predictive"] or name not in tree["observed_data"]:
        return None
    measured = tree["observed_data"].dataset[name]
    values = values_of(posterior, "observed_data", name)
    if not np.isfinite(values).any():
        return None
    draws = values_of(posterior, "posterior_predictive", name)
    draws = draws.reshape(-1, *draws.shape[2:])
    flat = values_of(posterior, "estimate", f"residual_{name}")
    # Of quaternions, small rotations.
    residual = flat.reshape(*values.shape[:2], -1)
    valid = np.isfinite(values)
    valid = valid if residual.shape == values.shape else valid.all(-1, keepdims=True)
    rows, last = measured.dims[1:]
    if last == "wheel":
        components = [str(wheel) for wheel in measured[last].values]
    elif name == "attitude":
        components = [f"about body {axis}" for axis in "xyz"]
    else:
        components = [f"axis {i + 1}" for i in range(residual.shape[-1])]
    return ChannelSeries(
        slews=[str(slew) for slew in measured["slew"].values],
        components=components,
        time=time_in_slew(posterior, "time" if rows == "row" else f"{rows}_time"),
        measured=values,
        predicted=draws.mean(0, dtype=float),
        spread=draws.std(0, dtype=float),
        residual=np.where(valid, residual, np.nan),
    )


@array_dataclass
class AttitudeMisfit:
    """Star-tracker misfits at the fixes of all slews; NaN in padding."""

    slews: list[str]  # names of the slews
    time: np.ndarray  # (slews, fixes) time from the slew's first row [s]
    # (slews, fixes, 3) measured minus predicted attitude as a small rotation in body axes [rad].
    angle_B: np.ndarray
    whitened: np.ndarray  # (slews, fixes, 3) the same in stated sigmas
    after: np.ndarray  # (slews, fixes) whether the fix lies in the second half of its slew
    sides: tuple[str, str]  # the two halves of a slew, as they are called over a panel


# Where fixes come before and after slews alone, and where during them too.
_SIDES = (
    ("before the slew", "after the slew"),
    ("first half of the slew", "second half of the slew"),
)


def attitude_misfit(posterior: Posterior) -> AttitudeMisfit | None:
    """Measured against predicted attitude, q_meas = q dq(e)."""
    series = channel_series(posterior, "attitude")
    if series is None or "fix_time" not in posterior.tree["constant_data"]:
        return None
    time, measured = series.time, series.measured
    valid = np.isfinite(time) & np.isfinite(measured).all(-1)
    if not valid.any():
        return None
    draws = values_of(posterior, "posterior_predictive", "attitude")
    draws = draws.reshape(-1, *draws.shape[2:])[:, valid]
    angle = np.full((*time.shape, 3), np.nan)
    # scipy rather than `quaternion.log`: nothing to compile.
    # Its q is body-to-inertial, so that q^-1 q_meas is in body axes too.
    seen = Rotation.from_quat(measured[valid])
    angle[valid] = np.mean(
        [(Rotation.from_quat(q).inv() * seen).as_rotvec() for q in draws], axis=0
    )
    middle = 0.5 * np.nanmax(time_in_slew(posterior, "time"), 1)
    pauses = np.diff(time) / middle[:, None]
    steady = np.isfinite(pauses).any() and np.nanmax(pauses) < LAYOUT.longest_pause_of_fixes
    after = time > middle[:, None]
    sides = _SIDES[int(steady)]
    return AttitudeMisfit(series.slews, time, angle, series.residual, after, sides)


def n_slews(posterior: Posterior) -> int:
    """Number of slews of the campaign."""
    return int(posterior.tree["estimate"].sizes["slew"])


def n_ensembles(posterior: Posterior) -> int:
    """Number of independent ensembles (chains are ordered by ensemble)."""
    sampled, predicted = posterior.tree["posterior"], posterior.tree["posterior_predictive"]
    return int(predicted.sizes.get("chain", sampled.sizes["chain"]))


def worst_slews(posterior: Posterior, max_slews: int) -> list[int]:
    """The slews whose data fit worst."""
    per_datum = values_of(posterior, "estimate", "slew_chi2").sum(-1) / np.maximum(
        values_of(posterior, "estimate", "slew_n_data").sum(-1), 1
    )
    return sorted(np.argsort(-per_datum, kind="stable")[:max_slews].tolist())
