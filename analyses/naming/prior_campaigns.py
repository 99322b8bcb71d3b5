"""Campaigns drawn from the prior that a diagnosis assumes: truths for `kinds.py`.

Nothing is hidden in half of them, one thing in 45 %, two in 4.5 %, more in the rest. One thing is
any effect of the library, fixed shape or random, or a shape without a name: all alike probable.
What it is, and how large, is drawn as the table of a flight without it weighs it: directions of one
size or each of its own, a mode's frequency, a random signal's time, where a shape without a name
enters, what it follows or how smooth it is. Left out are the hundredth of fixed shapes beyond their
prior, and random signals beside others. Fixed shapes, and what follows something known, are flown
by the package's own simulator, the others by another one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from analyses.naming.fixed_shape_campaigns import draw, plain_fit
from analyses.naming.stochastic_campaigns import (
    OF_TACHOMETERS,
    RANDOM,
    RandomSignal,
    process_of,
    random_campaign,
    straight_between,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.candidates import (
    FLEXIBLE_MODE,
    candidate_effects,
    frequencies,
    oscillator_columns,
)
from bayes_inertia.diagnosis.hypothesis_table import (
    FixedMember,
    RandomMember,
    log_prior_of_set,
    smallest_size,
)
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.linear_system import LinearModel, linear_model
from bayes_inertia.diagnosis.random_signals import (
    NAMELESS,
    SOURCES,
    STOCHASTIC_CANDIDATES,
    driven_blocks,
    random_members,
    roots_at,
    smooth_roots,
)
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import move_to
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, by_name
from bayes_inertia.physics.effects.formula import Formula
from bayes_inertia.physics.forward_model import Model

_AT_MOST = 3  # hidden at once
_FIXED = tuple(effect.name for effect in LIBRARY)
_NO_NAME = "no name"


class DrawnCampaign(NamedTuple):
    """A flight, its telemetry, and what is hidden in it."""

    flight: Flight
    campaign: Campaign
    hidden: tuple[str, ...]


def prior_campaign(seed: np.random.SeedSequence, tachometers: bool) -> DrawnCampaign:
    """Draw a campaign from the prior.

    `seed`: of everything in it. `tachometers`: whether it has them.
    """
    flown, chosen = seed.spawn(2)
    rng = np.random.default_rng(chosen)
    of_wheels = () if tachometers else OF_TACHOMETERS
    members = (*_FIXED, *(name for name in RANDOM if name not in of_wheels), _NO_NAME)
    count = number_of_hidden(rng, len(members))
    picked = tuple(rng.permutation(members if count < 2 else _FIXED)[:count].tolist())
    flight = draw(_again(flown), (), {}, tachometers)
    if not picked:
        return DrawnCampaign(flight, flight.campaign, ())
    weighed = _Weighed(flight.campaign, rng)
    if picked == (_NO_NAME,):
        return _without_name(weighed, _again(flown), tachometers)
    if picked[0] in RANDOM:
        flight, campaign, _ = random_campaign(picked[0], weighed, _again(flown), tachometers)
        return DrawnCampaign(flight, campaign, picked)
    effects = by_name(picked)
    values = {effect.name: weighed.values(effect) for effect in effects}
    flight = draw(_again(flown), effects, values, tachometers)
    return DrawnCampaign(flight, flight.campaign, picked)


def number_of_hidden(rng: np.random.Generator, members: int) -> int:
    """How many things are hidden, as probable as the prior of sets says.

    >>> counts = [number_of_hidden(np.random.default_rng(i), 25) for i in range(400)]
    >>> bool(0.43 < np.mean(np.array(counts) == 0) < 0.57), max(counts) <= 3
    (True, True)
    """
    sets = np.cumprod([1.0, *((members - k) / (k + 1) for k in range(_AT_MOST))])
    each = np.exp([log_prior_of_set(size, members) for size in range(_AT_MOST + 1)])
    return int(rng.choice(_AT_MOST + 1, p=sets * each / np.sum(sets * each)))


def _again(seed: np.random.SeedSequence) -> np.random.SeedSequence:
    """The same seed afresh: one that has been drawn from gives other children."""
    return np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key)


@dataclass(frozen=True)
class _Weighed:
    """What a table weighs at a flight in which nothing is hidden, and draws of it."""

    campaign: Campaign
    rng: np.random.Generator

    @cached_property
    def fit(self) -> Estimate:
        """The plain fit, in a model that holds all fixed shapes but the flexible mode."""
        effects = candidate_effects(self.campaign, LIBRARY)
        assert not effects.skipped
        return move_to(plain_fit(self.campaign), Model(self.campaign, effects.linear))

    @cached_property
    def linear(self) -> LinearModel:
        """The table's linear model there."""
        return linear_model(self.fit)

    @cached_property
    def response(self) -> TorqueResponse:
        """What torques do there."""
        return torque_response(self.fit)

    @cached_property
    def random(self) -> dict[str, RandomMember]:
        """Random effects and shapes without a name."""
        members = random_members(self.linear, self.response, STOCHASTIC_CANDIDATES)
        return {member.name: member for member in members}

    def values(self, effect: Effect) -> dict[str, np.ndarray | float]:
        """Parameters of an effect of a fixed shape."""
        if effect.name == FLEXIBLE_MODE:
            return self._mode(effect)
        (member,) = (m for m in self.linear.members if m.name == effect.name)
        return parameters_at(effect, self.campaign, self._amplitudes(member))

    def _amplitudes(self, member: FixedMember) -> np.ndarray:
        """Amplitudes (k,) of all parameters [prior sd]."""
        n, shape = len(member.index), self.rng.normal(size=len(member.shape))
        smallest, largest = np.log(member.sizes[[0, LIMITS.fixed_sizes - 1]])
        amplitude = self.rng.normal(size=n)
        if self.rng.random() < 0.5:
            amplitude *= np.exp(self.rng.uniform(smallest, largest))
        else:
            block = self.linear.system.matrix[np.ix_(member.index, member.index)]
            each = np.exp(self.rng.uniform(smallest, largest, n))
            amplitude = np.linalg.eigh(block)[1] @ (each * amplitude)
        amplitude = np.abs(amplitude) if member.one_sided else amplitude
        order = np.argsort(np.concatenate([member.index, member.shape]))
        return np.concatenate([amplitude, shape])[order]

    def _mode(self, mode: Effect) -> dict[str, np.ndarray | float]:
        """A flexible mode: any frequency that is tried, any direction of its coupling."""
        frequency = float(self.rng.uniform(*frequencies(self.response)[[0, -1]]))
        coupling = self.rng.normal(size=3)
        coupling /= np.linalg.norm(coupling)
        sd = mode.parameters(self.campaign)[0].priors[0].sd
        columns = oscillator_columns(self.response, np.array([frequency]), sd**2)
        matrix, _ = self.linear.fit.projected(columns)
        products = coupling[[0, 1, 2, 0, 0, 1]] * coupling[[0, 1, 2, 1, 2, 2]]
        smallest = smallest_size(np.array([products @ matrix @ products]), 1.0)
        # Its signal is of second order in the coupling.
        size = np.exp(0.5 * self.rng.uniform(np.log(smallest), 0.0))
        at_rest = parameters_at(mode, self.campaign, np.zeros(5))
        return at_rest | {"coupling": size * sd * coupling, "frequency": frequency}

    def _form(self, member: RandomMember) -> tuple[int, int]:
        """Which form of a random signal, and which of its sizes."""
        form = self.rng.choice(len(member.signals), p=np.exp(member.log_shares))
        weights = member.signals[form].weights
        return int(form), int(self.rng.choice(len(weights), p=weights / weights.sum()))

    def signal(self, kind: str, campaign: Campaign, rng: np.random.Generator) -> RandomSignal:
        """Of a random effect in such a campaign; its time and size are of its prior."""
        member = self.random[kind]
        form, size = self._form(member)
        before = sum(len(signal.sizes) for signal in member.signals[:form])
        parameters = member.starts[before + size]
        # What begins anew in each slew, or is the same in each, stands behind all times.
        alike = form >= len(np.unique(member.starts[:, 1:], axis=0))
        path = process_of(kind, rng, *parameters[1:])
        return RandomSignal(float(parameters[0]), kind, path, bool(alike))

    def without_name(self) -> _Shape:
        """A shape without a name."""
        present = [source for source, name in NAMELESS.items() if name in self.random]
        source = str(self.rng.choice(present))
        member = self.random[NAMELESS[source]]
        form, size = self._form(member)
        followed = [b.formula for place, b in driven_blocks(self.response) if place == source]
        # Smooth ones of several lengths, as many that repeat, then those that follow something.
        lengths = (len(member.signals) - len(followed)) // 2
        size = float(member.signals[form].sizes[size])
        if form >= 2 * lengths:
            return _Shape(source, size, formula=followed[form - 2 * lengths])
        return _Shape(source, size, form % lengths, alike=form >= lengths)


