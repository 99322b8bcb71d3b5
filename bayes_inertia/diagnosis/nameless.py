"""What has no name against what was named: imitation, and sets that the data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.driven_disturbances import DRIVEN_BY_LIBRARY, driven_evidence
from bayes_inertia.diagnosis.prior_of_sets import cost_of_further
from bayes_inertia.diagnosis.result import AlternativeEffect, NamelessShape, Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.diagnosis.unexplained import unexplained_signal
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# What a shape without a name is called in an ambiguous set, by where it enters.
NAMELESS = {
    "body torque": "nameless_body_torque",
    "wheel torque": "nameless_wheel_torque",
    "rate sensor": "nameless_rate_error",
    "tachometers": "nameless_tachometer_error",
    "star tracker": "nameless_star_tracker_error",
}
# Between the place where a disturbance enters and what it follows.
FOLLOWS = " that follows "


class Rival(NamedTuple):
    """The disturbance without a name that comes nearest to the effects named.

    Parameters
    ----------
    source : str
        Where it enters, and what it follows; empty where nothing was named.
    log_bayes_factor : float
        By which it beats the effects from one step on.
    instead_of : int
        The first of these steps, from 0.
    """

    source: str
    log_bayes_factor: float
    instead_of: int


def nameless_shapes(steps: Sequence[Step]) -> list[list[NamelessShape]]:
    """All disturbances without a name in what the fit before each step leaves."""
    return [
        _nameless(step, any(later.stochastic for later in steps[i:]))
        for i, step in enumerate(steps)
    ]


def nameless_rival(
    steps: Sequence[Step], candidates: int, shapes: Sequence[Sequence[NamelessShape]]
) -> Rival:
    """Weigh a disturbance without a name against the effects named.

    Several effects together can imitate one that is not in the library, each taking a part. A
    torque or sensor error of any shape has far more freedom and pays for it in evidence; one in
    proportion to something known (`driven_disturbances`) has about as much. Where either wins
    clearly, the names are not the cause. A claim of several effects at once pays for each further
    one (`prior_of_sets`).

    Returns: the disturbance that comes nearest, with the log evidence by which it beats all effects
    named, or the last of them, whichever is more, and from which step on; -inf without steps.
    """
    evidence, rival = 0.0, Rival("", -np.inf, 0)
    for i in reversed(range(len(steps))):
        evidence += steps[i].log_bayes_factor
        claimed = evidence - cost_of_further(i + 1, len(steps) - i - 1, candidates + 1)
        near = max(shapes[i], key=lambda shape: shape.log_bayes_factor)
        if near.log_bayes_factor - claimed > rival.log_bayes_factor:
            rival = Rival(near.source, float(near.log_bayes_factor - claimed), i)
    return rival


def _nameless(step: Step, random: bool) -> list[NamelessShape]:
    """Disturbances without a name in what the fit before a step leaves.

    A disturbance in proportion to something is one hypothesis, whatever drives it: its evidence
    is the average over all drivers. Against a random effect stands only what is averaged over
    its size and shape as that is, and no finer over time.
    """
    estimate = step.before
    if random:
        driven, free = driven_evidence(torque_response(estimate), estimate.linearised()), []
    else:
        signal = unexplained_signal(estimate)
        driven = signal.driven_evidence
        free = [s for s in (signal.torque, signal.better_signal) if s is not None]
    values = {driver: v for driver, v in driven.items() if driver not in DRIVEN_BY_LIBRARY}
    average = float(logsumexp(list(values.values())) - np.log(len(values)))
    (hook, driver), _ = max(values.items(), key=lambda item: item[1])
    return [
        *step.nameless,
        *(NamelessShape(s.source, s.log_evidence) for s in free),
        NamelessShape(f"{hook}{FOLLOWS}{driver}", average),
    ]


def names_may_imitate(steps: Sequence[Step], rules: Rules) -> bool:
    """Whether effects of a fixed shape may each have taken a part of something without a name.

    They stand beside a random effect which a shape without a name explains as well: what is random
    about it may be what they left of one disturbance that none of them is.

    Returns: false for a random effect alone, and without one.
    """
    if len(steps) < 2 or not steps[-1].stochastic:
        return False
    return bool(_nameless_equals(steps[-1], rules))


def ambiguous_sets(
    steps: Sequence[Step], rules: Rules, rival: Rival
) -> tuple[tuple[str, ...], ...]:
    """What the data cannot tell apart, the effects named first.

    A disturbance without a name that explains the data about as well as what was named from some
    step on may stand in place of each of these names. So may one effect in place of several.

    `rules`: its margin decides what is told from a disturbance without a name. Returns [source].
    """
    sets = []
    for i, (step, leads) in enumerate(zip(steps, nameless_leads(steps, rules, rival), strict=True)):
        beside = [name for a in step.alternatives for name in (a.effect, *a.beside)]
        beside += [a.effect for s in steps[:i] for a in s.alternatives if step.added in a.replaces]
        beside += leads
        if beside:
            sets.append((step.added, *dict.fromkeys(beside)))
    return tuple(sets)


def nameless_leads(
    steps: Sequence[Step], rules: Rules, rival: Rival
) -> tuple[dict[str, float], ...]:
    """What without a name explains the data about as well as each step's effect, and by how much.

    Returns: one a step: {value of `NAMELESS`: log evidence by which it beats what was named}.
    """
    found = []
    equal = rival.log_bayes_factor > -rules.log_evidence_margin
    for i, step in enumerate(steps):
        random = step.stochastic or any(_is_stochastic(a) for a in step.alternatives)
        near = [
            (shape.source, shape.log_bayes_factor - step.log_bayes_factor)
            for shape in (_nameless_equals(step, rules) if random else ())
        ]
        if equal and i >= rival.instead_of:
            near.append((rival.source.split(FOLLOWS)[0], rival.log_bayes_factor))
        leads: dict[str, float] = {}
        for source, lead in near:
            leads[NAMELESS[source]] = max(lead, leads.get(NAMELESS[source], lead))
        found.append(leads)
    return tuple(found)


def _nameless_equals(step: Step, rules: Rules) -> list[NamelessShape]:
    """Shapes without a name that explain the data as well as what a step added."""
    least = step.log_bayes_factor - rules.log_evidence_margin
    return [shape for shape in step.nameless if shape.log_bayes_factor > least]


def _is_stochastic(alternative: AlternativeEffect) -> bool:
    effects = {effect.name: effect for effect in alternative.estimate.model.effects}
    return isinstance(effects[alternative.effect], StochasticEffect)
