"""Effects by what a user calls them: a name of the library, or a reference to code of their own."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp

from bayes_inertia.errors import EffectError
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effect_declaration import check_declaration, guarded
from bayes_inertia.physics.effects import LIBRARY, REMAINDERS, STOCHASTIC, by_name
from bayes_inertia.physics.effects.of_device import with_settings
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.outside_effects import load_effect, pinned, reference_of
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.small_campaign import small_campaign


def effects_named(names: Sequence[str]) -> tuple[Effect, ...]:
    """The effects with these names, of the library or from outside.

    `names`: each a name of the library ("rate_bias"), `FILE.py:Class`, `package.module:Class`, the
    name of an entry point of an installed package, or what `pinned_names` returned; behind each,
    settings as in "flexible_mode:frequency=0.12:damping=0.01". "delay[mems]" is of one device.

    Examples
    --------
    >>> effects_named(["inertia_change:from_slew=5"])[0].from_slew
    5
    """
    effects = tuple(_effect_named(name) for name in names)
    for effect in effects:
        if sum(other.name == effect.name for other in effects) > 1:
            raise EffectError(
                "the same effect twice", where=effect.name, advice="name each effect once"
            )
    return effects


def remainders(kind: str | None) -> tuple[Effect, ...]:
    """What stands for disturbances without a name in a fit.

    Examples
    --------
    >>> [effect.name for effect in remainders("both")]
    ['torque_remainder', 'rate_remainder']
    """
    wanted = {f"{kind}_remainder"} if kind != "both" else {effect.name for effect in REMAINDERS}
    return tuple(effect for effect in REMAINDERS if effect.name in wanted)


def pinned_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names as a run keeps them; effects from outside are checked.

    Returns: references with absolute paths and digests; names of the library as they are.
    """
    effects_named(names)
    return tuple(_pinned_name(name) for name in names)


def split_settings(name: str) -> tuple[str, dict[str, str]]:
    """What a user calls an effect, and the settings behind it.

    Examples
    --------
    >>> split_settings("my_effects.py:Slosh:sigma=0.1")
    ('my_effects.py:Slosh', {'sigma': '0.1'})
    """
    given: dict[str, str] = {}
    while "=" in (setting := name.rpartition(":")[2]) and ":" in name:
        name = name.removesuffix(f":{setting}")
        key, _, value = setting.partition("=")
        given = {key.strip(): value.strip(), **given}
    return name, given


def _effect_named(name: str) -> Effect:
    plain, settings = split_settings(name)
    reference = reference_of(plain)
    if reference is None or _of_library(plain) is not None:
        return with_settings(by_name([plain])[0], settings)
    effect = load_effect(reference)
    alike = _of_library(str(effect.name))
    # The library's own class with other settings is no other effect.
    if alike is not None and type(alike) is not type(effect):
        raise EffectError(
            f"the library has an effect called {effect.name!r} too",
            where=str(reference),
            advice="give the class another `name`",
        )
    return with_settings(effect, settings)


def _pinned_name(name: str) -> str:
    plain, _ = split_settings(name)
    reference = reference_of(plain)
    if reference is None or _of_library(plain) is not None:
        return name
    _check_traceable(_effect_named(name))
    return f"{pinned(reference)}{name.removeprefix(plain)}"


def _of_library(name: str) -> Effect | None:
    known = (effect for effect in (*LIBRARY, *STOCHASTIC) if effect.name == name)
    return next(known, None)


def _check_traceable(effect: Effect) -> None:
    """Call every hook once, on shapes alone: quick, and no traceback in the middle of a fit."""
    campaign = small_campaign()
    check_declaration(effect, campaign)
    drives: tuple[Drive, Drive] = ("commanded", "measured")
    for drive in drives:
        model = guarded(effect, "building the model", partial(Model, campaign, (effect,), drive))
        local = jnp.zeros((model.n_slews, model.structure.n_local))
        predict = partial(predict_all, model.structure)
        arguments = (jnp.asarray(model.space.mean), local, jnp.zeros(model.n_bias), model.data)
        guarded(effect, "predicting telemetry", partial(jax.eval_shape, predict, *arguments))
