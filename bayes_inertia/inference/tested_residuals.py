"""The residuals whose size and whiteness are tested.

A fit takes away what it can explain. A few J, K and start states take little from many readings,
and the number of parameters that each channel pays for makes up for it. Free shapes over time take
much, and what they leave is not white: the fast part that a reduced basis lacks remains, the slow
one is overfitted. Where such a shape is a first-order process of the readings it is not taken away
but filtered out, like any other correlated noise (Mehra 1970, "On the identification of variances
and adaptive Kalman filtering": innovations are white if the model is right).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.inference.effect_noise import noise_of_effects
from bayes_inertia.inference.likelihood import Information
from bayes_inertia.inference.noise_filter import noise_memory
from bayes_inertia.inference.noise_model import Whitenings, stated_noise_of
from bayes_inertia.inference.objective import block_index
from bayes_inertia.inference.point import N_BIAS, Point
from bayes_inertia.inference.residual_series import residual_series
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.reading_noise import ReadingNoise


@array_dataclass
class TestedResiduals:
    """Residuals that are white and of unit variance where the model is right.

    Parameters
    ----------
    series : dict of list of (rows, components) arrays
        By channel and slew, in stated sigmas; NaN where nothing was measured.
    chi2 : (slews, channels) array
        Sums of squares by slew and channel.
    parameters : (channels,) array
        How many parameters each channel pays for.
    """

    series: dict[str, list[np.ndarray]]
    chi2: np.ndarray
    parameters: np.ndarray


def filtered_residuals(
    model: Model,
    point: Point,
    stated: Whitenings,
    information: Information,
    covariance: np.ndarray,
) -> TestedResiduals | None:
    """What to test of an estimate in which effects add first-order processes to readings.

    `covariance` (unknowns, unknowns) [free]. Returns: none where there is no such effect: residuals
    are tested as they are.
    """
    of_effects = noise_of_effects(model, point.theta)
    if not of_effects:
        return None
    filtered = np.zeros(point.n_local, bool)
    for each in of_effects:
        filtered[each.coefficients] = True
    whole = [each.noise._replace(knots=0) for each in of_effects]
    series = _filtered_series(model, point, stated, whole, filtered)
    chi2 = [[float(np.nansum(np.square(x))) for x in of_slews] for of_slews in series.values()]
    parameters = hat_traces(information, point.n_local, covariance, nuisances=~filtered)
    return TestedResiduals(series, np.array(chi2).T, parameters)


def _filtered_series(
    model: Model,
    point: Point,
    stated: Whitenings,
    noise: list[ReadingNoise],
    filtered: np.ndarray,
) -> dict[str, list[np.ndarray]]:
    """Residuals without the coefficients of these processes, the processes filtered out."""
    local, white = np.where(filtered, 0.0, point.local), []
    for channel, stated_white in zip(model.channels, stated, strict=True):
        of_channel = stated_noise_of(model, channel, point.theta)
        white.append(stated_white._replace(memory=noise_memory(model, channel, of_channel, noise)))
    return residual_series(model, replace(point, local=local), tuple(white))


def hat_traces(
    information: Information,
    n_local: int,
    covariance: np.ndarray,
    counted: np.ndarray | None = None,
    *,
    nuisances: np.ndarray | None = None,
) -> np.ndarray:
    """Trace of the hat matrix over each channel's rows.

    `covariance` (unknowns, unknowns) [free]; `counted` (f,) [free]. `nuisances` (n_local,): which
    of a slew's nuisances are paid for; all by default. The others act all the same. Returns (3,).
    """
    total = np.zeros(information.n_data.shape[1])
    for s, block in enumerate(information.matrix):
        index = block_index(len(information.free) + N_BIAS, n_local, s)
        if counted is not None:
            keep = np.concatenate([counted, np.ones(len(index) - len(counted), bool)])
            index, block = index[keep], block[:, keep][:, :, keep]
        paid = np.ones(len(index), bool)
        if nuisances is not None:
            paid[-n_local:] = nuisances
        total += np.einsum("cpq,qp->c", block[:, paid], covariance[np.ix_(index, index[paid])])
    return total


def effective_parameters(
    model: Model, point: Point, information: Information, covariance: np.ndarray
) -> np.ndarray:
    """How many parameters of location each channel pays for (channels,)."""
    if model.noise.is_stated:
        return hat_traces(information, point.n_local, covariance)
    located = np.array([model.space.names[i] not in model.noise.names for i in information.free])
    return hat_traces(information, point.n_local, covariance, located)
