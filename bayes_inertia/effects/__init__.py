"""The effect library: one small file per effect, and the explicit tuple of those that are tried by default.

The membership of `LIBRARY` decides how many comparisons a diagnosis makes. An effect of your own
belongs in a file of your own: hand an instance to `Model` (see `analyses/outside_effect.py`).
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from bayes_inertia.effect import Effect
from bayes_inertia.effects.constant_torque import ConstantTorque
from bayes_inertia.effects.rate_bias import RateBias
from bayes_inertia.effects.wheel_command_lag import WheelCommandLag
from bayes_inertia.effects.wheel_torque_gain import WheelTorqueGain
from bayes_inertia.errors import EffectError

LIBRARY: tuple[Effect, ...] = (
    RateBias(),
    WheelTorqueGain(),
    WheelCommandLag(),
    ConstantTorque(),
)

__all__ = ["LIBRARY", "ConstantTorque", "RateBias", "WheelCommandLag", "WheelTorqueGain", "by_name"]


def by_name(names: Sequence[str]) -> tuple[Effect, ...]:
    """The library's effects with these names, in the order given.

    Raises
    ------
    EffectError : a name is not in the library (the error lists the nearest ones), or is given twice.

    >>> [effect.name for effect in by_name(["rate_bias"])]
    ['rate_bias']
    """
    known = {effect.name: effect for effect in LIBRARY}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or list(known)
            raise EffectError(f"no effect of this name: {name!r}", where="effects", advice=f"perhaps {', '.join(near)}")
        if list(names).count(name) > 1:
            raise EffectError("the same effect twice", where=name, advice="name each effect once")
    return tuple(known[name] for name in names)
