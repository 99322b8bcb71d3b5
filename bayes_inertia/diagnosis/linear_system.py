"""The linear model of everything that may be missing, at a fit: from which hypotheses are weighed.

Columns of all effects of the library, everything fitted projected off. Effects that the fit holds
are members too: they are not projected off, and the data are those before they were fitted. Gains
are measured against a fit without any effect: what a linear model cannot see of that is one number
for all sets. What else may act, random signals and formulas, is projected beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.diagnosis.candidates import FlexibleModeCandidate
from bayes_inertia.diagnosis.hypothesis_table import (
    FixedMember,
    Given,
    System,
    fixed_member,
    visible,
)
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.objective import prior_root, prior_rows
from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class ProjectedSignal:
    """Coefficients of all slews, everything fitted projected off.

    Parameters
    ----------
    gradient : (slews, k) array
        g, by slew.
    matrix : (slews, k, slews, k) array
        A: what is fitted in common couples slews.
    cross : (slews, k, c) array
        Their products with the columns of effects of a fixed shape.
    """

    gradient: np.ndarray
    matrix: np.ndarray
    cross: np.ndarray

    def repeated(self) -> ProjectedSignal:
        """The same if the coefficients are one draw for all slews."""
        return ProjectedSignal(
            self.gradient.sum(0, keepdims=True),
            self.matrix.sum((0, 2))[None, :, None],
            self.cross.sum(0, keepdims=True),
        )


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
    null : (9,) array
        J and K if nothing acts.
    root : (9, unknowns) array
        R, R R^T their covariance then; R times what the fit imitates of a column is how far the
        column's amplitude moves J and K.
    mode : FlexibleModeCandidate or None
        The flexible mode among them.
    """

    fit: LinearisedFit
    system: System
    columns: np.ndarray
    members: tuple[FixedMember, ...]
    held: np.ndarray
    amplitude: np.ndarray
    offset: float
    null: np.ndarray
    root: np.ndarray
    mode: FlexibleModeCandidate | None = None

    @cached_property
    def imitated(self) -> np.ndarray:
        """What the fit imitates (unknowns, c) of the columns."""
        return self.fit.imitated(self.columns)

    @cached_property
    def told_by_data(self) -> np.ndarray:
        """S (c, c) without what only the prior of J and K tells of amplitudes.

        A gain that scales J with everything else is seen by that prior alone.
        """
        base = len(self.null)
        prior = prior_root(self.fit.model, self.fit.point.theta)[:base, :base]
        moved, own = prior @ self.system.matrix[-base:], prior @ self.root
        of_data = np.linalg.pinv(np.eye(base) - own @ own.T, 1e-9, hermitian=True)
        return self.system.matrix - moved.T @ of_data @ moved

    def projected(self, columns: np.ndarray) -> ProjectedSignal:
        """A signal, as `projected_signal`, beside the effects; J and K are last of these.

        The data are those before the effects were fitted.
        """
        alone, imitated = projected_signal(self.fit, columns)
        cross = np.swapaxes(columns, 1, 2) @ self.columns
        cross -= (imitated.T @ self.imitated).reshape(cross.shape)
        gradient = alone.gradient + cross[..., self.held] @ self.amplitude
        moved = (self.root @ imitated).T.reshape(*gradient.shape, -1)
        return ProjectedSignal(gradient, alone.matrix, np.concatenate([cross, moved], -1))


