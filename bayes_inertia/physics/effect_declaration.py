"""What an effect declares of itself (class, name, parameters), checked before it acts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import BayesInertiaError, EffectError
from bayes_inertia.physics.effect import Effect, has_hash, require_of_effect
from bayes_inertia.physics.parameters import Parameter
from bayes_inertia.physics.stochastic_effect import StochasticEffect

_NOT_SI = {"deg", "arcsec", "arcmin", "rpm", "min", "h", "gauss"}


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
    for good, what, advice in _declared(effect, campaign):
        require_of_effect(good, effect, what, advice)


# Whether all is well, what is wrong, what to do: asked one after the other, for what comes later
# relies on what was before.
_Checks = Iterator[tuple[bool, str, str]]


def _declared(effect: Effect, campaign: Campaign) -> _Checks:
    """Checks of a class, then of its parameters."""
    yield from _of_class(effect)
    parameters = guarded(effect, "parameters(campaign)", lambda: effect.parameters(campaign))
    some = isinstance(parameters, tuple) and all(isinstance(p, Parameter) for p in parameters)
    some = some and (len(parameters) > 0 or isinstance(effect, StochasticEffect))
    what = "parameters(campaign) is not a non-empty tuple of Parameter"
    yield some, what, "return (scalar(...), vector(...))"
    what = "parameters(campaign) differs from call to call"
    same = parameters == effect.parameters(campaign)
    yield same, what, "let it depend on fields and campaign only"
    names = Counter(p.name for p in parameters), Counter(n for p in parameters for n in p.names)
    doubled = sorted({name for count in names for name in count if count[name] > 1})
    what = f"the parameter name {doubled[:1]} is used twice"
    yield not doubled, what, "give each parameter and component its own name"
    for parameter in parameters:
        yield from _of_parameter(parameter)


def _of_class(effect: Effect) -> _Checks:
    advice = "derive from bayes_inertia.physics.effect.Effect and pass an instance"
    yield isinstance(effect, Effect), "this is not an instance of Effect", advice
    options = vars(type(effect)).get("__dataclass_params__")
    frozen = options is not None and options.frozen
    advice = "decorate it with @dataclass(frozen=True)"
    yield frozen, "the class is not a frozen dataclass", advice
    name = effect.kind if effect.device else effect.name
    named = isinstance(name, str) and name.isidentifier() and name != Effect.name
    advice = "set the class attribute `name` to an identifier"
    yield named, f"{effect.name!r} is no name for an effect", advice
    advice = "use numbers, strings and tuples as fields, not arrays or lists"
    yield has_hash(effect), "the instance cannot be hashed", advice


def _of_parameter(p: Parameter) -> _Checks:
    advice = 'state it as text, "" for a pure number'
    yield isinstance(p.unit, str), f"{p.name} has no unit", advice
    words = set(p.unit.replace("/", " ").replace("^", " ").split())
    si = not words & _NOT_SI
    yield si, f"{p.name} is in {p.unit}, not in SI units and radians", "convert it"
    what = f"{p.name} has {len(p.priors)} priors for {len(p.names)} components"
    yield len(p.priors) == len(p.names), what, "give one prior a component"
    inside = all(prior.lower <= p.null <= prior.upper and np.isfinite(p.null) for prior in p.priors)
    what = f"the null value {p.null} of {p.name} lies outside its prior"
    yield inside, what, "a null must be a possible value"
