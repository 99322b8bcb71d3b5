"""The Effect contract: one physical effect, its parameters, and the few places where it acts.

An effect is one frozen dataclass that overrides only the hooks it needs. Hooks are pure
functions written for ONE slew and ONE parameter vector in plain `jax.numpy`; the package makes
batches with `jax.vmap`, so no hook ever handles batch axes. A model is given its effects as
instances: nothing is registered anywhere, and an effect of your own needs no edit here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax.numpy as jnp
from jax import Array

from bayes_inertia.physics.parameters import Parameter

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bayes_inertia.campaign.campaign import Campaign


class SlewContext(NamedTuple):
    """What an effect may know about the slew it acts in (arrays on the integration grid of n points).

    `index` is the slew's number in the campaign, `slews` how many the campaign has, `start` its first row in
    the campaign [s], `middle` the middle of the whole campaign on that clock [s], `time` (n,) [s] from the
    slew's own zero, `step` (n,) [s] to the next grid point (0 in padding), `torque` (n, wheels) the commanded
    motor torque on the wheels [N m], `wheel_axes_B` (3, wheels), `spin_inertia` (wheels,) [kg m^2],
    `boresight_B` (3,), `rate_axes` (3, 3) the rate sensor's C_rate, one row a sensor axis.
    """

    index: Array
    slews: Array
    start: Array
    middle: Array
    time: Array
    step: Array
    torque: Array
    wheel_axes_B: Array
    spin_inertia: Array
    boresight_B: Array
    rate_axes: Array


class State(NamedTuple):
    """The state at one instant: `attitude` (4,), `rate_B` (3,) [rad/s], `wheel_momentum` (wheels,) relative
    to the body [N m s], `own` (k,) the effect's own states, `inertia_B` (3, 3) [kg m^2] of everything, wheels included
    (J_locked), as it is in this slew, `magnetic_field_N` (3,) [T], `position_N` (3,) [m]."""

    attitude: Array
    rate_B: Array
    wheel_momentum: Array
    own: Array
    inertia_B: Array
    magnetic_field_N: Array
    position_N: Array


class Trajectory(NamedTuple):
    """The simulated slew on the integration grid: `time` (n,), `attitude` (n, 4), `rate_B` (n, 3),
    `wheel_momentum` (n, wheels) relative to the body, `own` (n, k) the effect's own states."""

    time: Array
    attitude: Array
    rate_B: Array
    wheel_momentum: Array
    own: Array


@dataclass(frozen=True)
class Effect:
    """Base of all effects: every hook is "no change".

    Class attributes
    ----------------
    name : canonical name, also the prefix of the parameters in results.
    needs : environment columns without which the effect cannot act ("magnetic_field_N", "position_N").

    >>> Effect().parameters(None)
    ()
    """

    name: ClassVar[str] = "no_effect"
    needs: ClassVar[tuple[str, ...]] = ()

    def parameters(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """The effect's parameters for this campaign (how many wheels, which scales)."""
        return ()

    def max_step(self, campaign: Campaign) -> float | None:
        """Longest integration step that resolves the effect [s]; None if the telemetry's own step does."""
        return None

    def afterwards(self) -> Effect:
        """The effect as it is in slews flown after the campaign.

        Itself, unless it changes from slew to slew. Where the parameters of what is returned are
        those of the effect itself, their values are those that the campaign told; where they are
        not, only their prior is known.

        Returns
        -------
        Effect
            An effect of the same name.

        Examples
        --------
        >>> Effect().afterwards() == Effect()
        True
        """
        return self

    def acts(self, hook: str) -> bool:
        """Whether this effect changes anything in a hook: the simulator leaves out what nobody uses.

        >>> Effect().acts("body_torque")
        False
        """
        return getattr(type(self), hook) is not getattr(Effect, hook)

    # --- before the slew ---------------------------------------------------------------------
    def inertia(self, p: Mapping[str, Array], slew: SlewContext, inertia_B: Array) -> Array:
        """Inertia tensor (3, 3) of everything except the wheels' spin [kg m^2] during this slew."""
        return inertia_B

    def wheel_axes(self, p: Mapping[str, Array], slew: SlewContext, axes_B: Array) -> Array:
        """Spin axes (3, wheels) in body axes."""
        return axes_B

    def delivered_torque(self, p: Mapping[str, Array], slew: SlewContext, torque: Array) -> Array:
        """Motor torque on the wheels (n, wheels) [N m], mean over each grid interval, for the commanded one."""
        return torque

    # --- in the equations of motion ------------------------------------------------------------
    def wheel_torque(
        self, p: Mapping[str, Array], slew: SlewContext, t: Array, state: State
    ) -> Array:
        """Further torque between body and wheels, counted ON THE WHEEL (wheels,) [N m] (friction)."""
        return jnp.zeros_like(state.wheel_momentum)

    def body_torque(
        self, p: Mapping[str, Array], slew: SlewContext, t: Array, state: State
    ) -> Array:
        """External torque on the spacecraft (3,) [N m], body axes."""
        return jnp.zeros(3)

    # --- own states (flexible mode, slosh) -------------------------------------------------------
    def initial_state(self, p: Mapping[str, Array], slew: SlewContext, rate_B: Array) -> Array:
        """The effect's own states (k,) at the slew's first row, where the body turns at `rate_B` (3,); (0,) if it has none."""
        return jnp.zeros(0)

    def state_rate(
        self, p: Mapping[str, Array], slew: SlewContext, t: Array, state: State
    ) -> Array:
        """Time derivative (k,) of the own states."""
        return jnp.zeros_like(state.own)

    def internal_momentum(self, p: Mapping[str, Array], slew: SlewContext, own: Array) -> Array:
        """Angular momentum (3,) [N m s], body axes, carried by the own states beyond J w + G H."""
        return jnp.zeros(3)

    # --- sensors: whole slews at once, so that delays can look back --------------------------------
    def rate_output(
        self, p: Mapping[str, Array], slew: SlewContext, trajectory: Trajectory, rate_S: Array
    ) -> Array:
        """Rate-sensor signal (n, 3) [rad/s] in sensor axes before the scale factors: C_rate w + b and what is added."""
        return rate_S

    def attitude_output(
        self, p: Mapping[str, Array], slew: SlewContext, trajectory: Trajectory, attitude: Array
    ) -> Array:
        """Star-tracker quaternion (n, 4)."""
        return attitude

    def momentum_output(
        self, p: Mapping[str, Array], slew: SlewContext, trajectory: Trajectory, momentum: Array
    ) -> Array:
        """Tachometer momentum (n, wheels) [N m s] relative to the body."""
        return momentum
