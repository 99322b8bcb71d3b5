"""Information of a campaign on each parameter, and why there is no more.

All numbers belong to the Gauss-Newton approximation around an estimate, H = sum A + prior with the
information A of every slew and channel. For parameter i with marginal variance C_ii, the joint
direction w = C e_i / C_ii moves i by one and lets everything else follow as it hides the change
best. Then

    1 / C_ii = w^T H w = sum over rows (projected column)^2 + own prior + other priors,

which splits what is known of i, exactly, by slew, by channel and by row of telemetry. What is lost
to other parameters is C_ii H_ii, the variance inflation (see `analysis`).

What the feedback controller hides: seen from the attitude alone, a controller makes a wrong J
almost invisible, because it commands whatever torque keeps the slew on its profile. The fit takes
the commands as recorded, so that nothing is hidden from it: the response that the controller
removed from the motion stands in the commands. How much the commands are worth is the sd of a fit
that ignores them (measured drive) over that of one that uses them.

How much of a parameter's variance is due to which other unknowns.

The variance inflation C_ii H_ii is split among groups of unknowns by Shapley's value of log
variance (Shapley 1953; for variances Owen 2014): the factors multiply to the whole, and no order
of the groups is preferred.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import EstimateError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import clean_fit
from bayes_inertia.inference.laplace import Estimate, model_of
from bayes_inertia.inference.likelihood import unpadded_sensitivities
from bayes_inertia.inference.objective import block_index, prior_equations, prior_rows
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.observability.degeneracy import in_words, stated_degeneracies
from bayes_inertia.observability.limits import LIMITS
from bayes_inertia.observability.result import (
    Direction,
    InformationArrival,
    Observability,
    ParameterObservability,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.progress import Progress, as_callback, with_bar


@with_bar
def observe(
    estimate: Estimate | Model | Campaign,
    other_drive: Estimate | None = None,
    *,
    progress: Progress | bool | None = None,
) -> Observability:
    """What the campaign tells about each fitted parameter, and why not more.

    Parameters
    ----------
    estimate : Estimate, Model or Campaign
        Of the campaign; a campaign or a model is estimated first, outliers left out as `fit` does.
    other_drive : Estimate, optional
        The same campaign and effects estimated in the other drive, to see what the recorded
        commands are worth.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

    Returns
    -------
    Observability
        Numbers for each parameter, for directions, and over time.

    Raises
    ------
    EstimateError
        If the second estimate is of other parameters or of the same drive.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> seen = observe(small_campaign())
    >>> [row.name for row in seen.parameters][:3]
    ['Jxx', 'Jyy', 'Jzz']
    """
    say = as_callback(progress)
    if not isinstance(estimate, Estimate):
        estimate = clean_fit(optimizer.estimate(model_of(estimate), progress=say)).estimate
    say("asking each slew what it tells", 0, 0)
    model = estimate.model
    if other_drive is not None and (
        other_drive.model.space.names != model.space.names
        or other_drive.model.structure.drive == model.structure.drive
    ):
        raise EstimateError(
            "the second estimate is not of the same parameters in the other drive",
            advice="estimate Model(campaign, effects, drive=...)",
        )
    names = [model.space.names[i] for i in estimate.free]
    return Observability(
        campaign=model.campaign.name,
        drive=model.structure.drive,
        wheels=model.structure.wheels,
        effects=tuple(effect.name for effect in model.effects),
        slews=tuple(slew.name for slew in model.campaign.slews),
        channels=tuple(channel.name for channel in model.channels),
        parameters=_parameters(estimate, names, other_drive),
        covariance=estimate.covariance[np.ix_(estimate.free, estimate.free)],
        directions=_directions(estimate, names),
        degeneracies=stated_degeneracies(estimate),
        arrivals=_arrivals(estimate),
        discounted=estimate.discounted,
    )


def _groups(estimate: Estimate) -> dict[str, np.ndarray]:
    """Places of each group's unknowns in the joint vector; groups without any are left out."""
    free, structure, n = estimate.free, estimate.model.structure, estimate.model.n_base
    f, b, m = len(free), len(estimate.point.bias), estimate.point.n_local
    n_start = 6 + (structure.wheels if structure.drive == "commanded" else 0)
    local = f + b + np.arange(estimate.point.local.size).reshape(-1, m)
    # What has no fixed shape acts through coefficients, the last of a slew's nuisances.
    coefficients = local[:, structure.n_start :].ravel()
    parts = (
        np.flatnonzero(free < 6),
        np.flatnonzero((free >= 6) & (free < n)),
        local[:, :n_start].ravel(),
        local[:, n_start : structure.n_start].ravel(),
        f + np.arange(b),
        np.concatenate([np.flatnonzero(free >= n), coefficients]),
    )
    # Gains of actuators, K and bias of further sensors stand there without any effect.
    last = "effects" if estimate.model.effects else "devices"
    names = ("J", "K", "initial conditions", "tachometer noise", "rate bias", last)
    return {name: part for name, part in zip(names, parts, strict=True) if len(part)}


