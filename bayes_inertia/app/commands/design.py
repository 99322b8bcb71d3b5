"""`design`: the slews to fly next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bayes_inertia.app.commands.options import (
    AsJson,
    CampaignFolder,
    EffectNames,
    OutputFolder,
    Seed,
    names_in,
)
from bayes_inertia.app.terminal import (
    headed,
    narrow_table,
    plain_console,
    print_json_file,
    progress_bar,
)

if TYPE_CHECKING:
    from bayes_inertia.design.designer import Design
    from bayes_inertia.flight.plan import Plan

_COLUMNS = (
    "slew",
    "axis (body)",
    "angle [deg]",
    "rate [deg/s]",
    "ramps [deg/s²]",
    "starts [s]",
    "lasts [s]",
)

GoalOption = Annotated[
    str,
    typer.Option(
        help="cross_terms, inertia, scale_factors, correction_slew or separate:effect_a,effect_b."
    ),
]
SlewCount = Annotated[int, typer.Option(help="How many slews.", min=1, max=20)]
TotalTime = Annotated[
    float | None,
    typer.Option(
        help="From first to last telemetry [s]; without it, what slews like the paper's take."
    ),
]
MaxRate = Annotated[
    float | None,
    typer.Option(help="Largest true rate [deg/s]; without it, plan with the campaign's own."),
]
MaxAngle = Annotated[float | None, typer.Option(help="Largest angle of a slew [deg].")]
MaxAcceleration = Annotated[
    float | None,
    typer.Option(help="Largest angular acceleration [deg/s^2]; without it, what the wheels allow."),
]
KeepOuts = Annotated[
    list[str] | None,
    typer.Option(
        help="Cone that the star tracker avoids at rest: name,x,y,z,half_angle_deg (inertial), "
        "or a TOML file; may be repeated."
    ),
]
EndAttitude = Annotated[
    str | None, typer.Option(help="Attitude to end in: q1,q2,q3,q4, scalar last.")
]
AfterCampaign = Annotated[
    bool, typer.Option(help="Count what the campaign's telemetry tells already.")
]


def design_command(
    campaign: CampaignFolder,
    out: OutputFolder,
    goal: GoalOption = "cross_terms",
    slews: SlewCount = 5,
    total_time: TotalTime = None,
    max_rate: MaxRate = None,
    max_angle: MaxAngle = None,
    max_acceleration: MaxAcceleration = None,
    keep_out: KeepOuts = None,
    end_attitude: EndAttitude = None,
    after: AfterCampaign = False,
    effects: EffectNames = "",
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Design the slews to fly next.

    Writes design.json, design.png, and plan.toml, which `simulate` flies.
    """
    from bayes_inertia.app.design_request import DesignRequest

    request = DesignRequest(
        goal=goal,
        slews=slews,
        total_time=total_time,
        max_rate=max_rate,
        max_angle=max_angle,
        max_acceleration=max_acceleration,
        end_attitude=end_attitude,
        keep_out=tuple(keep_out or ()),
        after=after,
        seed=seed,
        effects=tuple(names_in(effects)),
    )
    with progress_bar() as progress:
        from bayes_inertia.app.design_folder import run_design

        design = run_design(campaign, out, request, progress)
    if as_json:
        print_json_file(out / "design.json")
    else:
        show_design(design, out)
    if not design.kept:
        raise typer.Exit(3)


def show_design(design: Design, folder: Path) -> None:
    """Print a designed plan: what it is expected to give, its slews, what is left of the limits.

    Parameters
    ----------
    design : Design
        The design.
    folder : Path
        Where its files are.
    """
    from bayes_inertia.app.design_folder import WHEELS_AT_REST

    console, goal = plain_console(), design.goal
    value, reference = (_with_unit(x, goal.unit) for x in (design.value, design.reference_value))
    gain = f", {design.gain:.3g} times smaller than with slews like the paper's ({reference})"
    console.print(headed(f"{goal.says}: {value}", gain))
    console.print(_slew_table(console, design.plan))
    console.print(headed("margins when flown in closed loop, tightest first:"))
    for margin in sorted(design.flown, key=lambda m: m.left):
        warning = "" if margin.kept else "BROKEN "
        console.print(Text.assemble("  ", (warning, "red"), margin.says))
    console.print(f"limits that hold the design back: {', '.join(design.active) or 'none'}")
    if not design.plan.wheel_momentum:
        console.print(WHEELS_AT_REST)
    console.print(
        f"wrote design.json, design.png and plan.toml (for `simulate --plan`) in {folder}"
    )


def _slew_table(console: Console, plan: Plan) -> Table:
    table = narrow_table(console, *_COLUMNS)
    rows = zip(plan.slews, plan.starts, plan.durations, strict=True)
    for i, (slew, start, duration) in enumerate(rows):
        table.add_row(
            str(i + 1),
            ", ".join(f"{x:+.3f}" for x in slew.axis_B),
            f"{np.degrees(slew.angle):.1f}",
            f"{np.degrees(slew.rate):.3f}",
            f"{np.degrees(slew.acceleration):.3f}",
            f"{start:.0f}",
            f"{duration:.0f}",
        )
    return table


def _with_unit(value: float, unit: str) -> str:
    """A value for people: angles in arc seconds."""
    if unit == "rad":
        return f"{3600.0 * np.degrees(value):.3g} arcsec"
    return f"{value:.3g} {unit}".rstrip()
