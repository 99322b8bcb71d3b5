"""The simulated campaigns of `fixed_shape.py`: truths, hidden effects and their amplitudes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import optimize, stats

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.score_test import ScoreTests, score_tests
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model

# Multiple of a step of about one prior sd, beyond which an effect is not looked for.
LARGEST_AMPLITUDE = 30.0


def plan() -> Plan:
    """Five slews like the paper's, at 2 Hz to keep the study short."""
    return replace(paper_like_plan(), telemetry_period=0.5)


def template_campaign() -> Campaign:
    """The planned campaign: hardware, prior, and the scale of default priors."""
    return planned_campaign(plan(), most_like_mission())


def draw(
    seed: np.random.SeedSequence, effects: tuple[Effect, ...], values: dict, tachometers: bool
) -> Flight:
    """One flight with its truth; its campaign with or without tachometers."""
    flight = draw_flight(template_campaign(), plan(), seed, effects=effects, values=values)
    return flight if tachometers else replace(flight, campaign=without_tachometers(flight.campaign))


def without_tachometers(campaign: Campaign) -> Campaign:
    """The campaign without tachometers."""
    wheels = tuple(replace(w, momentum_sigma=None) for w in campaign.wheels)
    return replace(
        campaign,
        wheels=wheels,
        slews=tuple(replace(s, wheel_momentum=None) for s in campaign.slews),
    )


def noncentrality(power: float, dof: int, level: float) -> float:
    """Non-centrality at which an ideal chi^2 test of this level has this power.

    >>> round(noncentrality(0.99, 1, 0.05), 1)
    18.4
    """
    limit = stats.chi2.isf(level, dof)
    return float(optimize.brentq(lambda nc: stats.ncx2.sf(limit, dof, nc) - power, 1e-3, 1e4))


def degrees_of_freedom(effect: Effect, campaign: Campaign) -> int:
    """Of the ideal test of an effect: its parameters but those that only give it its shape."""
    return sum(len(p.names) for p in effect.parameters(campaign) if not p.priors[0].logarithmic)


def direction(effect: Effect, rng: np.random.Generator, campaign: Campaign) -> dict:
    """Values of an effect's parameters one prior scale from null, in a random direction.

    Shape parameters at their null. The scale of a one-sided prior is that of its whole normal, as
    a diagnosis has it: its sd is smaller.
    """
    values = {}
    for p in effect.parameters(campaign):
        step = rng.normal(size=len(p.names))
        if p.priors[0].lower == p.null:
            step = np.abs(step)
        if p.priors[0].logarithmic:
            step = np.zeros(len(p.names))
        values[p.name] = (p.null, step * np.array([q.scale for q in p.priors]), p.components)
    return values


def scaled(values: dict, size: float) -> dict:
    """Those values at a multiple of the step from null."""
    return {
        k: null + size * step if components else float(null + size * step[0])
        for k, (null, step, components) in values.items()
    }


def plain_fit(campaign: Campaign) -> Estimate:
    """The fit without effects, from as many starts as a user's.

    In a local optimum the sensitivities are others.
    """
    return optimizer.estimate(Model(campaign), discount=False)


def _as_flown(campaign: Campaign) -> Campaign:
    return campaign


def amplitude_for(
    effect: Effect,
    values: dict,
    wanted: float,
    seed: np.random.SeedSequence,
    tachometers: bool,
    noise: Callable[[Campaign], Campaign] = _as_flown,
) -> float:
    """Multiple of `values` at which the projected signal has the wanted non-centrality.

    `noise` adds more noise to a flight's telemetry.
    """
    campaign = noise(draw(seed, (), {}, tachometers).campaign)
    plain = plain_fit(campaign)
    if effect.name == "flexible_mode":
        return mode_amplitude(effect, values, wanted, seed, plain, tachometers, noise)
    with_effect = optimizer.move_to(plain, Model(campaign, (effect,)))
    information = score_tests(linear_model(with_effect)).matrix
    step = unit_step(effect, values, campaign)
    unit = max(float(step @ information @ step), 1e-12)
    return float(np.clip(np.sqrt(wanted / unit), 1e-9, LARGEST_AMPLITUDE))


