"""Effects of a fixed shape in campaigns of the package's own simulator, for `kinds.py`.

Every campaign has its own J, K, bias, start attitude, angles and senses of its slews, and wheel
momenta, drawn from the prior, and is flown in closed loop with the hidden effect. The amplitude is
set by the ideal test: the non-centrality of the hidden effect's score, from its sensitivities
projected off everything that is fitted, in the same campaign without it. The kind `strong` flies
each effect at 3, 10 and 30 times that amplitude; what is not physical there (`physical_limits`) is
skipped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analyses.naming.fixed_shape_campaigns import (
    LARGEST_AMPLITUDE,
    amplitude_for,
    degrees_of_freedom,
    direction,
    draw,
    noncentrality,
    scaled,
    template_campaign,
    unit_step,
)
from analyses.naming.physical_limits import why_not_physical
from bayes_inertia.diagnosis.limits import Rules
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY

RULES = Rules()
# Effects without a trace in these campaigns: fixes are taken at rest, their time does not matter.
INVISIBLE = ("star_tracker_time_offset",)
NAMES = tuple(e.name for e in LIBRARY if e.name not in INVISIBLE)
# Of the ideal test: one candidate's share of the false alarms.
LEVEL = RULES.false_alarm_probability / len(NAMES)

# Kinds with several effects at once.
TOGETHER = {"pair": 2, "triple": 3}
# Of the kind `strong`: times the amplitude that is easily found.
FACTORS = (3, 10, 30)
# Between an effect's name and its factor, in the label of a strong one.
_TIMES = "*"


@dataclass(frozen=True)
class Case:
    """One campaign to be simulated: its kind, label, number and hidden effects."""

    kind: str
    label: str
    index: int
    effects: tuple[Effect, ...]
    tachometers: bool

    @property
    def seed(self) -> np.random.SeedSequence:
        """A fresh seed: one that has been drawn from gives other children."""
        key = (hash_of(self.kind + self.label), self.index, int(self.tachometers))
        if self.kind == "strong":
            # Names that end alike, as "wheel_misalignment" does, have one hash.
            key = (*key, NAMES.index(self.effects[0].name))
        return np.random.SeedSequence(20260, spawn_key=key)

    @property
    def factor(self) -> float:
        """Times the amplitude at the ideal test's power."""
        return float(self.label.partition(_TIMES)[2] or 1.0)

    @property
    def hidden(self) -> list[str]:
        """Names of what acts."""
        return [e.name for e in self.effects]


@dataclass(frozen=True)
class Hidden:
    """What acts in a campaign.

    `sizes` are multiples of `directions`, whose steps are about one prior sd; `prior_sds` is the
    largest distance of a parameter from its null in the template's prior sds. `wanted` are the
    non-centralities at the ideal test's power.
    """

    directions: dict
    wanted: list[float]
    sizes: dict[str, float]
    values: dict
    prior_sds: dict[str, float]
    rng: np.random.Generator


def hidden_in(case: Case, power: float, level: float) -> Hidden:
    """Draw directions and amplitudes of the hidden effects of a campaign."""
    # Not a child of the seed: the flight draws from those, and the effect's direction must not
    # follow its noise.
    rng = np.random.default_rng(np.random.SeedSequence(20261, spawn_key=case.seed.spawn_key))
    template = template_campaign()
    directions = {e.name: direction(e, rng, template) for e in case.effects}
    wanted = [noncentrality(power, degrees_of_freedom(e, template), level) for e in case.effects]
    sizes = {
        e.name: case.factor
        * amplitude_for(e, directions[e.name], of_test, case.seed, case.tachometers)
        for e, of_test in zip(case.effects, wanted, strict=True)
    }
    values = {name: scaled(directions[name], size) for name, size in sizes.items()}
    prior_sds = {
        e.name: sizes[e.name] * float(np.abs(unit_step(e, directions[e.name], template)).max())
        for e in case.effects
    }
    return Hidden(directions, wanted, sizes, values, prior_sds, rng)


def why_skipped(case: Case, hidden: Hidden) -> str:
    """Why a strong effect is not flown; empty if it is."""
    (effect,) = case.effects
    if hidden.sizes[effect.name] >= case.factor * LARGEST_AMPLITUDE:
        return f"{effect.name}: these slews hardly show it at any size"
    still = draw(case.seed, (), {}, case.tachometers)
    return why_not_physical(hidden.values, still.spacecraft.inertia_B)


def truth_of(flight: Flight) -> np.ndarray:
    """J (six elements) and K of a flight."""
    J = flight.spacecraft.inertia_B
    return np.array(
        [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *flight.spacecraft.scale_factor]
    )


def quoted_z(diagnosis: Diagnosis, truth: np.ndarray) -> np.ndarray:
    """Distance of J and K from the truth [sd], with the uncertainty that is quoted for them."""
    quoted = quoted_parameters(diagnosis)
    return (quoted.mean - truth) / quoted.sd


def hash_of(text: str) -> int:
    """A number that does not depend on the interpreter's hash seed.

    >>> hash_of("a")
    97
    """
    return int.from_bytes(text.encode(), "big") % (2**31)


def tasks(kind: str, count: int) -> list[tuple[str, int, tuple[Effect, ...]]]:
    """(label, index, effects) of all campaigns of a kind."""
    library = {e.name: e for e in LIBRARY}
    if kind == "clean":
        return [("clean", i, ()) for i in range(count)]
    if kind == "single":
        return [(name, i, (library[name],)) for i in range(count) for name in NAMES]
    if kind == "strong":
        return [
            (f"{name}{_TIMES}{factor}", i, (library[name],))
            for i in range(count)
            for factor in FACTORS
            for name in NAMES
        ]
    rng = np.random.default_rng(5)
    sets = [rng.choice(len(NAMES), TOGETHER[kind], replace=False) for _ in range(count)]
    return [(kind, i, tuple(library[NAMES[k]] for k in chosen)) for i, chosen in enumerate(sets)]
