"""Arguments and options that several commands share."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

import typer

from bayes_inertia.campaign.sensors import CHANNELS

CampaignFolder = Annotated[Path, typer.Argument(help="Campaign folder (with campaign.toml).")]
OutputFolder = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
Seed = Annotated[int, typer.Option(help="One integer that reproduces everything.", min=0)]
EffectNames = Annotated[
    str,
    typer.Option(
        help="Effects to fit along, separated by commas; `effects` lists their names. One of your "
        "own is called FILE.py:Class or package.module:Class. Settings follow a colon: "
        "inertia_change:from_slew=5, flexible_mode:frequency=0.12:damping=0.01."
    ),
]
FurtherCandidates = Annotated[
    str,
    typer.Option(
        "--effects",
        help="Effects to try beyond the library, separated by commas: FILE.py:Class, "
        "package.module:Class, or a name that `effects` lists; or one of the library with "
        "settings, such as flexible_mode:frequency=0.12, which then stands for it.",
    ),
]
DriveName = Annotated[
    Literal["commanded", "measured"] | None,
    typer.Option(help="Drive the model with torque commands or with tachometers."),
]
WithReport = Annotated[bool, typer.Option(help="Also write report.html.")]
OpenPage = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
Anyway = Annotated[
    bool,
    typer.Option(
        "--anyway", help="Go on although the data are impossible under the stated conventions."
    ),
]
Remainder = Annotated[
    Literal["torque", "rate", "both"] | None,
    typer.Option(
        help="Integrate out a torque, an error of the rate sensor, or both, of free shape and "
        "learnt size: J and K stay honest although the model is incomplete."
    ),
]
AsStated = Annotated[
    bool,
    typer.Option(
        "--as-stated",
        help="Take telemetry and noise as they are stated: leave no outlier out, measure no noise.",
    ),
]
NoiseOfChannel = Annotated[
    list[str] | None,
    typer.Option(
        "--noise",
        help="Distribution of a channel's noise: CHANNEL=gaussian or CHANNEL=student_t, with "
        "degrees of freedom as in rate=student_t:6 or rate=student_t:sampled (4 unless given). "
        f"Channels: {', '.join(CHANNELS)}, or a further sensor's name. May be given several times.",
    ),
]
SampledNoise = Annotated[
    str,
    typer.Option(
        "--sample-noise", help="Channels whose noise level is estimated along, separated by commas."
    ),
]
PriorRun = Annotated[
    Path | None,
    typer.Option(
        "--prior",
        help="J and K as a former result has them: the folder of a finished run of this spacecraft "
        "or of a sister, or a JSON file with names, mean and covariance.",
    ),
]
Inflate = Annotated[
    float,
    typer.Option(
        help="How much J and K may have changed since that result: an sd, as a fraction of the "
        "mean moment of inertia and of K, such as 1e-3.",
        min=0.0,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Jobs = Annotated[int, typer.Option(help="Processes.", min=1)]
EngineName = Annotated[
    Literal["process", "joblib", "dask"] | None,
    typer.Option(
        "--engine",
        help="Where tasks run: in this process, in --jobs processes, or on a dask cluster. "
        "Without it --jobs decides between the first two.",
    ),
]
SchedulerAddress = Annotated[
    str | None,
    typer.Option("--scheduler", help="Address of a dask scheduler, such as tcp://host:8786."),
]

# Where `demo` works unless told otherwise.
DEMO_FOLDER = Path("demo_run")
# The word that stands for a plan of the paper's five slews.
PAPER_HELP = "or the word paper for five slews like the paper's"


def names_in(text: str) -> list[str]:
    """Names in a list separated by commas.

    >>> names_in("wheel_friction, rate_bias_drift,")
    ['wheel_friction', 'rate_bias_drift']
    >>> names_in("delay[gyro, spare]")
    ['delay[gyro, spare]']
    """
    return [name.strip() for name in re.split(r",(?![^\[]*\])", text) if name.strip()]
