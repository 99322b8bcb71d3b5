"""Sampling: independently seeded, over-dispersed emcee ensembles, and whether they can be trusted.

The Laplace approximation gives an independence move; the differential evolution move beside it keeps
the ensembles moving where that approximation is poor, and a pilot run then replaces it. Chains are
kept in emcee's own HDF5 format, one file an ensemble (`chain_file`), and a killed run goes on bit for bit.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event
from time import perf_counter

import emcee
import numpy as np
from emcee.autocorr import integrated_time
from threadpoolctl import threadpool_limits

from bayes_inertia.errors import EstimateError
from bayes_inertia.files import make_folder, remove_leftovers
from bayes_inertia.inference.chain_file import load_chain, save_chain
from bayes_inertia.inference.laplace import Estimate, marginal
from bayes_inertia.inference.likelihood import Marginal, log_posterior, shared_log_posterior
from bayes_inertia.inference.moves import IndependenceMove
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.prediction import Structure

Progress = Callable[[str, int, int], None]
LogDensity = Callable[[np.ndarray], np.ndarray]
# Below this expected acceptance the Laplace approximation is too poor to propose from.
_POOR = 0.35
# The independence move gets as large a share of the steps as it would be accepted, within these: walkers that sit where the proposal is
# too thin are rejected again and again, and the other move frees them.
_SHARES = (0.5, 0.95)
_STRETCH = 2.0  # starts are spread this many times wider than the proposal
_BURN = 12
_SAVED = 8  # steps between savings of a chain
# Draws that convergence asks for, in autocorrelation times; and how many more than seem enough are taken.
_TIMES_TAU, _MARGIN = 20.0, 1.1


@dataclass(frozen=True)
class Settings:
    """How to sample.

    Attributes
    ----------
    seed : one integer that fixes everything. ensembles, walkers : independent ensembles, and walkers in each (more, where
    a model has so many parameters that emcee asks for them).
    steps : steps of each ensemble before the gates are looked at; then as many more as it seems to take, at most doubled at
    a time, until they pass or `max_steps` is reached.
    target_ess : effective samples wanted of the worst parameter. threads : ensembles that run at once.

    >>> Settings().ensembles
    4
    """

    seed: int = 0
    ensembles: int = 4
    walkers: int = 64
    steps: int = 72
    max_steps: int = 2304
    target_ess: float = 10_000.0
    threads: int = 2


@dataclass(frozen=True)
class Diagnostics:
    """Whether the sample can be trusted (field meanings: the `diagnostics` of summary.json)."""

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


@array_dataclass
class Chains:
    """Samples of the posterior.

    Attributes
    ----------
    samples : (ensembles, walkers, draws, d), warm-up removed. log_posterior : (ensembles, walkers, draws).
    diagnostics : see `Diagnostics`. proposal_degrees : of freedom of the independence move.
    """

    samples: np.ndarray
    log_posterior: np.ndarray
    diagnostics: Diagnostics
    proposal_degrees: float

    @property
    def flat(self) -> np.ndarray:
        """All draws (n, d)."""
        return self.samples.reshape(-1, self.samples.shape[-1])


def log_density_of(
    structure: Structure, frozen: Marginal, *, batch: int, shared_code: bool = False
) -> LogDensity:
    """The compiled marginal log posterior for numpy arrays (n, d) of any n, evaluated in batches of one size.

    `shared_code` compiles once for all campaigns of one shape, at half the speed afterwards.
    """

    compiled = (
        partial(shared_log_posterior, structure, frozen)
        if shared_code
        else log_posterior(structure, frozen)
    )

    def log_density(thetas: np.ndarray) -> np.ndarray:
        n = len(thetas)
        padded = np.concatenate([thetas, np.repeat(thetas[-1:], -n % batch, axis=0)])
        parts = [compiled(padded[i : i + batch]) for i in range(0, len(padded), batch)]
        return np.concatenate([np.asarray(p) for p in parts])[:n]

    return log_density


def batch_size(at: Estimate) -> int:
    """Draws evaluated at once: few enough that the trajectories of a batch stay in the processor's cache.

    emcee's half-ensemble moves ask for 32 at a time.
    """
    rows = at.model.data.arrays.telemetry.rate.shape
    return int(np.clip(2 ** int(np.log2(max(1.0, 150_000 / (rows[0] * rows[1])))), 8, 32))


def sample(
    at: Estimate,
    settings: Settings | None = None,
    *,
    folder: Path | None = None,
    progress: Progress | None = None,
    shared_code: bool = False,
) -> Chains:
    """Sample the marginal posterior around an estimate.

    Parameters
    ----------
    folder : where the chains are kept while they grow; with chains of the same run in it the run goes on.
    progress : called with (what, done, of).
    shared_code : compile once for all campaigns of one shape (studies of many short fits).

    Raises
    ------
    EstimateError : no finite starting points.
    """
    settings, began = settings or Settings(), perf_counter()
    log_density = log_density_of(
        at.model.structure, marginal(at), batch=batch_size(at), shared_code=shared_code
    )
    seeds = np.random.SeedSequence(settings.seed).spawn(settings.ensembles + 1)
    move, share, spent = _proposal(
        at, log_density, np.random.RandomState(np.random.MT19937(seeds[-1]))
    )
    moves = [(move, share), (emcee.moves.DEMove(), 1.0 - share)]
    if folder is not None:
        make_folder(folder)
    files = [
        None if folder is None else folder / f"ensemble_{k}.h5" for k in range(settings.ensembles)
    ]
    samplers = [
        _ensemble(at, log_density, moves, move, settings, seed, file)
        for seed, file in zip(seeds[:-1], files, strict=True)
    ]
    steps = settings.steps
    while True:
        _advance(samplers, files, steps, settings.threads, progress)
        chains = _collect(samplers, steps, move, spent, perf_counter() - began)
        wanted = steps_wanted(chains.diagnostics, settings)
        if wanted <= steps:
            return chains
        steps = wanted


def steps_wanted(found: Diagnostics, settings: Settings) -> int:
    """How many steps each ensemble should have, from the diagnostics of those that it has; no more than those if the gates passed.

    >>> found = Diagnostics(True, 1.0, 4000.0, 2000.0, 2.0, 18_944, 0.1, 1.0, 0.6, 12, 72)
    >>> steps_wanted(found, Settings(target_ess=1000.0)), steps_wanted(found, Settings(target_ess=2500.0)), steps_wanted(found, Settings())
    (72, 95, 144)
    """
    effective = float(np.minimum(found.ess_bulk_min, found.ess_tail_min))  # not a number stays one
    if (found.converged and effective >= settings.target_ess) or found.steps >= settings.max_steps:
        return found.steps
    draws = found.steps - found.discarded
    wanted = found.discarded + _MARGIN * draws * max(
        settings.target_ess / max(effective, 1.0), _TIMES_TAU * found.tau_max / draws
    )
    wanted = (
        wanted if np.isfinite(wanted) else np.inf
    )  # of chains that do not move nothing can be foreseen
    return min(
        int(np.clip(np.ceil(wanted), found.steps + _BURN, 2 * found.steps)), settings.max_steps
    )


def _proposal(
    at: Estimate, log_density: LogDensity, random: np.random.RandomState
) -> tuple[IndependenceMove, float, int]:
    """The Laplace approximation as proposal, or, where that is poor, the shape of a pilot sample; its share of the moves; the evaluations spent."""
    logarithmic = np.array([p.logarithmic for p in at.model.space.priors])
    move, spent = IndependenceMove(at.theta, at.covariance, logarithmic=logarithmic), 0
    for _ in range(4):
        draws = move.draw(random, 256)
        spent += len(draws)
        acceptance = _expected_acceptance(log_density(draws) - move.log_density(draws))
        if acceptance > _POOR:
            return move, float(np.clip(acceptance, *_SHARES)), spent
        starts = _finite_starts(move, log_density, random, _walkers(64, len(at.theta)))
        pilot = emcee.EnsembleSampler(
            len(starts), starts.shape[1], log_density, vectorize=True, moves=emcee.moves.DEMove()
        )
        pilot.random_state = random.get_state()
        pilot.run_mcmc(starts, 400)
        random.set_state(pilot.random_state)
        spent += 401 * len(starts)
        kept = pilot.get_chain(discard=200, flat=True)
        move = IndependenceMove(kept.mean(0), np.cov(kept.T), 8.0, logarithmic)
    return move, _SHARES[0], spent


def _expected_acceptance(log_weights: np.ndarray) -> float:
    """Acceptance an independence sampler would have, from importance weights of its proposals."""
    weights = np.exp(log_weights - log_weights.max())
    if not np.any(np.isfinite(log_weights)):
        return 0.0
    pairs = np.minimum(weights[:, None], weights[None, :])
    return float(pairs.sum() / (len(weights) * weights.sum()))


def _finite_starts(
    move: IndependenceMove, log_density: LogDensity, random: np.random.RandomState, n: int
) -> np.ndarray:
    """n over-dispersed points with finite density (emcee accepts others without a word)."""
    kept: list[np.ndarray] = []
    for _ in range(200):
        drawn = move.draw(random, n, stretch=_STRETCH)
        kept.extend(drawn[np.isfinite(log_density(drawn))])
        if len(kept) >= n:
            return np.array(kept[:n])
    raise EstimateError(
        "the posterior is not finite around its maximum",
        advice="check priors, and that every wheel and rate axis moves",
    )


def _walkers(wanted: int, d: int) -> int:
    """Walkers of an ensemble: emcee's moves need twice as many as there are dimensions."""
    return max(wanted, 2 * d)


