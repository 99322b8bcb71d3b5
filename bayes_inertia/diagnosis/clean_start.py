"""What is dirt and what may be physics: measured before a table is made, and again beside its best
row.

Outliers are local, and rounding is seen in the readings: both are treated at once. The level of the
noise comes from fast differences. Correlated noise can look like a slow missing effect, and the
other way round: where residuals show any, there is a start with it and one without, each with a
table of its own, and the evidence of both decides (`search`). So it is with louder noise, where
residuals that are too large have no structure in time.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.campaign.sensors import reading_step, stream_named, streams_of
from bayes_inertia.diagnosis.limits import LIMITS, Rules
from bayes_inertia.diagnosis.residuals import is_explained
from bayes_inertia.diagnosis.score_test import log_evidence_of_fit
from bayes_inertia.diagnosis.torque_response import tangents
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import (
    CleanFit,
    colours_seen,
    masks_at,
    noise_factors,
    refitted,
    rounded_channels,
    without_outliers,
)
from bayes_inertia.inference.input_noise import with_likely_inputs
from bayes_inertia.inference.laplace import Estimate, plain_series
from bayes_inertia.inference.likelihood import Point, padded_sensitivities, residuals
from bayes_inertia.inference.noise_colour import colour_of
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.treatment import DirtTreatment, treated
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class CleanStart:
    """Where a search begins.

    Parameters
    ----------
    stated : Model
        With all candidates, its campaign as stated.
    base : Estimate
        The fit without effects, as a point of the model with all of them.
    noise : mapping of float
        By channel, what its noise is multiplied by.
    treatment : DirtTreatment
        What was done to the campaign; its level is in `noise`.
    as_stated : bool
        Whether only the level of the noise is measured.
    """

    stated: Model
    base: Estimate
    noise: Mapping[str, float]
    treatment: DirtTreatment
    as_stated: bool = False


def clean_start(model: Model, *, seed: int = 0, as_stated: bool = False) -> CleanStart:
    """Fit the model without effects, dirt kept away; its noise is white."""
    with ThreadPoolExecutor(1) as pool:
        compiled = pool.submit(precompile, model)
        base = Model(model.campaign, (), model.structure.drive)
        estimate = with_likely_inputs(optimizer.estimate(base, seed=seed, discount=False))
        fit, base = CleanFit(estimate, DirtTreatment()), estimate.model
        if not as_stated:
            fit = _without_local_dirt(fit, base)
        noise = _noise(fit.estimate, fit.treatment)
        compiled.result()
    estimate = optimizer.with_noise(fit.estimate, noise)
    stated = replace(model, campaign=base.campaign)
    estimate = optimizer.move_to(estimate, replace(model, campaign=estimate.model.campaign))
    return CleanStart(stated, estimate, noise, fit.treatment, as_stated)


def _without_local_dirt(fit: CleanFit, stated: Model) -> CleanFit:
    """The fit without outliers, and without readings that rounding repeats."""

    def repeat(fit: CleanFit, treatment: DirtTreatment) -> CleanFit:
        campaign = treated(stated.campaign, treatment, stated.structure.drive)
        return CleanFit(refitted(fit.estimate, campaign, weak_data_first=True), treatment)

    fit = without_outliers(fit, stated.campaign, repeat)
    rounded = tuple(sorted(rounded_channels(fit.estimate)))
    treatment = replace(fit.treatment, rounded=rounded)
    return fit if treatment == fit.treatment else repeat(fit, treatment)


def _noise(estimate: Estimate, treatment: DirtTreatment) -> dict[str, float]:
    """By channel, what its noise is multiplied by: as measured, or as rounding makes it."""
    measured = noise_factors(estimate)
    rounded = rounded_channels(estimate) if treatment.rounded else {}
    measured |= {channel: rounded[channel] for channel in treatment.rounded if channel in rounded}
    for channel in treatment.by_residuals:
        of_residuals = float(np.sqrt(estimate.tests[channel].reduced_chi2 or 1.0))
        measured[channel] = max(1.0, measured[channel], of_residuals)
    return measured


def with_correlated_noise(start: CleanStart, *fits: Estimate) -> CleanStart | None:
    """The start with the correlated noise that residuals show, of the first fit that shows any.

    It is measured until fit and noise agree: a fit that takes the noise for white explains part of
    what is slow in it. Returns: none where noise is white, or has a colour already.
    """
    if start.as_stated or start.treatment.colour:
        return None
    colour = next(filter(None, (colours_seen(fit, slow=True) for fit in fits)), None)
    if colour is None:
        return None
    treatment = replace(start.treatment, colour=colour)
    base = _treated(start, start.base, treatment)
    coloured = _at_level(replace(start, base=base), _noise(base, treatment), treatment)
    for _ in range(LIMITS.rounds_of_noise):
        again = measured_again(coloured, coloured.base)
        if again is None:
            break
        coloured = again
    return coloured


def with_louder_noise(start: CleanStart, final: Estimate, rules: Rules) -> CleanStart | None:
    """The start with the noise as loud as the residuals of a fit, where nothing but that is wrong.

    Heavy tails, or noise that is louder at times: fast differences, of which the level is measured
    first, leave both out. Returns: none where residuals are no larger, or structured in time.
    """
    tests = final.final_tests
    channels = tuple(c for c, test in tests.items() if c != "total" and test.too_large)
    structured = any(tests[c].is_structured for c in channels)
    if start.as_stated or not channels or structured or is_explained(tests, rules):
        return None
    treatment = replace(start.treatment, by_residuals=channels)
    return _at_level(start, _noise(final, treatment), treatment)


def _at_level(start: CleanStart, noise: dict[str, float], treatment: DirtTreatment) -> CleanStart:
    """The start with another treatment and its noise at another level, its fit as it is."""
    base = optimizer.with_noise(start.base, noise)
    return replace(start, base=base, noise=noise, treatment=treatment)


def _treated(start: CleanStart, estimate: Estimate, treatment: DirtTreatment) -> Estimate:
    """An estimate with another treatment, its noise at the level that is stated."""
    campaign = treated(start.stated.campaign, treatment, start.stated.structure.drive)
    at_stated_level = optimizer.with_noise(estimate, dict.fromkeys(start.noise, 1.0))
    return refitted(at_stated_level, campaign, tolerance=LIMITS.comparison_tolerance)


def log_evidence_of_noise(estimate: Estimate, levels: int = 0) -> float:
    """Log evidence of a fit, less what the shape of correlated noise and levels of noise cost.

    A reading that is left out counts as one spread over an SI unit, far beyond any noise.
    """
    campaign = estimate.model.campaign
    coloured = sum(stream.correlated(campaign) is not None for stream in streams_of(campaign))
    numbers = LIMITS.numbers_of_colour * coloured + levels
    return log_evidence_of_fit(estimate) - 0.5 * numbers * float(np.log(LIMITS.readings_a_number))


def holds_correlated_noise(fit: Estimate) -> bool:
    """Whether a fit holds a process of the rates that lasts for few readings: correlated noise."""
    step, space = reading_step(fit.model.campaign), fit.model.space
    shortest = LIMITS.readings_of_noise * step
    random = (e for e in fit.effects_fitted if isinstance(e, StochasticEffect))
    # The sd comes first, the time next.
    times = (fit.theta[space.slice_of(e.name)][1:2] for e in random if e.acts("rate_output"))
    return any(time < shortest for of_effect in times for time in of_effect)


def measured_again(start: CleanStart, final: Estimate) -> CleanStart | None:
    """What dirt is once effects are named: they are not in the way any more.

    Returns: the start at other noise or with other masks; None where nothing changed.
    """
    treatment, coloured = start.treatment, list[CleanFit]()
    if not start.as_stated:
        coloured = [_coloured_again(start, final, channel) for channel in treatment.colour]
        for channel, fit in zip(treatment.colour, coloured, strict=True):
            colour = {**treatment.colour, channel: fit.treatment.colour[channel]}
            treatment = replace(treatment, colour=colour)
        if final is not start.base:
            masked = masks_at(final, start.stated.campaign, start.treatment)
            treatment = replace(treatment, masked=masked)
    if treatment != start.treatment:
        known = [fit.estimate for fit in coloured if fit.treatment == treatment]
        fitted = known[0] if known else _treated(start, final, treatment)
        same = final is start.base
        base = fitted if same else _treated(start, start.base, treatment)
        return _at_level(replace(start, base=base), _noise(fitted, treatment), treatment)
    if final is start.base:
        return None
    noise = _noise(final, treatment)
    return None if _is_settled(start.noise, noise) else _at_level(start, noise, treatment)


def _is_settled(before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Whether the level of the noise is as it was, in all channels."""
    changes = (np.log(level / before[channel]) for channel, level in after.items())
    return all(abs(change) < LIMITS.settled_level for change in changes)


