"""What a posterior predicts: telemetry with noise, and how likely each measurement is.

Numbers of the noise that a model was asked for: their draws, and how likely measurements are.

Of each slew as a whole, which ArviZ leaves out one at a time: its own nuisances are integrated out,
the rate bias, which slews share, is drawn given J, K and effects. Given a draw, slews are then
independent, as rows of one slew are not. How the whole density divides among the slews is taken to
first order around the optimum, so that no slew is simulated again; their sum is the density that
was sampled.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from bayes_inertia.inference.density_marginal import conditional_point_with_densities
from bayes_inertia.inference.laplace import Estimate, marginal, predicted_readings
from bayes_inertia.inference.likelihood import Point, Residuals, residuals
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.marginal_posterior import conditional_point
from bayes_inertia.inference.noise_model import (
    ChannelDensity,
    correlated_noise,
    densities_of,
    log_norms,
    measured,
    without_memory,
)
from bayes_inertia.inference.sampler import Chains
from bayes_inertia.inference.slew_shares import eliminated


def predicted_telemetry(
    estimate: Estimate, chains: Chains, rng: np.random.Generator
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Predicted telemetry and pointwise log likelihoods for thinned draws with their nuisances.

    Returns `predicted` (ensembles, draws, slews, rows, components): by channel, with measurement
    noise; NaN where nothing was measured; `pointwise` (ensembles, draws, slews, rows): log
    densities of the measurements, NaN without any, under "rate_point", "attitude_point",
    "momentum_point".
    """
    thinned, model = thinned_draws(chains, rng), estimate.model
    shape = (len(chains.samples), LIMITS.telemetry_draws)
    predicted: dict[str, np.ndarray] = {}
    pointwise: dict[str, np.ndarray] = {}
    parts = (measured(model), densities_of(model), log_norms(model, estimate.stated))
    placed = zip(range(len(model.channels)), model.channels, *parts, strict=True)
    channels = [each for each in placed if each[1].compared and each[2].size]
    # Each draw goes to its place at once: copies of telemetry-sized arrays would be the largest
    # things that a fit holds.
    for k, (theta, (new, gaps)) in enumerate(
        zip(thinned, _residuals_of_draws(estimate, thinned, rng), strict=True)
    ):
        for place, channel, valid, density, norm in channels:
            name, known = channel.name, valid.sum(-1)
            values = predicted_readings(
                estimate, place, np.asarray(gaps[place]).reshape(valid.shape)
            )
            if name not in predicted:
                predicted[name] = np.empty((len(thinned), *values.shape))
                pointwise[name] = np.empty((len(thinned), *known.shape), np.float32)
            predicted[name][k] = values
            # Log of the Gaussians' norms: they make densities comparable.
            norm = norm - 0.5 * np.log(2.0 * np.pi) * known
            lost = losses(density, theta, np.asarray(new[place]).reshape(valid.shape), valid)
            pointwise[name][k] = np.where(known, norm - lost, np.nan)
    for name, every in predicted.items():
        for part in np.split(np.arange(len(thinned)), shape[0]):
            every[part] = _with_noise(estimate, name, every[part], thinned[part], rng)
    return (
        {c: values.reshape(*shape, *values.shape[1:]) for c, values in predicted.items()},
        {f"{c}_point": p.reshape(*shape, *p.shape[1:]) for c, p in pointwise.items()},
    )


def _residuals_of_draws(
    estimate: Estimate, thetas: np.ndarray, rng: np.random.Generator
) -> Iterator[tuple[Residuals, Residuals]]:
    """Whitened residuals of each theta, and those where noise has no memory; nuisances drawn."""
    structure = estimate.model.structure
    for point in drawn_points(estimate, thetas, rng):
        new = gaps = residuals(structure, point, estimate.model.data, estimate.stated)
        # Correlated noise: what was measured differs from predictions by more than what is new.
        if any(each.memory is not None for each in estimate.stated):
            plain = without_memory(estimate.stated)
            gaps = residuals(structure, point, estimate.model.data, plain)
        yield new, gaps


def drawn_points(
    estimate: Estimate, thetas: np.ndarray, rng: np.random.Generator
) -> Iterator[Point]:
    """Each theta (n, d) with nuisances drawn from their posterior given it."""
    if not estimate.model.noise.is_stated:
        point_of = conditional_point_with_densities(estimate)
    else:
        point_of = partial(conditional_point, estimate.model.structure, marginal(estimate))
    numbers = estimate.point.bias.size + estimate.point.local.size
    for theta in thetas:
        yield point_of(theta, rng.standard_normal(numbers))


def thinned_draws(chains: Chains, rng: np.random.Generator) -> np.ndarray:
    """Some draws of each ensemble, evenly over its steps, of random walkers.

    Returns (ensembles draws, d).
    """
    ensembles, walkers, draws, _ = chains.samples.shape
    steps = np.linspace(0, draws - 1, LIMITS.telemetry_draws).astype(int)
    chosen = chains.samples[:, rng.integers(0, walkers, LIMITS.telemetry_draws), steps]
    return chosen.reshape(ensembles * LIMITS.telemetry_draws, -1)


