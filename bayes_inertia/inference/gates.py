"""What must hold before the numbers of a fit are used: all gates, and their words.

Chains are trusted by nested R-hat over ensembles, effective sample sizes and length.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from emcee.autocorr import integrated_time
from scipy import stats

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.settings import OPEN_VERDICTS, FitContext
from bayes_inertia.maths.printed import listed
from bayes_inertia.physics.effects import REMAINDERS


@dataclass(frozen=True)
class Diagnostics:
    """Whether the sample can be trusted.

    Parameters
    ----------
    converged : bool
        Whether R-hat, effective samples and length pass their gates.
    nested_rhat_max : float
        Of the worst parameter; walkers of one ensemble count as one chain.
    ess_bulk_min, ess_tail_min : float
        Effective samples of the worst parameter.
    tau_max : float
        Longest integrated autocorrelation time [steps].
    evaluations : int
        Of the posterior density, pilot included.
    ess_per_evaluation : float
        Effective samples an evaluation.
    seconds : float
        Wall time [s].
    acceptance : float
        Share of the proposals that were accepted.
    discarded : int
        Steps of warm-up.
    steps : int
        Steps of each ensemble, warm-up included.
    """

    converged: bool
    nested_rhat_max: float
    ess_bulk_min: float
    ess_tail_min: float
    tau_max: float
    evaluations: int
    ess_per_evaluation: float
    seconds: float
    acceptance: float
    discarded: int
    steps: int


def autocorrelation_time(chain: np.ndarray) -> float:
    """The largest integrated autocorrelation time of all parameters of an ensemble.

    `chain` (steps, walkers, d): A walker that has not moved yet has none: the chain then counts as
    one draw. Returns [steps].

    Examples
    --------
    >>> autocorrelation_time(np.random.default_rng(1).normal(size=(500, 4, 2))) < 2.0
    True
    >>> autocorrelation_time(np.ones((500, 4, 2)))
    500.0
    """
    if np.any(np.all(chain == chain[:1], axis=0)):
        return float(len(chain))
    return float(np.max(integrated_time(chain, quiet=True, tol=0)))


def diagnose_chains(
    samples: np.ndarray, *, tau: float, evaluations: int, discarded: int, **measured: float
) -> Diagnostics:
    """Convergence of samples.

    Plain R-hat over walkers raises false alarms on perfect ensembles and misses one that is stuck
    (Margossian et al. 2024); ensembles are what is independent here.

    `samples` (ensembles, walkers, draws, d); `tau` [steps]; `measured`: `seconds` [s] and
    `acceptance`.
    """
    from arviz_base import from_dict
    from arviz_stats import ess, rhat_nested

    ensembles, walkers, draws, d = samples.shape
    with warnings.catch_warnings():
        # Walkers are many by design.
        warnings.filterwarnings("ignore", "Found chain dimension to be longer", UserWarning)
        flat = samples.reshape(ensembles * walkers, draws, d)
        tree = from_dict({"posterior": {"theta": flat}})
    superchains = np.repeat(range(ensembles), walkers).tolist()
    rhat = float(rhat_nested(tree, superchain_ids=superchains)["theta"].max())
    # emcee's walkers are not independent: believe the smaller of both counts.
    by_tau = ensembles * walkers * draws / max(tau, 1.0)
    bulk = min(float(ess(tree, method="bulk")["theta"].min()), by_tau)
    tail = float(ess(tree, method="tail")["theta"].min())
    many = np.minimum(bulk, tail) >= LIMITS.ess_at_least
    long = draws >= LIMITS.autocorrelation_times * tau
    return Diagnostics(
        converged=bool(rhat < LIMITS.nested_rhat_below and many and long),
        nested_rhat_max=rhat,
        ess_bulk_min=bulk,
        ess_tail_min=tail,
        tau_max=tau,
        evaluations=evaluations,
        ess_per_evaluation=min(bulk, tail) / evaluations,
        discarded=discarded,
        steps=draws + discarded,
        **measured,
    )


_REMAINDER_NOTE = (
    "the diagnosis found that something is missing which no candidate explains; "
    "fitted along: {}, of free shape in each slew. The sd of J and K holds what that may have "
    "done, not what errors of other parts, such as the star tracker, may have done"
)


# What a wrong unit or convention makes of a scale factor or of J: the factor on it.
_FACTORS_ON_K: tuple[tuple[str, float], ...] = (
    ("rates in deg/s read as rad/s", pi / 180.0),
    ("rates in rad/s read as deg/s", 180.0 / pi),
    ("rates in rpm read as rad/s", pi / 30.0),
    ("rates in mrad/s read as rad/s", 1e-3),
    ("times in another unit than stated", 1e3),
    ("times in another unit than stated", 1e-3),
    ("rates of the opposite sign", -1.0),
)
_FACTORS_ON_J: tuple[tuple[str, float], ...] = (
    ("torque and momentum in mN m and mN m s read as N m and N m s", 1e3),
    ("torque and momentum a thousand times too small", 1e-3),
    ("J in g m^2 stated as kg m^2", 1e-3),
    ("J in kg cm^2 stated as kg m^2", 1e-4),
)


def check_gates(
    estimate: Estimate, diagnostics: Diagnostics, context: FitContext | None = None
) -> list[dict[str, Any]]:
    """Judge a fit.

    `context`: what a diagnosis said before: the noise that was taken, and whether something stayed
    unknown. Returns: one a gate: its `name`, whether it is `passed`, and what it `says`, in plain
    words.
    """
    context = context or FitContext()
    gates = [_converged(diagnostics), _explained(estimate, context), prior_gate(estimate)]
    if context.verdict in OPEN_VERDICTS:
        names = [effect.name for effect in estimate.model.effects]
        free = [effect.signal_title for effect in REMAINDERS if effect.name in names]
        says = _REMAINDER_NOTE.format(listed(free))
        gates.append({"name": "diagnosed", "passed": False, "says": says})
    return gates


def _converged(diagnostics: Diagnostics) -> dict[str, Any]:
    """Whether the ensembles agree and are long enough."""
    passed = diagnostics.converged
    draws = diagnostics.steps - diagnostics.discarded
    length = draws / max(diagnostics.tau_max, 1.0)
    effective = min(diagnostics.ess_bulk_min, diagnostics.ess_tail_min)
    says = (
        f"the ensembles {'agree' if passed else 'have not converged'}: "
        f"nested R-hat {diagnostics.nested_rhat_max:.4f} (below {LIMITS.nested_rhat_below}), "
        f"effective samples {effective:.0f} (at least {LIMITS.ess_at_least:.0f}), "
        f"chains {length:.0f} autocorrelation times long "
        f"(at least {LIMITS.autocorrelation_times:.0f})"
    )
    return {"name": "converged", "passed": passed, "says": says}


def _explained(estimate: Estimate, context: FitContext) -> dict[str, Any]:
    """Whether the residuals are what the model and the noise that was taken predict."""
    tests, noise = estimate.tests, _noise_in_words(estimate, context)
    large = [name for name, test in tests.items() if test.too_large]
    small = [name for name, test in tests.items() if test.rejected and not test.too_large]
    says = f"the residuals are what the model and {noise} predict"
    if small:
        says = (
            f"the residuals are smaller than {noise} predicts, in {', '.join(small)}: "
            "the uncertainties are too cautious"
        )
    if large:
        sizes = [f"{name} ({tests[name].why_too_large})" for name in large]
        next_step = "look for the missing effect with `diagnose`"
        if context.verdict:
            next_step = "the diagnosis found no effect that explains it"
        left = (d for d in estimate.model.campaign.dirt if d.treated == "ignored" and not d.slew)
        if outlying := [d.channel for d in left if d.kind == "outliers"]:
            asked = " ".join(f"--noise {channel}=student_t" for channel in outlying)
            next_step = (
                f"outliers of {listed(outlying)} are too many to be left out: fit with `{asked}`, "
                "which models them"
            )
        # After a diagnosis that leaves something open, its own gate says what that means.
        opened = context.verdict in OPEN_VERDICTS
        advice = "" if opened else f"; {next_step}, and do not read sd as the uncertainty"
        if estimate.model.campaign.prior is not None:
            advice += "; if the prior of J and K no longer holds, fit without it"
        if groups := groups_of_slews(estimate):
            advice += f"; {groups['says']}"
        says = f"the model does not explain the data: {', '.join(sizes)}{advice}"
    return {"name": "explained", "passed": not large, "says": says}


def groups_of_slews(estimate: Estimate) -> dict[str, Any] | None:
    """Two groups of slews that agree among themselves and not with each other, as in summary.json.

    None where the slews agree, or where no two groups are why they do not.
    """
    scatter = estimate.slew_scatter
    if scatter is None or (groups := scatter.groups) is None:
        return None
    model, space = estimate.model, estimate.model.space
    names = [[model.campaign.slews[s].name for s in part] for part in groups.slews]
    base = [(k, space.names[i]) for k, i in enumerate(estimate.free) if i < model.n_base]
    differences = {
        name: {"difference": float(groups.difference[k]), "sd": float(groups.sd[k])}
        for k, name in base
    }
    far = max(base, key=lambda place: abs(groups.difference[place[0]]) / groups.sd[place[0]])[1]
    one, other = (_group_in_words(*part) for part in zip(groups.slews, names, strict=True))
    change, sd = differences[far].values()
    unit = f" {space.units[space.names.index(far)]}".rstrip()
    says = (
        f"{one} agree among themselves, and so do {other}, but the two groups disagree, most in "
        f"{far}: by {change:.2g}{unit} ({abs(change) / sd:.0f} sd)"
    )
    if groups.slews[0][-1] < groups.slews[1][0]:
        effect = f"`--effects inertia_change:from_slew={groups.slews[1][0]}`"
        says += f"; if the tensor changed between them, fit with {effect}"
    return {"slews": names, "p_value": groups.p_value, "differences": differences, "says": says}


def _group_in_words(slews: tuple[int, ...], names: Sequence[str]) -> str:
    """Slews in a sentence: the first and the last where they follow each other."""
    if len(slews) > 2 and slews[-1] - slews[0] == len(slews) - 1:
        return f"{names[0]} to {names[-1]}"
    return listed(names)


def prior_gate(estimate: Estimate) -> dict[str, Any]:
    """Judge whether J and K are where they can be: not far outside what was known before.

    A posterior that leaves its prior is a finding, not a result: a unit or a prior is wrong.

    `estimate`: its J and K are judged, each for itself and all together, and what is stated of
    each device beside wheels, such as its gain, and of each further sensor, but for a gyro's bias.
    """
    space, theta = estimate.model.space, estimate.theta
    n = space.n_base
    distance = (theta - space.mean) / space.sd
    joint = distance[:n] if space.whitening is None else space.whitening[:n, :n] @ distance[:n]
    p_value = float(stats.chi2.sf(joint @ joint, n))
    campaign = estimate.model.campaign
    devices = {*(device.name for device in campaign.actuators), *dict(campaign.more_sensors)}
    owners = [name.rpartition(".") for name in space.names]
    of_devices = [x in devices and not kind.startswith("bias") for x, _, kind in owners]
    distance = np.where((np.arange(space.size) < n) | of_devices, distance, 0.0)
    far = np.flatnonzero(np.abs(distance) > LIMITS.prior_sd_at_most)
    worst = int(np.argmax(np.abs(distance)))
    place = (
        f"{space.names[worst]} = {theta[worst]:.4g} lies {abs(distance[worst]):.1f} prior sd "
        f"from its prior mean {space.mean[worst]:.4g}"
    )
    passed = not len(far) and p_value > LIMITS.prior_p_value_above
    if passed:
        says = f"the result is where what was known before allows it: {place}"
    else:
        more = "" if len(far) else f"; all of J and K together have p = {p_value:.1g}"
        if len(far) > 1:
            more = f", and {len(far) - 1} more beyond {LIMITS.prior_sd_at_most:g}"
        says = (
            f"the result contradicts what was known before: {place}{more}. "
            f"{_cause_of_contradiction(estimate, worst)}"
        )
    return {"name": "prior", "passed": passed, "says": says}


def _cause_of_contradiction(estimate: Estimate, worst: int) -> str:
    """What would explain J and K, or what is stated of a device, far from their priors.

    `worst`: which parameter is farthest.
    """
    space, theta = estimate.model.space, estimate.theta
    if worst >= space.n_base:
        device = space.names[worst].rpartition(".")[0]
        verb = "reads" if device in estimate.model.campaign.sensors else "was told"
        return (
            f"A wrong unit, sign or axis of what {device} {verb} would explain it, or a stated "
            "sd that is too small"
        )
    scale = theta[6 : space.n_base] / space.mean[6 : space.n_base]
    size = float(np.sum(theta[:3]) / np.sum(space.mean[:3]))
    # Without a rate sensor no K tells of its unit.
    on_K = _FACTORS_ON_K if len(scale) else ()
    causes = [c for c, f in on_K if np.all(np.abs(scale / f - 1) < LIMITS.near_a_factor)]
    causes += [c for c, f in _FACTORS_ON_J if abs(size / f - 1) < LIMITS.near_a_factor]
    if causes:
        return f"This is what {' or '.join(causes)} would do: check the units in the campaign"
    return (
        "A wrong unit, sign or axis in the campaign would explain it (see `bayes-inertia doctor`), "
        "or a prior that is too narrow"
    )


def _noise_in_words(estimate: Estimate, context: FitContext) -> str:
    """The noise that the fit took."""
    asked_for = estimate.model.noise
    if not asked_for.is_stated:
        return f"the noise that was asked for ({asked_for.in_words()})"
    factors = context.measured_noise or {}
    louder = [f"{channel} {factor:.2f}" for channel, factor in factors.items() if factor > 1.0]
    if not louder:
        return "the stated noise"
    return (
        f"the noise that was measured (times what is stated: {', '.join(louder)}; "
        "of its loudest axis or slew)"
    )