def _ensemble(
    at, log_density, moves, move, settings: Settings, seed, file: Path | None
) -> emcee.EnsembleSampler:
    """One ensemble at its start, or where its chain file ends."""
    random = np.random.RandomState(np.random.MT19937(seed))
    d, backend = len(at.theta), emcee.backends.Backend()
    walkers = _walkers(settings.walkers, d)
    if file is not None:
        remove_leftovers(file)
        backend = load_chain(file, walkers, d)
    sampler = emcee.EnsembleSampler(
        walkers, d, log_density, vectorize=True, moves=moves, backend=backend
    )
    if file is not None and backend.iteration > 0:
        sampler._previous_state = (
            sampler.get_last_sample()
        )  # with its random state: goes on bit for bit
        return sampler
    starts = _finite_starts(move, log_density, random, walkers)
    sampler._previous_state = emcee.State(starts, random_state=random.get_state())
    return sampler


def _advance(
    samplers: list[emcee.EnsembleSampler],
    files: list[Path | None],
    steps: int,
    threads: int,
    progress: Progress | None,
) -> None:
    """Bring every ensemble to `steps` steps."""
    target, done, stopped = steps * len(samplers), [0] * len(samplers), Event()

    def run(k: int) -> None:
        sampler = samplers[k]
        done[k] = sampler.backend.iteration
        if done[k] >= steps:
            return
        for _ in sampler.sample(sampler._previous_state, iterations=steps - done[k]):
            done[k] += 1
            if files[k] is not None and (done[k] % _SAVED == 0 or done[k] == steps):
                save_chain(sampler.backend, files[k])
            if progress:
                progress("sampling", sum(done), target)
            if stopped.is_set():
                return
        sampler._previous_state = sampler.get_last_sample()

    # BLAS gains nothing on matrices this small, and its waiting threads would take the cores from the ensembles.
    with threadpool_limits(1), ThreadPoolExecutor(threads) as pool:
        try:
            for ended in as_completed([pool.submit(run, k) for k in range(len(samplers))]):
                ended.result()  # as it ends and not in order: what the last ensemble meets must not wait for the first
        finally:
            stopped.set()  # an interrupt or an error ends the other ensembles too, instead of waiting for their last step


