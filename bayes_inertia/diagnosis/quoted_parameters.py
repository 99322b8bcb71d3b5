"""J and K as they are quoted: averaged over what may be missing, and how far it could move them.

Each fit believes its model. Averaged over all rows of a table, each with its probability, mean and
sd of J and K hold whichever it is (Hoeting et al. 1999, Bayesian model averaging: a tutorial).
After a plain fit the rows are nothing and every single effect of the library: against truth, no
other uncertainty holds as often as it says at so little width
(`analyses/results/calibration/quoted_sd.md`).

Where no candidate explains the data, or names explain a part of it, a torque and a rate error of
free shape are fitted along: of all that was tried against truth, J and K then hold it as often as
they say (`analyses/results/calibration/unmodelled_disturbance.md`).

What could still hide: to first order an effect of amplitude a [prior sd] that is left out moves
what is fitted by -N^-1 F^T C a, with N the normal matrix of everything fitted, F its columns and C
the effect's, and shows itself with the non-centrality a^T S a of its score (`score_test`). Of all
amplitudes that would be found with even odds at most, and are no larger than two prior sds, the one
that moves a parameter furthest has a closed form.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy import optimize, stats
from scipy.special import softmax

from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.diagnosis.hypothesis_table import (
    FixedMember,
    Names,
    System,
    given_fixed,
    log_evidence_of,
    nothing,
    visible,
)
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.linear_system import LinearModel, linear_model, mixed, parameters_of
from bayes_inertia.diagnosis.random_signals import SOURCES
from bayes_inertia.diagnosis.result import AlternativeParameters, Diagnosis
from bayes_inertia.diagnosis.table_search import Table, given_row
from bayes_inertia.errors import CampaignError, require_kind
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import padded_sensitivities
from bayes_inertia.inference.linearised_fit import LinearisedFit, Rows
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.settings import NOTHING, OPEN_VERDICTS
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import filled
from bayes_inertia.maths.robust_scale import sd_of_interval
from bayes_inertia.maths.values import AnyArray, array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, REMAINDERS, FlexibleMode
from bayes_inertia.physics.named_effects import remainders
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class Undetected:
    """The effect, of those that were not found, that could have moved a parameter furthest.

    Parameters
    ----------
    parameter : str
        Element of J or K.
    unit : str
        Its unit.
    sd : float
        Of its fit.
    shift : float
        How far an effect found with even odds could move it.
    effect : str
        Which effect.
    values : dict
        {parameter of the effect: value} that does it; its opposite moves as far the other way.
    unseen : bool
        Whether it is the effect's own prior, not the data, that limits the shift.

    Examples
    --------
    >>> Undetected("Jxx", "kg m^2", 2e-4, 1e-3, "wheel_command_lag", {"tau": 1e-3}, False).sds
    5.0
    """

    parameter: str
    unit: str
    sd: float
    shift: float
    effect: str
    values: dict[str, float]
    unseen: bool

    @property
    def sds(self) -> float:
        """The shift in units of the parameter's sd."""
        return self.shift / self.sd


def undetected_effects(diagnosis: Diagnosis) -> tuple[Undetected, ...]:
    """Find the effect that could hide furthest behind each element of J and K.

    What was named is fitted and hides nothing. A flexible mode, whose signal is of second order, is
    left out.

    Returns: one for each element that was fitted; empty where the verdict is "unknown".
    """
    if diagnosis.verdict == "unknown":
        return ()
    linear = linear_model(diagnosis.final)
    worst: dict[int, Undetected] = {}
    for member in linear.members:
        for i, row in _shifts(diagnosis.final, linear, member, diagnosis.threshold).items():
            if i not in worst or row.shift > worst[i].shift:
                worst[i] = row
    return tuple(worst[i] for i in sorted(worst))


