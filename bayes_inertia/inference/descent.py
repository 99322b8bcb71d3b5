"""Descents of the negative log posterior; sizes of stochastic effects are learnt on the way.

The first ones count the data weakly: a wide basin of attraction. They begin with a guess of the
wheel momentum that nothing measures. Without external torque the total momentum L = J w + A (h+U),
with U the integral of the wheel torques, is constant in inertial space. Seen from the body,
J (w(t) - w(0)) + A U(t) + integral of w x (J w + A U) = -(integral of w) x A h: linear in the
momentum h at the beginning. From there the simulation is near the data; from zero momentum most
descents lose their way. Of a body that nothing turns the same balance, J w - J w(0) + integral of
w x J w = 0, gives J and K to begin from.

Programs of a model with stochastic effects compile meanwhile: the compiler needs no interpreter
lock, and a program that two threads want is compiled once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import integrate, optimize

from bayes_inertia.campaign.hardware import body_rates
from bayes_inertia.errors import EstimateError
from bayes_inertia.inference.hyperparameters import Evidence, most_probable, without_hyperparameters
from bayes_inertia.inference.likelihood import Point, information_and_pull, residuals
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_model import Whitenings, discounted, n_data, whitening
from bayes_inertia.inference.objective import (
    gradient_in_chart,
    in_chart,
    moved,
    negative_log_posterior,
    normal_equations,
    prior_equations,
    step_sizes,
    whole_gradient,
)
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.least_squares import Equations, dogleg
from bayes_inertia.physics.forward_model import Model


@contextmanager
def compiled_meanwhile(model: Model, point: Point) -> Iterator[None]:
    """Compile a fit with effects without a fixed shape while the body of `with` runs.

    `model`: of others nothing is compiled: their few programs are needed at once. `point`: where it
    is evaluated once for that; the results are thrown away.
    """
    if not model.structure.hyperparameters:
        yield
        return
    with ThreadPoolExecutor(1) as pool:
        # Whatever fails here fails again where its result is asked for.
        pool.submit(_evaluate, model, point)
        yield


def _evaluate(model: Model, point: Point) -> None:
    """Derivatives and evidence first: they take longest to compile."""
    white, every = whitening(model, point.theta), np.arange(model.space.size)
    evidence = Evidence(model, point, white, every, whole=True)
    sizes = evidence.standardised(point.theta)
    evidence.negative_log(sizes)
    replace(evidence, whole=False).given(sizes[None])
    residuals(model.structure, point, model.data, white)


def descend(
    model: Model, point: Point, white: Whitenings, free: np.ndarray, **stop: Any
) -> tuple[Point, float]:
    """The minimum that a descent from a point reaches, and its objective.

    `free` (f,): indices of the parameters that may move. Those of stochastic effects among them go
    where the evidence is largest, the others to the minimum that belongs to them. Returns
    `objective`: half the sum of all whitened squares, priors included.
    """
    shaped = without_hyperparameters(model, free)
    if len(shaped) < len(free):
        rough = roughly(stop)
        point, _ = _to_minimum(model, point, white, shaped, **rough)
        for _ in range(LIMITS.most_rounds_of_sizes):
            point, change = most_probable(Evidence(model, point, white, free, whole=True))
            if change < LIMITS.settled:
                break
            point, _ = _to_minimum(model, point, white, shaped, **rough)
    return _to_minimum(model, point, white, shaped, **stop)


def roughly(stop: Mapping[str, Any]) -> dict[str, Any]:
    """When to stop where a descent as asked for follows.

    Examples
    --------
    >>> roughly({"steps": 60, "tolerance": 1e-7})
    {'steps': 60, 'tolerance': 0.001}
    """
    return {**stop, "tolerance": max(stop.get("tolerance", 0.0), LIMITS.tolerance_of_rounds)}


def _to_minimum(
    model: Model,
    point: Point,
    white: Whitenings,
    free: np.ndarray,
    *,
    silent: bool = False,
    **stop: Any,
) -> tuple[Point, float]:
    """The minimum with the sizes of stochastic effects as they are, these `silent` or not."""

    def equations(x: Point) -> Equations[Point]:
        blocks, pull = information_and_pull(model, x, white, free, silent=silent)
        hessian, gradient = in_chart(x, *normal_equations(model, x, blocks))

        def pull_in_chart(y: Point) -> np.ndarray:
            _, slope = prior_equations(model, y.theta, free)
            return gradient_in_chart(x, whole_gradient(y, slope, pull(y)))

        return Equations(hessian, gradient, pull_in_chart)

    # What noise alone makes of the objective; of other densities it has no such meaning.
    expected = 0.5 * max(float(n_data(model, white).sum()), 1.0)
    return dogleg(
        lambda x: negative_log_posterior(model, x, white),
        equations,
        lambda x, step: moved(model, x, step, free),
        point,
        step_sizes(model, point, free),
        expected=np.inf if any(each.density is not None for each in white) else expected,
        **stop,
    )


def guess_nuisances(model: Model, theta: np.ndarray) -> np.ndarray:
    """Nuisances to begin from.

    `theta` (d,). Returns (slews, n_local): in prior sd: zero, but for wheel momenta that are not
    measured.
    """
    local = np.zeros((model.n_slews, model.structure.n_local))
    unmeasured = model.campaign.wheels and not model.campaign.has_tachometers
    if model.structure.drive == "commanded" and unmeasured:
        prior_sd = np.asarray(model.data.scale.local[6:])
        J, K = inertia_tensor.tensor(theta[:6]), theta[6 : model.n_base]
        for s in range(model.n_slews):
            local[s, 6 : 6 + len(prior_sd)] = _start_momentum(model, J, K, s, prior_sd)
    return local


def _integrated(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    return integrate.cumulative_trapezoid(values, time, axis=0, initial=0.0)


def _unexplained(time: np.ndarray, rate: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """Momentum (n, 3) that a body with these rates and this momentum (n, 3) gained from outside."""
    return momentum - momentum[0] + _integrated(np.cross(rate, momentum), time)


def _complete_readings(model: Model, s: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n,) of slew s with complete readings, and these."""
    seen = model.campaign.with_body_rates
    return seen.slews[s].complete_rates(seen.valid_readings(seen.slews[s]))


