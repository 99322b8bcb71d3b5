"""The samplers of `benchmark.py`, each run and timed on one posterior."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import process_time

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from by_hand import ByHand
from emcee.autocorr import integrated_time

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.inference.laplace import Estimate, marginal
from bayes_inertia.inference.marginal_posterior import LogDensity, log_posterior_of
from bayes_inertia.inference.proposal import IndependenceMove
from bayes_inertia.inference.sampler import sample
from bayes_inertia.inference.settings import Settings

WALKERS = 32  # of emcee's own moves
OURS = "bayes_inertia (independence move + DE)"
STRETCH = "emcee StretchMove, this package's posterior"
DE = "emcee DEMove, this package's posterior"
NUTS = "NUTS (blackjax), this package's posterior"
LOOP = "do it yourself: emcee over solve_ivp, slew by slew"
BATCH = "do it yourself: the same, 32 walkers in one solve_ivp"


@dataclass(frozen=True)
class Effort:
    """How much telemetry there is, and how long each sampler runs."""

    period: float = 0.5  # of telemetry [s]
    slews: int = 5
    ours: int = 144  # steps of four ensembles of 64 walkers
    stretch: int = 6000  # steps of 32 walkers
    de: int = 1500
    nuts_warmup: int = 300
    nuts_draws: int = 1000
    nuts_chains: int = 2
    by_hand: int = 2  # evaluations
    by_hand_walkers: int = 32


QUICK = Effort(
    period=1.0,
    slews=2,
    ours=24,
    stretch=60,
    de=60,
    nuts_warmup=60,
    nuts_draws=60,
    nuts_chains=1,
    by_hand=1,
    by_hand_walkers=2,
)


@dataclass(frozen=True)
class Result:
    """How one sampler did.

    `ess` is that of the worst parameter among the kept draws. `evaluations` and `seconds` are those
    of the kept draws and of the warm-up; gradients count as evaluations. `note` says how it was
    measured.
    """

    name: str
    ess: float
    evaluations: float
    warmup_evaluations: float
    seconds: float
    warmup_seconds: float
    note: str = ""

    @property
    def milliseconds(self) -> float:
        """Processor time of one evaluation [ms], the sampler's own work included."""
        return 1e3 * self.seconds / self.evaluations

    def per_evaluation(self, *, warmup: bool) -> float:
        """Effective samples per evaluation."""
        return self.ess / (self.evaluations + warmup * self.warmup_evaluations)

    def per_second(self, *, warmup: bool) -> float:
        """Effective samples per second."""
        return self.ess / (self.seconds + warmup * self.warmup_seconds)


def effective_samples(chains: np.ndarray) -> float:
    """Of the worst parameter of (chains, draws, d).

    The smaller of ArviZ's bulk count and the draws over the autocorrelation time.
    """
    import arviz as az

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Found chain dimension to be longer", UserWarning)
        bulk = float(
            az.ess(az.from_dict({"posterior": {"theta": chains}}), method="bulk")["theta"].min()
        )
    if np.any(np.ptp(chains, axis=1) == 0.0):
        return 0.0  # a chain that never moved is no sample
    tau = float(np.max(integrated_time(np.swapaxes(chains, 0, 1), quiet=True, tol=0)))
    return min(bulk, chains.shape[0] * chains.shape[1] / tau)


def run_ours(estimate: Estimate, effort: Effort, seed: int) -> Result:
    """`bayes_inertia.inference.sampler`, timed between its first and its last step."""
    clock: list[float] = []
    settings = Settings(seed=seed, steps=effort.ours, max_steps=effort.ours, threads=1)
    chains = sample(
        estimate, settings, progress=lambda what, done, of: clock.append(process_time())
    )
    ensembles, walkers, draws, d = chains.samples.shape
    kept = ensembles * walkers * draws
    # The first step ends after compiling; what came before is counted by its evaluations.
    seconds_each = (clock[-1] - clock[0]) / ((len(clock) - 1) * walkers)
    warmup = chains.diagnostics.evaluations - kept
    return Result(
        OURS,
        effective_samples(chains.samples.reshape(ensembles * walkers, draws, d)),
        kept,
        warmup,
        seconds_each * kept,
        seconds_each * warmup,
        f"{ensembles} ensembles of {walkers} walkers, {effort.ours} steps",
    )


