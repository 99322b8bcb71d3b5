"""How many effective samples a second? This package's sampler and five others on one posterior, on
one core.

The campaign: five simulated slews of a MOST-like spacecraft with telemetry at 2 Hz; the posterior:
J and K, nine parameters.

    python analyses/benchmark.py

writes `figures/benchmark.png` and `analyses/results/benchmark.{md,json}` within five minutes of an
idle core. Needs the extra `benchmark`.

Times are processor seconds of this process, so that other work on the machine does not enter;
compiling is not in them, nor is
the optimizer, which gives every sampler its start and scale. Effective samples are those of the
worst parameter, the
smaller of ArviZ's bulk count and emcee's draws over autocorrelation time.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from time import process_time

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from emcee.autocorr import integrated_time
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parent))

from by_hand import ByHand

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.laplace import Estimate, marginal
from bayes_inertia.inference.marginal_posterior import LogDensity, log_density_of, log_posterior_of
from bayes_inertia.inference.moves import IndependenceMove
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.sampler import Settings, sample
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.pictures.style import BLUE, INK, MUTED, ORANGE, styled

ROOT = Path(__file__).parents[1]
WALKERS = 32  # of emcee's own moves
OURS, STRETCH, DE, NUTS, LOOP, BATCH = (
    "bayes_inertia (independence move + DE)",
    "emcee StretchMove, this package's posterior",
    "emcee DEMove, this package's posterior",
    "NUTS (blackjax), this package's posterior",
    "do it yourself: emcee over solve_ivp, slew by slew",
    "do it yourself: the same, 32 walkers in one solve_ivp",
)


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
    """One sampler: `ess` of the worst parameter among the kept draws; `evaluations` and `seconds`
    of the kept draws and of warm-up
    (gradients count as evaluations). `note` says how it was measured."""

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


def the_campaign(effort: Effort, seed: int) -> tuple[Campaign, np.ndarray]:
    """The campaign and its true (J, K)."""
    plan = paper_like_plan()
    plan = replace(plan, slews=plan.slews[: effort.slews], telemetry_period=effort.period)
    flight = draw_flight(planned_campaign(plan, most_like_mission()), plan, seed, vary=False)
    J = flight.spacecraft.inertia_B
    return flight.campaign, np.array(
        [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *flight.spacecraft.scale_factor]
    )


def effective_samples(chains: np.ndarray) -> float:
    """Of the worst parameter of (chains, draws, d): the smaller of ArviZ's bulk count and draws
    over autocorrelation time.
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


def run_ours(at: Estimate, effort: Effort, seed: int) -> Result:
    """`bayes_inertia.inference.sampler`, timed between its first and its last step."""
    clock: list[float] = []
    settings = Settings(seed=seed, steps=effort.ours, max_steps=effort.ours, threads=1)
    found = sample(at, settings, progress=lambda what, done, of: clock.append(process_time()))
    ensembles, walkers, draws, d = found.samples.shape
    kept = ensembles * walkers * draws
    # The first step ends after compiling; what came before is counted by its evaluations.
    each = (clock[-1] - clock[0]) / ((len(clock) - 1) * walkers)
    spent = found.diagnostics.evaluations - kept
    ess = effective_samples(found.samples.reshape(ensembles * walkers, draws, d))
    return Result(
        OURS,
        ess,
        kept,
        spent,
        each * kept,
        each * spent,
        f"{ensembles} ensembles of {walkers} walkers, {effort.ours} steps",
    )


