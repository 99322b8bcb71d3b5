"""First-order processes in the rates as candidates, weighed with nothing of them left out.

On knots such a process is weighed cheaply. Where it is strong, what it does between knots tells
most: which process it is, its size, and whether it is noise of another kind. There the whole
process is filtered out of the readings, and the evidence averaged over size and time by Laplace's
approximation.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.signal_evidence import GainOfSizes, SignalEvidence
from bayes_inertia.inference.filtered_evidence import (
    EvidencePeak,
    FilteredEvidence,
    evidence_peak,
    noise_level_used,
)
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.noise_model import noise_between_knots
from bayes_inertia.physics.parameters import LogNormal
from bayes_inertia.physics.processes import Process
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# Log evidence on knots above which the whole process is filtered.
_STRONG = 15.0
# What is worth less than this share of the best candidate on knots is not it.
_SHARE_OF_BEST = 0.7
# A level of the noise above one by this much has to compete with the stated one.
_HIGHER_LEVEL = 1e-3


def is_strong(on_knots: SignalEvidence) -> bool:
    """Whether a first-order process of the rates would be filtered."""
    return on_knots.log_bayes_factor >= _STRONG


def filtered_effects(
    fit: LinearisedFit, on_knots: Mapping[StochasticEffect, SignalEvidence]
) -> tuple[StochasticEffect, ...]:
    """Which effects are to be weighed by filtering.

    Returns: strong first-order processes of the rates that are not far behind the best candidate;
    empty where another one is fitted.
    """
    most = max((own.log_bayes_factor for own in on_knots.values()), default=0.0)
    if noise_between_knots(fit.model, fit.point.theta):
        return ()
    return tuple(
        effect
        for effect, own in on_knots.items()
        if is_strong(own)
        and own.log_bayes_factor >= _SHARE_OF_BEST * most
        and _is_of_rates(effect, fit.model.campaign)
    )


def _is_of_rates(effect: StochasticEffect, campaign: Campaign) -> bool:
    """Whether an effect is a first-order process of the rates, its parameters sizes and times."""
    priors = _priors(effect, campaign)
    if len(priors) < len(effect.parameters(campaign)):
        return False
    noise = effect.reading_noise({name: jnp.asarray(x.median) for name, x in priors.items()})
    return noise is not None and noise.channel == "rate" and noise.knots > 0


def _priors(effect: StochasticEffect, campaign: Campaign) -> dict[str, LogNormal]:
    """Priors of an effect's parameters that are single positive numbers."""
    of_each = {p.name: p.priors for p in effect.parameters(campaign)}
    return {
        name: priors[0]
        for name, priors in of_each.items()
        if len(priors) == 1 and isinstance(priors[0], LogNormal)
    }


def filtered_candidate(
    fit: LinearisedFit,
    effect: StochasticEffect,
    begin: np.ndarray,
    own: SignalEvidence,
    gain: GainOfSizes | None = None,
) -> tuple[float, tuple[float, ...]]:
    """Weigh a first-order process of the rates.

    `begin` (h,): its parameters where the evidence on knots is largest. `own`: on knots: over which
    sizes it was averaged, in medians of the prior. `gain`: what sizes, in medians of the prior,
    gain where the process goes on between slews: the filter begins anew in every slew. Returns
    `log_bayes_factor`: log evidence against nothing, averaged over sizes and times as on knots;
    `start`: its parameters where the evidence is largest.
    """
    priors = _priors(effect, fit.model.campaign)
    mean = np.array([prior.mean for prior in priors.values()])
    scale = np.array([prior.scale for prior in priors.values()])

    def processes(x: np.ndarray) -> tuple[Process, ...]:
        p = dict(zip(priors, jnp.exp(mean + scale * x), strict=True))
        noise = effect.reading_noise(p)
        return () if noise is None else (noise._replace(knots=0),)

    def between_slews(points: np.ndarray) -> np.ndarray:
        return gain(np.exp(scale[0] * points[:, 0])) if gain else np.zeros(len(points))

    level = noise_level_used(fit.model, fit.point, fit.white)
    nothing = np.zeros(fit.n_local, bool)
    evidence = FilteredEvidence(fit.model, fit.point, fit.white, fit.free, level, nothing)
    x = (np.log(begin) - mean) / scale
    # The size's prior is flat in its logarithm, over the sizes that were tried on knots.
    precision = np.array([0.0, *[1.0] * (len(x) - 1)])
    peaks = [
        evidence_peak(
            evidence, processes, x, precision, as_stated=as_stated, between_slews=between_slews
        )
        for as_stated in ((False, True) if level > 1.0 + _HIGHER_LEVEL else (False,))
    ]
    best = max(peaks, key=lambda peak: peak.log_evidence)
    # Of the size by its logarithm, of the others by their priors.
    density = own.log_density(float(np.exp(scale[0] * best.at[0]))) + np.log(scale[0])
    density -= 0.5 * np.log(2.0 * np.pi) * (len(x) - 1)
    average = _laplace(best) + density - np.log(len(peaks))
    before = float(evidence.log_evidence([()])[0])
    return average - before, tuple(np.exp(mean + scale * best.at).tolist())


def _laplace(peak: EvidencePeak) -> float:
    """Log of the integral around a peak."""
    h = len(peak.at)
    log_det = np.linalg.slogdet(peak.curvature)[1]
    return float(peak.log_evidence + 0.5 * h * np.log(2.0 * np.pi) - 0.5 * log_det)