def unit_step(effect: Effect, values: dict, campaign: Campaign) -> np.ndarray:
    """The step of `direction` in units of a campaign's prior scale, which may follow its rates."""
    scale = np.concatenate([[q.scale for q in p.priors] for p in effect.parameters(campaign)])
    return np.concatenate([step for _, step, _ in values.values()]) / scale


def mode_amplitude(
    effect: Effect,
    values: dict,
    wanted: float,
    seed: np.random.SeedSequence,
    plain: Estimate,
    tachometers: bool,
    noise: Callable[[Campaign], Campaign] = _as_flown,
) -> float:
    """As `amplitude_for`, for a flexible mode: by simulation.

    Its signal is of second order in its coupling.
    """
    size = 0.5
    for _ in range(3):
        values_at_size = {effect.name: scaled(values, size)}
        campaign = noise(draw(seed, (effect,), values_at_size, tachometers).campaign)
        size *= (wanted / max(projected_difference(campaign, plain), 1e-12)) ** 0.25
        size = float(np.clip(size, 1e-9, 4.0))
    return size


def ideal_powers(
    effects: tuple[Effect, ...],
    values: dict,
    wanted: list[float],
    seed: np.random.SeedSequence,
    tachometers: bool,
    level: float,
) -> list[float]:
    """Power of an ideal test for each of several effects once the others are fitted too.

    Alone each has the wanted non-centrality. Of a flexible mode, whose signal is of second order,
    nothing is taken off: its power is an upper bound.
    """
    campaign = draw(seed, (), {}, tachometers).campaign
    linear = tuple(e for e in effects if e.name != "flexible_mode")
    plain = optimizer.move_to(plain_fit(campaign), Model(campaign, linear))
    scores = score_tests(linear_model(plain))
    left = list(wanted)
    for i, effect in enumerate(effects):
        if effect.name in scores.names and len(scores.names) > 1:
            step = unit_step(effect, values[effect.name], campaign)
            apart, alone = _noncentralities(scores, scores.names.index(effect.name), step)
            left[i] = wanted[i] * apart / alone
    dofs = [degrees_of_freedom(e, campaign) for e in effects]
    return [
        float(stats.ncx2.sf(stats.chi2.isf(level, dof), dof, max(nc, 0.0)))
        for dof, nc in zip(dofs, left, strict=True)
    ]


def _noncentralities(scores: ScoreTests, i: int, step: np.ndarray) -> tuple[float, float]:
    """Non-centrality of effect i when all others are fitted, and alone."""
    hidden = scores.indices[i]
    fitted = np.concatenate([x for j, x in enumerate(scores.indices) if j != i])
    alone = scores.matrix[np.ix_(hidden, hidden)]
    cross = scores.matrix[np.ix_(hidden, fitted)]
    inverse = np.linalg.pinv(scores.matrix[np.ix_(fitted, fitted)], rcond=1e-9, hermitian=True)
    apart = alone - cross @ inverse @ cross.T
    return float(step @ apart @ step), float(step @ alone @ step)


def projected_difference(with_effect: Campaign, plain: Estimate) -> float:
    """|P (y1 - y0)|^2 for two campaigns with equal noise.

    What is left of their difference after fitting J, K, bias and starts. Both hold the same noise
    e: their residuals are P e and P (e + s).
    """
    residuals = [
        np.concatenate(
            [np.nan_to_num(x).ravel() for slews in fit.residual_series.values() for x in slews]
        )
        for fit in (plain, plain_fit(with_effect))
    ]
    return float(np.sum((residuals[1] - residuals[0]) ** 2))
