"""J and K where something is missing that no candidate explains: Bayesian model averaging.

Two fits are possible then, and each is wrong at times. One holds the effects that were tried, and
counts each slew as its residuals scatter: the misfit moves it. The other holds a torque and a rate
error of free shape as well: where their priors are not those of what is missing, they take motion
for it. No measure of the fit tells which is nearer (twelve throws of a known body: the first is
right, a disturbance that follows nothing: the second). Averaged at equal weights, J and K hold
both (Hoeting et al. 1999, Bayesian model averaging: a tutorial).
"""

from __future__ import annotations

from bayes_inertia.diagnosis.model_averaging import AlternativeParameters
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import REMAINDERS, FlexibleMode
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# The case with a torque and a rate error of free shape, among those averaged over.
FREE_SHAPES = "nameless_torque_and_rate_error"
# Neither of the two fits is known to be nearer.
_PROBABILITY = 0.5


def tried_effects(diagnosis: Diagnosis) -> tuple[Effect, ...]:
    """The effects of fixed shape that a diagnosis tried before it said "unknown".

    Returns: in the order in which they were added, those included whose place one without a fixed
    shape took; without a flexible mode: its states cost most of a fit, and what it stands for is
    not known.
    """
    tried = (*diagnosis.effects_added, *diagnosis.displaced)
    return tuple(e for e in tried if not isinstance(e, StochasticEffect | FlexibleMode))


def remainder_alternatives(diagnosis: Diagnosis) -> tuple[AlternativeParameters, ...]:
    """J and K with a torque and a rate error of free shape beside the effects that were tried.

    Returns: one, of probability 0.5; empty unless the verdict is "unknown" because no candidate
    explains the data.
    """
    if diagnosis.verdict != "unknown" or diagnosis.why_unknown != "misfit":
        return ()
    free = _with_remainders(diagnosis)
    return (
        AlternativeParameters(
            FREE_SHAPES,
            "",
            _PROBABILITY,
            tuple(free.model.space.names[:N_BASE]),
            free.theta[:N_BASE],
            free.covariance[:N_BASE, :N_BASE],
        ),
    )


def _with_remainders(diagnosis: Diagnosis) -> Estimate:
    """The fit with both shapes, of the campaign whose level of noise is as stated."""
    final = diagnosis.final.model
    effects = (*tried_effects(diagnosis), *REMAINDERS)
    return estimate(Model(final.campaign, effects, final.structure.drive), starts=1)
