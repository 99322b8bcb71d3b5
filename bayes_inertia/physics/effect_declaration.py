"""What an effect declares of itself (class, name, parameters), checked before it acts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import BayesInertiaError, EffectError
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Parameter
from bayes_inertia.physics.stochastic_effect import StochasticEffect

_NOT_SI = {"deg", "arcsec", "arcmin", "rpm", "min", "h", "gauss"}


def require_of_effect(condition: bool, effect: Any, what: str, advice: str) -> None:
    """Raise unless a condition holds.

    Examples
    --------
    >>> require_of_effect(False, Effect(), "it does nothing", "override a hook")
    Traceback (most recent call last):
    bayes_inertia.errors.EffectError: no_effect: it does nothing; override a hook
    """
    if not condition:
        where = str(getattr(effect, "name", type(effect).__name__))
        raise EffectError(what, where=where, advice=advice)


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
        raise EffectError(
            f"{step_name} fails: {type(reason).__name__}: {first}",
            where=effect.name,
            advice="hooks must be plain jax.numpy with fixed shapes and no branches on values",
        ) from reason


def check_declaration(effect: Effect, campaign: Campaign) -> None:
    """Check what an effect declares, without calling its hooks.

    Examples
    --------
    >>> from bayes_inertia.physics.effects.constant_torque import ConstantTorque
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> check_declaration(ConstantTorque(), small_campaign())
    """
    _check_class(effect)
    parameters = guarded(effect, "parameters(campaign)", lambda: effect.parameters(campaign))
    good = (
        isinstance(parameters, tuple)
        and all(isinstance(p, Parameter) for p in parameters)
        and (len(parameters) > 0 or isinstance(effect, StochasticEffect))
    )
    require_of_effect(
        good,
        effect,
        "parameters(campaign) is not a non-empty tuple of Parameter",
        "return (scalar(...), vector(...))",
    )
    require_of_effect(
        parameters == effect.parameters(campaign),
        effect,
        "parameters(campaign) differs from call to call",
        "let it depend on fields and campaign only",
    )
    labels = [name for p in parameters for name in p.names]
    names = [p.name for p in parameters]
    doubled = sorted(
        {name for name in labels if labels.count(name) > 1}
        | {name for name in names if names.count(name) > 1}
    )
    require_of_effect(
        not doubled,
        effect,
        f"the parameter name {doubled[:1]} is used twice",
        "give each parameter and component its own name",
    )
    for parameter in parameters:
        _check_parameter(effect, parameter)


def _check_class(effect: Effect) -> None:
    require_of_effect(
        isinstance(effect, Effect),
        effect,
        "this is not an instance of Effect",
        "derive from bayes_inertia.physics.effect.Effect and pass an instance",
    )
    options = getattr(type(effect), "__dataclass_params__", None)
    frozen = dataclasses.is_dataclass(effect) and options is not None and options.frozen
    require_of_effect(
        frozen and "__dataclass_params__" in vars(type(effect)),
        effect,
        "the class is not a frozen dataclass",
        "decorate it with @dataclass(frozen=True)",
    )
    name = effect.kind if effect.device else effect.name
    named = isinstance(name, str) and name.isidentifier() and name != Effect.name
    require_of_effect(
        named,
        effect,
        f"{effect.name!r} is no name for an effect",
        "set the class attribute `name` to an identifier",
    )
    try:
        hash(effect)
    except TypeError as reason:
        raise EffectError(
            "the instance cannot be hashed",
            where=effect.name,
            advice="use numbers, strings and tuples as fields, not arrays or lists",
        ) from reason


def _check_parameter(effect: Effect, p: Parameter) -> None:
    require_of_effect(
        isinstance(p.unit, str),
        effect,
        f"{p.name} has no unit",
        'state it as text, "" for a pure number',
    )
    words = set(p.unit.replace("/", " ").replace("^", " ").split())
    require_of_effect(
        not words & _NOT_SI,
        effect,
        f"{p.name} is in {p.unit}, not in SI units and radians",
        "convert it",
    )
    require_of_effect(
        len(p.priors) == len(p.names),
        effect,
        f"{p.name} has {len(p.priors)} priors for {len(p.names)} components",
        "give one prior a component",
    )
    inside = all(prior.lower <= p.null <= prior.upper and np.isfinite(p.null) for prior in p.priors)
    require_of_effect(
        inside,
        effect,
        f"the null value {p.null} of {p.name} lies outside its prior",
        "a null must be a possible value",
    )
