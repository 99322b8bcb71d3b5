"""The Effect contract: one physical effect, its parameters, and the few places where it acts.

An effect is one frozen dataclass that overrides only the hooks it needs. Hooks are pure
functions written for ONE slew and ONE parameter vector in plain `jax.numpy`; the package makes
batches with `jax.vmap`, so no hook ever handles batch axes. A model is given its effects as
instances: nothing is registered anywhere, and an effect of your own needs no edit here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial, wraps
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import BayesInertiaError, EffectError, kind_of, require
from bayes_inertia.files import vocabulary
from bayes_inertia.physics.parameters import Parameter
from bayes_inertia.physics.slew_context import SlewContext, State, Trajectory
from bayes_inertia.physics.slew_input import InputRows

# The parameters of one effect by name, each () or (components,).
Values = Mapping[str, Array]

# Hooks that make more than the attitude change during a slew.
MOVING_HOOKS = (
    "wheel_torque",
    "body_torque",
    "initial_state",
    "internal_momentum",
    "carried_momentum",
)
# Hooks that decide how the body and its wheels move: all that the simulator calls.
BODY_HOOKS = (
    "inertia",
    "wheel_axes",
    "delivered_torque",
    "delivered_inputs",
    *MOVING_HOOKS,
    "state_rate",
)
# Hooks that do nothing without wheels.
WHEEL_HOOKS = frozenset({"wheel_axes", "delivered_torque", "wheel_torque", "momentum_output"})
# Hooks that are given the whole slew, and may look between its rows.
LOOKING_BACK = ("rate_output", "attitude_output", "momentum_output", "direction_output")


@dataclass(frozen=True)
class Effect:
    """Base of all effects: every hook is "no change".

    An effect is a frozen dataclass; its fields are its settings, such as the sd of its prior. The
    class attribute `name` is its canonical name, also the prefix of its parameters in results.
    `needs` names the environment columns without which it cannot act ("magnetic_field_N",
    "position_N"), `inputs` the streams of `Slew.inputs` that its hooks look up.

    All hooks take the effect's parameters `p` ({name: array}, shape () or (components,)) and the
    `SlewContext` of the slew. They return what they were given, changed.

    Parameters
    ----------
    prior_scale : float, optional
        What the sds of its Gaussian priors are multiplied by in a `Model`: above 1 where data
        contradict them. Priors of shapes and of random sizes, log-normal, stay as they are.
    device : str, optional
        The sensor or actuator it acts on, where `kind` says what is wrong with it: its name then
        is "kind[device]". Empty: the first sensor of its kind.

    Examples
    --------
    >>> Effect().parameters(None)
    ()
    """

    name: ClassVar[str] = "no_effect"
    needs: ClassVar[tuple[str, ...]] = ()
    inputs: ClassVar[tuple[str, ...]] = ()
    kind: ClassVar[str] = ""
    prior_scale: float = field(default=1.0, kw_only=True)
    device: str = field(default="", kw_only=True)

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for hook in (*BODY_HOOKS, *LOOKING_BACK):
            given = vars(cls).get(hook)
            if hasattr(given, "__get__"):
                setattr(cls, hook, _guarded_hook(hook, given))

    def __post_init__(self) -> None:
        if self.kind and self.device:
            object.__setattr__(self, "name", f"{self.kind}[{self.device}]")

    def in_campaign(self, campaign: Campaign) -> Effect:
        """The effect as it acts in a campaign.

        Parameters
        ----------
        campaign : Campaign
            Tells what its device is, where it was named by kind and device alone.

        Returns
        -------
        Effect
            An effect of the same name.

        Examples
        --------
        >>> Effect().in_campaign(None) == Effect()
        True
        """
        return self

    def parameters(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """The effect's parameters.

        Parameters
        ----------
        campaign : Campaign
            Tells how many wheels there are, and the scales of default priors.

        Returns
        -------
        tuple of Parameter
            Each with unit, prior and null value.
        """
        return ()

    def max_step(self, campaign: Campaign) -> float | None:
        """The longest integration step that resolves the effect.

        Integration steps span several rows of telemetry where the motion allows it.

        Parameters
        ----------
        campaign : Campaign
            Where it acts.

        Returns
        -------
        float or None
            The step [s]; None if the telemetry's own step is short enough; infinity if the step
            that resolves the motion resolves the effect, because it changes no faster than
            attitude and rate do.
        """
        return None

    def looks_between_rows(self, campaign: Campaign) -> bool:
        """Whether a sensor hook looks at more than the row that it is asked for.

        Such hooks are given a grid on which straight lines follow the motion.

        Parameters
        ----------
        campaign : Campaign
            Where it acts.

        Returns
        -------
        bool
            False spares the finer grid: what is read in a row depends on that row alone, or is
            interpolated as smoothly as the body moves.
        """
        return True

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
        """Whether this effect changes anything in a hook; the simulator leaves out the others.

        Parameters
        ----------
        hook : str
            Name of the hook.

        Returns
        -------
        bool
            True if the effect's class overrides it.

        Examples
        --------
        >>> Effect().acts("body_torque")
        False
        """
        return getattr(type(self), hook) is not getattr(Effect, hook)

    # --- before the slew ---------------------------------------------------------------------
    def inertia(self, p: Values, slew: SlewContext, inertia_B: Array) -> Array:
        """The inertia tensor during this slew.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        inertia_B : (3, 3) array
            J of everything except the wheels' spin [kg m^2].

        Returns
        -------
        (3, 3) array
            The same, changed [kg m^2].
        """
        return inertia_B

    def wheel_axes(self, p: Values, slew: SlewContext, axes_B: Array) -> Array:
        """The wheels' spin axes.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        axes_B : (3, wheels) array
            Unit spin axes as columns, body frame.

        Returns
        -------
        (3, wheels) array
            The same, changed.
        """
        return axes_B

    def delivered_torque(self, p: Values, slew: SlewContext, torque: Array) -> Array:
        """The torque that the motors deliver for the commanded one.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        torque : (n, wheels) array
            Motor torque on the wheels, mean over each grid interval [N m].

        Returns
        -------
        (n, wheels) array
            The same, changed [N m].
        """
        return torque

    def delivered_inputs(
        self, p: Values, slew: SlewContext, inputs: Mapping[str, InputRows]
    ) -> Mapping[str, InputRows]:
        """What devices do for what they were told.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        inputs : mapping of str to InputRows
            By the names of `Slew.inputs`: a straight line over each grid interval.

        Returns
        -------
        mapping of str to InputRows
            The same, changed.
        """
        return inputs

    # --- in the equations of motion ------------------------------------------------------------
    def wheel_torque(self, p: Values, slew: SlewContext, t: Array, state: State) -> Array:
        """Further torque between body and wheels (friction).

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        t : () array
            Time from the slew's own zero [s].
        state : State
            The state at that instant.

        Returns
        -------
        (wheels,) array
            Counted ON THE WHEEL [N m].
        """
        return jnp.zeros_like(state.wheel_momentum)

    def body_torque(self, p: Values, slew: SlewContext, t: Array, state: State) -> Array:
        """External torque on the spacecraft.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        t : () array
            Time from the slew's own zero [s].
        state : State
            The state at that instant.

        Returns
        -------
        (3,) array
            Body frame [N m].
        """
        return jnp.zeros(3)

    # --- own states (flexible mode, slosh) -------------------------------------------------------
    def initial_state(self, p: Values, slew: SlewContext, rate_B: Array) -> Array:
        """The effect's own states at the slew's first row.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        rate_B : (3,) array
            Body rate there [rad/s].

        Returns
        -------
        (k,) array
            The states; (0,) if it has none.
        """
        return jnp.zeros(0)

    def state_rate(self, p: Values, slew: SlewContext, t: Array, state: State) -> Array:
        """Time derivative of the own states.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        t : () array
            Time from the slew's own zero [s].
        state : State
            The state at that instant.

        Returns
        -------
        (k,) array
            Change of each state per second.
        """
        return jnp.zeros_like(state.effect_states)

    def internal_momentum(self, p: Values, slew: SlewContext, effect_states: Array) -> Array:
        """Angular momentum that the effect's own states carry beyond J w + G H.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        effect_states : (k,) array
            Their values at one instant.

        Returns
        -------
        (3,) array
            Body frame [N m s].
        """
        return jnp.zeros(3)

    def carried_momentum(
        self, p: Values, slew: SlewContext, t: Array, inputs: Mapping[str, Array]
    ) -> Array:
        """Angular momentum that a device carries, known from its input (gimballed rotors).

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        t : () array
            Time from the slew's own zero [s].
        inputs : mapping of str to (k,) array
            What the devices in `inputs` do at that instant.

        Returns
        -------
        (3,) array
            Body frame [N m s].
        """
        return jnp.zeros(3)

    # --- sensors: whole slews at once, so that delays can look back ----------------------------
    def rate_output(
        self, p: Values, slew: SlewContext, trajectory: Trajectory, rate_S: Array
    ) -> Array:
        """The rate sensor's signal before the scale factors.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        trajectory : Trajectory
            The simulated slew, with the effect's own states.
        rate_S : (n, 3) array
            C_rate w + b in sensor axes [rad/s].

        Returns
        -------
        (n, 3) array
            The same, changed [rad/s].
        """
        return rate_S

    def attitude_output(
        self, p: Values, slew: SlewContext, trajectory: Trajectory, attitude: Array
    ) -> Array:
        """What the star tracker sees.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        trajectory : Trajectory
            The simulated slew, with the effect's own states.
        attitude : (n, 4) array
            Quaternions, body from inertial.

        Returns
        -------
        (n, 4) array
            The same, changed.
        """
        return attitude

    def direction_output(
        self, p: Values, slew: SlewContext, trajectory: Trajectory, seen_B: Array
    ) -> Array:
        """What a sensor of directions or of a field sees, before its own offset and scale.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        trajectory : Trajectory
            The simulated slew, with the effect's own states.
        seen_B : (n, 3) array
            The vector in body axes: of length 1, or a field [T].

        Returns
        -------
        (n, 3) array
            The same, changed.
        """
        return seen_B

    def momentum_output(
        self, p: Values, slew: SlewContext, trajectory: Trajectory, momentum: Array
    ) -> Array:
        """What the tachometers see.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters.
        slew : SlewContext
            The slew it acts in.
        trajectory : Trajectory
            The simulated slew, with the effect's own states.
        momentum : (n, wheels) array
            Wheel momentum relative to the body [N m s].

        Returns
        -------
        (n, wheels) array
            The same, changed [N m s].
        """
        return momentum


@dataclass(frozen=True)
class RowByRow(Effect):
    """Base of errors of a sensor that depend on nothing but the row that is asked for."""

    def looks_between_rows(self, campaign):
        return False


@dataclass(frozen=True)
class SmoothTorque(Effect):
    """Base of torques that change no faster than the body turns: any step resolves them."""

    def max_step(self, campaign):
        return math.inf


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
    >>> from bayes_inertia.physics.effects.constant_torque import ConstantTorque
    >>> active = ActiveEffects((ConstantTorque(),), {"constant_torque": {"torque": 1e-5}})
    >>> [parameters["torque"] for _, parameters in active]
    [1e-05]
    """

    effects: tuple[Effect, ...] = field(default=(), metadata={"static": True})
    values: Mapping[str, Values] = field(default_factory=dict)

    def of(self, effect: Effect) -> Values:
        """The parameters of one effect.

        Returns: {parameter's name: array}; empty for an effect without parameters.

        Examples
        --------
        >>> ActiveEffects().of(Effect())
        {}
        """
        return self.values.get(effect.name, {})

    def __iter__(self) -> Iterator[tuple[Effect, Values]]:
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


