"""Effects that are larger than their priors allow: refitted with wider priors, and said to be so.

A prior of an effect says how large it usually is. Where the data ask for far more, the prior pulls
the fit away from them and punishes the right name with the square of the distance. The effect is
then fitted with a prior as wide as its size; what that costs is in its evidence (`evidence`), and
the verdict says that either the prior is too narrow or the cause is another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.physics.forward_model import Model

# A prior that pulled hides part of the size: it is widened until nothing more comes to light.
_ROUNDS = 4


@dataclass(frozen=True)
class BeyondPrior:
    """An effect that is larger than its prior allows.

    Parameters
    ----------
    effect : str
        Its name.
    parameter : str
        Its parameter that lies furthest out.
    value : float
        What was fitted for it.
    unit : str
        Its unit.
    prior_sds : float
        How far it lies from where the effect does nothing, in sds of its prior as stated.
    prior_scale : float
        By how much the prior was widened.
    """

    effect: str
    parameter: str
    value: float
    unit: str
    prior_sds: float
    prior_scale: float


def within_prior(fitted: Estimate, effect: str, rules: Rules, *, tolerance: float) -> Estimate:
    """Refit an effect with a wider prior, if the one that it has is exceeded.

    `rules`: how far a parameter may lie from where it does nothing. Returns: the same object where
    the prior is kept to. Priors are widened by powers of two.
    """
    for _ in range(_ROUNDS):
        distance = float(np.abs(_distances(fitted, effect)).max(initial=0.0))
        if distance <= rules.prior_sd_at_most:
            break
        wide = move_to(fitted, _widened(fitted.model, effect, _power_of_two(distance)))
        fitted = re_estimate(wide, wide.theta, wide.free, tolerance=tolerance)
    return fitted


def beyond_prior(
    final: Estimate, effects: tuple[str, ...], rules: Rules
) -> tuple[BeyondPrior, ...]:
    """List the effects that are larger than their priors allow.

    `rules`: how far a parameter may lie from where it does nothing.
    """
    scales = {effect.name: effect.prior_scale for effect in final.model.effects}
    space, rows = final.model.space, []
    for effect in effects:
        part, distances = space.slice_of(effect), np.abs(_distances(final, effect))
        distances = distances * scales[effect]
        if distances.max(initial=0.0) <= rules.prior_sd_at_most:
            continue
        worst = int(np.argmax(distances))
        k = part.start + worst
        name = space.names[k].split(".", 1)[1]
        rows.append(
            BeyondPrior(
                effect,
                name,
                float(final.theta[k]),
                space.units[k],
                float(distances[worst]),
                scales[effect],
            )
        )
    return tuple(rows)


def _distances(fitted: Estimate, effect: str) -> np.ndarray:
    """How far each amplitude lies from where it does nothing [prior sd]; 0 for shapes."""
    space = fitted.model.space
    part = space.slice_of(effect)
    distance = (fitted.theta - space.nulls)[part] / space.sd[part]
    return np.where([prior.logarithmic for prior in space.priors[part]], 0.0, distance)


def _widened(model: Model, effect: str, factor: float) -> Model:
    effects = tuple(
        replace(e, prior_scale=factor * e.prior_scale) if e.name == effect else e
        for e in model.effects
    )
    return Model(model.campaign, effects, model.structure.drive, model.noise)


def _power_of_two(distance: float) -> float:
    """The next one: sizes that differ by noise get one prior."""
    return float(2.0 ** np.ceil(np.log2(distance)))
