"""A change of the inertia tensor that the campaign dates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp

from bayes_inertia.campaign.actuators import Change
from bayes_inertia.maths.inertia_tensor import ELEMENTS, tensor
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class StatedChange(Effect):
    """In the slews that start after it the tensor is J + change.

    Parameters
    ----------
    change : Change
        As the campaign states it.
    after : tuple of bool
        Whether each slew of the campaign is one of them.
    """

    change: Change
    after: tuple[bool, ...]

    @property
    def name(self) -> str:  # type: ignore[override]
        """The change's name."""
        return self.change.name

    def parameters(self, campaign):
        sigma = self.change.sigma_fraction * campaign.scale_of_motion()[2]
        return (vector("change", ELEMENTS, unit="kg m^2", prior=Normal(0.0, sigma)),)

    def afterwards(self):
        return replace(self, after=(True,))

    def inertia(self, p, slew, inertia_B):
        changed = jnp.asarray(self.after, dtype=float)[slew.index]
        return inertia_B + changed * tensor(p["change"])