def shaped(effect: Effect, hook: str, given: Any, like: Array) -> Array:
    """What a hook returned, or `EffectError` where its shape is not that of its kind.

    Of a single number all axes would take the same.

    >>> shaped(Effect(), "body_torque", 0.1, jnp.zeros(3))
    Traceback (most recent call last):
    bayes_inertia.errors.EffectError: no_effect: body_torque returned a float, not an array ...
    """
    own = jnp.shape(given) if hasattr(given, "shape") else kind_of(given)
    told = {"hook": hook, "own": own, "like": like.shape}
    require_rule(own == like.shape, effect, "hook_shape", **told)
    return given


def require_effects(given: Any) -> tuple[Effect, ...]:
    """Effects as a tuple, or `EffectError` for what is no instance of one, or has no hash.

    >>> require_effects(["magnetic_dipole"])
    Traceback (most recent call last):
    bayes_inertia.errors.EffectError: effects: 'magnetic_dipole' is no effect; ...
    """
    listed = isinstance(given, Iterable) and not isinstance(given, str)
    effects = tuple(given) if listed else (given,)
    for effect in effects:
        advice = "give instances in a list, such as those of bayes_inertia.LIBRARY"
        if not (listed and isinstance(effect, Effect)):
            what = f"{effect!r} is no {'effect' if listed else 'list of effects'}"
            raise EffectError(what, where="effects", advice=advice)
        require_rule(has_hash(effect), effect, "hashable")
    return effects


