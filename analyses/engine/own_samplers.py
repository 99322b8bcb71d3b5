"""Other samplers on the public density against `fit`.

    python -m analyses.engine.own_samplers [LIBRARY ...]

emcee's moves by hand, importance sampling with scipy's multivariate t, and, where they are
installed, NUTS of blackjax and nested sampling of dynesty, all on `log_density` of the example
campaign. Each must give the means and sds of `fit` within Monte Carlo error. It writes
`results/engine/own_samplers.json` and `.md`. Ten minutes; of named libraries
alone the rows are made anew.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import arviz as az
import emcee
import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

import bayes_inertia as bi
from analyses import results_of
from bayes_inertia.files import write_atomically
from bayes_inertia.version import __version__

SEED = 46
WALKERS, STEPS, WARM_UP = 64, 3000, 300
IMPORTANCE_DRAWS, DEGREES = 20_000, 8.0
LIVE_POINTS = 300
NUTS_WARM_UP, NUTS_DRAWS, NUTS_CHAINS = 300, 1000, 2


class Drawn(NamedTuple):
    """Draws (n, d) of a sampler, with weights (n,), and how many of them are effective."""

    draws: np.ndarray
    weights: np.ndarray
    effective: float


def evenly(draws: np.ndarray, effective: float) -> Drawn:
    """Draws that count alike."""
    return Drawn(draws, np.full(len(draws), 1.0 / len(draws)), effective)


def run_emcee(density: bi.LogDensity, move: emcee.moves.Move) -> Drawn:
    """One ensemble that begins at draws of the Laplace approximation."""
    rng = np.random.default_rng(SEED)
    starts = rng.multivariate_normal(density.mean, density.covariance, WALKERS)
    state = emcee.State(starts, random_state=np.random.RandomState(SEED).get_state())
    d = len(density.names)
    sampler = emcee.EnsembleSampler(WALKERS, d, density, vectorize=True, moves=move)
    sampler.run_mcmc(state, STEPS)
    draws = sampler.get_chain(discard=WARM_UP, flat=True)
    tau = float(np.max(sampler.get_autocorr_time(discard=WARM_UP, quiet=True)))
    return evenly(draws, len(draws) / tau)


def run_importance(density: bi.LogDensity) -> Drawn:
    """Draws of a wide multivariate t around the maximum, weighted."""
    wide = stats.multivariate_t(density.mean, density.covariance, DEGREES, seed=SEED)
    draws = wide.rvs(IMPORTANCE_DRAWS)
    logs = density(draws) - wide.logpdf(draws)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    return Drawn(draws, weights, float(1.0 / np.sum(weights**2)))


def run_nuts(density: bi.LogDensity) -> Drawn:
    """NUTS of blackjax in scales of the Laplace approximation."""
    import blackjax

    root, d = jnp.linalg.cholesky(jnp.asarray(density.covariance)), len(density.names)

    def whitened(z: jax.Array) -> Any:
        return density(jnp.asarray(density.mean) + root @ z)

    def chain(key: jax.Array) -> jax.Array:
        warm, run = jax.random.split(key)
        adaptation = blackjax.window_adaptation(blackjax.nuts, whitened)
        (state, parameters), _ = adaptation.run(warm, jnp.zeros(d), num_steps=NUTS_WARM_UP)
        kernel = blackjax.nuts(whitened, **parameters)

        def step(state: Any, key: jax.Array) -> tuple[Any, jax.Array]:
            state, _ = kernel.step(key, state)
            return state, state.position

        return jax.lax.scan(step, state, jax.random.split(run, NUTS_DRAWS))[1]

    keys = jax.random.split(jax.random.key(SEED), NUTS_CHAINS)
    z = np.stack([np.asarray(jax.jit(chain)(key)) for key in keys])
    effective = min(float(az.ess(z[..., k])) for k in range(d))
    return evenly(density.mean + z.reshape(-1, d) @ np.asarray(root).T, effective)


def run_dynesty(density: bi.LogDensity) -> Drawn:
    """Nested sampling of dynesty from the whole prior."""
    import dynesty

    rng, d = np.random.default_rng(SEED), len(density.names)
    # It asks for one point at a time: the function of JAX answers ten times faster than numpy's.
    compiled = jax.jit(density.log_likelihood)
    sampler = dynesty.NestedSampler(
        lambda theta: float(compiled(jnp.asarray(theta))),
        density.prior_transform,
        d,
        nlive=LIVE_POINTS,
        rstate=rng,
    )
    sampler.run_nested(print_progress=False)
    weights = np.asarray(sampler.results.importance_weights())
    return Drawn(sampler.results.samples, weights, float(1.0 / np.sum(weights**2)))


SAMPLERS: dict[str, tuple[str, Callable[[bi.LogDensity], Drawn]]] = {
    "emcee, DEMove": ("emcee", lambda density: run_emcee(density, emcee.moves.DEMove())),
    "emcee, StretchMove": ("emcee", lambda density: run_emcee(density, emcee.moves.StretchMove())),
    "scipy, importance sampling": ("scipy", run_importance),
    "blackjax, NUTS": ("blackjax", run_nuts),
    "dynesty, nested": ("dynesty", run_dynesty),
}


def compared(drawn: Drawn, posterior: bi.Posterior) -> dict[str, Any]:
    """Largest differences from the fit's means and sds, in Monte Carlo errors."""
    d = drawn.draws.shape[1]
    of_fit = posterior.attributes["diagnostics"]["ess_bulk_min"]
    mean = drawn.weights @ drawn.draws
    sd = np.sqrt(drawn.weights @ (drawn.draws - mean) ** 2)
    fit_mean, fit_sd = posterior.samples.mean(0), posterior.samples.std(0)
    error = float(np.sqrt(1.0 / drawn.effective + 1.0 / of_fit))
    in_errors = np.abs(mean - fit_mean) / fit_sd / error
    sd_in_errors = np.abs(sd / fit_sd - 1.0) / (error / np.sqrt(2.0))
    return {
        "effective_samples": drawn.effective,
        "mean_off_sd": float(np.max(np.abs(mean - fit_mean) / fit_sd)),
        "sd_ratio_off": float(np.max(np.abs(sd / fit_sd - 1.0))),
        "mean_off_errors": float(in_errors.max()),
        "sd_off_errors": float(sd_in_errors.max()),
        # As large as nine of them become in one comparison of a thousand.
        "limit_errors": float(stats.norm.isf(5e-4 / (2 * d))),
    }