def projected_signal(fit: LinearisedFit, columns: np.ndarray) -> tuple[ProjectedSignal, np.ndarray]:
    """Project everything fitted off a signal, beside no effect.

    `columns` (slews, numbers, k): changes of its whitened residuals by the coefficients of each
    slew. Returns: the signal; the share (unknowns, slews k) of each slew's columns that the fit
    imitates.
    """
    slews, _, k = columns.shape
    gradient, matrix = np.zeros((slews, k)), np.zeros((slews, k, slews, k))
    imitated = np.zeros((len(fit.inverse_root), slews, k))
    for s, own in enumerate(columns):
        gradient[s] = own.T @ fit.residual[s]
        matrix[s, :, s] = own.T @ own
        imitated[fit.index(s), s] = fit.columns[s].T @ own
    imitated = fit.inverse_root @ imitated.reshape(len(imitated), -1)
    matrix -= (imitated.T @ imitated).reshape(matrix.shape)
    fitted = (imitated.T @ fit.whitened_gradient).reshape(slews, k)
    return ProjectedSignal(fitted - gradient, matrix, np.zeros((slews, k, 0))), imitated


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
    space = estimate.model.space
    slope, distance, precision = _scales(estimate)
    parts = {e.name: np.arange(space.size)[space.slice_of(e.name)] for e in estimate.model.effects}
    own = np.isin(np.arange(space.size), [i for name in held for i in parts[name]])
    fit = (linearised or estimate.linearised()).without(np.flatnonzero(own))
    # Effects with parameters that are not projected off.
    parts = {name: p for name, p in parts.items() if len(p) and not np.isin(p, fit.free).any()}
    index = np.array([i for part in parts.values() for i in part], int)
    columns = fit.parameters[..., index] / slope[index]
    if mode is not None:
        columns = np.concatenate([columns, mode.columns], -1)
    matrix, gradient = fit.projected(columns)
    at = np.flatnonzero(own[index])
    amplitude = distance[index[at]]
    # The data are those before the effects were fitted.
    gradient = gradient + matrix[:, at] @ amplitude
    block = matrix[np.ix_(at, at)] + np.diag(precision[index[at]])
    linear = 0.5 * gradient[at] @ np.linalg.solve(block, gradient[at])
    root = _root_of_parameters(fit)
    moved = root @ fit.imitated(columns)
    model = LinearModel(
        fit=fit,
        system=_with_parameters(matrix, gradient, moved),
        columns=columns,
        members=tuple(_members(estimate, parts, matrix, log_costs or {}, mode)),
        held=at,
        amplitude=amplitude,
        offset=before - estimate.objective - float(linear) if len(at) else 0.0,
        null=estimate.theta[: len(moved)] + moved[:, at] @ amplitude,
        root=root,
        mode=mode,
    )
    return _without_scales(model, held)


def _without_scales(model: LinearModel, held: Sequence[str]) -> LinearModel:
    """The model without effects that the prior of J alone sees, as the gain of the one device.

    J is told on the scale of what such a gain would change: that is said of the result.
    """
    each, scales = (model.system.matrix, model.told_by_data), list[str]()
    for member in model.members:
        seen, by_data = (len(visible(matrix, member.index)[0]) for matrix in each)
        scales += [member.name] if seen and not by_data and member.name not in held else []
    kept = tuple(member for member in model.members if member.name not in scales)
    return replace(model, members=kept) if scales else model


def _scales(estimate: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of all parameters of a model (d,), in sds of the priors as stated.

    Returns: slope of the distance per unit; the distance from null; precision of the prior that was
    used.
    """
    space = estimate.model.space
    slope, distance = prior_rows(estimate.model, estimate.theta)
    wider = np.ones(space.size)
    for effect in estimate.model.effects:
        wider[space.slice_of(effect.name)] = effect.prior_scale
    wider[np.asarray(space.marginals()["logarithmic"])] = 1.0
    return slope * wider, distance * wider, wider**-2.0


def _members(
    estimate: Estimate,
    parts: Mapping[str, np.ndarray],
    matrix: np.ndarray,
    log_costs: Mapping[str, float],
    mode: FlexibleModeCandidate | None,
) -> Iterator[FixedMember]:
    """The effects of a fixed shape, their columns one after the other."""
    space, first = estimate.model.space, 0
    logarithmic = np.asarray(space.marginals()["logarithmic"])
    for name, part in parts.items():
        here, shape = np.arange(first, first + len(part)), logarithmic[part]
        sided = len(part) == 1 and space.lower[part[0]] == space.nulls[part[0]]
        own, cost = (here[~shape], here[shape]), log_costs.get(name, 0.0)
        yield fixed_member(name, *own, matrix, one_sided=bool(sided), log_cost=cost)
        first += len(part)
    if mode is not None:
        here = np.arange(first, first + mode.columns.shape[-1])
        searched = {"log_cost": np.log(mode.trials), "log_elsewhere": float(np.log(mode.elsewhere))}
        yield fixed_member(mode.name, here, here[:0], matrix, **searched)


def _root_of_parameters(fit: LinearisedFit) -> np.ndarray:
    """R (9, unknowns) of J and K; zero where they are held."""
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
    return linear.null + mean, linear.root @ linear.root.T - within + spread


def mixed(
    weights: np.ndarray, means: np.ndarray, matrices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (n,) of a mixture with weights (b,), the spread (n, n) of its means, its mean matrix."""
    mean = weights @ means
    spread = np.einsum("b,bi,bj->ij", weights, means - mean, means - mean)
    return mean, spread, np.einsum("b,bij->ij", weights, matrices)
