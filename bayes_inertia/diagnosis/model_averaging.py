"""J and K where it is not known which of several effects is the true one: Bayesian model averaging.

An ambiguous diagnosis goes on with the effect that explains the data best. Another of its set may
be the true one, and then J and K are others: their sd given the first alone is too small. Averaged
over the set, each effect in proportion to its evidence (Hoeting et al. 1999, Bayesian model
averaging: a tutorial), mean and sd hold whichever it is.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.diagnosis.conclusion import final_tests, is_explained
from bayes_inertia.diagnosis.nameless import NAMELESS, Rival, nameless_leads
from bayes_inertia.diagnosis.result import AlternativeEffect, Diagnosis, Step
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate, move_to, re_estimate, with_noise
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.physical_draws import draw_physical
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects import REMAINDERS
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@array_dataclass
class AlternativeParameters:
    """J and K if `effect` is the true one and not `instead_of`, which was named.

    Parameters
    ----------
    effect : str
        The effect assumed, or several joined by "and"; a value of `nameless.NAMELESS` for what has
        no name.
    instead_of : str
        The effect named; empty for one more effect, see `undetected_averaging`.
    probability : float
        Of this, from the evidence. What is missing from 1 in the sum over all alternatives belongs
        to the effects named.
    names : tuple of str
        Of the elements of J and K.
    mean : (9,) array
        Of J and K, SI units.
    covariance : (9, 9) array
        By Laplace's approximation.

    Examples
    --------
    >>> variance = np.full((1, 1), 4e-6)
    >>> AlternativeParameters(
    ...     "wheel_friction", "viscous_torque", 0.25, ("K1",), np.ones(1), variance
    ... ).sd
    array([0.002])
    """

    effect: str
    instead_of: str
    probability: float
    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (9,)."""
        return np.sqrt(np.diag(self.covariance))


class _Member(NamedTuple):
    """What may be true instead of an effect named, by how much log evidence more, and its fit."""

    effect: str
    instead_of: str
    lead: float
    estimate: Estimate


def alternative_parameters(diagnosis: Diagnosis) -> tuple[AlternativeParameters, ...]:
    """Fit J and K with another effect of an ambiguous set in place of the one named.

    One effect is exchanged at a time: that two sets are both led by the wrong one is left out. For
    what has no name stand a torque and a rate error of free shape (`physics.effects.REMAINDERS`).

    Returns: one for each alternative; empty where the verdict is not "ambiguous".
    """
    if diagnosis.verdict != "ambiguous":
        return ()
    members = [
        _Member(
            " and ".join((other.effect, *other.beside)),
            step.added,
            other.log_bayes_factor - step.log_bayes_factor,
            _exchanged(diagnosis, step, other),
        )
        for step in diagnosis.steps
        for other in step.alternatives
    ]
    members += _nameless_members(diagnosis)
    # At equal odds beforehand. Each alternative was weighed beside the effect of its own step.
    odds = np.exp([member.lead for member in members])
    return tuple(
        AlternativeParameters(
            member.effect,
            member.instead_of,
            float(probability),
            tuple(member.estimate.model.space.names[:N_BASE]),
            member.estimate.theta[:N_BASE],
            member.estimate.covariance[:N_BASE, :N_BASE],
        )
        for member, probability in zip(members, odds / (1.0 + odds.sum()), strict=True)
    )


def _nameless_members(diagnosis: Diagnosis) -> list[_Member]:
    """What has no name in the first ambiguous set that holds it.

    What it does to J and K nobody knows: a torque and a rate error of free shape stand for it.
    """
    places = [
        (name, named)
        for named, *others in diagnosis.ambiguous_with
        for name in others
        if name in NAMELESS.values()
    ]
    rival = Rival(diagnosis.nameless_source, diagnosis.nameless_lead, diagnosis.nameless_instead_of)
    leads = nameless_leads(diagnosis.steps, diagnosis.rules, rival)
    own = {step.added: of_step for step, of_step in zip(diagnosis.steps, leads, strict=True)}
    return [
        _Member(name, named, own[named][name], _with_remainders(diagnosis, named))
        for name, named in places[:1]
    ]


def _with_remainders(diagnosis: Diagnosis, named: str) -> Estimate:
    """The final fit with a torque and a rate error of free shape in place of one effect.

    What they leave of a disturbance of wheels or tachometers counts as noise.
    """
    final = diagnosis.final
    kept = (effect for effect in final.effects_fitted if effect.name != named)
    model = Model(final.model.campaign, (*kept, *REMAINDERS), final.model.structure.drive)
    fitted = with_noise(estimate(model, starts=1, discount=False), diagnosis.noise)
    if is_explained(final_tests(fitted), diagnosis.rules):
        return fitted
    return estimate(model, starts=1)