def run_emcee(
    at: Estimate, log_density: LogDensity, name: str, move: emcee.moves.Move, steps: int, seed: int
) -> Result:
    """One ensemble of an emcee move on this package's compiled posterior, from draws of the Laplace
    approximation.
    """
    walkers = WALKERS
    random = np.random.RandomState(seed)
    starts = IndependenceMove(at.theta, at.covariance).draw(random, walkers)
    sampler = emcee.EnsembleSampler(walkers, len(at.theta), log_density, vectorize=True, moves=move)
    state = sampler.run_mcmc(emcee.State(starts, random_state=random.get_state()), 2)
    sampler.reset()
    began = process_time()
    sampler.run_mcmc(state, steps)
    each = (process_time() - began) / (steps * walkers)
    chain = np.swapaxes(sampler.get_chain(), 0, 1)
    # It starts in the posterior to a few per cent, so that one autocorrelation time of warm-up is
    # plenty.
    discard = min(
        steps // 2,
        math.ceil(float(np.max(integrated_time(sampler.get_chain(), quiet=True, tol=0)))),
    )
    kept, spent = walkers * (steps - discard), walkers * discard
    return Result(
        name,
        effective_samples(chain[:, discard:]),
        kept,
        spent,
        each * kept,
        each * spent,
        f"{walkers} walkers, {steps} steps",
    )


def run_nuts(at: Estimate, effort: Effort, seed: int) -> Result:
    """NUTS with window adaptation, in coordinates whitened by the Laplace approximation; gradients
    by reverse mode.

    One chain after another: chains under `vmap` wait for the longest trajectory among them and were
    slower on one core.
    """
    import blackjax

    root = jnp.linalg.cholesky(jnp.asarray(at.covariance))
    posterior = partial(log_posterior_of, at.model.structure, marginal(at))

    def density(z):
        return posterior(at.theta + root @ z)

    adaptation = blackjax.window_adaptation(blackjax.nuts, density)

    @jax.jit
    def adapt(key, z):
        (state, found), info = adaptation.run(key, z, num_steps=effort.nuts_warmup)
        return state, found, info.info.num_integration_steps.sum()

    @jax.jit
    def draw(key, state, found):
        kernel = blackjax.nuts(density, **found)

        def step(state, key):
            state, info = kernel.step(key, state)
            return state, (state.position, info.num_integration_steps)

        return jax.lax.scan(step, state, jax.random.split(key, effort.nuts_draws))[1]

    adapt, draw, chains, gradients, spent, seconds, warm = (
        *_compiled(adapt, draw, seed, len(root)),
        [],
        0,
        0,
        0.0,
        0.0,
    )
    for key in jax.random.split(jax.random.key(seed), effort.nuts_chains):
        first, second, third = jax.random.split(key, 3)
        began = process_time()
        state, found, used = jax.block_until_ready(
            adapt(first, jax.random.normal(second, (len(root),)))
        )
        middle = process_time()
        z, steps = jax.block_until_ready(draw(third, state, found))
        warm, seconds = warm + middle - began, seconds + process_time() - middle
        chains.append(at.theta + np.asarray(z) @ np.asarray(root).T)
        gradients, spent = gradients + int(steps.sum()), spent + int(used)
    note = (
        f"{effort.nuts_chains} chains, {effort.nuts_warmup} steps of window adaptation, "
        f"{effort.nuts_draws} draws, gradients counted"
    )
    return Result(NUTS, effective_samples(np.array(chains)), gradients, spent, seconds, warm, note)


def _compiled(adapt: Callable, draw: Callable, seed: int, d: int) -> tuple[Callable, Callable]:
    """Both functions compiled ahead of time, for a key and a start of their kind."""
    key, z = jax.random.key(seed), jnp.zeros(d)
    state, found, _ = jax.eval_shape(adapt, key, z)
    return adapt.lower(key, z).compile(), draw.lower(key, state, found).compile()


def run_by_hand(
    at: Estimate, campaign: Campaign, truth: np.ndarray, effort: Effort, stretch: Result
) -> list[Result]:
    """What a user would write alone. Times are those of real evaluations at draws around the truth;
    effective samples per
    evaluation are those of `StretchMove` above, which is generous (see `by_hand`)."""
    # Of the solvers and tolerances tried, the fastest whose error is far below the noise.
    density = ByHand(campaign, "LSODA", 1e-8, 1e-10)
    draws = IndependenceMove(truth, at.covariance).draw(
        np.random.RandomState(1), max(effort.by_hand, effort.by_hand_walkers)
    )
    began = process_time()
    for theta in draws[: effort.by_hand]:
        density(theta)
    slow = (process_time() - began) / effort.by_hand
    began = process_time()
    density.batch(draws[: effort.by_hand_walkers])
    fast = (process_time() - began) / effort.by_hand_walkers
    shared = (
        "time measured on {} evaluations, effective samples per evaluation taken from StretchMove"
    )
    counts = (effort.by_hand, effort.by_hand_walkers)
    return [
        Result(
            name,
            stretch.ess,
            stretch.evaluations,
            stretch.warmup_evaluations,
            ms * stretch.evaluations,
            ms * stretch.warmup_evaluations,
            shared.format(n),
        )
        for name, ms, n in zip((LOOP, BATCH), (slow, fast), counts, strict=True)
    ]