def _with_noise(
    estimate: Estimate,
    name: str,
    predicted: np.ndarray,
    thetas: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Predictions of a channel (n, slews, rows, columns) with the noise that the likelihood counts.

    `thetas` (n, d): draws whose scale and shape of the noise count. In the measured drive J and K
    of the estimate say how tachometer noise shakes the rates.
    """
    model, place = estimate.model, estimate.model.structure.place(name)
    channel, density = model.channels[place], densities_of(model)[place]
    readings = model.data.arrays.telemetry.readings[place]
    scale, own = (
        np.array([of(theta) for theta in thetas], float)[:, None, None, None]
        for of in (density.scale_of, density.shape_of)
    )
    shape = (*predicted.shape[:-1], readings.valid.shape[-1])
    noise = scale * density.family.draw(rng, own, shape)
    if (memory := estimate.stated[place].memory) is not None:
        noise = correlated_noise(noise, memory)
    stated = channel.noise(model.campaign, estimate.theta, model.structure.drive)
    values = channel.moved(predicted, channel.drawn(stated, noise))
    return channel.known(readings._replace(values=values))


def losses(
    density: ChannelDensity, theta: np.ndarray, z: np.ndarray, valid: np.ndarray
) -> np.ndarray:
    """Minus the log densities of one channel's measurements, less those of its stated sigmas.

    `z`, `valid` (slews, rows, components). Returns (slews, rows): summed over the components of
    each row, without log(2 pi)/2 and log sigma.
    """
    scale, shape = float(density.scale_of(theta)), float(density.shape_of(theta))
    loss = np.asarray(density.family.loss(z / scale, shape)) + np.log(scale)
    return np.where(valid, loss, 0.0).sum(-1)


def slew_log_likelihood(
    estimate: Estimate, thetas: np.ndarray, likelihood: np.ndarray, rng: np.random.Generator
) -> np.ndarray | None:
    """Log densities (n, slews) of each slew's readings at draws (n, d) of the posterior.

    Over the density that residuals as large as the stated noise have: a constant of the campaign.
    `likelihood` (n,): log density of all readings at each, up to a constant. None where the noise
    is not as stated or the size of a stochastic effect is sampled: slews are not apart there.
    """
    if not estimate.model.noise.is_stated or estimate.model.structure.hyperparameters:
        return None
    constant, gradient, matrix = _equations(estimate)
    f, b = len(estimate.free), len(estimate.point.bias)
    shift = np.zeros((len(thetas), f + b))
    shift[:, :f] = thetas[:, estimate.free] - estimate.theta[estimate.free]
    # The bias given each draw, its prior included.
    precision = np.eye(b) + matrix[:, f:, f:].sum(0)
    slope = estimate.point.bias + gradient[:, f:].sum(0) + shift[:, :f] @ matrix[:, :f, f:].sum(0)
    shift[:, f:] = -np.linalg.solve(precision, slope.T).T
    at_best = _log_densities(constant, gradient, matrix, shift).sum(1)
    bias = estimate.point.bias + shift[:, f:]
    beyond = likelihood - (at_best - 0.5 * np.sum(bias**2, 1))
    # To first order nothing is beyond at the optimum.
    nearest = np.argmin(np.einsum("ni,ij,nj->n", shift, matrix.sum(0), shift))
    root = np.linalg.cholesky(precision)
    shift[:, f:] += np.linalg.solve(root.T, rng.standard_normal(bias.shape).T).T
    logs = _log_densities(constant, gradient, matrix, shift)
    return logs + (beyond - beyond[nearest])[:, None] / logs.shape[1]


def _log_densities(
    constant: np.ndarray, gradient: np.ndarray, matrix: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Log densities (n, slews) to second order at shifts (n, n_shared) from the optimum."""
    squares = np.einsum("ni,sij,nj->ns", shift, matrix, shift, optimize=True)
    return constant - shift @ gradient.T - 0.5 * squares


def _equations(estimate: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log density (slews,) at the optimum, its slope (slews, n_shared) and curvature, negated.

    Each slew's own nuisances are integrated out.
    """
    information, local = estimate.information, estimate.point.local
    parts = eliminated(information, local, len(estimate.free) + len(estimate.point.bias))
    squares = information.chi2.sum(1) + np.sum(local**2, 1) - np.sum(parts.pull**2, 1)
    determinants = np.log(np.abs(np.diagonal(parts.root, axis1=1, axis2=2))).sum(1)
    # Numbers of 10^5 would drown differences between models, and overflow in `az.compare`: counted
    # from the log density of what the noise as stated makes.
    used, stated = (log_norms(estimate.model, x) for x in (estimate.white, estimate.stated))
    norms = sum(a.sum(1) - b.sum(1) for a, b in zip(used, stated, strict=True))
    constant = determinants - 0.5 * (squares - information.n_data.sum(1)) + norms
    return constant, parts.gradient, parts.matrix
