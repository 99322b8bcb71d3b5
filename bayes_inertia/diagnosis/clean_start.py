"""What is dirt and what may be physics: decided before the table is made, and again after it.

Outliers are local, and rounding is seen in the readings: both are treated at once. The level of the
noise comes from fast differences. Correlated noise can look like a slow missing effect, and the
other way round: the two compete. Where one effect explains the residuals better than any noise that
is alike everywhere, physics goes first, and what it leaves is looked at again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.linear_system import (
    LinearModel,
    linear_model,
    log_evidence_of_each,
    stochastic_candidates,
)
from bayes_inertia.diagnosis.random_signals import SOURCES, StochasticCandidate
from bayes_inertia.diagnosis.table_search import with_stochastic
from bayes_inertia.diagnosis.torque_response import tangents
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import (
    CleanFit,
    colour_of_rounding,
    colour_seen,
    masks_at,
    refitted,
    rounded_channels,
    without_outliers,
)
from bayes_inertia.inference.input_noise import with_likely_inputs
from bayes_inertia.inference.laplace import Estimate, plain_series
from bayes_inertia.inference.likelihood import padded_sensitivities, residuals
from bayes_inertia.inference.noise_colour import Colour, ColourOfAxis, colour_of
from bayes_inertia.inference.noise_level import noise_factors
from bayes_inertia.inference.noise_model import log_normalisation, whitening
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.rounding import level_of_rounded, rounding_steps
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
    coloured : bool
        Whether noise may be correlated in time.
    """

    stated: Model
    base: Estimate
    noise: Mapping[str, float]
    treatment: DirtTreatment
    as_stated: bool = False
    coloured: bool = True


def clean_start(
    model: Model,
    *,
    seed: int = 0,
    as_stated: bool = False,
    coloured: bool = True,
    stochastic: Sequence[StochasticEffect] = (),
) -> CleanStart:
    """Fit the model without effects, dirt kept away.

    `stochastic`: candidates without a fixed shape: correlated noise must explain more than they do.
    """
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
    model = _flown(model, base.campaign)
    estimate = optimizer.move_to(estimate, _flown(model, estimate.model.campaign))
    start = CleanStart(model, estimate, noise, fit.treatment, as_stated, coloured)
    return _noise_or_physics(start, stochastic)


def _without_local_dirt(fit: CleanFit, stated: Model) -> CleanFit:
    """The fit without outliers, and without readings that rounding repeats."""

    def repeat(fit: CleanFit, treatment: DirtTreatment) -> CleanFit:
        campaign = treated(stated.campaign, treatment, stated.structure.drive)
        return CleanFit(refitted(fit.estimate, campaign, weak_data_first=True), treatment)

    fit = without_outliers(fit, stated.campaign, repeat)
    rounded = tuple(sorted(rounded_channels(fit.estimate)))
    colour = colour_of_rounding(fit.estimate) if "rate" in rounded else None
    treatment = replace(fit.treatment, rounded=rounded, colour=colour)
    return fit if treatment == fit.treatment else repeat(fit, treatment)


def _noise(estimate: Estimate, treatment: DirtTreatment) -> dict[str, float]:
    """By channel, what its noise is multiplied by: as measured, or as rounding makes it."""
    measured, steps = noise_factors(estimate), rounding_steps(estimate.model.campaign)
    for channel in treatment.rounded:
        if channel == "rate" and treatment.colour is not None:
            measured[channel] = 1.0  # The colour holds it all.
        else:
            measured[channel] = level_of_rounded(measured[channel], steps[channel])
    return measured


def _flown(model: Model, campaign: Campaign) -> Model:
    """The model of a campaign as it is treated."""
    if campaign is model.campaign:
        return model
    return Model(campaign, model.effects, model.structure.drive)


