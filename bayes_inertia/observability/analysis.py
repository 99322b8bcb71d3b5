"""What a campaign tells about each parameter, and why it does not tell more.

All numbers belong to the Gauss-Newton approximation around an estimate, H = sum A + prior with the information A
of every slew and channel. For parameter i with marginal variance C_ii, the joint direction w = C e_i / C_ii moves
i by one and lets everything else follow as it hides the change best. Then

    1 / C_ii = w^T H w = sum over rows (projected column)^2 + own prior + priors of everything else,

which splits what is known of i, exactly, by slew, by channel and by row of telemetry. What is lost to other
parameters is C_ii H_ii, the variance inflation; it is split among groups by Shapley's value of log variance
(Shapley 1953; for variances Owen 2014), so that the factors multiply to the whole and no order is preferred.

What the feedback controller hides: seen from the attitude alone, a controller makes a wrong J almost invisible,
because it commands whatever torque keeps the slew on its profile. The fit takes the commands as recorded, so that
nothing is hidden from it: the response that the controller removed from the motion stands in the commands. How much
the commands are worth is the sd of a fit that ignores them (measured drive) over that of one that uses them.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from bayes_inertia.errors import EstimateError
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import N_BIAS, block_index, prior_rows
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.observability.degeneracy import EXACT_BELOW, in_words, stated_degeneracies
from bayes_inertia.observability.result import (
    PRIOR_BELOW,
    Arrival,
    Direction,
    Observability,
    ParameterView,
)
from bayes_inertia.physics.packing import CHANNELS

GROUPS = ("J", "K", "initial conditions", "tachometer noise", "rate bias", "effects")


def observe(at: Estimate, other: Estimate | None = None) -> Observability:
    """What the campaign tells about each fitted parameter, and why not more.

    Parameters
    ----------
    at : an estimate.
    other : the same campaign and effects estimated in the other drive, to see what the recorded commands are worth.

    Raises
    ------
    EstimateError : `other` is of other parameters or of the same drive.
    """
    if other is not None and (
        other.model.space.names != at.model.space.names
        or other.model.structure.drive == at.model.structure.drive
    ):
        raise EstimateError(
            "the second estimate is not of the same parameters in the other drive",
            advice="estimate Model(campaign, effects, drive=...)",
        )
    names = [at.model.space.names[i] for i in at.free]
    campaign = at.model.campaign
    return Observability(
        campaign=campaign.name,
        drive=at.model.structure.drive,
        effects=tuple(e.name for e in at.model.effects),
        slews=tuple(s.name for s in campaign.slews),
        parameters=_parameters(at, names, other),
        covariance=at.covariance[np.ix_(at.free, at.free)],
        directions=_directions(at, names),
        degeneracies=stated_degeneracies(at),
        arrivals=_arrivals(at),
        discounted=at.discounted,
    )


def variance_inflation(precision: np.ndarray, groups: list[np.ndarray], wanted: int) -> np.ndarray:
    """Factors (wanted, groups) by which not knowing each group multiplies the variance of the first `wanted` unknowns.

    The product over groups is C_ii H_ii for the precision H (n, n) and C = H^-1; a group that holds i stands for the others in it.

    >>> H = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])
    >>> variance_inflation(H, [np.array([0]), np.array([1]), np.array([2])], 1).round(4).tolist()
    [[1.0, 1.5625, 1.0]]
    """
    n, logs = len(groups), {}
    for mask in range(2**n):
        inside = np.concatenate(
            [g for k, g in enumerate(groups) if mask >> k & 1] or [np.zeros(0, int)]
        ).astype(int)
        logs[mask] = _log_variances(precision, inside, wanted)
    out = np.zeros((wanted, n))
    for k in range(n):
        for mask in (m for m in range(2**n) if not m >> k & 1):
            size = mask.bit_count()
            weight = factorial(size) * factorial(n - size - 1) / factorial(n)
            out[:, k] += weight * (logs[mask | 1 << k] - logs[mask])
    return np.exp(out)


def _log_variances(precision: np.ndarray, uncertain: np.ndarray, wanted: int) -> np.ndarray:
    """Log variances (wanted,) where only `uncertain` and the unknown itself are not known."""
    own = np.diag(precision)[:wanted].copy()
    if not len(uncertain):
        return -np.log(own)
    covariance = inverse(precision[np.ix_(uncertain, uncertain)])
    cross = precision[np.ix_(uncertain, np.arange(wanted))]
    variance = np.zeros(wanted)
    outside = ~np.isin(np.arange(wanted), uncertain)
    variance[outside] = 1.0 / (
        own[outside] - np.einsum("ki,kl,li->i", cross[:, outside], covariance, cross[:, outside])
    )
    for place, i in enumerate(uncertain):
        if i < wanted:
            variance[i] = covariance[place, place]
    return np.log(variance)


def _groups(at: Estimate) -> dict[str, np.ndarray]:
    """Where each group's unknowns stand in the joint vector; groups without any are left out."""
    free, m = at.free, at.point.local.shape[1]
    f, structure = len(free), at.model.structure
    starts = 6 + (structure.wheels if structure.drive == "commanded" else 0)
    local = f + N_BIAS + np.arange(at.point.local.size).reshape(-1, m)
    parts = (
        np.flatnonzero(free < 6),
        np.flatnonzero((free >= 6) & (free < 9)),
        local[:, :starts].ravel(),
        local[:, starts:].ravel(),
    )
    parts = (*parts, f + np.arange(N_BIAS), np.flatnonzero(free >= 9))
    return {name: part for name, part in zip(GROUPS, parts, strict=True) if len(part)}