@contextmanager
def one_core() -> Iterator[None]:
    """Everything within runs on one core, where the system lets a process choose."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        with threadpool_limits(1):
            yield
    finally:
        os.sched_setaffinity(0, allowed)


def run(effort: Effort, seed: int) -> list[Result]:
    """All samplers on one posterior (NUTS where blackjax is installed)."""
    with one_core():
        campaign, truth = the_campaign(effort, seed)
        at = estimate(Model(campaign))
        results = [run_ours(at, effort, seed)]
        _say(results[-1])
        log_density = log_density_of(at.model.structure, marginal(at), batch=WALKERS // 2)
        for name, move, steps in (
            (STRETCH, emcee.moves.StretchMove(), effort.stretch),
            (DE, emcee.moves.DEMove(), effort.de),
        ):
            results.append(run_emcee(at, log_density, name, move, steps, seed))
            _say(results[-1])
        if find_spec("blackjax"):
            results.append(run_nuts(at, effort, seed))
            _say(results[-1])
        results += run_by_hand(at, campaign, truth, effort, results[1])
    return results


def _say(result: Result) -> None:
    print(
        f"{result.name}: {result.milliseconds:.3f} ms, {result.per_second(warmup=False):.3g} "
        "effective samples a second",
        file=sys.stderr,
    )


def claims(results: Sequence[Result]) -> list[dict]:
    """What the package promises, and what was measured (warm-up counted: the less favourable way
    for the package is taken).
    """
    by_name = {r.name: r for r in results}
    ours = by_name[OURS]

    def gain(name: str) -> float:
        return min(
            ours.per_second(warmup=w) / by_name[name].per_second(warmup=w) for w in (False, True)
        )

    rows = [
        (
            "effective samples per evaluation",
            0.5,
            min(ours.per_evaluation(warmup=w) for w in (False, True)),
        )
    ]
    if NUTS in by_name:
        rows.append(("times the effective samples per second of NUTS", 10.0, gain(NUTS)))
    rows.append(("times those of the do-it-yourself baseline, slew by slew", 1000.0, gain(LOOP)))
    rows.append(
        ("times those of the do-it-yourself baseline, 32 walkers at once", 1000.0, gain(BATCH))
    )
    return [
        {
            "claim": claim,
            "wanted": wanted,
            "measured": measured,
            "reached": bool(measured >= wanted),
        }
        for claim, wanted, measured in rows
    ]


def report(results: Sequence[Result], seed: int, seconds: float) -> str:
    """The result as Markdown."""
    ours = results[0]
    lines = [
        "# Effective samples per second",
        "",
        *(__doc__ or "").split("\n\n")[1:2],
        "",
        (__doc__ or "").split("\n\n")[-1].strip(),
        "",
    ]
    lines += [
        f"Made by `python analyses/benchmark.py` (seed {seed}) in {seconds:.0f} processor seconds, "
        "compiling included."
    ]
    lines += [
        "Ratios are to this package; the absolute times are those of one core of one machine.",
        "",
    ]
    header = (
        "sampler",
        "ms per evaluation",
        "ESS per evaluation",
        "with warm-up",
        "ESS per second",
        "with warm-up",
        "this package is faster by",
        "with warm-up",
    )
    lines += [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
    for r in results:
        cells = [f"{r.milliseconds:.3g}"]
        cells += [f"{r.per_evaluation(warmup=w):.3g}" for w in (False, True)] + [
            f"{r.per_second(warmup=w):.3g}" for w in (False, True)
        ]
        cells += [
            f"{ours.per_second(warmup=w) / r.per_second(warmup=w):,.3g}" for w in (False, True)
        ]
        lines.append(f"| {r.name} | {' | '.join(cells)} |")
    lines += [
        "",
        "How each was run:",
        "",
        *(f"- {r.name}: {r.note}; {r.ess:.0f} effective samples." for r in results),
        "",
    ]
    lines += ["| promised | wanted | measured | reached |", "|---|---|---|---|"]
    lines += [
        f"| {c['claim']} | {c['wanted']:g} | {c['measured']:,.3g} | "
        f"{'yes' if c['reached'] else 'NO'} |"
        for c in claims(results)
    ]
    lines += [
        "",
        "Measured figures are the smaller of those with and without warm-up. "
        "One evaluation is one posterior density, for NUTS one density with its",
        "gradient. The do-it-yourself baseline is treated kindly: "
        "it is given the sampling efficiency of nine dimensions, although its start states,",
        "held at the first readings, do not fit the data and would have to be sampled along.",
        "",
    ]
    return "\n".join(lines)


@styled
def picture(results: Sequence[Result]) -> Figure:
    """How many times fewer effective samples others give per evaluation and per second, on
    logarithmic bars.
    """
    ours = results[0]
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    labels = [r.name.replace(", ", ",\n").replace(": ", ":\n", 1) for r in results]
    y = np.arange(len(results))
    colors = [BLUE, *[ORANGE] * (len(results) - 1)]
    per_evaluation = np.array([r.per_evaluation(warmup=True) for r in results])
    gain = np.array([r.per_second(warmup=True) / ours.per_second(warmup=True) for r in results])
    texts = [f"{v:.2g}" for v in per_evaluation], ["1", *(f"1 / {1 / g:,.0f}" for g in gain[1:])]
    for ax, values, text, title in zip(
        (left, right), (per_evaluation, gain), texts, _TITLES, strict=True
    ):
        floor = 10.0 ** (np.floor(np.log10(values.min())) - 0.5)
        ax.barh(
            y,
            values - floor,
            left=floor,
            color=colors,
            edgecolor=INK,
            lw=0.5,
            hatch=["", *["//"] * (len(results) - 1)],
            height=0.62,
        )
        ax.set_xscale("log")
        ax.set_xlim(floor, values.max() * 12.0)
        ax.grid(axis="x", color=MUTED, alpha=0.25, lw=0.5)
        ax.set_axisbelow(True)
        for k, (value, label) in enumerate(zip(values, text, strict=True)):
            ax.text(value * 1.25, k, label, va="center", color=INK)
        ax.set_title(title)
    left.set_yticks(y, labels)
    left.invert_yaxis()
    return figure


_TITLES = (
    "effective samples per posterior evaluation",
    "effective samples per second, relative to this package",
)


def main(arguments: Sequence[str] | None = None) -> list[Result]:
    """Run all samplers; write figure, report and numbers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument(
        "--quick", action="store_true", help="hardly any samples: whether it runs, not how fast"
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT, help="folder with figures/ and analyses/results/"
    )
    asked = parser.parse_args(arguments)
    began = process_time()
    found = run(QUICK if asked.quick else Effort(), asked.seed)
    seconds = process_time() - began
    folder, figures = asked.out / "analyses" / "results", asked.out / "figures"
    for path in (folder, figures):
        path.mkdir(parents=True, exist_ok=True)
    versions = {
        name: metadata.version(name)
        for name in ("jax", "emcee", "blackjax", "scipy", "numpy", "arviz")
        if find_spec(name)
    }
    content = {
        "seed": asked.seed,
        "processor_seconds": seconds,
        "versions": versions,
        "results": [asdict(r) for r in found],
        "claims": claims(found),
    }
    write_atomically(folder / "benchmark.json", json.dumps(content, indent=1) + "\n")
    text = report(found, asked.seed, seconds)
    write_atomically(folder / "benchmark.md", text)
    write_atomically(
        figures / "benchmark.png", lambda temporary: picture(found).savefig(temporary, dpi=150)
    )
    print(text)
    return found


if __name__ == "__main__":
    main()
