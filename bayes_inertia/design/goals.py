"""What a campaign is designed for: a goal, and the number that says how well a covariance reaches it (smaller is better)."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.errors import CampaignError

GOALS = {
    "cross_terms": ("largest sd of a product of inertia", "kg m^2"),
    "inertia": ("typical sd of J: geometric mean over the axes of its error ellipsoid", "kg m^2"),
    "scale_factors": ("largest sd of a scale factor", ""),
    "correction_slew": (
        "sd of the correction slew after 60 deg about an axis of any direction",
        "rad",
    ),
    "separate": (
        "sd of the two effects fitted together, in prior sds (geometric mean)",
        "prior sd",
    ),
}
_REFERENCE_ANGLE = math.radians(60.0)
# The largest of several sds, made smooth: a norm of this order is at most 5 % above the largest of three.
_ORDER = 24


@dataclass(frozen=True)
class Goal:
    """What to determine: `kind`, a key of `GOALS`, and the two effects that `separate` is to tell apart.

    Raises `CampaignError` for an unknown kind or not two effects.

    >>> goal("separate:wheel_friction,constant_torque").effects
    ('wheel_friction', 'constant_torque')
    """

    kind: str
    effects: tuple[str, ...] = ()

    def __post_init__(self):
        if self.kind not in GOALS:
            near = difflib.get_close_matches(self.kind, GOALS, 1)
            advice = f"did you mean {near[0]}?" if near else f"choose {', '.join(GOALS)}"
            raise CampaignError(f"unknown goal {self.kind!r}", where="goal", advice=advice)
        if (len(set(self.effects)) != 2) if self.kind == "separate" else self.effects:
            raise CampaignError(
                "separate takes two different effects, other goals none",
                where="goal",
                advice="write separate:effect_a,effect_b",
            )

    @property
    def says(self) -> str:
        """What its number means."""
        return GOALS[self.kind][0]

    @property
    def unit(self) -> str:
        """Unit of its number."""
        return GOALS[self.kind][1]

    def __str__(self) -> str:
        """As `goal` reads it."""
        return f"{self.kind}:{','.join(self.effects)}" if self.effects else self.kind


def goal(text: str | Goal) -> Goal:
    """A goal from its text: `cross_terms`, `inertia`, `scale_factors`, `correction_slew`, `separate:effect_a,effect_b`.

    >>> goal("crossterms")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: goal: unknown goal 'crossterms'; did you mean cross_terms?
    """
    if isinstance(text, Goal):
        return text
    kind, _, effects = text.partition(":")
    return Goal(kind.strip(), tuple(name.strip() for name in effects.split(",") if name.strip()))


def criterion(
    wanted: Goal,
    covariance: Array,
    theta: Array,
    prior_sd: Array,
    groups: Sequence[tuple[int, int]] = (),
    *,
    smooth: bool = False,
) -> Array:
    """The goal's number () for a covariance (d, d) of the parameters; JAX can differentiate it.

    Parameters
    ----------
    theta : (d,) where the covariance holds. prior_sd : (d,). groups : where the parameters of the goal's two effects stand.
    smooth : a norm that is close to the largest sd and has derivatives everywhere, instead of the largest.

    >>> float(criterion(Goal("cross_terms"), jnp.diag(jnp.arange(9.0)), jnp.ones(9), jnp.ones(9)))**2
    5.000...
    """
    if wanted.kind in ("cross_terms", "scale_factors"):
        first = 3 if wanted.kind == "cross_terms" else 6
        variances = jnp.diag(covariance)[first : first + 3]
        return jnp.sqrt(_largest(variances) if smooth else jnp.max(variances))
    if wanted.kind == "inertia":
        scale = prior_sd[:6]
        size = jnp.linalg.slogdet(covariance[:6, :6] / scale / scale[:, None])[1] + 2.0 * jnp.sum(
            jnp.log(scale)
        )
        return jnp.exp(size / 12.0)
    if wanted.kind == "correction_slew":
        relative = covariance[6:9, 6:9] / theta[6:9] / theta[6:9, None]
        return jnp.sqrt(
            jnp.einsum("aij,jk,aik->", _corrections(), relative, _corrections())
            / len(_corrections())
        )
    size = 0.0
    for start, stop in groups:
        own = covariance[start:stop, start:stop] / prior_sd[start:stop] / prior_sd[start:stop, None]
        size = size + jnp.linalg.slogdet(own)[1] / (stop - start)
    return jnp.exp(0.25 * size)


def _largest(variances: Array) -> Array:
    top = jnp.max(variances)
    return top * jnp.sum((variances / top) ** (_ORDER // 2)) ** (2.0 / _ORDER)


def _corrections() -> np.ndarray:
    """Error of the final attitude (axes, 3, 3) [rad] for relative errors of the scale factors, after the reference slew about each of 13 axes.

    A controller that believes a scale factor e too large turns too fast by e about that axis; what it adds is turned on with the body:
    the integral of exp(-s [a]x) ds diag(a) over the slew.
    """
    axes = np.array([a for a in product((-1.0, 0.0, 1.0), repeat=3) if a > (0.0, 0.0, 0.0)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    out = []
    for a in axes:
        cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
        sine, versine = math.sin(_REFERENCE_ANGLE), 1.0 - math.cos(_REFERENCE_ANGLE)
        turned = (
            _REFERENCE_ANGLE * np.eye(3)
            - versine * cross
            + (_REFERENCE_ANGLE - sine) * cross @ cross
        )
        out.append(turned @ np.diag(a))
    return np.array(out)
