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

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.effect_noise import noise_of_effects
from bayes_inertia.inference.hat_matrix import hat_traces
from bayes_inertia.inference.likelihood import Information
from bayes_inertia.inference.noise_filter import momentum_noise_memory, rate_noise_memory
from bayes_inertia.inference.noise_memory import innovations
from bayes_inertia.inference.noise_model import Whitening, rate_noise_covariance
from bayes_inertia.inference.point import Point
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
    chi2 : (slews, 3) array
        Sums of squares by slew and channel.
    parameters : (3,) array
        How many parameters each channel pays for.
    """

    series: dict[str, list[np.ndarray]]
    chi2: np.ndarray
    parameters: np.ndarray


def filtered_residuals(
    model: Model,
    point: Point,
    stated: Whitening,
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
    chi2 = [[float(np.nansum(np.square(x))) for x in series[c]] for c in CHANNELS]
    parameters = hat_traces(information, point.n_local, covariance, nuisances=~filtered)
    return TestedResiduals(series, np.array(chi2).T, parameters)


def _filtered_series(
    model: Model,
    point: Point,
    stated: Whitening,
    noise: list[ReadingNoise],
    filtered: np.ndarray,
) -> dict[str, list[np.ndarray]]:
    """Residuals without the coefficients of these processes, the processes filtered out."""
    local = np.where(filtered, 0.0, point.local)
    of_rate = [each for each in noise if each.channel == "rate"]
    memory = rate_noise_memory(model, rate_noise_covariance(model, point.theta), of_rate)
    white = stated._replace(memory=memory)
    series = residual_series(model, replace(point, local=local), white)
    walk = momentum_noise_memory(model, [each for each in noise if each.channel == "momentum"])
    if walk is not None:
        known = np.nan_to_num(np.stack(series["momentum"]))
        new = innovations(known, walk)
        missing = np.isnan(np.stack(series["momentum"]))
        series["momentum"] = list(np.where(missing, np.nan, new))
    return series
