"""The command `bayes-inertia`. Exit codes: 0 done; 2 bad input; 3 finished, but the result must not be trusted as it is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from bayes_inertia.errors import BayesInertiaError

app = typer.Typer(
    name="bayes-inertia",
    help="Inertia tensor and rate-sensor scale factors of a spacecraft from slew telemetry, with honest uncertainty.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)

Campaign = Annotated[Path, typer.Argument(help="Campaign folder (with campaign.toml).")]
Out = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
Seed = Annotated[int, typer.Option(help="One integer that reproduces everything.", min=0)]
Effects = Annotated[
    str,
    typer.Option(help="Effects to fit along, separated by commas (see `doctor` for their names)."),
]
DriveName = Annotated[
    Literal["commanded", "measured"] | None,
    typer.Option(help="Drive the model with torque commands or with tachometers."),
]


@app.command()
def check(campaign: Campaign) -> None:
    """Read a campaign, check everything, and say what it contains."""
    from bayes_inertia.app.terminal import show_campaign
    from bayes_inertia.campaign.reader import read_campaign

    show_campaign(read_campaign(campaign))


@app.command()
def fit(
    campaign: Campaign,
    out: Out,
    effects: Effects = "",
    drive: DriveName = None,
    seed: Seed = 0,
    report: bool = True,
) -> None:
    """Estimate J, K and active effects: posterior.nc, summary.json and report.html in the results folder."""
    from bayes_inertia.app import run_folder
    from bayes_inertia.inference.sampler import Settings

    names = [name.strip() for name in effects.split(",") if name.strip()]
    run_folder.start(
        campaign, out, effects=names, drive=drive, settings=run_folder.with_seed(Settings(), seed)
    )
    _finish(out, report)


@app.command()
def diagnose(
    campaign: Campaign, out: Out, drive: DriveName = None, seed: Seed = 0, report: bool = True
) -> None:
    """Find which physical effect is missing from the model: diagnosis.json, and the fit with what was found."""
    from bayes_inertia.app import run_folder
    from bayes_inertia.inference.sampler import Settings

    # Enough for limits of 95 %: the samples of an effect with states of its own take minutes.
    run_folder.start(
        campaign,
        out,
        drive=drive,
        settings=Settings(seed=seed, target_ess=2_000.0),
        kind="diagnose",
    )
    _finish(out, report)


@app.command()
def observe(
    campaign: Campaign,
    out: Out,
    effects: Effects = "",
    drive: DriveName = None,
    seed: Seed = 0,
    both_drives: Annotated[
        bool,
        typer.Option(
            help="Also estimate in the other drive: what are the recorded commands worth?"
        ),
    ] = True,
) -> None:
    """Say how well each parameter is determined, and why not better: observability.json and observability.png."""
    from bayes_inertia.app.observe_campaign import observe_campaign
    from bayes_inertia.app.terminal import show_observability

    names = [name.strip() for name in effects.split(",") if name.strip()]
    seen = observe_campaign(
        campaign, out, effects=names, drive=drive, seed=seed, both_drives=both_drives
    )
    show_observability(seen, out)


@app.command()
def design(
    campaign: Campaign,
    out: Out,
    goal: Annotated[
        str,
        typer.Option(
            help="cross_terms, inertia, scale_factors, correction_slew or separate:effect_a,effect_b."
        ),
    ] = "cross_terms",
    slews: Annotated[int, typer.Option(help="How many slews.", min=1, max=20)] = 5,
    total_time: Annotated[
        float | None,
        typer.Option(
            help="From first to last telemetry [s]; without it, what slews like the paper's take."
        ),
    ] = None,
    max_rate: Annotated[
        float | None,
        typer.Option(help="Largest true rate [deg/s]; without it, plan with the campaign's own."),
    ] = None,
    max_angle: Annotated[float | None, typer.Option(help="Largest angle of a slew [deg].")] = None,
    max_acceleration: Annotated[
        float | None,
        typer.Option(
            help="Largest angular acceleration [deg/s^2]; without it, what the wheels allow."
        ),
    ] = None,
    keep_out: Annotated[
        list[str] | None,
        typer.Option(
            help="Cone that the star tracker avoids at rest: name,x,y,z,half_angle_deg (inertial), or a TOML file; repeat."
        ),
    ] = None,
    end_attitude: Annotated[
        str | None, typer.Option(help="Attitude to end in: q1,q2,q3,q4, scalar last.")
    ] = None,
    after: Annotated[
        bool, typer.Option(help="Count what the campaign's telemetry tells already.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """Design the slews to fly next: design.json, design.png and plan.toml, which `simulate` flies."""
    from bayes_inertia.app.design_commands import Request, run_design
    from bayes_inertia.app.terminal import show_design

    cones = tuple(keep_out or ())
    request = Request(
        goal,
        slews,
        total_time,
        max_rate,
        max_angle,
        max_acceleration,
        end_attitude,
        cones,
        after,
        seed,
    )
    found = run_design(campaign, out, request)
    show_design(found, out)
    if not found.kept:
        raise typer.Exit(3)


@app.command()
def compare(
    campaign: Campaign,
    plans: Annotated[
        list[str], typer.Argument(help="Plan files, or the word paper for the paper's five slews.")
    ],
    out: Out,
    simulated: Annotated[
        int, typer.Option(help="Campaigns to simulate and fit for each plan.", min=0)
    ] = 0,
    jobs: Annotated[int, typer.Option(help="Processes.", min=1)] = 1,
    seed: Seed = 0,
) -> None:
    """Compare plans by expected and achieved uncertainty, time, momentum and torque: compare.json and compare.png."""
    from bayes_inertia.app.design_commands import run_compare
    from bayes_inertia.app.terminal import show_comparison

    show_comparison(
        run_compare(campaign, plans, out, simulated=simulated, seed=seed, jobs=jobs), out
    )


@app.command()
def study(
    campaign: Campaign,
    out: Out,
    plan: Annotated[
        str, typer.Option(help="Plan file, or the word paper for the paper's five slews.")
    ] = "paper",
    campaigns: Annotated[int, typer.Option(help="Campaigns to simulate and fit.", min=2)] = 200,
    jobs: Annotated[int, typer.Option(help="Processes.", min=1)] = 1,
    seed: Seed = 0,
) -> None:
    """Do stated uncertainties hold? Fly a plan many times in simulation and fit each: study.json and study.png; goes on if killed."""
    from bayes_inertia.app.study import run_study
    from bayes_inertia.app.terminal import progress_bar, show_study

    with progress_bar() as progress:
        done = run_study(
            campaign, out, plan, campaigns=campaigns, seed=seed, jobs=jobs, progress=progress
        )
    show_study(done, out)
    if done.too_small:
        raise typer.Exit(3)


@app.command()
def resume(
    run: Annotated[Path, typer.Argument(help="Folder of a run that was interrupted.")],
    report: bool = True,
) -> None:
    """Go on with an interrupted fit, bit for bit as if it had never stopped."""
    _finish(run, report)


@app.command("report")
def report_(run: Annotated[Path, typer.Argument(help="Folder of a finished run.")]) -> None:
    """Write report.html again from posterior.nc (and diagnosis.json)."""
    from bayes_inertia.app.run_folder import sections
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.report import write_report

    posterior = Posterior.load(run / "posterior.nc")
    path = write_report(posterior, run / "report.html", sections(posterior, run))
    typer.echo(f"wrote {path}")


@app.command()
def simulate(
    out: Out,
    plan: Annotated[
        Path | None,
        typer.Option(
            help="Plan to fly (TOML); without one, five slews like those of the MOST paper."
        ),
    ] = None,
    hide: Annotated[
        list[str] | None,
        typer.Option(
            help="Hidden effect, as name or name.parameter=value[,value...]; may be repeated."
        ),
    ] = None,
    seed: Seed = 0,
) -> None:
    """Fly a plan with a simulated MOST-like spacecraft: a campaign folder, with its truth beside it."""
    from bayes_inertia.flight.plan import paper_like_plan
    from bayes_inertia.flight.plan_file import read_plan
    from bayes_inertia.flight.simulated_campaigns import simulate_most

    flight = simulate_most(read_plan(plan) if plan else paper_like_plan(), out, seed, hide or ())
    typer.echo(f"wrote {len(flight.campaign.slews)} slews and truth.json in {out}")


@app.command()
def demo(out: Out = Path("demo_run"), seed: Seed = 1) -> None:
    """Simulate a MOST-like campaign of five slews, fit it, and write the report."""
    from bayes_inertia.app import run_folder
    from bayes_inertia.flight.plan import paper_like_plan
    from bayes_inertia.flight.simulated_campaigns import simulate_most
    from bayes_inertia.inference.sampler import Settings

    simulate_most(paper_like_plan(), out / "campaign", seed, ())
    run_folder.start(out / "campaign", out / "fit", settings=run_folder.with_seed(Settings(), seed))
    _finish(out / "fit", True)


@app.command()
def doctor() -> None:
    """Say what this installation consists of, and whether it works."""
    from bayes_inertia.app.terminal import show_installation

    show_installation()


def _finish(folder: Path, report: bool) -> None:
    from bayes_inertia.app import run_folder
    from bayes_inertia.app.terminal import progress_bar, show_diagnosis, show_summary

    with progress_bar() as progress:
        posterior = run_folder.finish(folder, report=report, progress=progress)
    content = run_folder.read_diagnosis(folder)
    if content is not None:
        show_diagnosis(content)
    show_summary(posterior.summary(), folder, report)
    if not posterior.trusted or (content is not None and content["verdict"] == "unknown"):
        raise typer.Exit(3)


def main(arguments: list[str] | None = None) -> None:
    """Run the command and exit with its code."""
    try:
        code = app(args=arguments, standalone_mode=False)
    except BayesInertiaError as error:
        typer.echo(f"error: {error}", err=True)
        code = 2
    except typer.TyperException as error:
        error.show()
        code = error.exit_code
    except (typer.Abort, KeyboardInterrupt):
        typer.echo("interrupted; `bayes-inertia resume RUN` goes on with a fit", err=True)
        code = 130
    sys.exit(code or 0)