def main(only: Sequence[str] = ()) -> None:
    """Run what is installed, or the samplers of some libraries only, and write the table."""
    target = results_of(__file__) / "own_samplers.json"
    rows = json.loads(target.read_text())["samplers"] if only else {}
    campaign = bi.read_campaign(Path(bi.__file__).parent / "example")
    posterior = bi.fit(campaign, seed=SEED, settings=bi.Settings(target_ess=20_000))
    density = bi.log_density(campaign, seed=SEED)
    for name, (library, run) in SAMPLERS.items():
        if not only or library in only:
            rows[name] = compared(run(density), posterior) if find_spec(library) else None
            print(name, rows[name], flush=True)
    content = {"version": __version__, "seed": SEED, "samplers": rows}
    write_atomically(target, json.dumps(content, indent=1) + "\n")
    write_atomically(target.with_suffix(".md"), page(rows))


def page(rows: dict[str, dict[str, Any] | None]) -> str:
    """The table as a page."""
    lines = [
        "# Other samplers on the public density",
        "",
        "`bi.log_density` of the example campaign, sampled by others; means and sds of the nine",
        "parameters against those of `fit`. Differences are the largest of nine, in Monte Carlo",
        "errors of both; above the limit one comparison in a thousand lies by chance.",
        "",
        "| sampler | effective samples | mean off [sd] | mean off [errors] | sd off [errors] "
        "| limit |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        if row is None:
            lines.append(f"| {name} | not installed where this was run | | | | |")
            continue
        lines.append(
            f"| {name} | {row['effective_samples']:,.0f} | {row['mean_off_sd']:.3f} "
            f"| {row['mean_off_errors']:.1f} | {row['sd_off_errors']:.1f} "
            f"| {row['limit_errors']:.1f} |"
        )
    return "\n".join([*lines, "", "Made by `python -m analyses.engine.own_samplers`.", ""])


if __name__ == "__main__":
    main(sys.argv[1:])
