"""`design`: the slews to fly next."""

from __future__ import annotations

import json
from collections.abc import Sequence
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
    OpenPage,
    OutputFolder,
    Seed,
    names_in,
)
from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import (
    headed,
    narrow_table,
    open_in_browser,
    plain_console,
    print_json_file,
    progress_bar,
    quantity,
    unit_powers,
)
from bayes_inertia.report.layout import LAYOUT as REPORT_LAYOUT

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
    open_page: OpenPage = False,
    as_json: AsJson = False,
) -> None:
    """Design the slews to fly next.

    Writes design.json, design.png, design.html, and plan.toml, which `simulate` flies.
    """
    asked = (total_time, max_rate, max_angle, max_acceleration, end_attitude)
    names = tuple(names_in(effects))
    with progress_bar() as progress:
        from bayes_inertia.app.design_folder import DesignRequest, run_design

        request = DesignRequest(goal, slews, *asked, tuple(keep_out or ()), after, seed, names)
        design = run_design(campaign, out, request, progress)
    if as_json:
        print_json_file(out / "design.json")
    else:
        notes = json.loads((out / "design.json").read_text()).get("left_out", ())
        show_design(design, out, after, notes)
    open_in_browser(out / "design.html", open_page)
    raise typer.Exit(0 if design.kept else 3)


def show_design(
    design: Design, folder: Path, after: bool = False, notes: Sequence[str] = ()
) -> None:
    """Print a designed plan: what each parameter gains or loses, its slews, its margins."""
    from bayes_inertia.app.design_folder import WHEELS_AT_REST

    console, goal = plain_console(), design.goal
    value, reference = (quantity(x, goal.unit) for x in (design.value, design.reference_value))
    gain = f", {design.gain:.3g} times smaller than with slews like the paper's ({reference})"
    console.print(headed(f"{goal.says}: {value}", gain))
    console.print(_worse(design))
    console.print(_sd_table(console, design, "now" if after else "prior"))
    if not after:
        console.print("with --after this campaign's telemetry counts too")
    console.print(_slew_table(console, design.plan))
    _show_margins(console, design)
    for note in notes:
        console.print(headed("note", f": {note}", style="bold yellow"))
    if not design.plan.wheel_momentum:
        console.print(WHEELS_AT_REST)
    console.print(
        "wrote design.json, design.png, design.html and plan.toml (for `simulate --plan`) in "
        f"{folder}"
    )


def _worse(design: Design) -> Text:
    """Which parameters the plan leaves worse than slews like the paper's."""
    from bayes_inertia.report.formatting import listed

    ratios = {name: sd / design.reference_sd[name] for name, sd in design.sd.items()}
    worse = [
        f"{name} ({r:.1f} times)" for name, r in ratios.items() if r > REPORT_LAYOUT.worse_sd_ratio
    ]
    if not worse:
        return Text("no parameter gets worse than with slews like the paper's")
    rest = ": larger sd than with slews like the paper's"
    return headed(f"worse: {listed(worse)}", rest, style="bold yellow")


def _sd_table(console: Console, design: Design, before: str) -> Table:
    from bayes_inertia.report.formatting import number, plain, unit_text

    powers = unit_powers((design.units[name], sd) for name, sd in design.sd.items())
    table = narrow_table(
        console, "sd of", before, "with the plan", "paper's slews", "plan / paper's", "unit"
    )
    for name, sd in design.sd.items():
        power, paper = powers[design.units[name]], design.reference_sd[name]
        sds = (number(x, x, power) for x in (design.sd_before[name], sd, paper))
        ratio, unit = f"{sd / paper:.2f}", unit_text(design.units[name], power)
        table.add_row(
            plain(name),
            *sds,
            ratio,
            unit,
            style="yellow" if sd > REPORT_LAYOUT.worse_sd_ratio * paper else "",
        )
    return table


def _show_margins(console: Console, design: Design) -> None:
    """The tightest margins, and all that are broken."""
    margins = sorted(design.flown, key=lambda m: m.left)
    shown = [m for i, m in enumerate(margins) if i < LAYOUT.margins_of_design or not m.kept]
    more = f" ({len(margins) - len(shown)} more are kept)" if len(shown) < len(margins) else ""
    console.print(headed(f"tightest margins when flown in closed loop{more}:"))
    for margin in shown:
        console.print(Text.assemble("  ", ("" if margin.kept else "BROKEN ", "red"), margin.says))
    console.print(f"limits that hold the design back: {', '.join(design.active) or 'none'}")


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
