"""J and K where it is not known which of several effects is the true one: Bayesian model averaging.

An ambiguous diagnosis goes on with the effect that explains the data best. Another of its set may be the true one, and then J and K
are others: their sd given the first alone is too small. Averaged over the set, each effect in proportion to its evidence
(Hoeting et al. 1999, Bayesian model averaging: a tutorial), mean and sd hold whichever it is.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.diagnosis.result import Diagnosis, Rival, Step
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to, re_estimate, with_noise
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.physical_draws import draw_physical
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE


@array_dataclass
class Alternative:
    """J and K if `effect` is the true one and not `instead_of`, which was named.

    Attributes
    ----------
    probability : of this, from the evidence; what is missing from 1 in the sum over all alternatives belongs to the effects named.
    names, mean, covariance : of J and K (9,), (9,), (9, 9), in SI units, by Laplace's approximation.

    >>> Alternative("wheel_friction", "viscous_torque", 0.25, ("K1",), np.ones(1), np.full((1, 1), 4e-6)).sd
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


def alternatives(found: Diagnosis) -> tuple[Alternative, ...]:
    """The fits with another effect of an ambiguous set in place of the one named; empty where the verdict is another.

    One effect is exchanged at a time: that two sets are both led by the wrong one is left out.
    """
    if found.verdict != "ambiguous":
        return ()
    pairs = [(step, rival) for step in found.steps for rival in step.alternatives]
    # At equal odds beforehand. Each rival was weighed beside the effect of its own step.
    odds = np.exp([rival.log_bayes_factor - step.log_bayes_factor for step, rival in pairs])
    return tuple(
        _alternative(found, *pair, float(p))
        for pair, p in zip(pairs, odds / (1.0 + odds.sum()), strict=True)
    )


def _alternative(found: Diagnosis, step: Step, rival: Rival, probability: float) -> Alternative:
    at = _exchanged(found, step, rival)
    return Alternative(
        rival.effect,
        step.added,
        probability,
        tuple(at.model.space.names[:N_BASE]),
        at.theta[:N_BASE],
        at.covariance[:N_BASE, :N_BASE],
    )


def _exchanged(found: Diagnosis, step: Step, rival: Rival) -> Estimate:
    """The final fit with one effect in place of another."""
    if len(found.steps) == 1:
        begun = with_noise(rival.after, found.noise)
        return re_estimate(begun, begun.theta, begun.free)
    final, effects = found.final, {e.name: e for e in rival.after.model.effects}
    model = final.model
    if rival.effect not in {
        e.name for e in model.effects
    }:  # a flexible mode has a model of its own
        model = Model(
            model.campaign, (*model.effects, effects[rival.effect]), model.structure.drive
        )
    at, space = move_to(final, model), model.space
    there = dict(zip(rival.after.model.space.names, rival.after.theta, strict=True))
    theta, gone, come = at.theta.copy(), space.slice_of(step.added), space.slice_of(rival.effect)
    theta[gone] = space.nulls[gone]
    for i in (*range(N_BASE), *range(come.start, come.stop)):
        theta[i] = there[space.names[i]]
    kept = at.free[(at.free < gone.start) | (at.free >= gone.stop)]
    return re_estimate(at, theta, np.concatenate([kept, np.arange(come.start, come.stop)]))


def averaged(posterior: Posterior, others: Sequence[Alternative], seed: int) -> Posterior:
    """The posterior with a group `averaged` more: J, K and principal moments, whichever effect is the true one.

    Each draw is kept or gives way to one of an alternative's Gaussian, in proportion to the probabilities.
    `Posterior.summary` then speaks of the averaged J and K. The group `posterior` stays that of the effects named.
    """
    import xarray as xr

    if not others:
        return posterior
    rng, names = np.random.default_rng([seed, 4]), others[0].names
    draws = np.stack([posterior.tree["posterior"][name].values for name in names], -1)
    given = {
        name: {"mean": float(x.mean()), "sd": float(x.std(ddof=1))}
        for name, x in zip(names, np.moveaxis(draws, -1, 0), strict=True)
    }
    first = 1.0 - sum(o.probability for o in others)
    which = rng.choice(
        len(others) + 1, size=draws.shape[:2], p=[first, *(o.probability for o in others)]
    )
    for k, other in enumerate(others, 1):
        draws[which == k] = _physical_draws(other, int(np.sum(which == k)), rng)
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
    fitted = posterior.attributes["effects"]
    rows = [{"effects": fitted, "probability": first, "parameters": given}]
    rows += [
        _row([o.effect if name == o.instead_of else name for name in fitted], o) for o in others
    ]
    tree.attrs = posterior.tree.attrs | {
        "bayes_inertia": json.dumps(posterior.attributes | {"averaged_over": rows})
    }
    return replace(posterior, tree=tree)


def _row(effects: list[str], other: Alternative) -> dict:
    parameters = {
        name: {"mean": float(m), "sd": float(s)}
        for name, m, s in zip(other.names, other.mean, other.sd, strict=True)
    }
    return {"effects": effects, "probability": other.probability, "parameters": parameters}


def _physical_draws(alternative: Alternative, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draws (n, 9) of J and K."""
    mean, covariance = alternative.mean, alternative.covariance
    return draw_physical(
        lambda k: rng.multivariate_normal(mean, covariance, k, method="eigh"),
        n,
        where=alternative.effect,
        advice="hardly any tensor within its uncertainty is one of a body: fly more slews first",
    )