def _sd_without(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """sd without each slew (slews, f), and without each channel (channels, f): NaN without data."""
    f, n_data, fit = len(estimate.free), estimate.information.n_data, estimate.linearised()

    def sd(s: slice | int, c: slice | int) -> np.ndarray:
        weights = np.ones(n_data.shape)
        weights[s, c] = 0.0
        return np.sqrt(np.diag(inverse(fit.normal_equations(weights)[0]))[:f])

    every, channels = slice(None), np.full((n_data.shape[1], f), np.nan)
    for c in np.flatnonzero(n_data.any(axis=0)).tolist():
        channels[c] = sd(every, c)
    return np.stack([sd(s, every) for s in range(len(n_data))]), channels


def _followers(estimate: Estimate) -> np.ndarray:
    """w (joint, f): how everything follows each parameter, 1 at the parameter itself."""
    f = len(estimate.free)
    return estimate.joint_covariance[:, :f] / np.diag(estimate.joint_covariance)[:f]


def _shares(estimate: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of the marginal precision: data (slews, 3, f), own prior (f,), all priors (f,)."""
    f, m, w = len(estimate.free), estimate.point.n_local, _followers(estimate)
    b = len(estimate.point.bias)
    variance = np.diag(estimate.joint_covariance)[:f]
    blocks = [block_index(f + b, m, s) for s in range(estimate.model.n_slews)]
    of_slews = zip(blocks, estimate.information.matrix, strict=True)
    share = np.stack([np.einsum("pf,cpq,qf->cf", w[i], a, w[i]) for i, a in of_slews]) * variance
    precision, _ = prior_equations(estimate.model, estimate.theta, estimate.free)
    own = np.diag(precision)
    prior = np.concatenate([own, np.ones(len(w) - f)])[:, None] * w**2 * variance
    # What parameters share is counted with the other priors.
    across = np.einsum("pf,pq,qf->pf", w[:f], precision - np.diag(own), w[:f]) * variance
    prior[:f] += across * (1.0 - np.eye(f))
    prior[-1] += across.diagonal()
    return share, np.diag(prior[:f]), np.array([prior[:, k].sum() for k in range(f)])


def _parameters(
    estimate: Estimate, names: list[str], other_drive: Estimate | None
) -> tuple[ParameterObservability, ...]:
    space, free, f, theta = estimate.model.space, estimate.free, len(names), estimate.theta
    variance = np.diag(estimate.joint_covariance)[:f]
    share, own_prior, all_priors = _shares(estimate)
    # Information on each parameter alone, by slew and channel; of a random size it may seem less
    # than nothing.
    alone = np.stack([[np.diag(c)[:f] for c in a] for a in estimate.information.matrix])
    alone = np.maximum(alone, 0.0)
    groups = _groups(estimate)
    factors = inflation_by_group(estimate.hessian, list(groups.values()), f)
    without_slew, without_channel = _sd_without(estimate)
    correlation = estimate.covariance[np.ix_(free, free)] / np.sqrt(np.outer(variance, variance))
    robust, prior_sd = estimate.robust_sd, space.sd[free]
    size = np.where(free < 6, np.abs(theta[free]), np.abs(theta - space.nulls)[free])
    return tuple(
        ParameterObservability(
            name=name,
            unit=space.units[free[k]],
            value=float(theta[free[k]]),
            prior_sd=float(prior_sd[k]),
            sd=float(np.sqrt(variance[k])),
            robust_sd=None if robust is None else float(robust[free[k]]),
            contraction=float(1.0 - variance[k] / prior_sd[k] ** 2),
            signal=float(np.sqrt(alone[..., k].sum()) * prior_sd[k]),
            signal_by=np.sqrt(alone[..., k]) * prior_sd[k],
            signal_of_size=float(np.sqrt(alone[..., k].sum()) * size[k]),
            conditional_sd=float(estimate.hessian[k, k] ** -0.5),
            variance_inflation=float(variance[k] * estimate.hessian[k, k]),
            inflation=dict(zip(groups, factors[k].tolist(), strict=True)),
            share=share[..., k],
            share_own_prior=float(own_prior[k]),
            share_other_priors=float(all_priors[k] - own_prior[k]),
            sd_without_slew=without_slew[:, k],
            sd_without_channel=without_channel[:, k],
            partners=_partners(names, correlation[k], k),
            sd_other_drive=None if other_drive is None else float(other_drive.sd[free[k]]),
        )
        for k, name in enumerate(names)
    )


def _partners(names: list[str], correlation: np.ndarray, k: int) -> tuple[tuple[str, float], ...]:
    """The parameters that parameter k is most correlated with."""
    nearest = [j for j in np.argsort(-np.abs(correlation)) if j != k][: LIMITS.max_partners]
    return tuple((names[j], float(correlation[j])) for j in nearest)


def _directions(estimate: Estimate, names: list[str]) -> tuple[Direction, ...]:
    """Eigen-directions of the covariance in prior sds, least known first."""
    slope = prior_rows(estimate.model, estimate.theta)[0][estimate.free]
    covariance = estimate.covariance[np.ix_(estimate.free, estimate.free)]
    left, vectors = np.linalg.eigh(covariance * np.outer(slope, slope))
    if estimate.model.space.whitening is not None:
        precision, _ = prior_equations(estimate.model, estimate.theta, estimate.free)
        # Shares of the joint prior: directions of generalised eigenvectors, in prior sds.
        root = np.linalg.cholesky(precision)
        left, vectors = np.linalg.eigh(root.T @ covariance @ root)
        vectors = slope[:, None] * np.linalg.solve(root.T, vectors)
        vectors /= np.linalg.norm(vectors, axis=0)
    left = np.clip(left, 1e-300, 1.0)
    information = (1.0 - left) / left
    typical = max(float(np.median(information)), 1.0)
    directions = []
    for k in np.argsort(-left):
        told, contraction = float(information[k]), float(1.0 - left[k])
        exact = told < LIMITS.exact_below * typical and contraction < LIMITS.prior_below
        weights = vectors[:, k] * np.sign(vectors[np.argmax(np.abs(vectors[:, k])), k])
        directions.append(Direction(weights, told, contraction, exact, in_words(names, weights)))
    return tuple(directions)


def _arrivals(estimate: Estimate) -> tuple[InformationArrival, ...]:
    model, w = estimate.model, _followers(estimate)
    f, b, m = len(estimate.free), len(estimate.point.bias), estimate.point.n_local
    jacobian = unpadded_sensitivities(model, estimate.point, estimate.white, estimate.free).jacobian
    readings = model.data.arrays.telemetry.readings
    arrivals = []
    for s, slew in enumerate(model.campaign.slews):
        follow = w[block_index(f + b, m, s)]
        rows = np.zeros((model.data.arrays.telemetry.sample.shape[1], len(readings), f))
        for c, (columns, of_channel) in enumerate(zip(jacobian, readings, strict=True)):
            projected = columns[s] @ follow
            width = max(1, of_channel.valid.shape[-1])
            squares = (projected**2).reshape(-1, width, f).sum(1)
            np.add.at(rows[:, c], np.asarray(of_channel.row)[s, : len(squares)], squares)
        time = slew.time - slew.time[0]
        arrivals.append(InformationArrival(slew.name, time, rows[: len(time)]))
    return tuple(arrivals)


def inflation_by_group(
    precision: np.ndarray, groups: Sequence[np.ndarray], count: int
) -> np.ndarray:
    """Factors by which not knowing each group multiplies the variance of the first unknowns.

    A group that holds an unknown itself stands for the others in it.

    `precision` (n, n). `count`: how many of the unknowns, from the first, are asked about. Returns
    (count, groups): their product over groups is C_ii H_ii for C = H^-1.

    Examples
    --------
    >>> H = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])
    >>> groups = [np.array([0]), np.array([1]), np.array([2])]
    >>> inflation_by_group(H, groups, 1).round(4).tolist()
    [[1.0, 1.5625, 1.0]]
    """
    n, logs = len(groups), []
    for mask in range(2**n):
        members = [group for k, group in enumerate(groups) if mask >> k & 1]
        uncertain = np.concatenate([np.zeros(0, int), *members])
        logs.append(_log_variances(precision, uncertain, count))
    log_factors = np.zeros((count, n))
    for k in range(n):
        for mask in (m for m in range(2**n) if not m >> k & 1):
            size = mask.bit_count()
            weight = factorial(size) * factorial(n - size - 1) / factorial(n)
            log_factors[:, k] += weight * (logs[mask | 1 << k] - logs[mask])
    return np.exp(log_factors)


def _log_variances(precision: np.ndarray, uncertain: np.ndarray, count: int) -> np.ndarray:
    """Log variances (count,) where only `uncertain` and the unknown itself are not known."""
    alone = np.diag(precision)[:count].copy()
    if not len(uncertain):
        return -np.log(alone)
    covariance = inverse(precision[np.ix_(uncertain, uncertain)])
    cross = precision[np.ix_(uncertain, np.arange(count))]
    variance = np.zeros(count)
    outside = ~np.isin(np.arange(count), uncertain)
    taken = np.einsum("ki,kl,li->i", cross[:, outside], covariance, cross[:, outside])
    variance[outside] = 1.0 / (alone[outside] - taken)
    asked = uncertain < count
    variance[uncertain[asked]] = np.diag(covariance)[asked]
    return np.log(variance)
