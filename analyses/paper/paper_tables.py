"""Tables 1 to 4 of Ferguson's paper, and the pictures that correspond to its figures 3 to 6.

Run it with `python -m analyses.paper.paper_tables` (about three minutes).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from analyses.paper import table_pictures as pictures
from analyses.paper import table_words as words
from analyses.paper.closed_loop_check import closed_loop_check
from analyses.paper.ferguson import (
    ARCSEC,
    FLIGHT,
    FLOWN_SLEW,
    SIMULATED_SLEW,
    SIMULATION,
    controller_of,
    flown,
    prior_of,
    run,
    scatter,
    spacecraft_of,
)
from analyses.paper.single_effects import single_effects
from analyses.paper.table_words import Predictions
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.flight.closed_loop_flights import predict_final_errors
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.settings import Settings
from bayes_inertia.physics.forward_model import Model

SEED = 20070701
MULTIPLIERS = np.geomspace(10.0, 1000.0, 241)


def noise_likelihood(
    estimate: Estimate, index: np.ndarray, prior: bool = True
) -> dict[str, np.ndarray | float]:
    """Likelihood of the paper's errors (those at `index`) over a multiplier of all noise.

    With its mode and 90 % interval (flat prior in its logarithm).
    """
    offset, error = SIMULATION.initial - SIMULATION.truth, SIMULATION.new - SIMULATION.truth
    log_likelihood = []
    for m in MULTIPLIERS:
        s = scatter(estimate, offset, (m, m, m), prior=prior)
        log_likelihood.append(
            stats.multivariate_normal.logpdf(
                error[index], s.mean[index], s.covariance[np.ix_(index, index)]
            )
        )
    density = np.exp(np.array(log_likelihood) - np.max(log_likelihood))
    cumulative = np.cumsum(density) / np.sum(density)
    low, high = (float(np.interp(q, cumulative, MULTIPLIERS)) for q in (0.05, 0.95))
    best = float(MULTIPLIERS[np.argmax(density)])
    s = scatter(estimate, offset, (best,) * 3)
    z = (error - s.mean) / np.sqrt(np.diag(s.covariance))
    return {"density": density, "best": best, "low": low, "high": high, "z": z, "scatter": s}


def slew_plan(axis: np.ndarray, angle: float, duration: float) -> Plan:
    """One slew about an axis, telemetry as in the campaign."""
    plan = paper_like_plan()
    return replace(plan, slews=(PlannedSlew(tuple(axis), angle, duration=duration),))


def correction_slews(
    thetas: np.ndarray,
    believed: np.ndarray,
    angle: float,
    axes: np.ndarray,
    seed: int,
    noise: float = 1.0,
) -> np.ndarray:
    """Correction slews (axes, n) [arcsec] if each of thetas (n, 9) were the truth.

    The controller believes `believed` (9,).
    """
    mission = Mission(spacecraft_of(thetas[0], noise), prior_of(believed))
    duration = 145.0 if angle > 0.5 else 95.0
    errors = [
        predict_final_errors(
            thetas, slew_plan(a, angle, duration), mission, controller_of(believed), seed=seed + k
        )
        for k, a in enumerate(axes)
    ]
    return np.linalg.norm(errors, axis=-1) / ARCSEC


def sphere(n: int) -> np.ndarray:
    """n directions spread evenly over half the sphere (Fibonacci), after the three body axes."""
    k = np.arange(n) + 0.5
    z, turn = k / n, np.pi * (1.0 + 5**0.5) * k
    r = np.sqrt(1.0 - z**2)
    return np.concatenate([np.eye(3), np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)])


def flight_geometry(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Size (axes,) [arcsec] of the change on the 38 deg slew, and its cosine with what is left.

    The change is that from the initial J and K to the paper's new ones. Whatever is missing leaves
    the same error e, |e| = 1020", before and after, if the estimate changes only what it can:
    before = e + a, with a the simulated change. |e + a| = 1641" asks for this cosine; beyond +-1
    the axis is impossible.
    """
    angle, before, after = FLOWN_SLEW
    craft = spacecraft_of(FLIGHT.new, bias=(0.0, 0.0, 0.0))
    mission = Mission(craft, prior_of(FLIGHT.initial))
    change = [
        predict_final_errors(
            FLIGHT.new, slew_plan(a, angle, 145.0), mission, controller_of(FLIGHT.initial)
        )[0]
        / ARCSEC
        for a in axes
    ]
    size = np.linalg.norm(change, axis=1)
    return size, (before**2 - after**2 - size**2) / (2.0 * size * after)


def sampled(campaign, quick: bool) -> Posterior:
    """One full fit."""
    settings = (
        Settings(threads=1, ensembles=4, walkers=32, steps=24, max_steps=24, target_ess=100.0)
        if quick
        else Settings(threads=1)
    )
    return fit(campaign, seed=SEED, settings=settings)


