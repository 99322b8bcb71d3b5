"""Sampling: independently seeded, over-dispersed emcee ensembles.

The Laplace approximation gives an independence move; the differential evolution move beside it
keeps the ensembles moving where that approximation is poor, and a pilot run then replaces it.
Chains are kept in emcee's own HDF5 format, one file an ensemble, and a killed run
goes on bit for bit.

A kill at any moment leaves a file that can be read. emcee's `HDFBackend` writes into the same file
at every step, and a kill while it does leaves, now and then, a file that cannot be opened or a
random state that belongs to another step. Chains are kept in memory instead, and their file is
replaced from time to time; steps since then are computed again, to the same bits.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor, as_completed
from io import BytesIO
from pathlib import Path
from threading import Event
from time import perf_counter

import emcee
import numpy as np
from emcee.backends import Backend, HDFBackend
from threadpoolctl import threadpool_limits

from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.files import make_folder, remove_leftovers
from bayes_inertia.inference.density_marginal import log_density_with_densities
from bayes_inertia.inference.gates import Diagnostics, autocorrelation_time, diagnose_chains
from bayes_inertia.inference.laplace import Estimate, marginal
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.marginal_posterior import LogDensity, log_density_of
from bayes_inertia.inference.proposal import Proposal, find_proposal, finite_starts, walkers_needed
from bayes_inertia.inference.settings import Settings, require_settings, usual_settings
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.progress import Progress
from bayes_inertia.sealing import is_sealed, write_sealed
from bayes_inertia.tables.isolated import check_readable

_ADVICE = "delete it, and this ensemble begins again"


def load_chain(path: Path, walkers: int, d: int) -> Backend:
    """The chain that a file holds, in memory.

    Examples
    --------
    >>> load_chain(Path("no/such/file.h5"), 8, 2).shape
    (8, 2)
    """
    chain = Backend()
    chain.reset(walkers, d)
    if not path.exists():
        return chain
    try:
        if not is_sealed(path, _ADVICE):
            # Of an earlier version, or damaged: then it could end this process.
            check_readable(path, "check", _ADVICE)
        _load(path, chain, walkers, d)
    except CampaignError as error:
        raise OutputError(error.what, where=error.where, advice=error.advice) from error
    except OutputError:
        raise
    except Exception as error:  # The libraries raise whatever they stumble over.
        raise OutputError(f"not a chain ({error})", where=str(path), advice=_ADVICE) from error
    return chain


def _load(path: Path, chain: Backend, walkers: int, d: int) -> None:
    """Put what a file holds into an empty chain."""
    kept = HDFBackend(str(path), read_only=True)
    shape = tuple(map(int, kept.shape))
    if shape != (walkers, d):
        what = f"holds an ensemble of shape {shape}, wanted is {(walkers, d)}"
        raise OutputError(what, where=str(path), advice=_ADVICE)
    steps = int(kept.iteration)
    if steps <= 0:
        return
    chain.chain, chain.log_prob = kept.get_chain(), kept.get_log_prob()
    chain.accepted, chain.random_state = kept.accepted, kept.random_state
    chain.iteration = steps
    whole = chain.chain.shape == (steps, walkers, d) and chain.log_prob.shape == (steps, walkers)
    if not (whole and chain.accepted.shape == (walkers,) and np.isfinite(chain.chain).all()):
        raise OutputError("not a chain (incomplete)", where=str(path), advice=_ADVICE)
    np.random.RandomState().set_state(chain.random_state)  # Or an exception.


def save_chain(chain: Backend, path: Path) -> None:
    """Replace a file by what a chain holds now; emcee's `HDFBackend` reads it.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.h5")
    ...     save_chain(load_chain(path, 8, 2), path)
    ...     int(HDFBackend(str(path)).iteration)
    0
    """
    import h5py

    walkers, d = chain.shape
    steps = chain.iteration
    arrays = {
        "accepted": chain.accepted,
        "chain": chain.get_chain() if steps else np.zeros((0, walkers, d)),
        "log_prob": chain.get_log_prob() if steps else np.zeros((0, walkers)),
    }
    # In memory: HDF5 can end the process where the disk has no room.
    content = BytesIO()
    with h5py.File(content, "w") as file:
        group = file.create_group(HDFBackend("").name)
        for name, values in arrays.items():
            group[name] = values
        sizes = {"nwalkers": walkers, "ndim": d, "iteration": steps}
        group.attrs.update({"version": emcee.__version__, "has_blobs": False, **sizes})
        for i, part in enumerate(chain.random_state or ()):
            group.attrs[f"random_state_{i}"] = part
    with content.getbuffer() as written:
        write_sealed(path, written)


@array_dataclass
class Chains:
    """Samples of the posterior.

    Parameters
    ----------
    samples : (ensembles, walkers, draws, d) array
        Warm-up removed.
    log_posterior : (ensembles, walkers, draws) array
        Log density of each, up to a constant.
    diagnostics : Diagnostics
        Whether they can be trusted.
    """

    samples: np.ndarray
    log_posterior: np.ndarray
    diagnostics: Diagnostics


def _batch_size(rows: int, most: int) -> int:
    """Draws evaluated at once: few enough that their trajectories stay in the processor's cache.

    `rows`: of one draw's trajectories. Returns: A power of two from 8 to 32, or `most`; emcee's
    half-ensemble moves ask for 32 at a time.
    """
    cached = 2 ** int(np.log2(max(1.0, LIMITS.cached_rows / rows)))
    return min(most, int(np.clip(cached, 8, 32)))


def sample(
    estimate: Estimate,
    settings: Settings | None = None,
    *,
    folder: str | Path | None = None,
    progress: Progress | None = None,
) -> Chains:
    """Sample the marginal posterior around an estimate.

    `folder`: where the chains are kept while they grow; with chains of the same run in it the run
    goes on.
    """
    began = perf_counter()
    settings = require_settings(settings, usual_settings(estimate.model.effects))
    log_density = log_density_at(estimate, most=settings.walkers // 2)
    seeds = np.random.SeedSequence(settings.seed).spawn(settings.ensembles + 1)
    pilot_random = np.random.RandomState(np.random.MT19937(seeds[-1]))
    move, share, spent = find_proposal(estimate, log_density, pilot_random)
    moves = [(move, share), (emcee.moves.DEMove(), 1.0 - share)]
    files: list[Path | None] = [None] * settings.ensembles
    if folder is not None:
        folder = make_folder(folder)
        files = [folder / f"ensemble_{k}.h5" for k in range(settings.ensembles)]
    samplers = [
        _ensemble(log_density, moves, move, settings, seed, file)
        for seed, file in zip(seeds[:-1], files, strict=True)
    ]
    steps = settings.steps
    while True:
        _advance(samplers, files, steps, settings.threads, progress)
        chains = _collect(samplers, steps, spent, perf_counter() - began)
        wanted = steps_wanted(chains.diagnostics, settings)
        if wanted <= steps:
            return chains
        steps = wanted


def log_density_at(estimate: Estimate, most: int = 32) -> LogDensity:
    """The compiled density that is sampled around an estimate."""
    model = estimate.model
    if not model.noise.is_stated:
        rows = model.data.arrays.telemetry.sample.size
        return log_density_with_densities(estimate, batch=_batch_size(rows, most))
    rows = model.data.pieces[0].arrays.telemetry.sample.shape[1]
    return log_density_of(model.structure, marginal(estimate), batch=_batch_size(rows, most))


def steps_wanted(diagnostics: Diagnostics, settings: Settings) -> int:
    """How many steps each ensemble should have.

    Returns: no more than the steps that it has if the gates passed.

    Examples
    --------
    >>> diagnostics = Diagnostics(True, 1.0, 4000.0, 2000.0, 2.0, 11_264, 0.1, 1.0, 0.6, 12, 44)
    >>> [steps_wanted(diagnostics, Settings(target_ess=n)) for n in (1000.0, 2500.0, 10_000.0)]
    [44, 56, 88]
    """
    steps, draws = diagnostics.steps, diagnostics.steps - diagnostics.discarded
    # Not a number stays one.
    effective = float(np.minimum(diagnostics.ess_bulk_min, diagnostics.ess_tail_min))
    enough = diagnostics.converged and effective >= settings.target_ess
    if enough or steps >= settings.max_steps:
        return steps
    times = max(
        settings.target_ess / max(effective, 1.0),
        LIMITS.autocorrelation_times * diagnostics.tau_max / draws,
    )
    wanted = diagnostics.discarded + LIMITS.steps_margin * draws * times
    # Of chains that do not move nothing can be foreseen.
    wanted = wanted if np.isfinite(wanted) else np.inf
    most = int(np.clip(np.ceil(wanted), steps + LIMITS.least_further_steps, 2 * steps))
    return min(most, settings.max_steps)


def _ensemble(
    log_density: LogDensity,
    moves: list[tuple[emcee.moves.Move, float]],
    proposal: Proposal,
    settings: Settings,
    seed: np.random.SeedSequence,
    file: Path | None,
) -> emcee.EnsembleSampler:
    """One ensemble at its start, or where its chain file ends."""
    random = np.random.RandomState(np.random.MT19937(seed))
    d, backend = proposal.ndim, emcee.backends.Backend()
    walkers = walkers_needed(settings.walkers, d)
    if file is not None:
        remove_leftovers(file)
        backend = load_chain(file, walkers, d)
    sampler = emcee.EnsembleSampler(
        walkers, d, log_density, vectorize=True, moves=moves, backend=backend
    )
    if backend.iteration > 0:
        # With its random state: goes on bit for bit.
        sampler._previous_state = sampler.get_last_sample()
        return sampler
    starts = finite_starts(proposal, log_density, random, walkers)
    starts.random_state = random.get_state()
    sampler._previous_state = starts
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
        if done[k] >= steps or stopped.is_set():
            return
        for _ in sampler.sample(sampler._previous_state, iterations=steps - done[k]):
            done[k] += 1
            file, ends = files[k], stopped.is_set()
            # A file is replaced whole, so that a long chain waits for a sixteenth of its length.
            waits = max(LIMITS.least_further_steps, 2 ** (done[k].bit_length() - 5))
            if file is not None and (done[k] % waits == 0 or done[k] == steps or ends):
                save_chain(sampler.backend, file)
            if progress:
                progress("sampling, steps", sum(done), target)
            if ends:
                return
        sampler._previous_state = sampler.get_last_sample()

    # BLAS gains nothing on matrices this small, and its waiting threads would take the cores from
    # the ensembles.
    with threadpool_limits(1), ThreadPoolExecutor(threads) as pool:
        try:
            for ended in as_completed([pool.submit(run, k) for k in range(len(samplers))]):
                # As it ends and not in order: what the last ensemble meets must not wait for the
                # first.
                ended.result()
        finally:
            # An interrupt or an error ends the other ensembles too, instead of waiting for their
            # last step.
            stopped.set()


def _collect(
    samplers: list[emcee.EnsembleSampler], steps: int, spent: int, seconds: float
) -> Chains:
    """What the ensembles hold after `steps` steps, without warm-up."""
    # Of a run that was killed some ensembles may have more: what is decided here must not depend
    # on that.
    chain = np.stack([s.get_chain()[:steps] for s in samplers])  # (ensembles, steps, walkers, d)
    lp = np.stack([s.get_log_prob()[:steps] for s in samplers])
    warm_up = min(LIMITS.least_warm_up_steps, chain.shape[1] // 2)
    tau = max(autocorrelation_time(c[warm_up:]) for c in chain)
    discard = min(max(LIMITS.least_warm_up_steps, int(np.ceil(5.0 * tau))), chain.shape[1] // 2)
    kept = np.moveaxis(chain[:, discard:], 1, 2)
    diagnostics = diagnose_chains(
        kept,
        tau=tau,
        evaluations=spent + int(chain.shape[0] * chain.shape[2] * (chain.shape[1] + 1)),
        seconds=seconds,
        # Not emcee's own count, which holds the further steps too.
        acceptance=float(np.mean(np.any(chain[:, 1:] != chain[:, :-1], axis=-1))),
        discarded=discard,
    )
    return Chains(kept, np.moveaxis(lp[:, discard:], 1, 2), diagnostics)
