"""Any effect, with parameters of its own in every slew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import jax.numpy as jnp
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.effect import BODY_HOOKS, LOOKING_BACK, Effect, require_of_effect
from bayes_inertia.physics.parameters import Parameter
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.stochastic_effect import StochasticEffect


def _as_its_inner(cls: Any) -> Any:
    """Let a class be as its inner effect is; hooks have the parameters of this slew."""

    def forwarded(hook: str) -> Any:
        def call(self: EachSlew, p: Mapping[str, Array], slew: SlewContext, *rest: Any) -> Any:
            of_slew = {name: self._of_slew(name, value, slew) for name, value in p.items()}
            return getattr(self.inner, hook)(of_slew, slew, *rest)

        return call

    for hook in (*BODY_HOOKS, *LOOKING_BACK):
        setattr(cls, hook, forwarded(hook))
    for key in ("name", "needs", "inputs"):
        setattr(cls, key, property(attrgetter(f"inner.{key}")))
    for key in ("afterwards", "acts", "max_step", "looks_between_rows"):
        setattr(cls, key, lambda self, *given, key=key: getattr(self.inner, key)(*given))
    return cls


@_as_its_inner
@dataclass(frozen=True)
class EachSlew(Effect):
    """An effect that differs from slew to slew.

    A torque that depends on the weather, or a sensor that was bumped in between.

    Its parameters are those of `inner` once for every slew, each with inner's prior, so that
    one slew tells nothing of the next. What is found to need this may be real, or may be a
    shared cause that the inner effect describes badly. Make it with `EachSlew.of`.

    Of a slew after the campaign only the prior is known. `afterwards` therefore is the inner
    effect as it is then, with parameters to be drawn from its prior. The hooks themselves do
    nothing in a slew whose number is not one of the campaign's.

    Parameters
    ----------
    inner : Effect
        The effect that differs from slew to slew.
    slews : int
        Number of slews of the campaign.
    scalars : tuple of str, optional
        Names of inner's parameters without components.
    nulls : tuple of (str, float), optional
        Name and null value of each of inner's parameters, in the parameter's unit.
    """

    inner: Effect
    slews: int
    scalars: tuple[str, ...] = ()
    nulls: tuple[tuple[str, float], ...] = ()

    @classmethod
    def of(cls, inner: Effect, campaign: Campaign) -> EachSlew:
        """`inner`, different in each slew of a campaign.

        Returns: the effect to give to a `Model` of this campaign.

        Examples
        --------
        >>> from bayes_inertia.physics.effects.wheel_command_lag import WheelCommandLag
        >>> from bayes_inertia.physics.small_campaign import small_campaign
        >>> campaign = small_campaign()
        >>> EachSlew.of(WheelCommandLag(), campaign).parameters(campaign)[0].names[:2]
        ('tau_1', 'tau_2')
        """
        inner = inner.in_campaign(campaign)
        what = "has other coefficients in each slew anyway"
        require_of_effect(not isinstance(inner, StochasticEffect), inner, what, "give it as it is")
        parameters = inner.parameters(campaign)
        scalars = tuple(p.name for p in parameters if not p.components)
        nulls = tuple((p.name, p.null) for p in parameters)
        count, scale = len(campaign.slews), inner.prior_scale
        return cls(inner, count, scalars, nulls, device=inner.device, prior_scale=scale)

    def parameters(self, campaign):
        return tuple(self._repeated(p) for p in self.inner.parameters(campaign))

    def _repeated(self, p: Parameter) -> Parameter:
        labels = tuple(
            "_".join(filter(None, (str(k + 1), c)))
            for k in range(self.slews)
            for c in (p.components or ("",))
        )
        return Parameter(p.name, p.unit, p.priors * self.slews, p.null, labels)

    def _of_slew(self, name: str, values: Array, slew: SlewContext) -> Array:
        """One parameter in this slew; its null in a slew that the campaign does not have."""
        rows = jnp.reshape(values, (self.slews, -1))
        row = rows.at[slew.index].get(mode="fill", fill_value=dict(self.nulls).get(name, 0.0))
        return row[0] if name in self.scalars else row
