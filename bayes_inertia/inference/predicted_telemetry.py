"""What a posterior predicts: telemetry with noise, and how likely each measurement is.

Numbers of the noise that a model was asked for: their draws, and how likely measurements are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import jax
import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.channel_rows import measured
from bayes_inertia.inference.laplace import Estimate, marginal
from bayes_inertia.inference.likelihood import residuals
from bayes_inertia.inference.marginal_posterior import conditional_point
from bayes_inertia.inference.noise_marginal import conditional_point_with_noise, noise_marginal
from bayes_inertia.inference.noise_memory import correlated_noise
from bayes_inertia.inference.noise_model import rate_noise_covariance
from bayes_inertia.inference.noise_parameters import NoiseRules, channel_rules, noise_values
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.sampler import Chains
from bayes_inertia.inference.student_t import log_norm, tail_of
from bayes_inertia.maths import quaternion

# Draws of each ensemble kept for telemetry-sized groups.
_DRAWS_OF_EACH_ENSEMBLE = 16

_turned = jax.jit(lambda q, small_rotation: quaternion.multiply(q, quaternion.exp(small_rotation)))


def predicted_telemetry(
    estimate: Estimate, chains: Chains, rng: np.random.Generator
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Predicted telemetry and pointwise log likelihoods for thinned draws with their nuisances.

    Returns `predicted` (ensembles, draws, slews, rows, components): by channel, with measurement
    noise; NaN where nothing was measured; `pointwise` (ensembles, draws, slews, rows): log
    densities of the measurements, under "rate_point", "attitude_point", "momentum_point".
    """
    thinned = thinned_draws(chains, rng)
    shape = (len(chains.samples), _DRAWS_OF_EACH_ENSEMBLE)
    predicted: dict[str, np.ndarray] = {}
    pointwise: dict[str, np.ndarray] = {}
    norms = _log_norms(estimate)
    # Each draw goes to its place at once: copies of telemetry-sized arrays would be the largest
    # things that a fit holds.
    for k, (channels, lost) in enumerate(_of_draws(estimate, thinned, rng)):
        for c, values in channels.items():
            if c not in predicted:
                predicted[c] = np.empty((len(thinned), *values.shape))
                pointwise[c] = np.empty((len(thinned), *values.shape[:2]), np.float32)
            predicted[c][k] = values
            pointwise[c][k] = norms[c] - lost[c]
    for c, values in predicted.items():
        for of_ensemble in np.split(np.arange(len(thinned)), shape[0]):
            unit = _noise_of(estimate, thinned[of_ensemble], rng)
            block = {c: values[of_ensemble][None]}
            values[of_ensemble] = with_measurement_noise(estimate, block, rng, unit)[c][0]
    return (
        {c: values.reshape(*shape, *values.shape[1:]) for c, values in predicted.items()},
        {f"{c}_point": p.reshape(*shape, *p.shape[1:]) for c, p in pointwise.items()},
    )


def _of_draws(
    estimate: Estimate, thetas: np.ndarray, rng: np.random.Generator
) -> Iterator[tuple[dict[str, np.ndarray], dict[str, np.ndarray]]]:
    """Predictions without noise, and minus log densities (slews, rows), by channel, of each theta.

    Nuisances are drawn.
    """
    point_of, structure = drawn_nuisances(estimate), estimate.model.structure
    normal_numbers = estimate.point.bias.size + estimate.point.local.size
    # Correlated noise: what was measured differs from predictions by more than what is new in it.
    memory = estimate.stated.memory
    plain = None if memory is None else estimate.stated._replace(memory=None)
    for theta in thetas:
        point = point_of(theta, rng.standard_normal(normal_numbers))
        r = residuals(structure, point, estimate.model.data, estimate.stated)
        new = {c: np.asarray(value) for c, value in zip(CHANNELS, r, strict=True)}
        gaps = new
        if plain is not None:
            r = residuals(structure, point, estimate.model.data, plain)
            gaps = {c: np.asarray(value) for c, value in zip(CHANNELS, r, strict=True)}
        channels = {c: v for c, v in _predicted(estimate, gaps).items() if v.size}
        yield (
            channels,
            {
                c: _losses(estimate, theta, c, new[c].reshape(*values.shape[:2], -1))
                for c, values in channels.items()
            },
        )


def _noise_of(
    estimate: Estimate, thetas: np.ndarray, rng: np.random.Generator
) -> Callable[[str, tuple[int, ...]], np.ndarray] | None:
    """Where it is not as stated, the noise of draws, in stated sigmas."""
    if estimate.model.noise.is_stated:
        return None
    return partial(unit_noise, channel_rules(estimate.model), thetas, rng=rng)


def drawn_nuisances(estimate: Estimate) -> Callable[[np.ndarray, np.ndarray], Point]:
    """How nuisances are drawn given theta.

    Returns: from theta (d,) and standard normal numbers (3 + slews n_local,) to a point.
    """
    if not estimate.model.noise.is_stated:
        return conditional_point_with_noise(estimate, noise_marginal(estimate))
    return partial(conditional_point, estimate.model.structure, marginal(estimate))


def _losses(estimate: Estimate, theta: np.ndarray, channel: str, z: np.ndarray) -> np.ndarray:
    """Minus log densities of rows (slews, rows), from their residuals in stated sigmas."""
    if estimate.model.noise.is_stated:
        return 0.5 * np.square(z).sum(-1)
    valid = dict(zip(CHANNELS, measured(estimate.model), strict=True))[channel]
    return losses(channel_rules(estimate.model), theta, channel, z, valid)