def run_emcee(
    estimate: Estimate,
    log_density: LogDensity,
    name: str,
    move: emcee.moves.Move,
    steps: int,
    seed: int,
) -> Result:
    """One ensemble of an emcee move on this package's compiled posterior.

    It starts from draws of the Laplace approximation.
    """
    random = np.random.RandomState(seed)
    starts = IndependenceMove(estimate.theta, estimate.covariance).draw(random, WALKERS)
    sampler = emcee.EnsembleSampler(
        WALKERS, len(estimate.theta), log_density, vectorize=True, moves=move
    )
    state = sampler.run_mcmc(emcee.State(starts, random_state=random.get_state()), 2)
    sampler.reset()
    began = process_time()
    sampler.run_mcmc(state, steps)
    seconds_each = (process_time() - began) / (steps * WALKERS)
    # It starts in the posterior to a few per cent: one autocorrelation time of warm-up is plenty.
    tau = float(np.max(integrated_time(sampler.get_chain(), quiet=True, tol=0)))
    discard = min(steps // 2, math.ceil(tau))
    chains = np.swapaxes(sampler.get_chain(), 0, 1)[:, discard:]
    kept, warmup = WALKERS * (steps - discard), WALKERS * discard
    return Result(
        name,
        effective_samples(chains),
        kept,
        warmup,
        seconds_each * kept,
        seconds_each * warmup,
        f"{WALKERS} walkers, {steps} steps",
    )


def run_nuts(estimate: Estimate, effort: Effort, seed: int) -> Result:
    """NUTS with window adaptation, in coordinates whitened by the Laplace approximation.

    Gradients by reverse mode. One chain after another: chains under `vmap` wait for the longest
    trajectory among them and were slower on one core.
    """
    root = np.asarray(jnp.linalg.cholesky(jnp.asarray(estimate.covariance)))
    adapt, draw = _compiled(*_nuts(estimate, effort), seed, len(root))
    chains, gradients, warmup, seconds, warmup_seconds = [], 0, 0, 0.0, 0.0
    for key in jax.random.split(jax.random.key(seed), effort.nuts_chains):
        first, second, third = jax.random.split(key, 3)
        began = process_time()
        state, parameters, adaptation_steps = jax.block_until_ready(
            adapt(first, jax.random.normal(second, (len(root),)))
        )
        middle = process_time()
        z, steps = jax.block_until_ready(draw(third, state, parameters))
        warmup_seconds += middle - began
        seconds += process_time() - middle
        chains.append(estimate.theta + np.asarray(z) @ root.T)
        gradients += int(steps.sum())
        warmup += int(adaptation_steps)
    note = (
        f"{effort.nuts_chains} chains, {effort.nuts_warmup} steps of window adaptation, "
        f"{effort.nuts_draws} draws, gradients counted"
    )
    ess = effective_samples(np.array(chains))
    return Result(NUTS, ess, gradients, warmup, seconds, warmup_seconds, note)


def _nuts(estimate: Estimate, effort: Effort) -> tuple[Callable, Callable]:
    """Window adaptation (key, z) and drawing (key, state, parameters), not yet compiled."""
    import blackjax

    root = jnp.linalg.cholesky(jnp.asarray(estimate.covariance))
    posterior = partial(log_posterior_of, estimate.model.structure, marginal(estimate))

    def density(z):
        return posterior(estimate.theta + root @ z)

    adaptation = blackjax.window_adaptation(blackjax.nuts, density)

    def adapt(key, z):
        (state, parameters), info = adaptation.run(key, z, num_steps=effort.nuts_warmup)
        return state, parameters, info.info.num_integration_steps.sum()

    def draw(key, state, parameters):
        kernel = blackjax.nuts(density, **parameters)

        def step(state, key):
            state, info = kernel.step(key, state)
            return state, (state.position, info.num_integration_steps)

        return jax.lax.scan(step, state, jax.random.split(key, effort.nuts_draws))[1]

    return adapt, draw


def _compiled(adapt: Callable, draw: Callable, seed: int, d: int) -> tuple[Callable, Callable]:
    """Both functions compiled ahead of time, for a key and a start of their kind."""
    key, z = jax.random.key(seed), jnp.zeros(d)
    state, parameters, _ = jax.eval_shape(adapt, key, z)
    return (
        jax.jit(adapt).lower(key, z).compile(),
        jax.jit(draw).lower(key, state, parameters).compile(),
    )


def run_by_hand(
    estimate: Estimate, campaign: Campaign, truth: np.ndarray, effort: Effort, stretch: Result
) -> list[Result]:
    """What a user would write alone.

    Times are those of real evaluations at draws around the truth. Effective samples per evaluation
    are those of `StretchMove` above, which is generous (see `by_hand`).
    """
    # Of the solvers and tolerances tried, the fastest whose error is far below the noise.
    density = ByHand(campaign, "LSODA", 1e-8, 1e-10)
    draws = IndependenceMove(truth, estimate.covariance).draw(
        np.random.RandomState(1), max(effort.by_hand, effort.by_hand_walkers)
    )
    began = process_time()
    for theta in draws[: effort.by_hand]:
        density(theta)
    loop_seconds = (process_time() - began) / effort.by_hand
    began = process_time()
    density.batch(draws[: effort.by_hand_walkers])
    batch_seconds = (process_time() - began) / effort.by_hand_walkers
    return [
        Result(
            name,
            stretch.ess,
            stretch.evaluations,
            stretch.warmup_evaluations,
            seconds * stretch.evaluations,
            seconds * stretch.warmup_evaluations,
            f"time measured on {evaluations} evaluations, "
            "effective samples per evaluation taken from StretchMove",
        )
        for name, seconds, evaluations in (
            (LOOP, loop_seconds, effort.by_hand),
            (BATCH, batch_seconds, effort.by_hand_walkers),
        )
    ]
