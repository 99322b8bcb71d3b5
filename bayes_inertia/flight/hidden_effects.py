"""Effects that act in a simulated flight and that its campaign does not mention, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import EffectError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.named_effects import effects_named, pinned_names
from bayes_inertia.physics.parameters import ParameterSpace


def with_hidden_effects(mission: Mission, plan: Plan, hidden: Sequence[str], seed: int) -> Mission:
    """A mission in which further effects act.

    `plan`: what will be flown; it sets the scale of default priors. `hidden`: each is `name`
    (parameters drawn from their priors) or `name.parameter=value[,value...]` (parameters not named
    are at their null). Returns: the same prior; its spacecraft has the effects beside its own.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> names = ["wheel_command_lag.tau=0.1"]
    >>> hiding = with_hidden_effects(most_like_mission(), paper_like_plan(), names, 0)
    >>> hiding.spacecraft.values["wheel_command_lag"]["tau"].item()
    0.1
    """
    if not hidden:
        return mission
    template = planned_campaign(plan, mission)
    effects, values = _hidden_effects(hidden, template, np.random.default_rng([seed, 2]))
    craft = mission.spacecraft
    craft = replace(craft, effects=(*craft.effects, *effects), values={**craft.values, **values})
    return replace(mission, spacecraft=craft)


def parameter_space(effect: Effect, template: Campaign) -> ParameterSpace:
    """The parameters of one effect.

    `template`: whose hardware and slews set the scale of default priors.
    """
    return ParameterSpace(tuple((effect.name, p) for p in effect.parameters(template)))


@dataclass(frozen=True)
class _Request:
    """A request like `wheel_command_lag.tau=0.12`; without `parameter` the effect is drawn."""

    effect: str
    parameter: str
    value: str

    @classmethod
    def parsed(cls, text: str) -> _Request:
        key, _, value = text.partition("=")
        # An effect from outside is called `FILE.py:Class` or `package.module:Class`.
        source, colon, rest = key.rpartition(":")
        effect, _, parameter = rest.partition(".")
        return cls(f"{source}{colon}{effect}", parameter, value)


def _hidden_effects(
    texts: Sequence[str], template: Campaign, rng: np.random.Generator
) -> tuple[tuple[Effect, ...], dict[str, dict[str, Any]]]:
    """Effects and values that requests name."""
    requests = [_Request.parsed(text) for text in texts]
    names = tuple(dict.fromkeys(request.effect for request in requests))
    effects = effects_named(pinned_names(names))
    values: dict[str, dict[str, Any]] = {}
    for name, effect in zip(names, effects, strict=True):
        space = parameter_space(effect, template)
        settings = [r for r in requests if r.effect == name and r.parameter]
        flat = space.nulls if settings else space.draw(rng, 1)[0]
        by_parameter = {
            k: np.asarray(v) for k, v in space.split(jnp.asarray(flat))[effect.name].items()
        }
        for request in settings:
            by_parameter[request.parameter] = _requested_value(request, by_parameter)
        values[effect.name] = by_parameter
    return effects, values


def _requested_value(request: _Request, by_parameter: Mapping[str, np.ndarray]) -> np.ndarray:
    """The value that a request asks for, in the shape of its parameter."""
    if request.parameter not in by_parameter:
        raise EffectError(
            f"no parameter {request.parameter!r}",
            where=request.effect,
            advice=f"its parameters are {', '.join(by_parameter)}",
        )
    null = by_parameter[request.parameter]
    try:
        given = np.array([float(x) for x in request.value.split(",")])
        return np.broadcast_to(given, null.shape) if null.shape else given.reshape(())
    except ValueError:
        count = f"{null.size} number{'s' if null.size > 1 else ''}"
        raise EffectError(
            f"{request.value!r} is not {count}",
            where=f"{request.effect}.{request.parameter}",
            advice="give numbers separated by commas",
        ) from None
