"""Goals of a design, and the number that says how well a covariance reaches each."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.errors import CampaignError, require

# What the number of each goal means, and its unit; smaller is better.
GOALS = {
    "cross_terms": ("largest sd of a product of inertia", "kg m^2"),
    "inertia": ("typical sd of J: geometric mean over the axes of its error ellipsoid", "kg m^2"),
    "scale_factors": ("largest sd of a scale factor", ""),
    "correction_slew": (
        f"sd of the correction slew after {NUMERICS.corrected_turn_deg:g} deg "
        "about an axis of any direction",
        "rad",
    ),
    "separate": (
        "sd of the two effects fitted together, in prior sds (geometric mean)",
        "prior sd",
    ),
}


@dataclass(frozen=True)
class Goal:
    """What to determine.

    Parameters
    ----------
    kind : str
        A key of `GOALS`.
    effects : tuple of str, optional
        The two effects that `separate` is to tell apart; none for other goals.

    Raises
    ------
    CampaignError
        If the kind is unknown, or the effects are not two.

    Examples
    --------
    >>> Goal("scale_factors").says
    'largest sd of a scale factor'
    """

    kind: str
    effects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", tuple(self.effects))
        if self.kind not in GOALS:
            near = difflib.get_close_matches(str(self.kind), GOALS, 1)
            advice = f"did you mean {near[0]}?" if near else f"choose {', '.join(GOALS)}"
            raise CampaignError(f"unknown goal {self.kind!r}", where="goal", advice=advice)
        asked = 2 if self.kind == "separate" else 0
        what = "separate takes two different effects, other goals none"
        right = len(set(self.effects)) == asked
        require(right, "goal", what, "write separate:effect_a,effect_b")

    @property
    def says(self) -> str:
        """Meaning of its number."""
        return GOALS[self.kind][0]

    @property
    def unit(self) -> str:
        """Unit of its number."""
        return GOALS[self.kind][1]

    def __str__(self) -> str:
        """As `parse_goal` reads it."""
        return f"{self.kind}:{','.join(self.effects)}" if self.effects else self.kind


def parse_goal(text: str | Goal) -> Goal:
    """A goal from its text.

    `text`: `cross_terms`, `inertia`, `scale_factors`, `correction_slew`, or
    `separate:effect_a,effect_b`. A goal is returned as it is.

    Examples
    --------
    >>> parse_goal("separate:wheel_friction,constant_torque").effects
    ('wheel_friction', 'constant_torque')
    >>> parse_goal("crossterms")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: goal: unknown goal 'crossterms'; did you mean cross_terms?
    """
    if isinstance(text, Goal):
        return text
    kind, _, effects = str(text).partition(":")
    return Goal(kind.strip(), tuple(name.strip() for name in effects.split(",") if name.strip()))


def require_goal(goal: Goal, n_base: int) -> None:
    """`CampaignError` where a spacecraft with `n_base` elements of J and K has no such number."""
    lacks = {"scale_factors": n_base == 6, "correction_slew": n_base != 9}
    if lacks.get(goal.kind, False):
        kind = "rate sensor" if goal.kind == "scale_factors" else "rate sensor of three axes"
        what = f"it is about a {kind}, which this spacecraft does not fly by"
        advice = "choose cross_terms, inertia or separate"
        raise CampaignError(what, where=f"goal {goal.kind}", advice=advice)


def criterion(
    goal: Goal,
    covariance: Array,
    theta: Array,
    prior_sd: Array,
    groups: Sequence[tuple[int, int]] = (),
    n_base: int = 9,
    *,
    smooth: bool = False,
) -> Array:
    """The goal's number for a covariance of the parameters; JAX can differentiate it.

    `covariance` (d, d); `theta` (d,); `prior_sd` (d,). `groups`: where the parameters of the goal's
    two effects stand: (first, behind the last) of each; `n_base`: numbers of J and K. `smooth`:
    whether the largest sd is replaced by a norm close to it, which has derivatives everywhere.

    Examples
    --------
    >>> covariance = jnp.diag(jnp.arange(9.0))
    >>> float(criterion(Goal("cross_terms"), covariance, jnp.ones(9), jnp.ones(9)))**2
    5.000...
    """
    if goal.kind in ("cross_terms", "scale_factors"):
        part = slice(3, 6) if goal.kind == "cross_terms" else slice(6, n_base)
        variances = jnp.diag(covariance)[part]
        return jnp.sqrt(_smooth_largest(variances) if smooth else jnp.max(variances))
    if goal.kind == "inertia":
        scale = prior_sd[:6]
        volume = jnp.linalg.slogdet(covariance[:6, :6] / scale / scale[:, None])[1]
        return jnp.exp((volume + 2.0 * jnp.sum(jnp.log(scale))) / 12.0)
    if goal.kind == "correction_slew":
        relative = covariance[6:9, 6:9] / theta[6:9] / theta[6:9, None]
        slopes = correction_sensitivity()
        return jnp.sqrt(jnp.einsum("aij,jk,aik->", slopes, relative, slopes) / len(slopes))
    size = 0.0
    for start, stop in groups:
        part = slice(start, stop)
        scaled = covariance[part, part] / prior_sd[part] / prior_sd[part, None]
        size = size + jnp.linalg.slogdet(scaled)[1] / (stop - start)
    return jnp.exp(0.25 * size)


def _smooth_largest(variances: Array) -> Array:
    """A norm close to the largest of variances (n,)."""
    top = jnp.max(variances)
    order = NUMERICS.norm_order
    return top * jnp.sum((variances / top) ** (order // 2)) ** (2.0 / order)


def correction_sensitivity() -> np.ndarray:
    """Sensitivity of the final attitude to relative errors of the scale factors.

    A controller that believes a scale factor e too large turns too fast by e about that axis. What
    it adds is turned on with the body: the integral of exp(-s [a]x) ds diag(a) over a slew of 60
    degrees about the axis a.

    Returns (13, 3, 3): rotation vector [rad] for relative errors of (K1, K2, K3), for slews about
    13 axes: the body axes and the diagonals between them.

    Examples
    --------
    >>> correction_sensitivity().shape
    (13, 3, 3)
    """
    turn = NUMERICS.corrected_turn
    axes = np.array([a for a in product((-1.0, 0.0, 1.0), repeat=3) if a > (0.0, 0.0, 0.0)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    out = []
    for a in axes:
        cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
        sine, versine = math.sin(turn), 1.0 - math.cos(turn)
        turned = turn * np.eye(3) - versine * cross + (turn - sine) * cross @ cross
        out.append(turned @ np.diag(a))
    return np.array(out)
