"""The table of hypotheses around its best row: weighed at a fit, refitted, weighed again there.

At the fit without effects every set is weighed to first order (`hypothesis_table`). The best row is
refitted in full, and all sets are weighed again around it: until the best row is one that was
refitted. A row counts with its own refit's evidence, or as it was weighed at the refit nearest to
it. Of the probabilities is read what is named, what could be it as well, and how sure it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.candidates import (
    FLEXIBLE_MODE,
    CandidateEffects,
    FlexibleModeCandidate,
    flexible_mode_candidate,
    theta_with_mode,
)
from bayes_inertia.diagnosis.hypothesis_table import (
    Given,
    Names,
    RandomMember,
    evidence_of_sets,
    given_all,
    given_random,
    log_evidence_of,
    log_prior_of_set,
    nothing,
    of_columns,
    posterior,
)
from bayes_inertia.diagnosis.limits import LIMITS, Rules
from bayes_inertia.diagnosis.linear_system import LinearModel, linear_model
from bayes_inertia.diagnosis.random_signals import NAMELESS, random_members
from bayes_inertia.diagnosis.result import Hypothesis, within_prior
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.inference.descent import compiled_meanwhile
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import Point
from bayes_inertia.inference.objective import negative_log_posterior
from bayes_inertia.inference.optimizer import move_to, re_estimate
from bayes_inertia.inference.settings import NOTHING
from bayes_inertia.maths.kept_programs import return_freed_memory
from bayes_inertia.physics.stochastic_effect import StochasticEffect
from bayes_inertia.progress import Progress


def with_stochastic(before: Estimate, effect: StochasticEffect, start: np.ndarray) -> Estimate:
    """Fit one effect without a fixed shape more; effects that were not fitted are left out.

    Returns: of a model that holds what is fitted and nothing else.
    """
    model = replace(before.model, effects=(*before.effects_fitted, effect))
    begin = move_to(before, model)
    part = model.space.slice_of(effect.name)
    theta = begin.theta.copy()
    theta[part] = start
    free = np.concatenate([begin.free, np.arange(part.start, part.stop)])
    with compiled_meanwhile(model, replace(begin.point, theta=theta)):
        return re_estimate(begin, theta, free, tolerance=LIMITS.comparison_tolerance)


SHAPELESS = frozenset(NAMELESS.values())


@dataclass(frozen=True)
class Search:
    """What may be missing, and the thresholds by which it is named.

    Parameters
    ----------
    effects : CandidateEffects
        Of a fixed shape.
    stochastic : tuple of StochasticEffect
        Without one.
    rules : Rules
        Thresholds.
    seed : int
        Of simulated thresholds.
    say : callable
        Told what is done.
    """

    effects: CandidateEffects
    stochastic: tuple[StochasticEffect, ...]
    rules: Rules
    seed: int
    say: Progress


@dataclass(frozen=True)
class RefittedRow:
    """A set of effects of fixed shape fitted in full, and all sets weighed around it.

    Parameters
    ----------
    names : frozenset of str
        The effects.
    estimate : Estimate
        The fit.
    linear : LinearModel
        The linear model there.
    response : TorqueResponse
        What torques and errors of sensors do there.
    log_evidence : mapping
        Of all sets, against nothing.
    random : tuple of RandomMember
        Signals without a fixed shape there.
    """

    names: Names
    estimate: Estimate
    linear: LinearModel
    response: TorqueResponse
    log_evidence: Mapping[Names, float]
    random: tuple[RandomMember, ...] = ()


@dataclass(frozen=True)
class Table:
    """All hypotheses.

    Parameters
    ----------
    rows : dict
        Probability of each set, most probable first.
    log_evidence, log_prior : dict
        Of each; the evidence is against nothing.
    refitted : dict of RefittedRow
        Rows that were refitted.
    """

    rows: dict[Names, float]
    log_evidence: dict[Names, float]
    log_prior: dict[Names, float]
    refitted: dict[Names, RefittedRow]

    @property
    def best_shape(self) -> Names:
        """The best row with a shape without a name; empty, if there is none."""
        return next((row for row in self.rows if row & SHAPELESS), frozenset())

    def best_names(self, rules: Rules, fewest: int) -> Names:
        """The best row of so many names alone, or a larger one about as probable."""
        names = [row for row in self.rows if len(row) >= fewest and not row & SHAPELESS]
        best = next(iter(names), frozenset[str]())
        least = rules.larger_set_share * self.rows.get(best, 0.0)
        return next((row for row in names if row > best and self.rows[row] >= least), best)

    @property
    def first(self) -> RefittedRow:
        """The fit without effects."""
        return self.refitted[frozenset()]

    def fixed_part(self, row: Names) -> Names:
        """The members of a row that have a fixed shape."""
        return row & {member.name for member in self.first.linear.members}

    def weighed_at(self, row: Names) -> RefittedRow:
        """The refit nearest to a row, of those around which it was weighed."""
        weighed = (r for r in self.refitted.values() if row in r.log_evidence)
        return _nearest(self.fixed_part(row), weighed)


def table_of(base: Estimate, search: Search) -> Table:
    """Weigh everything that may be missing."""
    refitted: dict[Names, RefittedRow] = {}
    names: Names | None = frozenset()
    while names is not None and len(refitted) <= search.rules.max_refits:
        estimate = _refit(names, refitted, search) if refitted else base
        refitted[names] = _weighed(names, estimate, refitted, search)
        table = _read(refitted, search.rules)
        names = _next(table, search.rules)
    return table


def _weighed(
    names: Names, estimate: Estimate, refitted: Mapping[Names, RefittedRow], search: Search
) -> RefittedRow:
    """All sets weighed around a fit; as at the nearest fit where that foretold this one."""
    costs, linear, before = search.effects.log_costs, None, estimate.objective
    at, held = estimate.linearised(), sorted(names)
    if refitted:
        near, before = _below(names, refitted), refitted[frozenset()].estimate.objective
        linear = linear_model(estimate, held, before, None, costs, at)
        members = [m for m in linear.members if m.name in names]
        own = log_evidence_of(nothing(linear.system), members) + linear.offset
        if abs(own - near.log_evidence.get(names, np.inf)) < LIMITS.linear:
            return replace(near, names=names, estimate=estimate)
    response = torque_response(estimate)
    mode = flexible_mode_candidate(at, search.effects, response)
    if linear is None or mode is not None:
        linear = linear_model(estimate, held, before, mode, costs, at)
    # The fit leaves free what the table takes: 0.3 GB.
    return_freed_memory()
    random = random_members(linear, response, search.stochastic, driven=not costs)
    largest = min(max(3, len(names) + 1), search.rules.max_effects)
    values = evidence_of_sets(linear.system, linear.members, random, largest, names)
    values = {row: value + linear.offset for row, value in values.items()}
    return RefittedRow(names, estimate, linear, response, values, random)


def given_row(table: Table, row: Names) -> tuple[LinearModel, Given]:
    """The linear model given the members of a row, at the refit nearest to it."""
    at = table.weighed_at(row)
    fixed = [m for m in at.linear.members if m.name in row]
    random = [m for m in at.random if m.name in row]
    system = at.linear.system
    given = given_random(system, random[0]) if random else nothing(system)
    return at.linear, given_all(*of_columns(given, fixed, len(at.linear.null)))


def _below(names: Names, refitted: Mapping[Names, RefittedRow]) -> RefittedRow:
    """The refit that lacks fewest of a set of effects, and holds no others."""
    return _nearest(names, (r for r in refitted.values() if r.names <= names))


def _nearest(names: Names, among: Iterable[RefittedRow]) -> RefittedRow:
    """The refit that differs in fewest effects, the best of several."""
    return min(among, key=lambda r: (len(r.names ^ names), -r.log_evidence[r.names]))


def _read(refitted: Mapping[Names, RefittedRow], rules: Rules) -> Table:
    """The table as it stands: each row as weighed at the refit nearest to it."""
    table = Table({}, {}, {}, dict(refitted))
    # In the order in which they were weighed: sums round alike in every process.
    rows = [row for at in refitted.values() for row in at.log_evidence]
    rows = [row for row in dict.fromkeys(rows) if len(row) <= rules.max_effects]
    values = {row: table.weighed_at(row).log_evidence[row] for row in rows}
    random = {m.name for m in table.first.random}
    members = len(table.first.linear.members) + len(random - SHAPELESS) + 1
    # All shapes without a name together are one member.
    shapes = np.log(max(len(random & SHAPELESS), 1))
    prior = {r: log_prior_of_set(len(r), members) - shapes * len(r & SHAPELESS) for r in values}
    return with_evidence(replace(table, log_prior=prior), values)


def with_evidence(table: Table, log_evidence: dict[Names, float]) -> Table:
    """The table with other evidence of its rows."""
    rows = posterior(log_evidence, table.log_prior)
    return replace(table, rows=rows, log_evidence=log_evidence)


def _next(table: Table, rules: Rules) -> Names | None:
    """The effects of fixed shape of the best row and of the names to be read, if not refitted."""
    best = next(iter(table.rows))
    wanted = (table.fixed_part(row) for row in (best, table.best_names(rules, 0)))
    return next((names for names in wanted if names not in table.refitted), None)


def fit_of(table: Table, names: Names, search: Search) -> Estimate:
    """The fit of a set of effects of fixed shape, brought to its end."""
    if not names:
        return table.first.estimate
    row = table.refitted.get(names)
    fitted = row.estimate if row else _refit(names, table.refitted, search)
    return re_estimate(fitted, fitted.theta, fitted.free)


def _refit(names: Names, refitted: Mapping[Names, RefittedRow], search: Search) -> Estimate:
    """Fit a set of effects, begun where the nearest linear model has everything.

    Where that fits no better than without them nothing is linear: the way from there may end in a
    local optimum. The fit begins with the data counted weakly, and once more from where it ends.
    """
    near, base = _below(names, refitted), refitted[frozenset()].estimate
    estimate, theta, steps = _start(names, near, search)
    point = _followed(replace(estimate.point, theta=theta), near.linear, steps)
    reached = negative_log_posterior(estimate.model, point, estimate.white)
    weak = not reached < near.estimate.objective
    if not weak:
        local = replace(estimate.point, bias=point.bias, local=point.local)
        estimate, theta = replace(estimate, point=local), point.theta
    parts = (estimate.model.space.slice_of(name) for name in sorted(names))
    free = [np.intersect1d(np.arange(estimate.model.n_known), base.free)]
    free += [np.arange(part.start, part.stop) for part in parts]
    stop = {"tolerance": LIMITS.comparison_tolerance}
    moving = np.concatenate(free)
    fitted = re_estimate(estimate, theta, moving, weak_data_first=weak, **stop)
    if weak:
        # Nuisances that were guessed far from the truth may lead to a local optimum as well.
        again = re_estimate(fitted, fitted.theta, moving, weak_data_first=True, **stop)
        fitted = min(fitted, again, key=lambda fit: fit.objective)
    for name in sorted(names):
        fitted = within_prior(fitted, name, search.rules, **stop)
    return fitted


def _start(
    names: Names, near: RefittedRow, search: Search
) -> tuple[Estimate, np.ndarray, dict[str, np.ndarray]]:
    """The nearest fit, theta (d,) with what its linear model foretells of more effects, and that.

    Steps of these effects [prior sd as stated].
    """
    estimate, theta = near.estimate, near.estimate.theta.copy()
    if FLEXIBLE_MODE in names - near.names:
        estimate, theta = _with_mode(estimate, search.effects, near.linear.mode)
    space = estimate.model.space
    scales = {e.name: e.prior_scale for e in estimate.model.effects}
    largest, foretold = LIMITS.largest_amplitude, amplitudes(near.linear, names)
    steps = {name: np.clip(foretold[name], -largest, largest) for name in names - near.names}
    for name in steps.keys() - {FLEXIBLE_MODE}:
        part = space.slice_of(name)
        sd = space.sd[part]
        inside = space.lower[part] + 1e-3 * sd, space.upper[part] - 1e-3 * sd
        theta[part] = np.clip(space.nulls[part] + steps[name] * sd / scales[name], *inside)
    return estimate, theta, steps


def _followed(point: Point, linear: LinearModel, steps: Mapping[str, np.ndarray]) -> Point:
    """A point with everything that a fit holds moved as steps of effects ask, to first order."""
    change = np.zeros(linear.columns.shape[-1])
    for member in linear.members:
        change[member.columns] = steps.get(member.name, 0.0)
    moved = -linear.fit.inverse_root.T @ (linear.imitated @ change)
    f, shared = len(linear.fit.free), linear.fit.n_shared
    theta = point.theta.copy()
    theta[linear.fit.free] += moved[:f]
    own = moved[shared:].reshape(point.local.shape)
    return Point(theta, point.bias + moved[f:shared], point.local + own)


def amplitudes(linear: LinearModel, names: Names) -> dict[str, np.ndarray]:
    """Best amplitudes of a set of effects, of the stated prior [prior sd]; shapes stay at zero."""
    members = [m for m in linear.members if m.name in names]
    index = np.concatenate([m.index for m in members])
    block = linear.system.matrix[np.ix_(index, index)] + np.eye(len(index))
    values = np.zeros(len(linear.system.gradient))
    values[index] = np.linalg.solve(block, linear.system.gradient[index])
    return {m.name: values[m.columns] for m in members}


def _with_mode(
    estimate: Estimate, effects: CandidateEffects, candidate: FlexibleModeCandidate | None
) -> tuple[Estimate, np.ndarray]:
    """The fit in a model that holds a flexible mode, and its parameters with the mode's."""
    assert candidate is not None
    assert effects.flexible_mode is not None
    model, frequency = estimate.model, float(2.0 ** np.round(np.log2(candidate.frequency)))
    mode = replace(effects.flexible_mode, frequency=frequency)
    start = move_to(estimate, replace(model, effects=(*model.effects, mode)))
    return start, theta_with_mode(start, candidate)


