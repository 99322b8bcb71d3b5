"""Arguments and options of all commands: their types, and what `vocabulary.toml` says of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from importlib.resources import files
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import say
from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.files import vocabulary
from bayes_inertia.progress import Progress

if TYPE_CHECKING:
    from bayes_inertia.studies.engine import Execution

DriveName = Literal["commanded", "measured"]
FormatName = Literal["acm", "apm", "json", "csv", "matlab", "latex", "basilisk", "42"]
EngineName = Literal["process", "joblib", "dask"]

# Where `demo` works unless told otherwise.
DEMO_FOLDER = Path("demo_run")
TEMPLATES = files("bayes_inertia") / "templates"
# By the name of a spacecraft, the file of its commented campaign.
LIKE = {file.name.removesuffix(".toml"): file for file in sorted(TEMPLATES.iterdir(), key=str)}
_FILLED_IN = {
    "campaigns_of_study": LAYOUT.campaigns_of_study,
    "fits_of_calibration": LAYOUT.fits_of_calibration,
    "channels": ", ".join(CHANNELS),
    # The word that stands for a plan of the paper's five slews.
    "paper": "or the word paper for five slews like the paper's",
    "templates": ", ".join(LIKE),
}


@dataclass(frozen=True)
class FitOptions:
    """Options that `fit`, `update` and `diagnose` share."""

    effects: str = ""
    drive: DriveName | None = None
    seed: int = 0
    report: bool = True
    open_page: bool = False
    anyway: bool = False
    as_stated: bool = False
    as_json: bool = False


@dataclass(frozen=True)
class EngineOptions:
    """Options that say where the tasks of a study run."""

    engine: EngineName | None = None
    scheduler: str | None = None
    jobs: int = 1

    def execution(self, progress: Progress) -> Execution:
        """Where these tasks run, with progress and notices on the terminal."""
        from bayes_inertia.studies.engine import Execution

        return Execution(self.engine, self.jobs, self.scheduler, progress, say)


@dataclass(frozen=True)
class DesignRequest:
    """Options of `design`; None where nothing was asked."""

    goal: str = "cross_terms"
    slews: int = 5
    total_time: float | None = None
    max_rate: float | None = None  # [deg/s]
    max_angle: float | None = None  # [deg]
    max_acceleration: float | None = None  # [deg/s^2]
    keep_out: list[str] | None = None
    end_attitude: str | None = None
    after: bool = False
    effects: str = ""
    seed: int = 0


def described(name: str, command: Callable[..., None]) -> Callable[..., None]:
    """A command as Typer takes it: each parameter with what `vocabulary.toml` says of it.

    A parameter that is a dataclass stands for its fields, which are options of the command.
    """
    groups: dict[str, Any] = {}
    parameters: list[Parameter] = []
    for parameter in signature(command, eval_str=True).parameters.values():
        kind = parameter.annotation
        if is_dataclass(kind):
            groups[parameter.name] = kind
        parameters += _parameters(kind) if is_dataclass(kind) else [parameter]

    @wraps(command)
    def run(**given: Any) -> None:
        for key, kind in groups.items():
            given[key] = kind(**{field.name: given.pop(field.name) for field in fields(kind)})
        command(**given)

    told: Any = run
    told.__signature__ = Signature([_with_help(name, parameter) for parameter in parameters])
    return run


def _parameters(kind: Any) -> list[Parameter]:
    """The parameters that make a dataclass."""
    return list(signature(kind, eval_str=True).parameters.values())


def _with_help(command: str, parameter: Parameter) -> Parameter:
    """A parameter whose type bears its help, flags and limits; as it is where nothing is said."""
    words = vocabulary("app")
    said = (words["options"] | words["of"].get(command, {})).get(parameter.name)
    if said is None:
        return parameter
    told = {"help": said} if isinstance(said, str) else dict(said)
    flags, argument = told.pop("flags", ()), told.pop("argument", False)
    told["help"] = told["help"].format(**_FILLED_IN)
    form: Any = Annotated
    kind = typer.Argument if argument else typer.Option
    return parameter.replace(annotation=form[parameter.annotation, kind(*flags, **told)])


EXAMPLES: dict[str, list[str]] = vocabulary("app")["examples"]


def example_of(command: str) -> str:
    """The end of a command's help.

    >>> "bayes-inertia check campaign" in example_of("check")
    True
    """
    lines = "\n".join(f"  bayes-inertia {words}" for words in EXAMPLES[command])
    # The sign \\b keeps the help from filling the lines.
    return f"\b\nExample:\n{lines}\n\n`bayes-inertia --help` lists --quiet and --no-cache."


def names_in(text: str) -> list[str]:
    """Names in a list separated by commas.

    >>> names_in("wheel_friction, rate_bias_drift,")
    ['wheel_friction', 'rate_bias_drift']
    >>> names_in("delay[gyro, spare]")
    ['delay[gyro, spare]']
    """
    return [name.strip() for name in re.split(r",(?![^\[]*\])", text) if name.strip()]
