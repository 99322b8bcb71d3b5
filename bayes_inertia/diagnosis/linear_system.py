"""The linear model of everything that may be missing, at a fit: from which hypotheses are weighed.

Columns of all effects of the library, of random signals and of shapes without a name, everything
fitted projected off. Effects that the fit holds are members too: they are not projected off, and
the data are those before they were fitted. Gains are measured against a fit without any effect:
what a linear model cannot see of that is one number for all sets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain

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
    nothing,
    signal_of,
)
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.random_signals import (
    NAMELESS,
    SOURCES,
    CandidateRoots,
    ProjectedSignal,
    TachometerShape,
    dense,
    forms_of,
    largest_size,
    parameters_at,
    projected_signal,
    roots_at,
    smooth_roots,
    usable,
)
from bayes_inertia.diagnosis.torque_response import PROGRAMS, TorqueResponse, coefficient_columns
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
    slope, distance, precision, logarithmic = _scales(estimate)
    own = _own(estimate, *held)
    fit = (linearised or estimate.linearised()).without(own)
    names = _names(estimate, held, fit.free)
    index = _own(estimate, *names)
    columns = fit.parameters[..., index] / slope[index]
    if mode is not None:
        columns = np.concatenate([columns, mode.columns], -1)
    matrix, gradient = fit.projected(columns)
    at = np.flatnonzero(np.isin(index, own))
    amplitude = distance[index[at]]
    # The data are those before the effects were fitted.
    gradient = gradient + matrix[:, at] @ amplitude
    block = matrix[np.ix_(at, at)] + np.diag(precision[index[at]])
    linear = 0.5 * gradient[at] @ np.linalg.solve(block, gradient[at])
    root = _root_of_parameters(fit)
    moved = root @ fit.imitated(columns)
    members = _members(estimate, names, matrix, logarithmic, log_costs or {})
    if mode is not None:
        here, cost = np.arange(len(index), columns.shape[-1]), np.log(mode.trials)
        members.append(fixed_member(mode.name, here, here[:0], matrix, log_cost=cost))
    return LinearModel(
        fit=fit,
        system=_with_parameters(matrix, gradient, moved),
        columns=columns,
        members=tuple(members),
        held=at,
        amplitude=amplitude,
        offset=before - estimate.objective - float(linear) if len(at) else 0.0,
        null=estimate.theta[: len(moved)] + moved[:, at] @ amplitude,
        covariance=root @ root.T,
    )


def _scales(estimate: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of all parameters of a model (d,), in sds of the priors as stated.

    Returns: slope of the distance per unit; the distance from null; precision of the prior that was
    used; whether a parameter is logarithmic: gives a shape.
    """
    space = estimate.model.space
    slope, distance = prior_rows(estimate.model, estimate.theta)
    wider = np.ones(space.size)
    for effect in estimate.model.effects:
        wider[space.slice_of(effect.name)] = effect.prior_scale
    logarithmic = np.array([prior.logarithmic for prior in space.priors])
    wider[logarithmic] = 1.0
    return slope * wider, distance * wider, wider**-2.0, logarithmic


def _own(estimate: Estimate, *names: str) -> np.ndarray:
    """Where the parameters of effects stand, one after the other."""
    space = estimate.model.space
    every = np.arange(space.size)
    return np.concatenate([every[:0], *(every[space.slice_of(name)] for name in names)])


def _names(estimate: Estimate, held: Sequence[str], projected: np.ndarray) -> list[str]:
    """Effects with parameters that are not projected off."""
    parts = {effect.name: _own(estimate, effect.name) for effect in estimate.model.effects}
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
        part = _own(estimate, name)
        here, shape = np.arange(first, first + len(part)), logarithmic[part]
        sided = len(part) == 1 and space.lower[part[0]] == space.nulls[part[0]]
        own, cost = (here[~shape], here[shape]), log_costs.get(name, 0.0)
        members.append(fixed_member(name, *own, matrix, one_sided=bool(sided), log_cost=cost))
        first += len(part)
    return members


def _root_of_parameters(fit: LinearisedFit) -> np.ndarray:
    """R (9, unknowns), R R^T the covariance of J and K if nothing acts; zero where they are held.

    R times what the fit imitates of a column is how far the column's amplitude moves J and K.
    """
    base = fit.free < fit.model.n_base
    root = np.zeros((fit.model.n_base, len(fit.inverse_root)))
    root[fit.free[base]] = fit.inverse_root.T[: len(base)][base]
    return root


def _with_parameters(matrix: np.ndarray, gradient: np.ndarray, moved: np.ndarray) -> System:
    """S and u with J and K, which amplitudes move (9, c), as further columns."""
    of_both = np.zeros((len(moved), len(moved)))
    whole = np.block([[matrix, moved.T], [moved, of_both]])
    return System(whole, np.append(gradient, of_both[0]))


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
    unnamed: dict[str, list[list[Signal]]] = {}
    for i, effect in enumerate(both):
        source = next(name for hook, name in SOURCES.items() if effect.acts(hook))
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
    for source, forms in (_driven(linear, response) if nameless and driven else {}).items():
        unnamed.setdefault(source, []).append(forms)
    for source, groups in unnamed.items():
        # Smooth, repeated, in proportion to something known: each kind is as probable.
        odds = np.concatenate([np.full(len(forms), -np.log(len(forms))) for forms in groups])
        members.append(RandomMember(NAMELESS[source], [*chain(*groups)], odds))
    return tuple(members)


def _numbers(roots: Sequence[CandidateRoots], effects: Sequence[StochasticEffect]) -> int:
    """Numbers in the bases of all forms of all effects, were they all like this one."""
    slews, blocks, size, _ = roots[0].blocks.shape
    return len(effects) * len(roots) * (slews * blocks * size) ** 2


def log_evidence_of_each(linear: LinearModel) -> dict[str, float]:
    """Log evidence of every effect of a fixed shape against nothing."""
    begin = nothing(linear.system)
    return {member.name: log_evidence_of(begin, [member]) for member in linear.members}


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
    return RandomMember(effect.name, forms, own.log_odds, np.array(starts), matrix)


def _free(
    effect: StochasticEffect, model: Model, signal: ProjectedSignal, roots: Sequence[CandidateRoots]
) -> list[list[Signal]]:
    """Smooth signals where an effect on knots enters, and such that repeat in every slew."""
    largest = largest_size(effect, model)
    smooth = smooth_roots(roots[LIMITS.shapes.index(0.0)].blocks)
    same = signal.repeated()
    return [
        [_signal(signal, dense(root), largest) for root in smooth],
        [_signal(same, dense(root[:1]), largest) for root in smooth],
    ]


def _projected(linear: LinearModel, columns: np.ndarray) -> ProjectedSignal:
    """Coefficients of all slews; the last nine of their products are how they move J and K."""
    signal, imitated = projected_signal(linear.fit, columns, linear.columns)
    gradient = signal.gradient + signal.cross[..., linear.held] @ linear.amplitude
    moved = _root_of_parameters(linear.fit) @ imitated
    moved = moved.T.reshape(*gradient.shape, len(moved))
    return ProjectedSignal(gradient, signal.matrix, np.concatenate([signal.cross, moved], -1))


def _signal(
    projected: ProjectedSignal, root: np.ndarray, largest: float, *, kept: bool = False
) -> Signal:
    """One form; `root` of each slew (slews, k, k), or of all slews (slews k, slews k)."""
    root = block_diag(*root) if root.ndim == 3 else root
    n, cross = len(root), projected.cross
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
