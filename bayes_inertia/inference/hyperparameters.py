"""Sizes and times of stochastic effects: the evidence of the data for them, and its maximum.

The parameters of a stochastic effect fix the prior of its coefficients and nothing else. The joint
posterior of both has no useful maximum (it grows where coefficients become likely), so they are
moved by the evidence: the data's probability with everything else integrated out, to first order
around a point (MacKay 1992, "Bayesian interpolation"; type II maximum likelihood with a prior).
They are counted in prior sds from the centres of their priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular
from scipy import optimize
from scipy.linalg import block_diag

from bayes_inertia.errors import EstimateError
from bayes_inertia.inference.likelihood import (
    Information,
    Point,
    information_blocks,
    unpadded_sensitivities,
)
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.marginal_posterior import (
    EliminatedSlews,
    Roots,
    SlewEquations,
    eliminated,
    eliminated_at_once,
    log_integral,
    prior_roots,
    root_change,
    times,
)
from bayes_inertia.inference.noise_model import (
    ChannelProcess,
    Whitening,
    Whitenings,
    coefficients_of,
    estimated_noise,
    filter_of,
    in_states,
    innovations,
    processes_of_effects,
    readings_of,
    rows_of,
    wandering_noise,
)
from bayes_inertia.inference.objective import prior_equations, prior_rows
from bayes_inertia.maths.device_arrays import (
    filled,
    in_batches,
    on_device,
    padded,
    padded_size,
    repeated,
)
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import Structure
from bayes_inertia.physics.processes import RowTimes, StateSpace
from bayes_inertia.physics.slew_context import SlewContext


class SharedFirst(NamedTuple):
    """Unknowns in prior sds, in the order in which they are eliminated: what slews share first.

    Parameters
    ----------
    scale : (f + n_bias + n_local,) array
        One prior sd of (theta[free], bias, own nuisances).
    order : (f + n_bias + n_local,) array of int
        Where each stands among those: the bias, theta[free], own nuisances.
    precision : (n_bias + f,) squared array
        Of the prior of what slews share, in that order.
    gradient : (n_bias + f,) array
        Of the same.
    """

    scale: np.ndarray
    order: np.ndarray
    precision: np.ndarray
    gradient: np.ndarray


def shared_first(model: Model, point: Point, free: np.ndarray) -> SharedFirst:
    """How unknowns are scaled and ordered, so that the matrix of what slews share is well scaled.

    `free` (f,).
    """
    slope = prior_rows(model, point.theta)[0][free]
    precision, gradient = prior_equations(model, point.theta, free)
    unit = np.where(slope != 0.0, slope, 1.0)
    f, b = len(free), len(point.bias)
    end = f + b + point.n_local
    return SharedFirst(
        np.concatenate([1.0 / unit, np.ones(b + point.n_local)]),
        np.r_[f : f + b, :f, f + b : end],
        block_diag(np.eye(b), precision / np.outer(unit, unit)),
        np.concatenate([point.bias, gradient / unit]),
    )


def without_hyperparameters(model: Model, free: np.ndarray) -> np.ndarray:
    """Parameters that change the signal of an effect, not only the prior of its coefficients.

    `free` (f,). Returns (g,): the very array where the model has no stochastic effect.
    """
    fixed = model.structure.hyperparameters
    return free if not fixed else free[~np.isin(free, fixed)]


class FilteredRows(NamedTuple):
    """Readings of one channel out of which processes are filtered, of whatever sizes.

    Parameters
    ----------
    columns : (slews, n, c, 1 + k) array
        Whitened residuals where nothing is filtered, then their derivatives.
    at : (k,) array of int
        Places of these unknowns in the equations.
    valid : (slews, n, c) array of bool
        What was measured.
    rows : RowTimes
    variance, white : (c,) arrays
        As of `WanderingNoise`.
    known : tuple of StateSpace
        Processes whose sizes are not learnt.
    """

    columns: AnyArray
    at: AnyArray
    valid: AnyArray
    rows: RowTimes
    variance: AnyArray
    white: AnyArray
    known: tuple[StateSpace, ...]


class FrozenEvidence(NamedTuple):
    """What the evidence needs: a pytree of JAX.

    Its shapes are those of the model, whichever of its parameters may move: all share one program.

    Parameters
    ----------
    equations : SlewEquations
        What slews share stands in this order: the bias, then the parameters that are not learnt
        here, in units of `scale`. Those that may not move stand last, and no data speak of them.
    inverse_roots : tuple of (slews, b, m, m) arrays
        Inverses of the roots of the coefficients' prior covariance at the point.
    theta : (d,) array
        The point's parameters.
    free, learnt : (f,), (h,) array of int
        Indices of all parameters that shape signals, and of all those of stochastic effects.
    scale : (f,) array
        Of the former: one prior sd.
    priors : dict of (h,) arrays
        Of the latter, as `ParameterSpace.marginals`.
    contexts : SlewContext
        With the slews as leading axis.
    filtered : dict of FilteredRows
        By channel, what the equations lack; empty where nothing is filtered whole.
    """

    equations: SlewEquations
    inverse_roots: Roots
    theta: AnyArray
    free: AnyArray
    learnt: AnyArray
    scale: AnyArray
    priors: dict[str, AnyArray]
    contexts: SlewContext
    filtered: dict[str, FilteredRows]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data's evidence for parameters of stochastic effects, to first order around a point.

    Parameters
    ----------
    model : Model
    point : Point
        Where the derivatives were taken.
    white : tuple of Whitening
        The noise as used.
    free : (f,) array of int
        Indices of all parameters that may move.
    whole : bool
        Whether processes of readings are filtered whole, whatever their size: nothing that they do
        between knots is left out. Else they act through their coefficients, as where J and K are
        sampled, and what they do between knots stays as it is used.
    """

    model: Model
    point: Point
    white: Whitenings
    free: np.ndarray
    whole: bool = False

    @property
    def shaped(self) -> np.ndarray:
        """Those that are not learnt here."""
        return without_hyperparameters(self.model, self.free)

    @property
    def learnt(self) -> np.ndarray:
        """Indices of the parameters of stochastic effects that may move."""
        return np.setdiff1d(self.free, self.shaped)

    @cached_property
    def information(self) -> Information:
        """Normal equations of the parameters that are not learnt here."""
        return information_blocks(self.model, self.point, self.white, self.shaped)

    @cached_property
    def hyperparameters(self) -> np.ndarray:
        """Indices (h,) of all parameters of stochastic effects."""
        return np.array(self.model.structure.hyperparameters)

    @cached_property
    def priors(self) -> dict[str, np.ndarray]:
        """Of all parameters of stochastic effects, as `ParameterSpace.marginals`."""
        marginals = self.model.space.marginals().items()
        return {key: np.asarray(values)[self.hyperparameters] for key, values in marginals}

    def standardised(self, theta: np.ndarray) -> np.ndarray:
        """The parameters of stochastic effects (..., h) of all (..., d), in prior sds."""
        priors, value = self.priors, np.asarray(theta)[..., self.hyperparameters]
        logarithmic = priors["logarithmic"]
        value = np.where(logarithmic, np.log(np.where(logarithmic, value, 1.0)), value)
        return (value - priors["mean"]) / priors["scale"]

    def theta(self, standardised: np.ndarray) -> np.ndarray:
        """The point's parameters (..., d) with others of stochastic effects (..., h)."""
        return _theta(self.priors, self.hyperparameters, self.point.theta, standardised)

    @cached_property
    def frozen(self) -> FrozenEvidence:
        """What compiled functions are given."""
        model, point, moving = self.model, self.point, self.shaped
        shaped = without_hyperparameters(model, np.arange(model.space.size))
        held = np.setdiff1d(shaped, moving)
        f, unknowns = len(moving), shared_first(model, point, moving)
        of_held, at = np.zeros(len(held)), len(point.bias) + f
        # Between what slews share and the nuisances of each.
        places = np.full(len(held), at)
        standing = estimated_noise(model, point.theta) if self.whole else ()
        chi2, matrix, gradient, filtered = (
            self._unfiltered(unknowns, standing, len(held))
            if standing
            else self._known_noise(unknowns)
        )
        rows = np.insert(matrix, places, 0.0, axis=1)
        numbers = (
            chi2,
            np.insert(rows, places, 0.0, axis=2),
            np.insert(gradient, places, 0.0, axis=1),
            block_diag(unknowns.precision, np.eye(len(held))),
            np.concatenate([unknowns.gradient, of_held]),
            0.0,
            np.where(coefficients_of(model, standing), 0.0, point.local),
        )
        roots = prior_roots(model.structure, point.theta, model.data.contexts)
        equations = SlewEquations(*(np.asarray(x, float) for x in numbers))
        # Slews of which no data speak, so that a few numbers of slews share a program.
        size = padded_size(model.n_slews, 1, often=True)
        idle = {k: filled(getattr(equations, k), size, 0) for k in ("matrix", "gradient", "local")}
        frozen = FrozenEvidence(
            equations._replace(**idle),
            tuple(repeated(np.linalg.inv(root), size, 0) for root in roots),
            point.theta,
            np.concatenate([moving, held]),
            self.hyperparameters,
            np.concatenate([unknowns.scale[:f], of_held + 1.0]),
            self.priors,
            jax.tree.map(lambda x: repeated(x, size, 0), model.data.contexts),
            filtered,
        )
        return jax.tree.map(on_device, frozen)

    def _known_noise(self, unknowns: SharedFirst) -> tuple[Any, ...]:
        """Squares (which say nothing here), matrix and gradient where the noise stays as used."""
        scale, order = unknowns.scale, unknowns.order
        matrix = self.information.matrix.sum(1) * np.outer(scale, scale)
        gradient = (self.information.gradient.sum(1) * scale)[:, order]
        return 0.0, matrix[:, order[:, None], order], gradient, {}

    def _unfiltered(
        self, unknowns: SharedFirst, standing: Sequence[ChannelProcess], held: int
    ) -> tuple[Any, ...]:
        """The same of channels without estimated processes, and the rows of the others.

        Coefficients that stand for processes are left out: their columns are zero.
        """
        model, point, b = self.model, self.point, len(self.point.bias)
        names = {each.process.channel for each in standing}
        white = tuple(
            each._replace(memory=None, density=None) if channel.name in names else each
            for channel, each in zip(model.channels, self.white, strict=True)
        )
        s = unpadded_sensitivities(model, point, white, self.shaped)
        out = coefficients_of(model, standing)
        gone = np.concatenate([np.zeros(len(self.shaped) + b, bool), out])
        kept = np.flatnonzero(~gone[unknowns.order])
        shared = len(self.shaped) + b
        places = np.where(kept < shared, kept, kept + held)
        places = np.concatenate([places, shared + np.arange(held)])
        u = len(unknowns.order)
        products, filtered = np.zeros((model.n_slews, 1 + u, 1 + u)), {}
        for channel, each, r, j in zip(model.channels, white, s.residuals, s.jacobian, strict=True):
            columns = np.asarray(j)
            r = np.asarray(r) - np.einsum("snk,sk->sn", columns[..., gone], point.local[:, out])
            columns = np.where(gone, 0.0, columns * unknowns.scale)[..., unknowns.order]
            if channel.name in names:
                # One shape, whichever parameters may move: columns of those held are zero.
                columns = np.concatenate([r[..., None], columns[..., kept]], -1)
                columns = filled(columns, 1 + len(kept) + held, -1)
                filtered[channel.name] = self._rows(channel, each, columns, places)
            else:
                columns = np.concatenate([r[..., None], columns], -1)
                products = products + np.swapaxes(columns, 1, 2) @ columns
        return products[:, 0, 0].sum(), products[:, 1:, 1:], products[:, 1:, 0], filtered

    def _rows(
        self, channel: Channel, white: Whitening, columns: np.ndarray, places: np.ndarray
    ) -> FilteredRows:
        """What is filtered of one channel (slews, numbers, 1 + k)."""
        model, valid = self.model, readings_of(self.model, channel)
        level = level_used(model, channel, self.point.theta, white)
        noise = wandering_noise(model, channel, self.point.theta, level=level)
        assert noise is not None
        times, measured = rows_of(model), padded(valid)
        size, n = measured.shape[:2]
        rows = RowTimes(filled(repeated(times.times, n), size, 0), filled(times.away, size, 0))
        known = [each.process for each in noise.processes if not each.estimated]
        return FilteredRows(
            padded(columns.reshape(*valid.shape, -1)),
            places,
            measured,
            rows,
            noise.variance,
            noise.white,
            tuple(each.in_rows(rows, noise.variance) for each in known),
        )

    def negative_log(self, standardised: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log evidence and log prior, up to a constant.

        `standardised` (h,) [prior sd]. Returns `slope` (h,).
        """
        at = jnp.asarray(standardised)
        value, slope = _negative_log(self.model.structure, self.frozen, at)
        return float(value), np.asarray(slope)

    def given(self, standardised: np.ndarray) -> GivenSizes:
        """The other parameters given those of stochastic effects (n, h) [prior sd]; of numpy."""
        program = partial(given_sizes, self.model.structure, self.frozen)
        at_once = eliminated_at_once(self.frozen.equations.matrix.size)
        return in_batches(program, standardised, at_once)


def _theta(
    priors: dict[str, AnyArray],
    learnt: AnyArray,
    theta: AnyArray,
    standardised: AnyArray,
    xp: Any = np,
) -> Any:
    """Parameters (..., d) with the learnt ones from standardised ones (..., h)."""
    value, logarithmic = priors["mean"] + priors["scale"] * standardised, priors["logarithmic"]
    value = xp.where(logarithmic, xp.exp(xp.where(logarithmic, value, 0.0)), value)
    value = xp.clip(value, priors["lower"], priors["upper"])
    every = np.arange(len(theta))
    place = xp.minimum(xp.searchsorted(learnt, every), len(learnt) - 1)
    return xp.where(xp.isin(every, learnt), value[..., place], theta)


def _all_but_learnt_eliminated(
    structure: Structure, frozen: FrozenEvidence, standardised: Array
) -> tuple[EliminatedSlews, Array]:
    """The quadratic form, and the log of the norm of what is filtered."""
    theta = _theta(frozen.priors, frozen.learnt, frozen.theta, standardised, jnp)
    change = root_change(structure, frozen.inverse_roots, theta, frozen.contexts)
    equations, norm = frozen.equations, jnp.zeros(())
    processes = processes_of_effects(structure, theta) if frozen.filtered else ()
    for name, own in frozen.filtered.items():
        whole = (x.process._replace(knots=0) for x in processes if x.process.channel == name)
        states = [*own.known, *(x.in_rows(own.rows, own.variance, jnp) for x in whole)]
        memory = filter_of(in_states(states, jnp), own.white, own.valid)
        new = innovations(own.columns, memory)
        products = jnp.einsum("sncp,sncq->spq", new, new)
        norm = norm + jnp.sum(jnp.where(own.valid, jnp.log(memory.scale), 0.0))
        equations = equations._replace(
            chi2=equations.chi2 + jnp.sum(products[:, 0, 0]),
            matrix=equations.matrix.at[:, own.at[:, None], own.at].add(products[:, 1:, 1:]),
            gradient=equations.gradient.at[:, own.at].add(products[:, 1:, 0]),
        )
    return eliminated(change, equations), norm


@KeptProgram
@partial(jax.value_and_grad, argnums=2)
def _negative_log(structure: Structure, frozen: FrozenEvidence, standardised: Array) -> Array:
    parts, norm = _all_but_learnt_eliminated(structure, frozen, standardised)
    return 0.5 * jnp.sum(standardised**2) - log_integral(parts) - norm


class GivenSizes(NamedTuple):
    """The other parameters given those of stochastic effects, to first order: normal.

    Parameters
    ----------
    log_evidence : (n,) array
        Of the learnt parameters, their prior included.
    mean : (n, f) array
        Of the others.
    root : (n, f, f) array
        Lower triangular; root root^T is their precision in units of their prior sds.
    """

    # Of numpy on the host, of JAX in compiled code.
    log_evidence: AnyArray
    mean: AnyArray
    root: AnyArray


@KeptProgram
def given_sizes(structure: Structure, frozen: FrozenEvidence, standardised: Array) -> GivenSizes:
    """What the data say of J, K and the like for given parameters of stochastic effects.

    `standardised` (n, h) [prior sd].
    """

    def at(standardised: Array) -> GivenSizes:
        parts, norm = _all_but_learnt_eliminated(structure, frozen, standardised)
        value = log_integral(parts) + norm - 0.5 * jnp.sum(standardised**2)
        # The bias stands first: the last block of the root is what is left of it.
        b = len(parts.shared_step) - len(frozen.free)
        root, step = parts.shared_root[b:, b:], parts.shared_step[b:]
        move = solve_triangular(root.T, -step, lower=False)
        return GivenSizes(value, frozen.theta[frozen.free] + frozen.scale * move, root)

    return jax.vmap(at)(standardised)


def level_used(model: Model, channel: Channel, theta: np.ndarray, white: Whitening) -> float:
    """Noise of a channel as used over noise as stated, over all slews."""
    noise = channel.noise(model.campaign, theta, model.structure.drive)
    stated = np.square(channel.factors(noise, readings_of(model, channel))).sum()
    return float(np.sqrt(stated / np.square(np.asarray(white.factors)).sum())) if stated else 1.0


def most_probable(evidence: Evidence) -> tuple[Point, float]:
    """The parameters of stochastic effects that the data favour.

    Returns `point`: with them; its coefficients are what they were, whitened anew; `change`: by how
    much the parameters moved, the largest [prior sd].
    """
    begin = evidence.standardised(evidence.point.theta)
    far, moves = LIMITS.farthest_sd, np.isin(evidence.hyperparameters, evidence.free)
    bounds = [(-far, far) if m else (x, x) for x, m in zip(begin, moves, strict=True)]
    best = optimize.minimize(
        evidence.negative_log, begin, jac=True, method="L-BFGS-B", bounds=bounds
    )
    point = with_sizes(evidence.model, evidence.point, evidence.theta(best.x))
    return point, float(np.abs(best.x - begin).max())


def with_sizes(model: Model, point: Point, theta: np.ndarray) -> Point:
    """The same signals where their prior is another.

    `theta` (d,).
    """
    contexts, n = model.data.contexts, model.structure.n_start
    before, after = (prior_roots(model.structure, x, contexts) for x in (point.theta, theta))
    local = np.array(point.local)
    coefficients = times(before, local[:, n:])
    local[:, n:] = times(tuple(map(np.linalg.inv, after)), coefficients)
    return replace(point, theta=theta, local=local)


def information_with_learnt(
    model: Model, point: Point, white: Whitenings, free: np.ndarray
) -> Information:
    """Normal equations in which the learnt parameters have the curvature of their evidence.

    What the evidence tells of them is shared out evenly to slews and counted as of the first
    channel; they are taken as independent of everything else, which is right to first order.

    `free` (f,). Returns: as of `information_blocks` where no parameter of a stochastic effect is
    among them.
    """
    if len(without_hyperparameters(model, free)) == len(free):
        return information_blocks(model, point, white, free)
    evidence = Evidence(model, point, white, free)
    plain = evidence.information
    curvature = curvature_of(evidence)
    slope, distance = prior_rows(model, point.theta)
    to_standardised = slope[evidence.learnt]
    own = np.outer(to_standardised, to_standardised) * (curvature - np.eye(len(to_standardised)))
    learnt, slews = np.searchsorted(free, evidence.learnt), model.n_slews
    at = learnt - np.arange(len(learnt))
    matrix = np.insert(np.insert(plain.matrix, at, 0.0, axis=2), at, 0.0, axis=3)
    gradient = np.insert(plain.gradient, at, 0.0, axis=2)
    matrix[:, 0][:, learnt[:, None], learnt] = own / slews
    gradient[:, 0][:, learnt] = -to_standardised * distance[evidence.learnt] / slews
    return plain._replace(matrix=matrix, gradient=gradient, free=free)


def curvature_of(evidence: Evidence) -> np.ndarray:
    """Second derivatives (h, h) by differences of values, lifted to be positive definite.

    Of the values that the sampler's proposal needs as well: slopes would be a program of their own.
    """
    at, sides = evidence.standardised(evidence.point.theta), np.array([1.0, -1.0])
    moves = np.isin(evidence.hyperparameters, evidence.free)
    steps = np.multiply.outer(sides, LIMITS.size_step * np.eye(len(at))[moves])
    pairs = at + steps[:, None, :, None] + steps[None, :, None, :]
    logs = evidence.given(pairs.reshape(-1, len(at))).log_evidence.reshape(pairs.shape[:-1])
    if not np.all(np.isfinite(logs)):
        names = ", ".join(evidence.model.space.names[i] for i in evidence.hyperparameters)
        raise EstimateError(
            f"the evidence is not finite around its best {names}: the model misses the data by far "
            "more than a disturbance",
            advice="check units and signs of the telemetry columns (`bayes-inertia doctor "
            "CAMPAIGN`), or fit with the effect that is missing",
        )
    hessian = -np.einsum("s,t,stij->ij", sides, sides, logs) / (2.0 * LIMITS.size_step) ** 2
    powers, directions = np.linalg.eigh(0.5 * (hessian + hessian.T))
    powers = np.clip(powers, LIMITS.least_evidence_curvature, LIMITS.least_sd_of_size**-2)
    return (directions * powers) @ directions.T
