"""What the command prints: tables for people, progress on stderr, silence when not a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.observability import result

if TYPE_CHECKING:
    from bayes_inertia.app.observe_campaign import Observed
    from bayes_inertia.app.study import Study
    from bayes_inertia.design.comparison import Contender
    from bayes_inertia.design.designer import Design

_DETERMINED = {"determined": "yes", "weakly": "no: mostly prior", "prior": "no: prior"}
_WORDS = {"determined": "yes", "partly determined": "partly", "not determined": "no"}


@contextmanager
def progress_bar() -> Iterator:
    """A progress callback (what, done, of) that draws on stderr, or does nothing when stderr is not a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("starting", total=None)
        yield lambda what, done, of: progress.update(
            task, description=what, completed=done, total=of
        )


def show_campaign(campaign: Campaign) -> None:
    """Print what a campaign contains, and what can be done with it."""
    console = Console()
    console.print(
        f"[bold]{campaign.name}[/bold]: {len(campaign.slews)} slews, {len(campaign.wheels)} wheels"
    )
    table = Table(
        "slew",
        "rows",
        "step [s]",
        "duration [s]",
        "peak rate [deg/s]",
        "fixes",
        "commands",
        "wheel momentum",
    )
    for slew in campaign.slews:
        fixes = int(slew.fixes.sum())
        peak = np.degrees(np.nanmax(np.linalg.norm(slew.rate, axis=1)))
        given = ["yes" if x is not None else "no" for x in (slew.wheel_torque, slew.wheel_momentum)]
        table.add_row(
            slew.name,
            str(len(slew.time)),
            f"{np.median(np.diff(slew.time)):.4g}",
            f"{slew.duration:.4g}",
            f"{peak:.3g}",
            str(fixes),
            *given,
        )
    console.print(table)
    moments = ", ".join(f"{m:.4g}" for m in np.linalg.eigvalsh(campaign.inertia.tensor))
    kind = "with" if campaign.inertia.includes_wheel_spin else "without"
    console.print(f"prior principal moments: {moments} kg m^2 ({kind} the wheels' spin inertia)")
    drives = [
        name
        for name, possible in (
            ("commanded", campaign.has_commands or not campaign.wheels),
            ("measured", campaign.has_tachometers),
        )
        if possible
    ]
    console.print(
        f"possible drives: {', '.join(drives) or 'none: add wheel_torque or wheel_momentum columns'}"
    )
    if campaign.star_tracker is None:
        console.print(
            "no star tracker: attitude is not compared, start and final attitude errors stay unknown"
        )


def show_summary(summary: dict[str, Any], folder: Path, report: bool = True) -> None:
    """Print a fit's verdict first, then its numbers; `report` says whether one was written."""
    from bayes_inertia.report import wording

    console = Console()
    if summary["trusted"]:
        console.print("[bold green]The result can be used.[/bold green]")
    else:
        console.print("[bold red]Do not use this result as it stands.[/bold red]")
    for gate in summary["gates"]:
        console.print(
            f"  {'[green]passed[/green]' if gate['passed'] else '[red]FAILED[/red]'} {gate['name']}: {gate['says']}"
        )
    table = Table(box=SIMPLE, pad_edge=False, collapse_padding=True)
    table.add_column(
        "name", overflow="fold"
    )  # a long name gives way, between its words, never a number
    for heading in ("estimate", "± sd", "unit", "prior sd", "contraction", "determined"):
        table.add_column(heading, no_wrap=True)
    for name, p in summary["parameters"].items():
        used = wording.quoted(p["sd"], p["robust_sd"])
        power = wording.exponent(p["mean"], used.sd)
        gained = wording.contraction(used.sd, p["prior_sd"])
        shown = [wording.number(value, used.sd, power) for value in (p["mean"], used.sd)]
        prior = f"{p['prior_sd'] / 10.0**power:.2g}"
        words = name.replace("_", " ").replace(".", ": ")
        table.add_row(
            words,
            *shown,
            wording.unit_text(p["unit"], power),
            prior,
            wording.contraction_text(gained),
            _WORDS[wording.determined(gained)],
        )
    console.print(table)
    console.print("sd: the larger of the model's and of what the scatter between slews supports")
    if over := wording.averaged_over(summary):
        console.print(f"J and K: averaged over what may be true ({over})")
    chi2 = ", ".join(
        f"{key} {value:.3f}"
        for key, value in summary["fit"]["reduced_chi2"].items()
        if value is not None
    )
    found = summary["diagnostics"]
    console.print(f"reduced chi^2: {chi2}")
    console.print(
        f"{found['ess_bulk_min']:.0f} effective samples from {found['evaluations']} evaluations in {found['seconds']:.1f} s"
    )
    console.print(
        f"wrote posterior.nc{', summary.json and report.html' if report else ' and summary.json'} in {folder}"
    )