@dataclass(frozen=True)
class Fits:
    """The three fits: of the simulated campaign at our noise and at the inferred one, of a flight.

    `noise` is what `noise_likelihood` says of the first, `draws` are the posterior's of the second.
    """

    noise: dict
    quiet_flight: Flight
    quiet: Estimate
    loud: Estimate
    draws: np.ndarray
    flight: Estimate


def fits(quick: bool) -> Fits:
    """Simulate and fit what the tables need."""
    plan, truth = paper_like_plan(), SIMULATION.truth
    quiet_flight = flown(plan, spacecraft_of(truth), seed=SEED)
    quiet = estimate(Model(quiet_flight.campaign), starts=1)
    noise = noise_likelihood(quiet, np.arange(9))
    loud = flown(plan, spacecraft_of(truth, noise["best"]), seed=SEED).campaign
    craft = spacecraft_of(FLIGHT.new, noise["best"])
    flight = flown(plan, craft, FLIGHT.initial, seed=SEED + 3).campaign
    return Fits(
        noise,
        quiet_flight,
        quiet,
        estimate(Model(loud), starts=1),
        sampled(loud, quick).samples,
        estimate(Model(flight), starts=1),
    )


def predictions(fitted: Fits, rng: np.random.Generator, quick: bool) -> Predictions:
    """The correction slews of Tables 2 and 4, and what follows from them.

    What the paper's tables leave open about the flight is drawn from the estimator's scatter at the
    inferred noise.
    """
    axes, n, noise = sphere(4 if quick else 21), 40 if quick else 200, fitted.noise
    angle2, angle4 = SIMULATED_SLEW[0], FLOWN_SLEW[0]
    truths = np.tile(SIMULATION.truth, (n, 1))
    flights = rng.multivariate_normal(FLIGHT.new, noise["scatter"].covariance, n)
    exact = np.tile(FLIGHT.new, (n, 1))
    change, cosine = flight_geometry(axes)
    loud = correction_slews(truths, SIMULATION.new, angle2, axes[:3], 70, noise["best"])
    return Predictions(
        table2={
            "before": correction_slews(truths, SIMULATION.initial, angle2, axes, 10),
            "after": correction_slews(truths, SIMULATION.new, angle2, axes, 20),
            "WLS here": correction_slews(truths, fitted.quiet.theta, angle2, axes, 30),
        },
        table4={
            "before": correction_slews(flights, FLIGHT.initial, angle4, axes, 40),
            "after": correction_slews(flights, FLIGHT.new, angle4, axes, 50),
            "exact": correction_slews(exact, FLIGHT.new, angle4, axes, 60),
        },
        loud=loud,
        change=change,
        cosine=cosine,
    )


def analysis(quick: bool = False):
    """All tables and pictures."""
    rng, fitted = np.random.default_rng(SEED), fits(quick)
    quiet = fitted.quiet
    predicted = predictions(fitted, rng, quick)
    parts = {
        "J": noise_likelihood(quiet, np.arange(6)),
        "K": noise_likelihood(quiet, np.arange(6, 9)),
        "flat": noise_likelihood(quiet, np.arange(9), prior=False),
    }
    check = closed_loop_check(SIMULATION.truth, SEED)
    angle, _, left = FLOWN_SLEW
    effects = single_effects(slew_plan(np.array([1.0, 0.0, 0.0]), angle, 145.0), left, quick)
    flight_draws = rng.multivariate_normal(fitted.flight.theta, fitted.flight.covariance, 20_000)
    tables = [
        *words.fit_tables(fitted.noise, quiet, fitted.loud, fitted.draws),
        words.slew_table2(predicted),
        words.flight_table(fitted.noise, fitted.flight, flight_draws),
        words.slew_table4(predicted),
        words.effect_table(effects),
        *([check[0]] if check else []),
    ]
    result = words.result(fitted.noise, parts, predicted, check, quiet, tables)
    return result, drawings(fitted, predicted)


def drawings(fitted: Fits, predicted: Predictions) -> dict[str, Figure]:
    """All pictures, by file name."""
    quiet, noise = fitted.quiet, fitted.noise
    sd = np.sqrt(np.diag(noise["scatter"].covariance))
    return {
        "paper_table1_posterior.png": pictures.posterior(
            fitted.draws, SIMULATION, fitted.loud.theta
        ),
        "paper_noise.png": pictures.noise(MULTIPLIERS, noise),
        "paper_cross_terms.png": pictures.cross_terms(SIMULATION, sd, quiet.sd),
        "paper_correction_slews.png": pictures.corrections(
            predicted.table2, predicted.table4, SIMULATED_SLEW, FLOWN_SLEW
        ),
        "paper_figure3_rates.png": pictures.rates(fitted.quiet_flight),
        "paper_figure4_wheels.png": pictures.wheels(fitted.quiet_flight),
        "paper_figure5_rate_residuals.png": pictures.rate_residuals(quiet, SIMULATION.initial),
        "paper_figure6_attitude.png": pictures.attitude_residuals(quiet, SIMULATION.initial),
    }


if __name__ == "__main__":
    run(__doc__, analysis)