def _shifts(
    estimate: Estimate, linear: LinearModel, member: FixedMember, threshold: float
) -> dict[int, Undetected]:
    """How far an effect could move each element of J and K that was fitted."""
    space, matrix = estimate.model.space, linear.system.matrix
    part, index = space.slice_of(member.name), member.columns
    seen = len(visible(matrix, index)[0])
    limit = noncentrality_at_even_odds(max(seen, 1), threshold)
    block = matrix[np.ix_(index, index)] / limit
    shift, amplitude = largest_shifts(matrix[-len(linear.null) :, index], block)
    values = space.nulls[part] + amplitude * space.sd[part]
    unseen = np.sum(amplitude**2, 1) > 0.5 * LIMITS.hidden_amplitude**2
    names = [name.split(".", 1)[1] for name in space.names[part]]
    return {
        int(i): Undetected(
            parameter=space.names[i],
            unit=space.units[i],
            sd=float(estimate.sd[i]),
            shift=float(shift[i]),
            effect=member.name,
            values=dict(zip(names, values[i].tolist(), strict=True)),
            unseen=bool(unseen[i]),
        )
        for i in np.intersect1d(estimate.free, np.arange(space.n_base))
    }


def noncentrality_at_even_odds(dof: int, level: float) -> float:
    """Find the non-centrality that a chi^2 test finds every second time.

    `level`: its level: the p-value below which it finds something.

    Examples
    --------
    >>> round(noncentrality_at_even_odds(1, 0.05), 2)
    3.84
    """
    limit = stats.chi2.isf(level, dof)
    return float(optimize.brentq(lambda nc: stats.ncx2.sf(limit, dof, nc) - 0.5, 0.0, limit + 10.0))