def _sd_without(at: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """sd (slews, f) without each slew and (3, f) without each channel; NaN for channels without data."""
    f, shape, fit = len(at.free), at.information.n_data.shape, at.linearised()

    def sd(weights: np.ndarray) -> np.ndarray:
        return np.sqrt(np.diag(inverse(fit.weighted_hessian(weights)))[:f])

    slews = np.stack(
        [
            sd(np.where(np.arange(shape[0])[:, None] == s, 0.0, np.ones(shape)))
            for s in range(shape[0])
        ]
    )
    measured = at.information.n_data.any(axis=0)
    channels = [
        sd(np.where(np.arange(3) == c, 0.0, np.ones(shape))) if measured[c] else np.full(f, np.nan)
        for c in range(3)
    ]
    return slews, np.stack(channels)


def _followers(at: Estimate) -> np.ndarray:
    """w (joint, f): how everything follows each parameter, 1 at the parameter itself."""
    f = len(at.free)
    return at.joint_covariance[:, :f] / np.diag(at.joint_covariance)[:f]


def _parameters(
    at: Estimate, names: list[str], other: Estimate | None
) -> tuple[ParameterView, ...]:
    space, free, f = at.model.space, at.free, len(at.free)
    m, w, variance = at.point.local.shape[1], _followers(at), np.diag(at.joint_covariance)[:f]
    blocks = [block_index(f + N_BIAS, m, s) for s in range(at.model.n_slews)]
    share = (
        np.stack(
            [
                np.einsum("pf,cpq,qf->cf", w[i], a, w[i])
                for i, a in zip(blocks, at.information.matrix, strict=True)
            ]
        )
        * variance
    )
    slope = prior_rows(at.model, at.theta)[0][free]
    prior = np.concatenate([slope**2, np.ones(len(w) - f)])[:, None] * w**2 * variance
    own_prior = np.diag(prior[:f])
    own = np.stack([[np.diag(c)[:f] for c in a] for a in at.information.matrix])
    groups = _groups(at)
    factors = variance_inflation(at.hessian, list(groups.values()), f)
    without_slew, without_channel = _sd_without(at)
    correlation = at.covariance[np.ix_(free, free)] / np.sqrt(np.outer(variance, variance))
    robust, prior_sd = at.robust_sd, space.sd[free]
    size = np.where(free < 6, np.abs(at.theta[free]), np.abs(at.theta - space.nulls)[free])
    out = []
    for k, name in enumerate(names):
        near = [j for j in np.argsort(-np.abs(correlation[k])) if j != k][:3]
        sd = float(np.sqrt(variance[k]))
        out.append(
            ParameterView(
                name=name,
                unit=space.units[free[k]],
                value=float(at.theta[free[k]]),
                prior_sd=float(prior_sd[k]),
                sd=sd,
                robust_sd=None if robust is None else float(robust[free[k]]),
                contraction=float(1.0 - variance[k] / prior_sd[k] ** 2),
                signal=float(np.sqrt(own[..., k].sum()) * prior_sd[k]),
                signal_by=np.sqrt(np.maximum(own[..., k], 0.0)) * prior_sd[k],
                signal_of_size=float(np.sqrt(own[..., k].sum()) * size[k]),
                conditional_sd=float(at.hessian[k, k] ** -0.5),
                variance_inflation=float(variance[k] * at.hessian[k, k]),
                inflation=dict(zip(groups, factors[k].tolist(), strict=True)),
                share=share[..., k],
                share_own_prior=float(own_prior[k]),
                share_other_priors=float(prior[:, k].sum() - own_prior[k]),
                sd_without_slew=without_slew[:, k],
                sd_without_channel=without_channel[:, k],
                partners=tuple((names[j], float(correlation[k, j])) for j in near),
                sd_other_drive=None if other is None else float(other.sd[free[k]]),
            )
        )
    return tuple(out)


def _directions(at: Estimate, names: list[str]) -> tuple[Direction, ...]:
    """Eigen-directions of the covariance in prior sds, least known first."""
    slope = prior_rows(at.model, at.theta)[0][at.free]
    left, vectors = np.linalg.eigh(at.covariance[np.ix_(at.free, at.free)] * np.outer(slope, slope))
    left = np.clip(left, 1e-300, 1.0)
    information = (1.0 - left) / left
    typical = max(float(np.median(information)), 1.0)
    out = []
    for k in np.argsort(-left):
        exact = bool(information[k] < EXACT_BELOW * typical and 1.0 - left[k] < PRIOR_BELOW)
        vector = vectors[:, k] * np.sign(vectors[np.argmax(np.abs(vectors[:, k])), k])
        out.append(
            Direction(
                vector, float(information[k]), float(1.0 - left[k]), exact, in_words(names, vector)
            )
        )
    return tuple(out)


def _arrivals(at: Estimate) -> tuple[Arrival, ...]:
    model, w = at.model, _followers(at)
    f, m = len(at.free), at.point.n_local
    jacobian = at.linearised().fitted_columns()
    fix_row = np.asarray(model.data.arrays.telemetry.fix_row)
    out = []
    for s, slew in enumerate(model.campaign.slews):
        follow = w[block_index(f + N_BIAS, m, s)]
        rows = np.zeros((model.data.arrays.telemetry.rate.shape[1], len(CHANNELS), f))
        for c, (columns, width) in enumerate(
            zip(jacobian, (3, 3, max(1, model.structure.wheels)), strict=True)
        ):
            projected = columns[s] @ follow
            squares = (projected**2).reshape(-1, width, f).sum(1)
            np.add.at(rows[:, c], fix_row[s] if c == 1 else np.arange(len(squares)), squares)
        out.append(Arrival(slew.name, slew.time - slew.time[0], rows[: len(slew.time)]))
    return tuple(out)
