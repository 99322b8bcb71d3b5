"""Do the independent ensembles agree?"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import posterior_data, style


@style.styled
def draw_chains(posterior: Posterior) -> Figure:
    """Trace and rank histogram of the parameter whose ensembles agree least, and log posterior."""
    diagnostics, n = posterior.attributes["diagnostics"], posterior_data.n_ensembles(posterior)
    name = worst_parameter(posterior)
    values, scale = ensembles_of(posterior, name)
    figure, cells = style.grid(2.8, 1, 3, left=0.8, top=0.7, bottom=0.55, gap_x=0.85)
    trace, ranks, height = (figure.add_axes(cell) for cell in cells)
    trace_panel(trace, scale(values), scale.label, diagnostics["discarded"])
    trace.set_title(f"trace of {name}: mean and 90 % of walkers")
    rank_panel(ranks, values, diagnostics["tau_max"])
    ranks.set_title(f"ranks of {name}")
    lp = by_ensemble(posterior, "sample_stats", "lp")
    trace_panel(height, lp - lp.max(), "below the highest draw [nat]", diagnostics["discarded"])
    height.set_title("log posterior")
    style.legend(figure, style.component_lines([f"ensemble {i + 1}" for i in range(n)]), 8)
    return figure


def worst_parameter(posterior: Posterior) -> str:
    """The parameter whose ensembles' means differ most, in units of its sd."""

    def distance(name: str) -> float:
        values = by_ensemble(posterior, "posterior", name)
        return float(values.mean((1, 2)).std() / max(values.std(), 1e-300))

    return max(posterior.names, key=distance)


def ensembles_of(posterior: Posterior, name: str) -> tuple[np.ndarray, style.Scale]:
    """Draws (ensembles, walkers, draws) of a parameter, and the scale of its axis."""
    values = by_ensemble(posterior, "posterior", name)
    unit = str(posterior.tree["posterior"][name].attrs.get("units", ""))
    return values, style.scale(name, unit, float(values.mean()), 3.0 * float(values.std()))


def by_ensemble(posterior: Posterior, group: str, name: str) -> np.ndarray:
    """A variable as (ensembles, walkers, draws)."""
    values = posterior_data.values_of(posterior, group, name)
    n = posterior_data.n_ensembles(posterior)
    # Runs of earlier versions have a chain for each walker.
    walkers = posterior.attributes.get("walkers") or len(values) // n
    return values.reshape(n, walkers, -1)


def trace_panel(axes: Axes, values: np.ndarray, label: str, discarded: int) -> None:
    """Mean and 90 % of the walkers of each ensemble, step by step."""
    step = discarded + np.arange(values.shape[-1])
    for i, walkers in enumerate(values):
        mean = walkers.mean(0)
        rows = style.thinned_rows(mean[:, None], LAYOUT.most_line_points)
        axes.plot(step[rows], mean[rows], **style.line(i), lw=1.2)
    for i, walkers in enumerate(values):
        keep = slice(None, None, max(1, len(step) // 400))
        low, high = np.quantile(walkers[:, keep], [0.05, 0.95], axis=0)
        axes.fill_between(step[keep], low, high, color=style.color(i), alpha=0.10, lw=0)
    axes.set(xlabel="step of the ensemble", ylabel=label)


def rank_panel(axes: Axes, values: np.ndarray, tau: float) -> None:
    """Share of each ensemble's draws in equal-population bins of all draws.

    The band holds 99 % of the shares of independent ensembles.
    """
    ranks = stats.rankdata(values.ravel()).reshape(len(values), -1) / values.size
    edges = np.linspace(0.0, 1.0, LAYOUT.chain_bins + 1)
    for i, ensemble in enumerate(ranks):
        share = np.histogram(ensemble, edges)[0] * LAYOUT.chain_bins / ensemble.size
        axes.stairs(share, edges, **style.line(i), lw=1.1, baseline=None)
    effective = ranks.shape[1] / max(tau, 1.0)
    half = 2.576 * np.sqrt((LAYOUT.chain_bins - 1) / effective)
    axes.axhspan(1.0 - half, 1.0 + half, color=style.PALE, alpha=0.6, lw=0, zorder=0)
    axes.axhline(1.0, color=style.MUTED, lw=0.6)
    axes.set(
        xlabel="rank among all draws [–]",
        ylabel="density of ranks [–]",
        xlim=(0, 1),
        ylim=(min(0.6, 1 - 1.6 * half), max(1.4, 1 + 1.6 * half)),
    )