@dataclass(frozen=True)
class _Shape:
    """A shape without a name: one that follows something, or a smooth one of some length.

    `source`: where it enters. `size`: in prior sds. `length`: which of those that are tried.
    `alike`: whether it is the same in every slew.
    """

    source: str
    size: float
    length: int = 0
    alike: bool = False
    formula: Formula | None = None

    @property
    def kind(self) -> str:
        """The random effect that enters there on knots."""
        hook = next(hook for hook, source in SOURCES.items() if source == self.source)
        acting = (e for e in STOCHASTIC_CANDIDATES if e.acts(hook))
        return next(e.name for e in acting if hasattr(e, "knots") or hasattr(e, "pieces"))

    def signal(self, kind: str, campaign: Campaign, rng: np.random.Generator) -> RandomSignal:
        """A smooth signal, straight between the knots of that effect."""
        (of_effect,) = roots_at(Model(campaign, by_name([kind])), 0.0)
        slews, axes, knots, _ = of_effect.blocks.shape
        root = smooth_roots(of_effect.blocks)[self.length]
        drawn = root @ rng.normal(size=(slews, knots, axes))
        drawn = drawn[[0] * slews] if self.alike else drawn
        return RandomSignal(self.size, kind, straight_between(campaign, drawn))


def _without_name(
    weighed: _Weighed, seed: np.random.SeedSequence, tachometers: bool
) -> DrawnCampaign:
    """A campaign in which a shape without a name is hidden."""
    shape = weighed.without_name()
    if shape.formula is None:
        flight, campaign, _ = random_campaign(shape.kind, shape, seed, tachometers)
        return DrawnCampaign(flight, campaign, (f"outside_{shape.kind}",))
    formula, count = shape.formula, len(shape.formula.parameters(weighed.campaign)[0].names)
    amplitude = shape.size * weighed.rng.normal(size=count)
    values = {formula.name: parameters_at(formula, weighed.campaign, amplitude)}
    flight = draw(seed, (formula,), values, tachometers)
    return DrawnCampaign(flight, flight.campaign, (f"outside_{formula.name}",))


def parameters_at(
    effect: Effect, campaign: Campaign, amplitude: np.ndarray
) -> dict[str, np.ndarray | float]:
    """Values of an effect's parameters; `amplitude` (k,): of all of them, in prior sds from null.

    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> (effect,) = by_name(["wheel_command_lag"])
    >>> sorted(parameters_at(effect, small_campaign(), np.zeros(1)).items())
    [('tau', 0.0)]
    """
    values, first = dict[str, np.ndarray | float](), 0
    for p in effect.parameters(campaign):
        step = amplitude[first : first + len(p.names)] * [q.scale for q in p.priors]
        value = p.null * np.exp(step) if p.priors[0].logarithmic else p.null + step
        value = np.clip(value, [q.lower for q in p.priors], [q.upper for q in p.priors])
        values[p.name] = value if p.components else float(value[0])
        first += len(p.names)
    return values