def has_hash(effect: Effect) -> bool:
    """Whether compiled code can be kept for an effect."""
    try:
        hash(effect)
    except TypeError:
        return False
    return True


def require_of_effect(condition: bool, effect: Any, what: str, advice: str) -> None:
    """Raise unless a condition holds; `effect`: an effect, or what it is called.

    Examples
    --------
    >>> require_of_effect(False, Effect(), "it does nothing", "override a hook")
    Traceback (most recent call last):
    bayes_inertia.errors.EffectError: no_effect: it does nothing; override a hook
    """
    require(condition, _place(effect), what, advice, error=EffectError)


def require_rule(condition: bool, effect: Any, rule: str, /, **told: Any) -> None:
    """Raise unless a rule of the contract is kept; `told`: what its words leave open.

    >>> require_rule(False, Effect(), "unit", name="tau")
    Traceback (most recent call last):
    bayes_inertia.errors.EffectError: no_effect: tau has no unit; state it as text, "" for a ...
    """
    if not condition:
        raise broken(effect, rule, **told)


def broken(effect: Any, rule: str, /, **told: Any) -> EffectError:
    """The error of an effect, or of what it is called, that breaks a rule of the contract."""
    what, advice = (text.format(**told) for text in vocabulary("physics")["contract"][rule])
    return EffectError(what, where=_place(effect), advice=advice)