_SOURCES = {name: source for source, name in NAMELESS.items()}


class Reading(NamedTuple):
    """What a table says.

    Parameters
    ----------
    verdict : str
        As `Diagnosis.verdict`.
    named : tuple of str
        Effects of the best row with names alone.
    ambiguous_with : tuple of tuples of str
        Sets that cannot be told apart, the member of the best row first, `NOTHING` last.
    why_unknown : str
        As `Diagnosis.why_unknown`.
    nameless_lead : float
        Log odds of the best row with a shape without a name against the best without.
    nameless_source : str
        Where that shape enters.
    """

    verdict: str
    named: tuple[str, ...] = ()
    ambiguous_with: tuple[tuple[str, ...], ...] = ()
    why_unknown: str = ""
    nameless_lead: float = -np.inf
    nameless_source: str = ""

    @property
    def row(self) -> Names:
        """The row of the effects named."""
        return frozenset(self.named)


def read_table(table: Table, rules: Rules, *, significant: bool) -> Reading:
    """Read the verdict off a table.

    `significant`: whether anything is, at the level of false alarms of the rules; where nothing is,
    nothing is named.
    """
    if not significant or not next(iter(table.rows)):
        return Reading("consistent")
    row, shape = table.best_names(rules, 1), table.best_shape
    reading = Reading("named", tuple(sorted(row, key=lambda name: -_single(table, name))))
    if shape:
        with np.errstate(divide="ignore"):  # a probability may be too small for a number
            lead = float(np.log(table.rows[shape]) - np.log(table.rows[row]))
        (own,) = shape & SHAPELESS
        reading = reading._replace(nameless_lead=lead, nameless_source=_SOURCES[own])
    if reading.nameless_lead <= rules.log_evidence_margin:
        sets = _ambiguous_sets(table, reading.named, rules)
        return reading._replace(verdict="ambiguous" if sets else "named", ambiguous_with=sets)
    # Beside the shape, the names may still explain a part.
    if row & shape:
        return reading._replace(verdict="partial")
    return reading._replace(verdict="unknown", why_unknown="imitation")


