"""The linear model of everything that may be missing, at a fit: from which hypotheses are weighed.

Columns of all effects of the library, of random signals and of shapes without a name, everything
fitted projected off. Effects that the fit holds are members too: they are not projected off, and
the data are those before they were fitted. Gains are measured against a fit without any effect:
what a linear model cannot see of that is one number for all sets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from bayes_inertia.diagnosis.candidates import FlexibleModeCandidate
from bayes_inertia.diagnosis.formulas import DRIVEN_BY_LIBRARY, told_blocks
from bayes_inertia.diagnosis.hypothesis_table import (
    FixedMember,
    Given,
    RandomMember,
    Signal,
    System,
    fixed_member,
    log_evidence_of,
    log_evidence_of_random,
    nothing,
    signal_of,
)
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.random_signals import (
    NAMELESS,
    SOURCES,
    CandidateRoots,
    ProjectedSignal,
    StochasticCandidate,
    TachometerShape,
    dense,
    forms_of,
    imitated_share,
    largest_size,
    parameters_at,
    projected_signal,
    roots_at,
    smooth_roots,
    source_of,
    usable,
)
from bayes_inertia.diagnosis.torque_response import (
    PROGRAMS,
    TorqueResponse,
    coefficient_columns,
    torque_response,
)
from bayes_inertia.inference.compiled_programs import forget_surplus
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effects.formula import PLACES
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@array_dataclass
class LinearModel:
    """What can be said of all sets of effects at one fit, to first order.

    Parameters
    ----------
    fit : LinearisedFit
        The fit; what it holds as free is projected off.
    system : System
        S and u of the effects of a fixed shape; the last nine columns are J and K: conditioned on
        members, their block of S is what these take off the covariance, and of u their shift.
    columns : (slews, numbers, c) array
        Their columns.
    members : tuple of FixedMember
        These effects.
    held, amplitude : (h,) arrays
        Columns of what the fit holds, and its amplitudes there.
    offset : float
        Log evidence of nothing in this linear model against the fit without effects.
    null, covariance : (9,), (9, 9) arrays
        J and K if nothing acts.
    """

    fit: LinearisedFit
    system: System
    columns: np.ndarray
    members: tuple[FixedMember, ...]
    held: np.ndarray
    amplitude: np.ndarray
    offset: float
    null: np.ndarray
    covariance: np.ndarray


def linear_model(
    estimate: Estimate,
    held: Sequence[str] = (),
    before: float = np.nan,
    mode: FlexibleModeCandidate | None = None,
    log_costs: Mapping[str, float] | None = None,
    linearised: LinearisedFit | None = None,
) -> LinearModel:
    """The linear model at a fit that holds the effects `held`.

    `before`: objective of the fit without any effect. `mode`: the flexible mode that the residuals
    show best, if the fit holds none. `log_costs`: by how much less probable an effect is than
    others. `linearised`: the fit, whose rows may be known already.
    """
    scales, own = _scales(estimate), _own(estimate, held)
    fit = (linearised or estimate.linearised()).without(own)
    names = _names(estimate, held, fit.free)
    index = _own(estimate, names)
    columns = fit.parameters[..., index] / scales.slope[index]
    if mode is not None:
        columns = np.concatenate([columns, mode.columns], -1)
    matrix, gradient = fit.projected(columns)
    at = np.flatnonzero(np.isin(index, own))
    amplitude = scales.amplitude[index[at]]
    # The data are those before the effects were fitted.
    gradient = gradient + matrix[:, at] @ amplitude
    block = matrix[np.ix_(at, at)] + np.diag(scales.precision[index[at]])
    linear = 0.5 * gradient[at] @ np.linalg.solve(block, gradient[at])
    moved = _shift_per_amplitude(fit, fit.imitated(columns))
    members = _members(estimate, names, matrix, scales.logarithmic, log_costs or {})
    if mode is not None:
        here = np.arange(len(index), columns.shape[-1])
        members.append(
            fixed_member(mode.name, here, here[:0], matrix, log_cost=np.log(mode.trials))
        )
    return LinearModel(
        fit=fit,
        system=_with_parameters(matrix, gradient, moved),
        columns=columns,
        members=tuple(members),
        held=at,
        amplitude=amplitude,
        offset=before - estimate.objective - float(linear) if len(at) else 0.0,
        null=estimate.theta[: len(moved)] + moved[:, at] @ amplitude,
        covariance=_covariance(fit),
    )


class _Scales(NamedTuple):
    """Of all parameters of a model, in sds of the priors as stated.

    `slope` (d,): of the distance per unit; `amplitude` (d,): the distance from null; `precision`
    (d,): of the prior that was used; `logarithmic` (d,): whether it gives a shape.
    """

    slope: np.ndarray
    amplitude: np.ndarray
    precision: np.ndarray
    logarithmic: np.ndarray


def _scales(estimate: Estimate) -> _Scales:
    space = estimate.model.space
    slope, distance = prior_rows(estimate.model, estimate.theta)
    wider = np.ones(space.size)
    for effect in estimate.model.effects:
        wider[space.slice_of(effect.name)] = effect.prior_scale
    logarithmic = np.array([prior.logarithmic for prior in space.priors])
    wider[logarithmic] = 1.0
    return _Scales(slope * wider, distance * wider, wider**-2.0, logarithmic)


def _part(estimate: Estimate, name: str) -> np.ndarray:
    """Where an effect's parameters stand."""
    part = estimate.model.space.slice_of(name)
    return np.arange(part.start, part.stop)