def thinned_draws(chains: Chains, rng: np.random.Generator) -> np.ndarray:
    """Some draws of each ensemble, evenly over its steps, of random walkers.

    Returns (ensembles draws, d).
    """
    ensembles, walkers, draws, _ = chains.samples.shape
    steps = np.linspace(0, draws - 1, _DRAWS_OF_EACH_ENSEMBLE).astype(int)
    chosen = chains.samples[:, rng.integers(0, walkers, _DRAWS_OF_EACH_ENSEMBLE), steps]
    return chosen.reshape(ensembles * _DRAWS_OF_EACH_ENSEMBLE, -1)


def _predicted(estimate: Estimate, gaps: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Predictions at the measurements: what is measured minus residuals in stated sigmas."""
    telemetry, white = estimate.model.data.arrays.telemetry, estimate.stated
    gap = gaps["rate"].reshape(telemetry.rate.shape)
    error = np.einsum("srij,srj->sri", _inverses(np.asarray(white.rate)), gap)
    predicted = {"rate": np.asarray(telemetry.rate) - error}
    if telemetry.attitude.size:
        turn = np.einsum(
            "srij,srj->sri",
            _inverses(np.asarray(white.attitude)),
            gaps["attitude"].reshape(*telemetry.attitude.shape[:2], 3),
        )
        predicted["attitude"] = np.asarray(_turned(telemetry.attitude, -turn))
    if estimate.model.structure.drive == "commanded" and telemetry.momentum.size:
        scale = np.asarray(white.momentum)
        error = gaps["momentum"].reshape(scale.shape) / np.where(scale > 0, scale, 1.0)
        predicted["momentum"] = np.asarray(telemetry.momentum) - error
    return predicted


def _inverses(factors: np.ndarray) -> np.ndarray:
    """Inverses of triangular factors (..., 3, 3); rows of zeros (nothing measured) stay."""
    empty = np.diagonal(factors, axis1=-2, axis2=-1) == 0.0
    filled = factors + np.where(empty[..., None], np.eye(3), 0.0)
    return np.linalg.inv(filled) * ~empty[..., None]


def _log_norms(estimate: Estimate) -> dict[str, np.ndarray]:
    """Log of the Gaussians' norms by channel (slews, rows): they make densities comparable."""

    def norm(diagonal: np.ndarray) -> np.ndarray:
        measured = diagonal > 0
        logs = np.log(np.where(measured, diagonal, 1.0)) - 0.5 * np.log(2 * np.pi)
        return np.sum(np.where(measured, logs, 0.0), -1)

    white = estimate.stated
    matrices = (np.diagonal(w, axis1=-2, axis2=-1) for w in (white.rate, white.attitude))
    norms = [*(norm(m) for m in matrices), norm(np.asarray(white.momentum))]
    if white.memory is not None:
        norms[0] = norms[0] + np.log(np.asarray(white.memory.scale)).sum(-1)
    return dict(zip(CHANNELS, norms, strict=True))


def with_measurement_noise(
    estimate: Estimate,
    predicted: dict[str, np.ndarray],
    rng: np.random.Generator,
    unit: Callable[[str, tuple[int, ...]], np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """Predictions with the noise that the likelihood counts.

    `predicted` (..., slews, rows, components). `estimate`: its campaign states the noise; in the
    measured drive its J and K say how tachometer noise shakes the rates. `unit`: noise in stated
    sigmas, of a channel and a shape; standard normal unless given.
    """
    telemetry, campaign = estimate.model.data.arrays.telemetry, estimate.model.campaign
    unit = unit or (lambda channel, shape: rng.standard_normal(shape))
    noisy = {}
    if "rate" in predicted:
        root = np.linalg.cholesky(rate_noise_covariance(estimate.model, estimate.theta))
        noise = unit("rate", predicted["rate"].shape)
        if estimate.stated.memory is not None:
            noise = correlated_noise(noise, estimate.stated.memory)
        noise = noise @ root.T
        values = predicted["rate"] + noise.astype(np.float32)
        noisy["rate"] = np.where(telemetry.rate_valid, values, np.float32(np.nan))
    tracker = campaign.star_tracker
    if "attitude" in predicted and tracker is not None:
        along = np.outer(tracker.boresight_B, tracker.boresight_B)
        spread = tracker.sigma_cross * (np.eye(3) - along) + tracker.sigma_roll * along
        turn = unit("attitude", (*predicted["attitude"].shape[:-1], 3)) @ spread
        values = _turned(predicted["attitude"], turn)
        noisy["attitude"] = np.where(np.asarray(telemetry.fix_valid)[..., None], values, np.nan)
    if "momentum" in predicted:
        sigma = np.array([w.momentum_sigma or np.nan for w in campaign.wheels])
        noise = sigma * unit("momentum", predicted["momentum"].shape)
        values = predicted["momentum"] + noise.astype(np.float32)
        noisy["momentum"] = np.where(telemetry.momentum_valid, values, np.float32(np.nan))
    return noisy


def unit_noise(
    rules: NoiseRules,
    thetas: np.ndarray,
    channel: str,
    shape: tuple[int, ...],
    rng: np.random.Generator,
) -> np.ndarray:
    """Noise of one channel in stated sigmas.

    `thetas` (n, d): draws whose scale and degrees of freedom count, in the order of the first axes.
    `shape`: (ensembles, draws, ...) of the noise, ensembles times draws being n.
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

    `theta` (d,); `z` (slews, rows, components); `valid` (slews, rows, components). Returns (slews,
    rows): summed over the components of each row, without log(2 pi)/2 and log sigma.
    """
    c = CHANNELS.index(channel)
    scales, degrees = noise_values(rules, theta)
    loss = np.asarray(tail_of(rules[c].heavy, z / scales[c], degrees[c]).loss)
    loss = loss + np.log(scales[c]) + (log_norm(degrees[c]) if rules[c].heavy else 0.0)
    return np.where(valid, loss, 0.0).sum(-1)