def show_diagnosis(content: dict[str, Any]) -> None:
    """Print a diagnosis' verdict first, then why, and the best candidates."""
    from bayes_inertia.report.diagnosis_wording import plain, probability, verdict
    from bayes_inertia.report.pictures.style import tenths

    console = Console()
    said = verdict(content)
    color = {"good": "green", "caution": "yellow", "bad": "red"}[said.level]
    console.print(f"[bold {color}]{said.title}[/bold {color}]")
    for sentence in said.sentences:
        console.print(f"  {sentence}")
    table = Table(box=SIMPLE)
    table.add_column("candidate")
    for heading in ("score", "dof", "p", "log Bayes"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for c in [c for c in content["candidates"] if c["p_value"] is not None][:6]:
        word = (
            "named"
            if c["effect"] in content["named"]
            else "significant"
            if c["p_value"] < content["threshold"]
            else ""
        )
        p = probability(c["p_value"]).removeprefix("p ").removeprefix("= ")
        table.add_row(
            plain(c["effect"]),
            tenths(c["score"]),
            str(c["dof"]),
            p,
            tenths(c["log_bayes_factor"]),
            word,
        )
    console.print(table)
    console.print("wrote diagnosis.json")


def show_observability(seen: Observed, folder: Path) -> None:
    """Print what a campaign tells about each parameter: a table, a sentence each, what it cannot tell, and where emcee differs."""
    console, found = Console(), seen.found
    table = Table(box=SIMPLE)
    for heading in ("name", "prior sd", "sd", "unit", "signal", "lost", "commands", "determined"):
        table.add_column(heading, no_wrap=True)
    for p in found.parameters:
        worth = result.commands_worth(p, found.drive)
        lost, word = f"x{np.sqrt(p.variance_inflation):.2g}", _DETERMINED.get(p.verdict, p.verdict)
        table.add_row(
            p.name,
            f"{p.prior_sd:.2g}",
            f"{p.sd:.2g}",
            p.unit,
            f"{p.signal:,.3g}",
            lost,
            "-" if worth is None else f"x{worth:.2g}",
            word,
        )
    console.print(table)
    console.print(
        "signal: response of all telemetry to one prior sd, in sigmas; lost: sd over its value if all else were known;"
    )
    console.print("commands: sd with the torque commands ignored over sd with them")
    for name in found.names:
        console.print(f"  {result.sentence(found, name)}", highlight=False)
    weakest = [d for d in found.directions if d.verdict_is_prior] or list(found.directions[:1])
    for d in weakest:
        kind = (
            "exactly degenerate"
            if d.exact
            else f"prior sd shrinks by {100 * (1 - (1 - d.contraction) ** 0.5):.4g} %"
        )
        console.print(f"[bold]least known together:[/bold] {d.says} ({kind})", highlight=False)
    for d in found.degeneracies:
        console.print(f"[bold]{d.name}:[/bold] {d.says}", highlight=False)
    for row in seen.comparison or ():
        for warning in row.warnings:
            console.print(f"[bold yellow]{row.name}:[/bold yellow] {warning}", highlight=False)
    console.print(f"wrote observability.json and observability.png in {folder}")


def show_design(found: Design, folder: Path) -> None:
    """Print a designed plan: what it is expected to give, its slews, and what it leaves of the limits."""
    from bayes_inertia.app.design_commands import WHEELS_AT_REST

    console = Console()
    value, reference = (
        _in_degrees(x, found.goal.unit) for x in (found.value, found.reference_value)
    )
    console.print(
        f"[bold]{found.goal.says}: {value}[/bold], {found.gain:.3g} times smaller than with slews like the paper's ({reference})",
        highlight=False,
    )
    table = Table(
        "slew",
        "axis (body)",
        "angle [deg]",
        "rate [deg/s]",
        "ramps [deg/s²]",
        "starts [s]",
        "lasts [s]",
        box=SIMPLE,
    )
    for i, (slew, start, lasts) in enumerate(
        zip(found.plan.slews, found.plan.starts, found.plan.durations, strict=True)
    ):
        numbers = (
            f"{np.degrees(slew.angle):.1f}",
            f"{np.degrees(slew.rate):.3f}",
            f"{np.degrees(slew.acceleration):.3f}",
            f"{start:.0f}",
            f"{lasts:.0f}",
        )
        table.add_row(str(i + 1), ", ".join(f"{x:+.3f}" for x in slew.axis_B), *numbers)
    console.print(table)
    console.print("[bold]margins when flown in closed loop, tightest first:[/bold]")
    for margin in sorted(found.flown, key=lambda m: m.left):
        console.print(
            f"  {'' if margin.kept else '[red]BROKEN[/red] '}{margin.says}", highlight=False
        )
    console.print(f"limits that hold the design back: {', '.join(found.active) or 'none'}")
    if not found.plan.wheel_momentum:
        console.print(WHEELS_AT_REST, highlight=False, markup=False)
    console.print(
        f"wrote design.json, design.png and plan.toml (for `simulate --plan`) in {folder}"
    )


def show_comparison(contenders: Sequence[Contender], folder: Path) -> None:
    """Print plans side by side: expected and achieved sds, and what they cost."""
    from bayes_inertia.design.comparison import NAMES

    console = Console()
    table = Table(box=SIMPLE)
    table.add_column("", no_wrap=True)
    for c in contenders:
        table.add_column(c.name, justify="right")
    for i, name in enumerate(NAMES):
        cells = []
        for c in contenders:
            got = (
                ""
                if c.achieved is None
                else f" (achieved {c.achieved.sd[i]:.3g} ± {c.achieved.sd_error[i]:.1g})"
            )
            cells.append(f"{c.expected[i]:.3g}{got}")
        table.add_row(f"sd {name}", *cells)
    rows = {
        "worst cross term [kg m²]": [f"{c.worst_cross_term:.3g}" for c in contenders],
        "total time [s]": [f"{c.total_time:.0f}" for c in contenders],
        "in motion [s]": [f"{c.motion_time:.0f}" for c in contenders],
        "peak momentum [N m s]": [f"{c.peak_momentum:.3g}" for c in contenders],
        "peak torque [N m]": [f"{c.peak_torque:.3g}" for c in contenders],
        "limits broken": [
            ", ".join(m.limit for m in c.margins if not m.kept) or "none" for c in contenders
        ],
    }
    for name, cells in rows.items():
        table.add_row(name, *cells)
    console.print(table)
    console.print(f"wrote compare.json and compare.png in {folder}")


def show_study(study: Study, folder: Path) -> None:
    """Print achieved beside stated sds, and how often intervals held the truth."""
    from bayes_inertia.design.comparison import NAMES

    console, found, (narrow, wide) = (
        Console(),
        study.found,
        (study.coverage(0.68), study.coverage(0.95)),
    )
    table = Table(box=SIMPLE)
    for column in ("", "achieved sd", "stated sd", "in 68 %", "in 95 %"):
        table.add_column(column, justify="right" if column else "left", no_wrap=True)
    stated = (found.stated**2).mean(0) ** 0.5
    for i, name in enumerate(NAMES):
        shares = [
            f"{100 * share:.1f} % ({100 * low:.0f} to {100 * high:.0f})"
            for share, low, high in (narrow[i], wide[i])
        ]
        table.add_row(
            name, f"{found.sd[i]:.3g} ± {found.sd_error[i]:.1g}", f"{stated[i]:.3g}", *shares
        )
    console.print(table)
    said = (
        f"Stated sds are TOO SMALL for {', '.join(study.too_small)}."
        if study.too_small
        else "Stated sds hold."
    )
    console.print(f"{len(found.errors)} campaigns of {study.plan.name}. {said}")
    console.print(f"wrote study.json and study.png in {folder}")


def _in_degrees(value: float, unit: str) -> str:
    return (
        f"{3600.0 * np.degrees(value):.3g} arcsec"
        if unit == "rad"
        else f"{value:.3g} {unit}".rstrip()
    )


def show_installation() -> None:
    """Print versions, devices and known effects, and run a small self-test."""
    import jax
    import jax.numpy as jnp

    from bayes_inertia.physics.effects import LIBRARY
    from bayes_inertia.physics.simulator import Start, idle_slew, simulate

    console = Console()
    table = Table("package", "version")
    for name in (
        "bayes-inertia",
        "numpy",
        "scipy",
        "jax",
        "emcee",
        "arviz",
        "xarray",
        "matplotlib",
    ):
        table.add_row(name, metadata.version(name))
    console.print(table)
    console.print(
        f"computing on: {', '.join(str(d) for d in jax.devices())}; 64-bit: {jnp.zeros(1).dtype == jnp.float64}"
    )
    slew = idle_slew(np.arange(100.0))
    start = Start(jnp.array([0.01, 0.02, 0.01]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    J = jnp.diag(jnp.array([3.0, 2.0, 2.0]))
    rate = simulate(slew, start, J)[0].rate_B
    drift = float(
        jnp.abs(jnp.einsum("ni,ij,nj->n", rate, J, rate) / (rate[0] @ J @ rate[0]) - 1.0).max()
    )
    console.print(
        f"self-test: energy of a free tumble is constant to {drift:.1e} ({'passed' if drift < 1e-9 else 'FAILED'})"
    )
    console.print(f"effects: {', '.join(effect.name for effect in LIBRARY)}")
