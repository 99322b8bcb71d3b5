"""An inertia tensor that changes once during the campaign."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp

from bayes_inertia.maths.inertia_tensor import ELEMENTS, tensor
from bayes_inertia.physics.effect import Effect, require_of_effect
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class InertiaChange(Effect):
    """From one slew on the tensor is J + change; J is what it was before.

    A deployment, fuel used, an antenna moved.

    A campaign of one slew cannot show it.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd of each element [kg m^2]; None takes 3 % of the mean moment of inertia.
    from_slew : int or None, optional
        Number of the first slew with the new tensor, counted from 0; None takes the last half
        of the campaign.

    Raises
    ------
    EffectError
        If a campaign has no slew of this number.

    Examples
    --------
    >>> InertiaChange(sigma=0.1).parameters(None)[0].names[:2]
    ('change_Jxx', 'change_Jyy')
    """

    name = "inertia_change"
    sigma: float | None = None
    from_slew: int | None = None

    def in_campaign(self, campaign):
        known = self.from_slew is None or self.from_slew in range(len(campaign.slews))
        what, advice = f"there is no slew {self.from_slew!r}", "count slews from 0"
        require_of_effect(known, self, what, advice)
        return self

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else 0.03 * campaign.scale_of_motion()[2]
        return (vector("change", ELEMENTS, unit="kg m^2", prior=Normal(0.0, sigma)),)

    def afterwards(self):
        return replace(self, from_slew=0)

    def inertia(self, p, slew, inertia_B):
        first = (slew.slews + 1) // 2 if self.from_slew is None else self.from_slew
        return inertia_B + jnp.where(slew.index >= first, 1.0, 0.0) * tensor(p["change"])