def _noise_or_physics(start: CleanStart, stochastic: Sequence[StochasticEffect]) -> CleanStart:
    """The start with correlated noise, if that explains more than any candidate could.

    Where an effect without a fixed shape explains the most, noise stays white to the end.
    """
    colour = None
    if start.coloured and not start.as_stated and start.treatment.colour is None:
        colour = colour_seen(start.base, slow=True)
    if colour is None:
        return start
    linear = linear_model(start.base)
    best = max(log_evidence_of_each(linear).values(), default=0.0)
    coloured = _coloured(start, colour)
    gain = _log_evidence(coloured.base) - _log_evidence(start.base)
    weighed = _refitted_if_strong(start, stochastic, linear)
    if _most(weighed, colour) > max(best, gain):
        return replace(start, coloured=False)
    return coloured if gain > max(best, 0.0) else start


def _refitted_if_strong(
    start: CleanStart, effects: Sequence[StochasticEffect], linear: LinearModel
) -> list[StochasticCandidate]:
    """Effects without a fixed shape; the best one of the rates, if strong, weighed as noise is.

    What a strong process does between its knots tells most of what it is.
    """
    weighed = list(stochastic_candidates(linear, start.base, effects))
    best = weighed[0].log_bayes_factor if weighed else 0.0
    least = max(LIMITS.strong, LIMITS.share_of_best * best)
    of_rates = (c for c in weighed if c.source == SOURCES["rate_output"])
    found = next((c for c in of_rates if c.log_bayes_factor >= least), None)
    if found is not None:
        (effect,) = (e for e in effects if e.name == found.effect)
        fit = with_stochastic(start.base, effect, found.start)
        _, fit = at_measured_level(start, fit)
        value = _log_evidence(fit, len(found.start)) - _log_evidence(start.base)
        # A fit takes slews as independent: what a process gains between them the knots tell.
        value = max(found.log_bayes_factor, value)
        weighed[weighed.index(found)] = replace(found, log_bayes_factor=value)
    return weighed


def _most(weighed: Sequence[StochasticCandidate], colour: Colour) -> float:
    """The largest log evidence among effects without a fixed shape; at least zero.

    A process of the rates that lasts for few readings is what correlated noise is.
    """
    shortest = LIMITS.readings_of_noise * colour.spacing
    slow = (
        c
        for c in weighed
        if c.source != SOURCES["rate_output"] or not c.start[1:] or c.start[1] > shortest
    )
    return max([0.0, *(c.log_bayes_factor for c in slow if c.effect)])


def _coloured(start: CleanStart, colour: Colour) -> CleanStart:
    """The start with correlated noise, measured until fit and noise agree.

    A fit that takes the noise for white explains part of what is slow in it.
    """
    slews = start.base.model.campaign.slews
    for _ in range(LIMITS.rounds_of_colour):
        coloured = _restarted(start, replace(start.treatment, colour=colour))
        again = colour_of(slews, _in_stated_sigmas(coloured, coloured.base), slow=True)
        if again is None or _is_alike(again, colour):
            break
        colour = again
    return coloured


def _restarted(start: CleanStart, treatment: DirtTreatment) -> CleanStart:
    """The base fit with another treatment."""
    base, noise = _with_treatment(start, start.base, treatment)
    return replace(start, base=base, noise=noise, treatment=treatment)


def _with_treatment(
    start: CleanStart, estimate: Estimate, treatment: DirtTreatment
) -> tuple[Estimate, dict[str, float]]:
    """An estimate with another treatment, and the level of its noise, measured anew."""
    campaign = treated(start.stated.campaign, treatment, start.stated.structure.drive)
    calm = optimizer.with_noise(estimate, dict.fromkeys(start.noise, 1.0))
    estimate = refitted(calm, campaign)
    noise = _noise(estimate, treatment)
    return optimizer.with_noise(estimate, noise), noise


def _log_evidence(estimate: Estimate, numbers: int = 0) -> float:
    """Log posterior density with the norms of the noise, less what the shape of the noise costs.

    `numbers`: that give it its shape, beside those of its colour.
    """
    if RATE.correlated(estimate.model.campaign) is not None:
        numbers += LIMITS.numbers_of_colour
    cost = 0.5 * numbers * float(np.log(LIMITS.readings_a_number))
    return log_normalisation(estimate.model, estimate.white) - estimate.objective - cost