def _own(estimate: Estimate, held: Sequence[str]) -> np.ndarray:
    """Where the parameters of effects stand, one after the other."""
    return np.concatenate([np.array([], int), *(_part(estimate, name) for name in held)])


def _names(estimate: Estimate, held: Sequence[str], projected: np.ndarray) -> list[str]:
    """Effects with parameters that are not projected off."""
    names = [effect.name for effect in estimate.model.effects]
    parts = {name: _part(estimate, name) for name in names}
    return [
        name
        for name, part in parts.items()
        if len(part) and (name in held or not np.isin(part, projected).any())
    ]


def _members(
    estimate: Estimate,
    names: Sequence[str],
    matrix: np.ndarray,
    logarithmic: np.ndarray,
    log_costs: Mapping[str, float],
) -> list[FixedMember]:
    """The effects of a fixed shape, their columns one after the other."""
    space, members, first = estimate.model.space, [], 0
    for name in names:
        part = _part(estimate, name)
        here, shape = np.arange(first, first + len(part)), logarithmic[part]
        sided = len(part) == 1 and space.lower[part[0]] == space.nulls[part[0]]
        members.append(
            fixed_member(
                name,
                here[~shape],
                here[shape],
                matrix,
                one_sided=bool(sided),
                log_cost=log_costs.get(name, 0.0),
            )
        )
        first += len(part)
    return members


def _shift_per_amplitude(fit: LinearisedFit, imitated: np.ndarray) -> np.ndarray:
    """How far what is left out moves J and K (9, c) per unit; zero where they are held.

    `imitated` (unknowns, c): the share of its columns that the fit imitates.
    """
    n, free = fit.model.n_base, fit.free
    out, base = np.zeros((n, imitated.shape[1])), free < n
    out[free[base]] = (fit.inverse_root.T @ imitated)[: len(free)][base]
    return out


def _with_parameters(matrix: np.ndarray, gradient: np.ndarray, moved: np.ndarray) -> System:
    """S and u with J and K, which amplitudes move (9, c), as further columns."""
    return System(
        np.block([[matrix, moved.T], [moved, np.zeros((len(moved), len(moved)))]]),
        np.concatenate([gradient, np.zeros(len(moved))]),
    )