def _coloured_again(start: CleanStart, final: Estimate, channel: str) -> CleanFit:
    """The fit with correlated noise as it leaves it, if that explains more than the one before."""
    before, slews = CleanFit(final, start.treatment), final.model.campaign.slews
    if channel in start.treatment.rounded:
        return before
    # Residuals in the sigmas that the campaign states.
    stated, used = (
        np.array(stream_named(channel, each.campaign).sigma(each.campaign), float)
        for each in (start.stated, final.model)
    )
    series = [(used / stated) * own for own in plain_series(final)[channel]]
    again = colour_of(slews, series, slow=True)
    if again is None:
        return before
    treatment = replace(start.treatment, colour={**start.treatment.colour, channel: again})
    fit = _treated(start, final, treatment)
    at_level = optimizer.with_noise(fit, _noise(fit, treatment))
    gain = log_evidence_of_noise(at_level) - log_evidence_of_noise(final)
    return CleanFit(fit, treatment) if gain > LIMITS.linear else before


def at_measured_level(start: CleanStart, final: Estimate) -> tuple[CleanStart, Estimate]:
    """The fit at the level of noise that it leaves.

    A strong process beside noise that seemed louder than it is has a wrong size at first: fit and
    level are repeated until they agree. The fit may have stopped early, as one that is compared
    with others; it is brought to its end.
    """
    at_level, noise = final, start.noise
    for _ in range(LIMITS.rounds_of_level):
        again = _noise(at_level, start.treatment)
        if _is_settled(noise, again):
            break
        at_level, noise = optimizer.with_noise(at_level, again), again
    # At another level a fit goes to its end by itself.
    if at_level is final:
        at_level = optimizer.re_estimate(final, final.theta, final.free)
    return replace(start, noise=noise), at_level


def precompile(model: Model) -> None:
    """Evaluate a model once, all its effects at their null, so that later calls find compiled code.

    Wait for it before the model is used: two threads that call the same new function compile it
    twice.
    """
    theta, local = model.space.nulls, np.zeros((model.n_slews, model.structure.n_local))
    point, white = Point(theta, np.zeros(model.n_bias), local), whitening(model, theta)
    padded_sensitivities(model, point, white, np.arange(model.n_base))
    tangents(model.structure, theta, local, model.data)
    residuals(model.structure, point, model.data, white)
