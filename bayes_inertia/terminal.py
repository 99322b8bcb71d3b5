"""What the command prints: tables for people, progress on stderr, silence when not a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from bayes_inertia.campaign import Campaign


@contextmanager
def progress_bar() -> Iterator:
    """A progress callback (what, done, of) that draws on stderr, or does nothing when stderr is not a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("starting", total=None)
        yield lambda what, done, of: progress.update(task, description=what, completed=done, total=of)


def show_campaign(campaign: Campaign) -> None:
    """Print what a campaign contains, and what can be done with it."""
    console = Console()
    console.print(f"[bold]{campaign.name}[/bold]: {len(campaign.slews)} slews, {len(campaign.wheels)} wheels")
    table = Table("slew", "rows", "step [s]", "duration [s]", "peak rate [deg/s]", "fixes", "commands", "wheel momentum")
    for slew in campaign.slews:
        fixes = 0 if slew.attitude is None else int(np.isfinite(slew.attitude).all(axis=1).sum())
        peak = np.degrees(np.nanmax(np.linalg.norm(slew.rate, axis=1)))
        given = ["yes" if x is not None else "no" for x in (slew.wheel_torque, slew.wheel_momentum)]
        table.add_row(slew.name, str(len(slew.time)), f"{np.median(np.diff(slew.time)):.4g}", f"{slew.duration:.4g}", f"{peak:.3g}", str(fixes), *given)
    console.print(table)
    moments = ", ".join(f"{m:.4g}" for m in np.linalg.eigvalsh(campaign.inertia.tensor))
    kind = "with" if campaign.inertia.includes_wheel_spin else "without"
    console.print(f"prior principal moments: {moments} kg m^2 ({kind} the wheels' spin inertia)")
    drives = [name for name, possible in (("commanded", campaign.has_commands or not campaign.wheels), ("measured", campaign.has_tachometers)) if possible]
    console.print(f"possible drives: {', '.join(drives) or 'none: add wheel_torque or wheel_momentum columns'}")
    if campaign.star_tracker is None:
        console.print("no star tracker: attitude is not compared, start and final attitude errors stay unknown")


def show_summary(summary: dict[str, Any], folder: Path) -> None:
    """Print a fit's verdict first, then its numbers."""
    console = Console()
    if summary["trusted"]:
        console.print(f"[bold green]The result can be used.[/bold green] {' '.join(g['says'] + '.' for g in summary['gates'])}")
    else:
        console.print("[bold red]Do not use the sd of this result as its uncertainty.[/bold red]")
        for reason in summary["reasons"]:
            console.print(f"  {reason}")
    table = Table("parameter", "estimate", "uncertainty", "robust sd", "prior sd", "contraction", "unit", "determined")
    for name, p in summary["parameters"].items():
        robust = p["robust_sd"]
        quoted = max(p["sd"], robust or 0.0)
        digits = max(0, 1 - int(np.floor(np.log10(quoted)))) if quoted > 0 else 6
        word = "yes" if p["contraction"] > 0.9 else ("partly" if p["observable"] else "no: prior")
        shown = "-" if robust is None else f"{robust:.2g}"
        table.add_row(name, f"{p['mean']:.{min(digits, 10)}f}", f"{quoted:.2g}", shown, f"{p['prior_sd']:.2g}", f"{p['contraction']:.4f}", p["unit"], word)
    console.print(table)
    chi2 = ", ".join(f"{key} {value:.3f}" for key, value in summary["fit"]["reduced_chi2"].items() if value is not None)
    found = summary["diagnostics"]
    console.print(f"reduced chi^2: {chi2}")
    console.print(f"{found['ess_bulk_min']:.0f} effective samples from {found['evaluations']} evaluations in {found['seconds']:.1f} s")
    console.print(f"wrote posterior.nc, summary.json and report.html in {folder}")


def show_installation() -> None:
    """Print versions, devices and known effects, and run a small self-test."""
    import jax
    import jax.numpy as jnp

    from bayes_inertia.dynamics import Start, idle_slew, simulate
    from bayes_inertia.effects import LIBRARY

    console = Console()
    table = Table("package", "version")
    for name in ("bayes-inertia", "numpy", "scipy", "jax", "emcee", "arviz", "xarray", "matplotlib"):
        table.add_row(name, metadata.version(name))
    console.print(table)
    console.print(f"computing on: {', '.join(str(d) for d in jax.devices())}; 64-bit: {jnp.zeros(1).dtype == jnp.float64}")
    slew = idle_slew(np.arange(100.0))
    start = Start(jnp.array([0.01, 0.02, 0.01]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    J = jnp.diag(jnp.array([3.0, 2.0, 2.0]))
    rate = simulate(slew, start, J)[0].rate_B
    drift = float(jnp.abs(jnp.einsum("ni,ij,nj->n", rate, J, rate) / (rate[0] @ J @ rate[0]) - 1.0).max())
    console.print(f"self-test: energy of a free tumble is constant to {drift:.1e} ({'passed' if drift < 1e-9 else 'FAILED'})")
    console.print(f"effects: {', '.join(effect.name for effect in LIBRARY)}")
