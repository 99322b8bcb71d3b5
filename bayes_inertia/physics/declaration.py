"""What an effect declares of itself, held against the contract without calling its hooks."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.effect import Effect, guarded, has_hash, require_rule
from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC
from bayes_inertia.physics.parameters import Parameter
from bayes_inertia.physics.stochastic_effect import StochasticEffect

_NOT_SI = {"deg", "arcsec", "arcmin", "rpm", "min", "h", "gauss"}
_ENVIRONMENT = ("magnetic_field_N", "position_N")


def check_declaration(effect: Effect, campaign: Campaign, *, known: bool = False) -> None:
    """Check what an effect declares, without calling its hooks.

    `known`: whether it may act as it is, with nothing to fit.

    Examples
    --------
    >>> from bayes_inertia.physics.effects.constant_torque import ConstantTorque
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> check_declaration(ConstantTorque(), small_campaign())
    """
    _check_class(effect)
    parameters = guarded(effect, "parameters(campaign)", lambda: effect.parameters(campaign))
    some = isinstance(parameters, tuple) and all(isinstance(p, Parameter) for p in parameters)
    some = some and (known or len(parameters) > 0 or isinstance(effect, StochasticEffect))
    require_rule(some, effect, "parameters")
    require_rule(parameters == effect.parameters(campaign), effect, "same_parameters")
    names = Counter(p.name for p in parameters), Counter(n for p in parameters for n in p.names)
    doubled = sorted({name for count in names for name in count if count[name] > 1})
    require_rule(not doubled, effect, "names", doubled=doubled[:1])
    for parameter in parameters:
        _check_parameter(effect, parameter)


def require_own_name(effect: Effect, where: Any) -> None:
    """Raise where an effect has the name of one in the library; `where`: what it is called."""
    # The library's own class with other settings is no other effect.
    alike = next((e for e in (*LIBRARY, *STOCHASTIC) if e.name == effect.name), effect)
    require_rule(type(alike) is type(effect), where, "own_name", name=effect.name)


def _check_class(effect: Effect) -> None:
    require_rule(isinstance(effect, Effect), effect, "instance")
    options = vars(type(effect)).get("__dataclass_params__")
    require_rule(options is not None and options.frozen, effect, "frozen")
    name = effect.kind if effect.device else effect.name
    named = isinstance(name, str) and name.isidentifier() and name != Effect.name
    require_rule(named, effect, "identifier", name=effect.name)
    require_rule(has_hash(effect), effect, "hashable")
    require_own_name(effect, effect)
    unknown = [column for column in effect.needs if column not in _ENVIRONMENT]
    told = {"unknown": unknown[:1], "known": " and ".join(_ENVIRONMENT)}
    require_rule(not unknown, effect, "needs", **told)


def _check_parameter(effect: Effect, p: Parameter) -> None:
    require_rule(isinstance(p.unit, str), effect, "unit", name=p.name)
    words = set(p.unit.replace("/", " ").replace("^", " ").split())
    require_rule(not words & _NOT_SI, effect, "si", name=p.name, unit=p.unit)
    told = {"name": p.name, "priors": len(p.priors), "components": len(p.names), "null": p.null}
    require_rule(len(p.priors) == len(p.names), effect, "priors", **told)
    inside = all(prior.lower <= p.null <= prior.upper and np.isfinite(p.null) for prior in p.priors)
    require_rule(inside, effect, "possible_null", **told)