def _ambiguous_sets(
    table: Table, named: tuple[str, ...], rules: Rules
) -> tuple[tuple[str, ...], ...]:
    """What stands in other rows in place of the effects named; nothing, if nothing does."""
    row, sets = frozenset(named), dict[str, list[str]]()
    least = table.rows[row] * np.exp(-rules.log_evidence_margin)
    for other, *others in _answers(table):
        lost, gained = [name for name in named if name not in other], sorted(other - row)
        if sum(table.rows[each] for each in (other, *others)) <= least:
            continue
        for name in lost[:1] if gained else lost:
            places = sets.setdefault(name, [])
            found = [*gained, *lost[1:]] if gained else [NOTHING]
            places += [name for name in found if name not in places]
    order = {name: sorted(places, key=lambda n: n == NOTHING) for name, places in sets.items()}
    return tuple((name, *order[name]) for name in named if name in sets)


def _answers(table: Table) -> list[list[Names]]:
    """Rows, most probable first; those that differ in the shape without a name are one answer."""
    joined: dict[tuple[Names, bool], list[Names]] = {}
    for row in table.rows:
        joined.setdefault((row - SHAPELESS, bool(row & SHAPELESS)), []).append(row)
    return list(joined.values())


def unexplained_reading(table: Table, reading: Reading) -> Reading:
    """The reading where the best row leaves residuals that are not noise.

    Names that a shape without a name does not make needless explain a part; else nothing is named.
    """
    if reading.named and set(reading.named) <= table.best_shape:
        return reading._replace(verdict="partial", ambiguous_with=())
    return reading._replace(verdict="unknown", ambiguous_with=(), why_unknown="misfit")


