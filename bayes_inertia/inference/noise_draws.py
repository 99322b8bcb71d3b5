"""Numbers of the noise that a model was asked for: their draws, and how likely measurements are."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.noise_parameters import NoiseRules, noise_values
from bayes_inertia.inference.student_t import log_norm, tail_of


def unit_noise(
    rules: NoiseRules,
    thetas: np.ndarray,
    channel: str,
    shape: tuple[int, ...],
    rng: np.random.Generator,
) -> np.ndarray:
    """Noise of one channel in stated sigmas.

    Parameters
    ----------
    rules : tuple of ChannelRule
    thetas : (n, d) array
        Draws whose scale and degrees of freedom count, in the order of the first axes.
    channel : {"rate", "attitude", "momentum"}
    shape : tuple of int
        (ensembles, draws, ...) of the noise, ensembles times draws being n.
    rng : numpy.random.Generator

    Returns
    -------
    array
        Of this shape.
    """
    c = CHANNELS.index(channel)
    rows = [noise_values(rules, theta) for theta in thetas]
    width = (*shape[:2], *(1 for _ in shape[2:]))
    scale = np.array([scales[c] for scales, _ in rows], float).reshape(width)
    degrees = np.array([nu[c] for _, nu in rows], float).reshape(width)
    if rules[c].heavy:
        return scale * rng.standard_t(np.broadcast_to(degrees, shape))
    return scale * rng.standard_normal(shape)


def losses(
    rules: NoiseRules, theta: np.ndarray, channel: str, z: np.ndarray, valid: np.ndarray
) -> np.ndarray:
    """Minus the log densities of one channel's measurements, less those of its stated sigmas.

    Parameters
    ----------
    rules : tuple of ChannelRule
    theta : (d,) array
    channel : {"rate", "attitude", "momentum"}
    z : (slews, rows, components) array
        Residuals in stated sigmas.
    valid : (slews, rows, components) array of bool
        What was measured.

    Returns
    -------
    (slews, rows) array
        Summed over the components of each row, without log(2 pi)/2 and log sigma.
    """
    c = CHANNELS.index(channel)
    scales, degrees = noise_values(rules, theta)
    loss = np.asarray(tail_of(rules[c].heavy, z / scales[c], degrees[c]).loss)
    loss = loss + np.log(scales[c]) + (log_norm(degrees[c]) if rules[c].heavy else 0.0)
    return np.where(valid, loss, 0.0).sum(-1)