def largest_shifts(
    shift_per_amplitude: np.ndarray, data: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Largest shifts over amplitudes a with a^T data a + |a|^2 / 4 at most 1.

    `shift_per_amplitude` (p, n). `data` (n, n): normal matrix of the amplitudes, 1 where an effect
    is found with even odds. Returns `shift` (p,): the largest value of each function; `amplitude`
    (p, n): the amplitudes that reach it.

    Examples
    --------
    >>> shift, amplitude = largest_shifts(np.eye(2), np.diag([1e6, 0.0]))
    >>> shift.round(6).tolist(), amplitude.round(6).tolist()
    ([0.001, 2.0], [[0.001, 0.0], [0.0, 2.0]])
    """
    matrix = data + np.eye(len(data)) / LIMITS.hidden_amplitude**2
    towards = np.linalg.solve(matrix, shift_per_amplitude.T).T
    shift = np.sqrt(np.maximum(np.sum(shift_per_amplitude * towards, 1), 0.0))
    return shift, towards / np.maximum(shift, 1e-300)[:, None]


def undetected_alternatives(
    estimate: Estimate, library: Sequence[Effect] = LIBRARY
) -> tuple[AlternativeParameters, ...]:
    """J and K with each candidate that is not fitted, to first order, and how probable it is.

    Beforehand it is as likely as not that one of them acts, each as likely as the others, with
    amplitudes of the prior, in the directions that the campaign can see. What it cannot see, such
    as a gain that all wheels share, is a condition of the result and no part of its uncertainty.
    A flexible mode, whose signal is of second order, is left out.

    Returns: one for each candidate that the campaign can see, in place of nothing (`instead_of` is
    empty).
    """
    held = _with_candidates(estimate, library)
    linear = linear_model(held, linearised=_linearised(estimate, held))
    evidence = [log_evidence_of(nothing(linear.system), [m]) for m in linear.members]
    # The first is nothing; a log evidence may be too large for its exponential.
    log_odds = np.append(0.0, np.array(evidence) - np.log(len(linear.members)))
    probabilities = softmax(log_odds)[1:].tolist()
    rows = (
        _alternative(held, linear, member, probability)
        for member, probability in zip(linear.members, probabilities, strict=True)
    )
    return tuple(row for row in rows if row is not None)


def _with_candidates(estimate: Estimate, library: Sequence[Effect]) -> Estimate:
    """The fit in a model that holds all candidates of the library at their null."""
    model = estimate.model
    known = {effect.name for effect in model.effects}
    usable = candidate_effects(model.campaign, library).linear
    others = tuple(effect for effect in usable if effect.name not in known)
    larger = replace(model, effects=(*model.effects, *others))
    return move_to(estimate, larger) if others else estimate


def _linearised(estimate: Estimate, held: Estimate) -> LinearisedFit:
    """A fit in a model with candidates, to first order.

    Columns of coefficients are those of the fit: they cost more than all candidates together.
    """
    model, fit = held.model, held.linearised()
    coefficients = sum(model.structure.coefficients)
    if held is estimate or not coefficients or not model.noise.is_stated:
        return fit
    every = np.arange(model.space.size)
    new = padded_sensitivities(model, held.point, held.white, every, silent=True)
    width = every.size + held.point.bias.size + model.structure.n_start
    known = (j[..., -coefficients:] for j in estimate.linearised().sensitivities.jacobian)
    # Its rows may be padded to another length.
    columns = [
        np.concatenate([j[..., :width], filled(own[:, : j.shape[1]], j.shape[1])], -1)
        for j, own in zip(new.jacobian, known, strict=True)
    ]
    rows = Rows(np.concatenate(new.residuals, 1), np.concatenate(columns, 1))
    return replace(fit, given_rows=rows)


def _alternative(
    estimate: Estimate, linear: LinearModel, member: FixedMember, probability: float
) -> AlternativeParameters | None:
    """J and K with one effect more, of prior size; None if the data alone cannot see it."""
    system, names = linear.system, estimate.model.space.names[: len(linear.null)]
    _, directions = visible(linear.told_by_data, member.index)
    own, base = directions.shape[1], np.arange(-len(names), 0)
    if not own:
        return None
    turn = np.zeros((len(system.matrix), own + len(names)))
    turn[member.index, :own], turn[base, base] = directions, 1.0
    gradient = np.maximum(system.gradient, 0.0) if member.one_sided else system.gradient
    seen = nothing(System(turn.T @ system.matrix @ turn, turn.T @ gradient))
    unit = FixedMember(member.name, np.arange(own), np.arange(0), np.ones(1), np.ones(1))
    mean, covariance = parameters_of(linear, given_fixed(seen, unit))
    return AlternativeParameters(member.name, "", probability, names, mean, covariance)


def other_rows(table: Table, named: Names) -> tuple[AlternativeParameters, ...]:
    """J and K of all rows but that of the effects named; many improbable ones are one row."""
    space = table.first.estimate.model.space
    names, instead_of = space.names[: space.n_base], " and ".join(sorted(named)) or NOTHING
    listed, rest = list[AlternativeParameters](), list[AlternativeParameters]()
    for row, probability in table.rows.items():
        if row != named and probability > LIMITS.negligible_probability:
            moments = parameters_of(*given_row(table, row))
            effects = " and ".join(sorted(row))
            own = AlternativeParameters(effects, instead_of, probability, names, *moments)
            (listed if probability > LIMITS.least_probability else rest).append(own)
    if rest:
        weights = np.array([row.probability for row in rest])
        means = np.array([row.mean for row in rest])
        covariances = np.array([row.covariance for row in rest])
        mean, spread, within = mixed(weights / weights.sum(), means, covariances)
        merged = "others", instead_of, float(weights.sum()), names, mean, within + spread
        listed.append(AlternativeParameters(*merged))
    return tuple(listed)


def fitted_effects(diagnosis: Diagnosis) -> tuple[Effect, ...]:
    """The effects that a full fit after a diagnosis holds, with the settings they were found with.

    Returns: those added, in their order. Where no candidate explains the data, a torque and a rate
    error of free shape (without a rate sensor the torque alone) in their place, and a torque of the
    wheels, or an error of their tachometers, where a shape without a name is seen there. Where
    names explain a part of it, both, but no random effect for which a free shape stands, and no
    flexible mode: its states cost most of a fit, and what it stands for is not known.
    """
    if diagnosis.verdict not in OPEN_VERDICTS:
        return diagnosis.effects_added
    campaign = diagnosis.base.model.campaign
    seen = [hook for hook, source in SOURCES.items() if source == diagnosis.nameless_source]
    usual = remainders("both")
    # Others alone would contradict the sensors that see it.
    shapes = tuple(e for e in REMAINDERS if e in usual or any(map(e.acts, seen)))
    free = tuple(shape for shape in shapes if shape.coefficient_count(campaign))
    if diagnosis.verdict == "unknown":
        return free
    hooks = [hook for hook in SOURCES if any(shape.acts(hook) for shape in shapes)]
    kept = (
        e
        for e in diagnosis.effects_added
        if not isinstance(e, FlexibleMode)
        and not (isinstance(e, StochasticEffect) and any(map(e.acts, hooks)))
    )
    return (*kept, *free)


def averaged_posterior(
    posterior: Posterior,
    alternatives: Sequence[AlternativeParameters],
    seed: int,
    ends: tuple[AnyArray, AnyArray] = (-np.inf, np.inf),
) -> Posterior:
    """Average J and K over the effects that may be the true one.

    Each draw is kept or gives way to one of an alternative's Gaussian, in proportion to the
    probabilities.

    `alternatives`: J and K with other effects in their place. `ends`: lower and upper ones of the
    prior of J and K (9,). Returns: with one group `averaged` more, of J, K and principal moments,
    of which `Posterior.summary` then speaks. The group `posterior` stays that of the effects named.
    """
    if not alternatives:
        return posterior
    rng, names = np.random.default_rng([seed, 4]), alternatives[0].names
    named_draws: Any = posterior.tree["posterior"]
    draws = np.stack([named_draws[name].values for name in names], -1)
    flat, probabilities = draws.reshape(-1, len(names)), [a.probability for a in alternatives]
    first = max(0.0, 1.0 - sum(probabilities))
    own = AlternativeParameters("", "", first, names, flat.mean(0), np.cov(flat.T))
    which = rng.choice(len(alternatives) + 1, size=draws.shape[:2], p=[first, *probabilities])
    for k, row in enumerate(alternatives, 1):
        drawn = partial(rng.multivariate_normal, row.mean, row.covariance, method="eigh")
        count = int(np.sum(which == k))
        # An alternative that no body allows, or no prior, has no draws: the fit's own stay.
        with suppress(CampaignError):
            draws[which == k] = inertia_tensor.draw_physical(drawn, count, ends=ends)
    rows = [_row(posterior.attributes["effects"], row) for row in (own, *alternatives)]
    return _with_group(posterior, names, draws, rows)


def _with_group(
    posterior: Posterior, names: Sequence[str], draws: np.ndarray, rows: list[dict[str, Any]]
) -> Posterior:
    """The posterior with averaged draws (chains, draws, 9), and what they are averaged over."""
    import xarray as xr

    dims = ("chain", "draw")
    values: dict[str, Any] = {name: (dims, draws[..., i]) for i, name in enumerate(names)}
    moments = inertia_tensor.principal_moments(draws[..., :6])
    values["principal_moment"] = (*dims, "axis"), moments
    tree = posterior.tree.copy()
    tree["averaged"] = xr.DataTree(xr.Dataset(values, coords=tree["posterior"].coords))
    for name in values:
        source = "derived" if name == "principal_moment" else "posterior"
        tree["averaged"][name].attrs["units"] = tree[source][name].attrs.get("units", "")
    tree.attrs = posterior.tree.attrs | {
        "bayes_inertia": json.dumps(posterior.attributes | {"averaged_over": rows})
    }
    return replace(posterior, tree=tree)


def _row(named: Sequence[str], alternative: AlternativeParameters) -> dict[str, Any]:
    own = alternative.effect.split(" and ") if alternative.effect else []
    each = zip(alternative.names, alternative.mean, alternative.sd, strict=True)
    return {
        "effects": own if alternative.instead_of else [*named, *own],
        "probability": alternative.probability,
        "parameters": {name: {"mean": float(m), "sd": float(sd)} for name, m, sd in each},
    }


@array_dataclass
class QuotedParameters:
    """J and K with the uncertainty to quote.

    Parameters
    ----------
    names : tuple of str
        Of the elements of J and K.
    mean : (9,) array
        SI units; the median where several models are averaged.
    sd : (9,) array
        Of normal distributions with the same 90 % intervals.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray


def quoted_parameters(found: Estimate | Diagnosis) -> QuotedParameters:
    """J and K of a fit, or after a diagnosis, at the optimum (Laplace's approximation).

    `fit` and `diagnose_and_fit` sample the posterior of the same fits; their summaries quote the
    same.

    Parameters
    ----------
    found : Estimate or Diagnosis
        A fit whose residuals are explained, or what a diagnosis found.

    Returns
    -------
    QuotedParameters
        Averaged over what may act although it was not found: after a diagnosis over all rows of its
        table. Where the verdict is "partial" or "unknown" the fits hold a torque and a rate error
        of free shape: see the module.

    Raises
    ------
    EstimateError
        If the optimizer finds no usable estimate.

    Examples
    --------
    It takes seconds after a fit or a diagnosis, so this is no doctest::

        quoted = quoted_parameters(diagnose(campaign))
        dict(zip(quoted.names, quoted.sd))
    """
    advice = "give what `estimate` or `diagnose` returned"
    require_kind(found, Estimate | Diagnosis, "found", advice)
    if isinstance(found, Estimate):
        fit, others, factor = found, undetected_alternatives(found), found.dispersion_factor
    elif found.verdict in OPEN_VERDICTS:
        fit, others, factor = _refitted(found), (), 1.0
    else:
        fit, others, factor = found.final, found.other_rows, found.final.dispersion_factor
    quoted = averaged_parameters(_quoted_row(fit), others, factor)
    beyond = np.square(fit.prior_beyond_shifts).sum(axis=0)[: len(quoted.sd)]
    return replace(quoted, sd=np.sqrt(quoted.sd**2 + beyond))


def averaged_parameters(
    first: AlternativeParameters,
    alternatives: tuple[AlternativeParameters, ...],
    dispersion_factor: float = 1.0,
) -> QuotedParameters:
    """Median of a mixture, and the sd that belongs to its 90 % interval.

    `dispersion_factor`: by which slews disagree more than the fit says.

    Examples
    --------
    >>> def row(mean, probability):
    ...     return AlternativeParameters(
    ...         "a", "", probability, ("K1",), np.full(1, mean), np.eye(1))
    >>> mixed = averaged_parameters(row(0.0, 0.0), (row(2.0, 0.5),))
    >>> mixed.mean, mixed.sd.round(2)
    (array([1.]), array([1.39]))
    """
    rows = (first, *alternatives)
    shares = np.array([r.probability for r in rows])
    shares[0] = 1.0 - shares[1:].sum()
    means, sds = (np.array([getattr(r, key) for r in rows]) for key in ("mean", "sd"))
    low, middle, high = (
        np.array([_quantile(level, shares, m, s) for m, s in zip(means.T, sds.T, strict=True)])
        for level in (0.05, 0.5, 0.95)
    )
    return QuotedParameters(first.names, middle, dispersion_factor * sd_of_interval(low, high))


def _quantile(level: float, shares: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> float:
    """Quantile of a mixture of normal distributions, all arrays (n,)."""
    if not np.all(sd > 0.0):
        return float(mean[0])  # A parameter that is held.
    low, high = float(np.min(mean - 6.0 * sd)), float(np.max(mean + 6.0 * sd))
    return optimize.brentq(
        lambda value: float(shares @ stats.norm.cdf((value - mean) / sd)) - level, low, high
    )


def _quoted_row(fit: Estimate) -> AlternativeParameters:
    """J and K of a fit."""
    n = fit.model.n_base
    names, covariance = tuple(fit.model.space.names[:n]), fit.covariance[:n, :n]
    return AlternativeParameters("", "", 0.0, names, fit.theta[:n], covariance)


def _refitted(diagnosis: Diagnosis) -> Estimate:
    """The full fit of an open verdict from where the last ended, each slew as it scatters."""
    final = diagnosis.final
    model = replace(final.model, effects=fitted_effects(diagnosis))
    known = dict(zip(final.model.space.names, final.theta, strict=True))
    mean = zip(model.space.names, model.space.mean, strict=True)
    return estimate(model, start=np.array([known.get(name, value) for name, value in mean]))
