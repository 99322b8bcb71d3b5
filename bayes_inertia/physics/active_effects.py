"""The effects that act, together with the values of their parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import jax
from jax import Array

from bayes_inertia.physics.effect import Effect


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ActiveEffects:
    """Effects and the values of their parameters, which always travel together.

    A pytree: `effects` belong to the compiled code, the arrays in `values` are its leaves.

    Parameters
    ----------
    effects : tuple of Effect, optional
        What acts, in the order in which their hooks are called.
    values : mapping of str to mapping of str to Array, optional
        {effect's name: {parameter's name: array}}, in the units of the parameters.

    Examples
    --------
    >>> from bayes_inertia.physics.effects.body_torques import ConstantTorque
    >>> active = ActiveEffects((ConstantTorque(),), {"constant_torque": {"torque": 1e-5}})
    >>> [parameters["torque"] for _, parameters in active]
    [1e-05]
    """

    effects: tuple[Effect, ...] = field(default=(), metadata={"static": True})
    values: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)

    def of(self, effect: Effect) -> Mapping[str, Array]:
        """The parameters of one effect.

        Returns: {parameter's name: array}; empty for an effect without parameters.

        Examples
        --------
        >>> ActiveEffects().of(Effect())
        {}
        """
        return self.values.get(effect.name, {})

    def __iter__(self) -> Iterator[tuple[Effect, Mapping[str, Array]]]:
        return ((effect, self.of(effect)) for effect in self.effects)

    def __len__(self) -> int:
        return len(self.effects)

    def act(self, *hooks: str) -> bool:
        """Whether any of the effects changes anything in one of these hooks.

        Returns: true if one of the effects overrides one of the hooks.

        Examples
        --------
        >>> ActiveEffects().act("body_torque", "wheel_torque")
        False
        """
        return any(effect.acts(hook) for effect in self.effects for hook in hooks)