def _single(table: Table, name: str) -> float:
    return table.log_evidence.get(frozenset([name]), -np.inf)


def hypotheses_of(table: Table) -> tuple[Hypothesis, ...]:
    """The rows that are listed, most probable first; their probabilities add up to one.

    Shapes without a name are one hypothesis, beside each set of names.
    """
    rows = [_together(table, members) for members in _answers(table)]
    rows.sort(key=lambda row: -row.probability)
    kept = [row for row in rows if row.kind == "nothing" or not row.effects]
    kept += [row for row in rows if row not in kept][: LIMITS.listed]
    rest = [row for row in rows if row not in kept]
    if rest:
        prior = float(logsumexp([row.log_prior for row in rest]))
        joint = float(logsumexp([row.log_prior + row.log_evidence for row in rest]))
        total = sum(row.probability for row in rest)
        kept.append(Hypothesis("others", (), prior, joint - prior, total))
    return tuple(sorted(kept, key=lambda row: -row.probability))


def _together(table: Table, members: list[Names]) -> Hypothesis:
    """Rows that differ in the shape without a name alone, as one."""
    names = members[0] - SHAPELESS
    kind: Any = "nameless" if members[0] & SHAPELESS else "effects" if names else "nothing"
    prior = float(logsumexp([table.log_prior[row] for row in members]))
    joint = logsumexp([table.log_prior[row] + table.log_evidence[row] for row in members])
    probability = sum(table.rows[row] for row in members)
    effects = tuple(sorted(names, key=lambda name: -_single(table, name)))
    return Hypothesis(kind, effects, prior, float(joint) - prior, float(probability))