def _exchanged(diagnosis: Diagnosis, step: Step, other: AlternativeEffect) -> Estimate:
    """The final fit with one effect in place of another."""
    if len(diagnosis.steps) == 1 or other.beside or other.replaces:
        start = with_noise(other.estimate, diagnosis.noise)
        return re_estimate(start, start.theta, start.free)
    start = move_to(diagnosis.final, _model_with(diagnosis.final, step.added, other))
    space, theta, free = start.model.space, start.theta.copy(), start.free
    values = dict(zip(other.estimate.model.space.names, other.estimate.theta, strict=True))
    added = space.slice_of(other.effect)
    for i in (*range(N_BASE), *range(added.start, added.stop)):
        theta[i] = values[space.names[i]]
    if step.added in {effect.name for effect in start.model.effects}:
        removed = space.slice_of(step.added)
        theta[removed] = space.nulls[removed]
        free = free[(free < removed.start) | (free >= removed.stop)]
    return re_estimate(start, theta, np.concatenate([free, np.arange(added.start, added.stop)]))


def _model_with(final: Estimate, removed: str, other: AlternativeEffect) -> Model:
    """A model that holds an alternative effect as it was fitted, and need not hold another.

    A flexible mode has a model of its own, and a strong effect a wider prior. An effect without a
    fixed shape has no null: it is there or not.
    """
    model = final.model
    effects = {effect.name: effect for effect in model.effects}
    fitted = {effect.name: effect for effect in other.estimate.model.effects}[other.effect]
    if isinstance(fitted, StochasticEffect) or isinstance(effects[removed], StochasticEffect):
        effects = {e.name: e for e in final.effects_fitted if e.name != removed}
    elif effects.get(other.effect) == fitted:
        return model
    effects[other.effect] = fitted
    return Model(model.campaign, tuple(effects.values()), model.structure.drive)


def averaged_posterior(
    posterior: Posterior, alternatives: Sequence[AlternativeParameters], seed: int
) -> Posterior:
    """Average J and K over the effects that may be the true one.

    Each draw is kept or gives way to one of an alternative's Gaussian, in proportion to the
    probabilities.

    `alternatives`: J and K with other effects in their place. Returns: with one group `averaged`
    more, of J, K and principal moments, of which `Posterior.summary` then speaks. The group
    `posterior` stays that of the effects named.
    """
    if not alternatives:
        return posterior
    rng, names = np.random.default_rng([seed, 4]), alternatives[0].names
    named_draws: Any = posterior.tree["posterior"]
    draws = np.stack([named_draws[name].values for name in names], -1)
    given = {
        name: {"mean": float(x.mean()), "sd": float(x.std(ddof=1))}
        for name, x in zip(names, np.moveaxis(draws, -1, 0), strict=True)
    }
    probabilities = [a.probability for a in alternatives]
    first = 1.0 - sum(probabilities)
    which = rng.choice(len(alternatives) + 1, size=draws.shape[:2], p=[first, *probabilities])
    for k, alternative in enumerate(alternatives, 1):
        draws[which == k] = _physical_draws(alternative, int(np.sum(which == k)), rng)
    named = posterior.attributes["effects"]
    rows = [{"effects": named, "probability": first, "parameters": given}]
    rows += [_row(named, alternative) for alternative in alternatives]
    return _with_group(posterior, names, draws, rows)


def _with_group(
    posterior: Posterior, names: Sequence[str], draws: np.ndarray, rows: list[dict[str, Any]]
) -> Posterior:
    """The posterior with averaged draws (chains, draws, 9), and what they are averaged over."""
    import xarray as xr

    group = xr.Dataset(
        {name: (("chain", "draw"), draws[..., i]) for i, name in enumerate(names)},
        coords=posterior.tree["posterior"].coords,
    )
    group["principal_moment"] = (
        ("chain", "draw", "axis"),
        inertia_tensor.principal_moments(draws[..., :6]),
    )
    tree = posterior.tree.copy()
    tree["averaged"] = xr.DataTree(group)
    for name in (*names, "principal_moment"):
        source = "derived" if name == "principal_moment" else "posterior"
        tree["averaged"][name].attrs["units"] = tree[source][name].attrs.get("units", "")
    tree.attrs = posterior.tree.attrs | {
        "bayes_inertia": json.dumps(posterior.attributes | {"averaged_over": rows})
    }
    return replace(posterior, tree=tree)


def _row(named: Sequence[str], alternative: AlternativeParameters) -> dict[str, Any]:
    effects = [alternative.effect if n == alternative.instead_of else n for n in named]
    if not alternative.instead_of:
        effects.append(alternative.effect)
    parameters = {
        name: {"mean": float(m), "sd": float(s)}
        for name, m, s in zip(alternative.names, alternative.mean, alternative.sd, strict=True)
    }
    return {
        "effects": effects,
        "probability": alternative.probability,
        "parameters": parameters,
    }


def _physical_draws(
    alternative: AlternativeParameters, n: int, rng: np.random.Generator
) -> np.ndarray:
    """Draws (n, 9) of J and K."""
    mean, covariance = alternative.mean, alternative.covariance
    return draw_physical(
        lambda k: rng.multivariate_normal(mean, covariance, k, method="eigh"),
        n,
        where=alternative.effect,
        advice="hardly any tensor within its uncertainty is one of a body: fly more slews first",
    )