def _place(effect: Any) -> str:
    """An effect as messages call it."""
    named = isinstance(effect, str | Path)
    return str(effect if named else getattr(effect, "name", type(effect).__name__))


def _guarded_hook(hook: str, given: Any) -> Callable[..., Any]:
    """A hook; whatever goes wrong in it becomes an `EffectError` that names effect and hook."""

    @wraps(given)
    def called(self: Effect, *args: Any, **kwargs: Any) -> Any:
        bound = given.__get__(self, type(self))
        return guarded(self, hook, partial(bound, *args, **kwargs))

    return called


def guarded(effect: Effect, step_name: str, call: Callable[[], Any]) -> Any:
    """The result of a call; whatever goes wrong in it becomes an `EffectError` that says where.

    Examples
    --------
    >>> guarded(Effect(), "adding", lambda: 1 + 1)
    2
    """
    try:
        return call()
    except EffectError:
        raise
    except BayesInertiaError as reason:
        where = ", ".join((effect.name, step_name, *filter(None, [reason.where])))
        raise EffectError(reason.what, where=where, advice=reason.advice) from reason
    except Exception as reason:
        first = (str(reason).strip() or type(reason).__name__).splitlines()[0]
        what = f"{step_name} fails: {type(reason).__name__}: {first}"
        advice = "hooks must be plain jax.numpy with fixed shapes and no branches on values"
        raise EffectError(what, where=effect.name, advice=advice) from reason
