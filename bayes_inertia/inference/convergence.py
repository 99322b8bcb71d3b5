"""Whether chains can be trusted: nested R-hat over ensembles, effective sample sizes, length."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from emcee.autocorr import integrated_time

from bayes_inertia.inference.limits import LIMITS


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
    samples: np.ndarray,
    *,
    tau: float,
    evaluations: int,
    seconds: float,
    acceptance: float,
    discarded: int,
) -> Diagnostics:
    """Convergence of samples.

    Plain R-hat over walkers raises false alarms on perfect ensembles and misses one that is stuck
    (Margossian et al. 2024); ensembles are what is independent here.

    `samples` (ensembles, walkers, draws, d); `tau` [steps]; `seconds` [s].
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
        seconds=seconds,
        acceptance=acceptance,
        discarded=discarded,
        steps=draws + discarded,
    )