def measured_again(
    start: CleanStart, final: Estimate, weighed: Sequence[StochasticCandidate] = ()
) -> CleanStart | None:
    """What dirt is once effects are named: they are not in the way any more.

    `weighed`: what has no fixed shape, at that fit: correlated noise must explain more than it
    does. Returns: the start at other noise or with other masks; None where nothing changed.
    """
    if start.as_stated:
        return None if final is start.base else _at_level_of(start, final)
    colour = _colour_after(start, final, weighed)
    if colour is not start.treatment.colour:
        if colour is None:
            return _restarted(start, replace(start.treatment, colour=None))
        return _coloured(start, colour)
    if final is start.base:
        return None
    masked = masks_at(final, start.stated.campaign, start.treatment)
    if masked == start.treatment.masked:
        return _at_level_of(start, final)
    treatment = replace(start.treatment, masked=masked)
    cleaned, _ = _with_treatment(start, final, treatment)
    again = _restarted(start, treatment)
    return _at_level_of(again, cleaned) or again


def _colour_after(
    start: CleanStart, final: Estimate, weighed: Sequence[StochasticCandidate]
) -> Colour | None:
    """Correlated noise in what effects leave; the very object where it is as before."""
    before = start.treatment.colour
    if (
        not start.coloured
        or "rate" in start.treatment.rounded
        or (before is not None and final is start.base)
    ):
        return before
    if before is None:
        colour = colour_seen(final, slow=True)
        if colour is None:
            return None
        coloured, _ = _with_treatment(start, final, replace(start.treatment, colour=colour))
        gain = _log_evidence(coloured) - _log_evidence(final)
        return colour if gain > _most(weighed, colour) else None
    slews = final.model.campaign.slews
    colour = colour_of(slews, _in_stated_sigmas(start, final), slow=True)
    return before if colour is not None and _is_alike(colour, before) else colour


def _in_stated_sigmas(start: CleanStart, final: Estimate) -> list[np.ndarray]:
    """Residuals of the rates in the sigmas that the campaign states."""
    stated = np.array(RATE.sigma(start.stated.campaign))
    ratio = np.array(RATE.sigma(final.model.campaign)) / stated if len(stated) else 1.0
    return [series * ratio for series in plain_series(final)["rate"]]


def _is_alike(colour: Colour, other: Colour) -> bool:
    """Whether two colours are one within what can be told."""
    for one, two in zip(colour.axes, other.axes, strict=True):
        sd = abs(np.log(one.sd / two.sd))
        slow = abs(np.log(_slow_power(one) / _slow_power(two)))
        if sd > np.log(LIMITS.same_sd) or slow > np.log(LIMITS.same_power):
            return False
    return True


def _slow_power(axis: ColourOfAxis) -> float:
    """Power of the noise of one axis at rest of frequency."""
    lasting = (1.0 + axis.correlation) / (1.0 - axis.correlation)
    return axis.sd**2 * (1.0 - axis.share + axis.share * lasting)


def at_measured_level(start: CleanStart, final: Estimate) -> tuple[CleanStart, Estimate]:
    """The fit at the level of noise that it leaves.

    A strong process beside noise that seemed louder than it is has a wrong size at first: fit and
    level are repeated until they agree. The fit may have stopped early, as one that is compared
    with others; it is brought to its end.
    """
    at_level, noise = final, start.noise
    for _ in range(LIMITS.rounds_of_level):
        again = _noise(at_level, start.treatment)
        if again == noise:
            break
        at_level, noise = optimizer.with_noise(at_level, again), again
    # At another level a fit goes to its end by itself.
    if at_level is final:
        at_level = optimizer.re_estimate(final, final.theta, final.free)
    return replace(start, noise=noise), at_level


def _at_level_of(start: CleanStart, final: Estimate) -> CleanStart | None:
    """The start at the level of noise that a fit leaves; None where it is at that."""
    noise = _noise(final, start.treatment)
    if noise == start.noise:
        return None
    return replace(start, base=optimizer.with_noise(start.base, noise), noise=noise)


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