def _covariance(fit: LinearisedFit) -> np.ndarray:
    """Covariance (9, 9) of J and K if nothing acts; zero where they are held."""
    n = fit.model.n_base
    covariance, base = np.zeros((n, n)), fit.free[fit.free < n]
    whole = fit.inverse_root.T @ fit.inverse_root
    covariance[np.ix_(base, base)] = whole[: len(base), : len(base)]
    return covariance


def parameters_of(linear: LinearModel, given: Given) -> tuple[np.ndarray, np.ndarray]:
    """Mean (9,) and covariance (9, 9) of J and K given members, averaged over their sizes."""
    weights = np.exp(given.log_weight - logsumexp(given.log_weight))
    n = len(linear.null)
    mean, spread, within = mixed(weights, given.gradient[:, -n:], given.matrix[:, -n:, -n:])
    return linear.null + mean, linear.covariance - within + spread


def mixed(
    weights: np.ndarray, means: np.ndarray, matrices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (n,) of a mixture with weights (b,), the spread (n, n) of its means, its mean matrix."""
    mean = weights @ means
    spread = np.einsum("b,bi,bj->ij", weights, means - mean, means - mean)
    return mean, spread, np.einsum("b,bij->ij", weights, matrices)


def random_members(
    linear: LinearModel,
    response: TorqueResponse,
    effects: Sequence[StochasticEffect],
    *,
    nameless: bool = True,
    driven: bool = True,
) -> tuple[RandomMember, ...]:
    """Random effects, and shapes without a name, beside the effects of a fixed shape.

    `driven`: whether a shape may follow something known; not where formulas say what it follows.
    """
    forget_surplus(PROGRAMS)
    fit = linear.fit
    numbers = fit.residual.size
    shapes = (TachometerShape(),) if nameless else ()
    both = (*usable(effects, fit.model, numbers), *usable(shapes, fit.model, numbers))
    model = Model(fit.model.campaign, both, fit.model.structure.drive)
    roots = [roots_at(model, x) for x in LIMITS.shapes]
    members: list[RandomMember] = []
    unnamed: dict[str, list[tuple[Signal, float]]] = {}
    for i, effect in enumerate(both):
        source = source_of(effect)
        if isinstance(effect, TachometerShape) and source in unnamed:
            continue
        columns = coefficient_columns(response, effect)
        if not columns.any():
            continue
        own, signal = [of_all[i] for of_all in roots], _projected(linear, columns)
        if not isinstance(effect, TachometerShape):
            kept = len(linear.held) == 0 and _numbers(own, both) <= LIMITS.largest_matrices
            members.append(_random(effect, model, signal, own, kept=kept))
        if nameless and own[0].blocks.shape[-1] > 1 and source not in unnamed:
            unnamed[source] = _free(effect, model, signal, own)
    if nameless:
        for source, forms in (_driven(linear, response) if driven else {}).items():
            unnamed.setdefault(source, []).extend((x, -np.log(len(forms))) for x in forms)
    members += [
        RandomMember(NAMELESS[s], [x for x, _ in forms], np.array([w for _, w in forms]), s)
        for s, forms in unnamed.items()
    ]
    return tuple(members)


def _numbers(roots: Sequence[CandidateRoots], effects: Sequence[StochasticEffect]) -> int:
    """Numbers in the bases of all forms of all effects, were they all like this one."""
    slews, blocks, size, _ = roots[0].blocks.shape
    return len(effects) * len(roots) * (slews * blocks * size) ** 2


def candidate_of(member: RandomMember, log_bayes_factor: float) -> StochasticCandidate:
    """A member as a candidate, begun where its evidence is largest."""
    start: tuple[float, ...] = ()
    if member.starts is not None:
        start = tuple(member.starts[np.argmax(log_evidence_of_random(member))].tolist())
    name = "" if member.name in NAMELESS.values() else member.name
    return StochasticCandidate(name, member.source, log_bayes_factor, start)


def log_evidence_of_each(linear: LinearModel) -> dict[str, float]:
    """Log evidence of every effect of a fixed shape against nothing."""
    begin = nothing(linear.system)
    return {member.name: log_evidence_of(begin, [member]) for member in linear.members}


def stochastic_candidates(
    linear: LinearModel, estimate: Estimate, effects: Sequence[StochasticEffect]
) -> tuple[StochasticCandidate, ...]:
    """Weigh effects without a fixed shape at a fit, best evidence first."""
    members = random_members(linear, torque_response(estimate), effects, nameless=False)
    found = [candidate_of(m, float(logsumexp(log_evidence_of_random(m)))) for m in members]
    return tuple(sorted(found, key=lambda c: -c.log_bayes_factor))


def _random(
    effect: StochasticEffect,
    model: Model,
    signal: ProjectedSignal,
    roots: Sequence[CandidateRoots],
    *,
    kept: bool,
) -> RandomMember:
    """A random effect; `roots` are its own at each of `LIMITS.shapes`.

    `kept`: whether bases are, from which campaigns are simulated.
    """
    own, largest = forms_of(effect, model, roots), largest_size(effect, model)
    forms = [_signal(signal, root, largest, kept=kept) for root in own.roots]
    n = signal.gradient.size
    matrix = signal.matrix.reshape(n, n) if kept else None
    starts = [
        parameters_at(model, effect, size, shape)
        for form, shape in zip(forms, own.shapes, strict=True)
        for size in form.sizes
    ]
    source = source_of(effect)
    return RandomMember(effect.name, forms, own.log_odds, source, np.array(starts), matrix)


def _free(
    effect: StochasticEffect, model: Model, signal: ProjectedSignal, roots: Sequence[CandidateRoots]
) -> list[tuple[Signal, float]]:
    """Smooth signals where an effect on knots enters, and such that repeat in every slew."""
    largest = largest_size(effect, model)
    smooth = smooth_roots(roots[LIMITS.shapes.index(0.0)].blocks)
    same = signal.repeated()
    forms = [_signal(signal, dense(root), largest) for root in smooth]
    forms += [_signal(same, dense(root[:1]), largest) for root in smooth]
    return [(form, -np.log(len(smooth))) for form in forms]


def _projected(linear: LinearModel, columns: np.ndarray) -> ProjectedSignal:
    """Coefficients of all slews; the last nine of their products are how they move J and K."""
    fit, imitated = linear.fit, imitated_share(linear.fit, columns)
    signal = projected_signal(fit, columns, imitated)
    cross = np.swapaxes(columns, 1, 2) @ linear.columns
    cross -= (imitated.T @ fit.imitated(linear.columns)).reshape(cross.shape)
    gradient = signal.gradient + cross[..., linear.held] @ linear.amplitude
    moved = _shift_per_amplitude(fit, imitated)
    cross = np.concatenate([cross, moved.T.reshape(*cross.shape[:2], len(moved))], -1)
    return ProjectedSignal(gradient, signal.matrix, cross)


def _signal(
    projected: ProjectedSignal, root: np.ndarray, largest: float, *, kept: bool = False
) -> Signal:
    """One form; `root` of each slew (slews, k, k), or of all slews (slews k, slews k)."""
    root = block_diag(*root) if root.ndim == 3 else root
    n, cross = len(root), projected.cross
    assert cross is not None
    matrix, gradient = projected.matrix.reshape(n, n), projected.gradient.ravel()
    found = signal_of(matrix, gradient, cross.reshape(n, -1), root, largest)
    return found if kept else replace(found, basis=np.zeros((0, len(found.powers))))


def _driven(linear: LinearModel, response: TorqueResponse) -> dict[str, list[Signal]]:
    """Disturbances in proportion to something known, along any axes: by where they enter."""
    found: dict[str, list[Signal]] = {}
    for block in told_blocks(response):
        formula = block.formula
        if (formula.place, formula.driver) not in DRIVEN_BY_LIBRARY:
            signal = _projected(linear, block.columns).repeated()
            one = np.eye(block.columns.shape[-1])[None]
            source = SOURCES[PLACES[formula.place].hook]
            found.setdefault(source, []).append(_signal(signal, one, 1.0))
    return found