def _rate_B(model: Model, readings: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Body rates (n, 3) of readings [rad/s]."""
    seen = model.campaign.with_body_rates
    return body_rates(seen.gyro, readings, K if seen is model.campaign else np.ones(3))


def _start_momentum(
    model: Model, J: np.ndarray, scale_factor: np.ndarray, s: int, prior_sd: np.ndarray
) -> np.ndarray:
    """Wheel momentum (wheels,) at the start of slew s beyond the reference, in prior sd."""
    slew, axes = model.campaign.slews[s], model.campaign.wheel_axes_B
    rows, readings = _complete_readings(model, s)
    if len(rows) < 2:
        return np.zeros(len(prior_sd))
    time, rate = slew.time[rows], _rate_B(model, readings, scale_factor)
    taken_up = _integrated(np.asarray(slew.wheel_torque), slew.time)[rows]
    reference = np.asarray(model.data.arrays.reference.wheel_momentum)[s]
    unexplained = _unexplained(time, rate, rate @ J + (taken_up + reference) @ axes.T)
    turned = _integrated(rate, time)
    columns = np.cross(turned[:, :, None], (axes * prior_sd)[None], axis=1)
    # What no momentum explains comes from errors of J and K, alike over the slew: all its rows
    # count as one. Momentum along the axis of the slew, which leaves hardly a trace, is then left
    # to the prior.
    columns, unexplained = columns.reshape(-1, len(prior_sd)), unexplained.ravel()
    scatter = unexplained - columns @ np.linalg.lstsq(columns, unexplained, rcond=1e-6)[0]
    weight = float(np.sum(scatter**2)) + 1e-300
    normal = columns.T @ columns + weight * np.eye(len(prior_sd))
    return -np.linalg.solve(normal, columns.T @ unexplained)


def _balanced(model: Model, theta: np.ndarray) -> np.ndarray | None:
    """J and K near which a body that nothing turns keeps its momentum, as the rates show it.

    `theta` (d,). None of other bodies, and where the balance is lost in bias and noise of the
    rates. From a J that is some per cent wrong a simulated tumble soon turns the other way;
    this balance needs no simulation.
    """
    campaign = model.campaign
    if campaign.wheels or campaign.actuators:
        return None
    n, mean, sd = model.n_base, model.space.mean[: model.n_base], model.space.sd[: model.n_base]
    told = [_complete_readings(model, s) for s in range(model.n_slews)]
    told = [(campaign.slews[s].time[rows], x) for s, (rows, x) in enumerate(told) if len(rows) > 1]

    def residual(x: np.ndarray) -> np.ndarray:
        J, K = inertia_tensor.tensor(mean[:6] + sd[:6] * x[:6]), mean[6:] + sd[6:] * x[6:]
        parts = [x]
        for time, readings in told:
            rate = _rate_B(model, readings, K)
            momentum = rate @ J
            size = LIMITS.balance * np.linalg.norm(momentum, axis=1).max(initial=1e-300)
            # What bias and noise make of it lasts over the slew: its rows count as one.
            gained = _unexplained(time, rate, momentum) / (size * np.sqrt(len(time)))
            parts.append(gained.ravel())
        return np.concatenate(parts)

    x = optimize.least_squares(residual, (theta[:n] - mean) / sd).x
    found = np.concatenate([mean + sd * x, theta[n:]])
    credible = bool(np.abs(x).max() < LIMITS.prior_sd_at_most)
    return found if credible and inertia_tensor.is_physical(found[:6]) else None


def gentle_descents(
    model: Model, seed: int, starts: int, start: np.ndarray | None, free: np.ndarray
) -> list[tuple[float, Point]]:
    """Objective and end of each gentle descent.

    Effects without a fixed shape stay silent: while the data count weakly they have nothing to
    explain, and the columns of their many coefficients cost time.

    `start` (d,); `free` (f,). `starts`: how many, the first at the prior mean, others drawn from
    the prior; more where none comes near the data.
    """
    fixed, free = list(model.structure.hyperparameters), without_hyperparameters(model, free)
    theta = model.space.mean if start is None else np.asarray(start, float)
    thetas = theta[None]
    if start is None:
        draws = model.draw_prior(np.random.default_rng(seed), max(starts, LIMITS.most_starts) - 1)
        # A little into the support of priors that end at their null.
        margin = 0.1 * model.space.sd
        ends = model.space.lower + margin, model.space.upper - margin
        thetas = np.clip(np.array([theta, *draws]), *ends)
        thetas[:, fixed] = theta[fixed]
    rates = 3 if model.campaign.rate_sensor is None else len(model.campaign.gyro.axes)
    readings = sum(rates * len(s.time) for s in model.campaign.slews)
    near = LIMITS.lost_reduced_chi2 * LIMITS.gentle_weight * 0.5 * readings
    silent = np.zeros((model.n_slews, model.structure.n_local))
    descents: list[tuple[float, Point]] = []
    with compiled_meanwhile(model, Point(theta, np.zeros(model.n_bias), silent)):
        for k, begin in enumerate(thetas):
            if k >= starts and descents and min(o for o, _ in descents) < near:
                break
            objective, point = _gentle_descent(model, begin, free)
            if np.isfinite(objective):
                descents.append((objective, point))
    if not descents:
        raise EstimateError(
            "no start of the optimizer gave finite residuals",
            advice="check units and signs of the telemetry columns",
        )
    return descents


def _without_bias(model: Model, theta: np.ndarray) -> Point:
    """A point to begin from: no bias, nuisances guessed."""
    return Point(theta, np.zeros(model.n_bias), guess_nuisances(model, theta))


def _gentle_descent(model: Model, theta: np.ndarray, free: np.ndarray) -> tuple[float, Point]:
    """Objective and end of a descent with the data counted weakly.

    J, K and the nuisances move first: far from the optimum an effect would take over what they
    have to explain. Nuisances guessed at a J far from the truth can end in a local optimum: they
    are guessed again at the J that was reached.
    """
    theta = np.asarray(theta, float)
    weights = np.full((model.n_slews, len(model.channels)), LIMITS.gentle_weight)
    white = discounted(whitening(model, theta), weights)
    core = free[free < model.n_base]
    gently: dict[str, Any] = {"silent": True, **LIMITS.gentle_stop}
    first = _without_bias(model, theta)
    balanced = _balanced(model, theta) if len(core) == model.n_base else None
    if balanced is not None:
        both = first, _without_bias(model, balanced)
        first = min(both, key=lambda point: negative_log_posterior(model, point, white))
    point, objective = _to_minimum(model, first, white, core, **gently)
    if np.any(first.local):
        guess = Point(point.theta, point.bias, guess_nuisances(model, point.theta))
        second, lower = _to_minimum(model, guess, white, core, **gently)
        if lower < objective:
            point, objective = second, lower
    if len(core) < len(free):
        point, objective = _to_minimum(model, point, white, free, **gently)
    return objective, point