def _collect(samplers, steps: int, move: IndependenceMove, spent: int, seconds: float) -> Chains:
    # Of a run that was killed some ensembles may have more: what is decided here must not depend on that.
    chain = np.stack([s.get_chain()[:steps] for s in samplers])  # (ensembles, steps, walkers, d)
    lp = np.stack([s.get_log_prob()[:steps] for s in samplers])
    burn = min(_BURN, chain.shape[1] // 2)
    tau = max(autocorrelation_time(c[burn:]) for c in chain)
    discard = min(max(_BURN, int(np.ceil(5.0 * tau))), chain.shape[1] // 2)
    kept = np.moveaxis(chain[:, discard:], 1, 2)
    evaluations = spent + int(chain.shape[0] * chain.shape[2] * (chain.shape[1] + 1))
    # Not emcee's own count, which holds the further steps too.
    acceptance = float(np.mean(np.any(chain[:, 1:] != chain[:, :-1], axis=-1)))
    found = diagnose_chains(
        kept,
        tau=tau,
        evaluations=evaluations,
        seconds=seconds,
        acceptance=acceptance,
        discarded=discard,
    )
    return Chains(kept, np.moveaxis(lp[:, discard:], 1, 2), found, move.degrees)


def autocorrelation_time(chain: np.ndarray) -> float:
    """The largest integrated autocorrelation time of all parameters of an ensemble's chain (steps, walkers, d).

    A walker that has not moved yet has none: the chain then counts as one draw.

    >>> autocorrelation_time(np.random.default_rng(1).normal(size=(500, 4, 2))) < 2.0, autocorrelation_time(np.ones((500, 4, 2)))
    (True, 500.0)
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
    """Convergence of samples (ensembles, walkers, draws, d): nested R-hat over ensembles, effective sample sizes, length.

    Plain R-hat over walkers raises false alarms on perfect ensembles and misses one that is stuck
    (Margossian et al. 2024); ensembles are what is independent here.
    """
    import arviz as az

    ensembles, walkers, draws, d = samples.shape
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "Found chain dimension to be longer", UserWarning
        )  # walkers are many by design
        tree = az.from_dict(
            {"posterior": {"theta": samples.reshape(ensembles * walkers, draws, d)}}
        )
    superchains = np.repeat(range(ensembles), walkers).tolist()
    rhat = float(az.rhat_nested(tree, superchain_ids=superchains)["theta"].max())
    # emcee's walkers are not independent: believe the smaller of both counts.
    by_tau = ensembles * walkers * draws / max(tau, 1.0)
    bulk = min(float(az.ess(tree, method="bulk")["theta"].min()), by_tau)
    tail = float(az.ess(tree, method="tail")["theta"].min())
    return Diagnostics(
        converged=bool(
            rhat < 1.01 and np.minimum(bulk, tail) >= 400.0 and draws >= _TIMES_TAU * tau
        ),
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
