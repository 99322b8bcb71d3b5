"""The command `bayes-inertia`, collected from its files.

Exit codes: 0 done; 2 bad input, or the machine failed (disk, memory); 3 finished, but the result
must not be trusted as it is; 130 after SIGINT, 143 after SIGTERM.

What the machine did to a command, in one message: memory, disk, processes.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from typing import Annotated

import typer

from bayes_inertia.app.commands import campaigns, check, import_raw, many, plans, runs
from bayes_inertia.app.compiled_code import compiled_code_kept
from bayes_inertia.app.interruption import ending_soon_on_signals, how_to_go_on
from bayes_inertia.app.options import described, example_of
from bayes_inertia.app.terminal import quietly, safe_message, usable_streams
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.version import __version__

COMMANDS: dict[str, Callable[..., None]] = {
    "new": campaigns.new_command,
    "import": import_raw.import_command,
    "check": check.check_command,
    "fit": runs.fit_command,
    "fit-many": many.fit_many_command,
    "update": runs.update_command,
    "diagnose": runs.diagnose_command,
    "observe": plans.observe_command,
    "design": plans.design_command,
    "compare": plans.compare_command,
    "history": many.history_command,
    "fleet": many.fleet_command,
    "study": many.study_command,
    "resume": runs.resume_command,
    "report": runs.report_command,
    "export": runs.export_command,
    "simulate": campaigns.simulate_command,
    "effects": check.effects_command,
    "demo": runs.demo_command,
    "doctor": check.doctor_command,
}


def command_line() -> typer.Typer:
    """The command with all its subcommands."""
    app = typer.Typer(
        name="bayes-inertia",
        help="Inertia tensor and rate-sensor scale factors of a spacecraft from slew telemetry, "
        "with honest uncertainty.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        # Units such as [deg/s] in the help would be taken for markup.
        rich_markup_mode=None,
    )
    app.callback()(described("", _options))
    for name, command in COMMANDS.items():
        app.command(name, epilog=example_of(name))(described(name, command))
    return app


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bayes-inertia {__version__}")
        raise typer.Exit


def _options(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Say the version and exit.", callback=_show_version, is_eager=True
        ),
    ] = False,
    cache: bool = True,
    quiet: bool = False,
) -> None:
    # Many small programs one after another: a GPU takes two to five times as long for them.
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    context.with_resource(quietly(quiet))
    context.with_resource(compiled_code_kept(cache))


def main(arguments: list[str] | None = None) -> None:
    """Run the command and exit with its code."""
    words = sys.argv[1:] if arguments is None else arguments
    # The interpreter would look at every object once more before it ends, for most of a second.
    atexit.register(gc.freeze)
    with usable_streams(), ending_soon_on_signals(lambda: how_to_go_on(words)) as interruption:
        try:
            code = _exit_code(words)
        except (typer.Abort, KeyboardInterrupt):
            interruption.say()
            code = interruption.exit_code
        # Typer makes an exit code of a signal too, its own.
        if interruption.signalled:
            interruption.end_process()
    sys.exit(code)


def _quiet_first(words: list[str]) -> list[str]:
    """The words with --quiet where options of all commands stand: before the command."""
    quiet = [word for word in words if word in ("--quiet", "-q")]
    return [*quiet[:1], *(word for word in words if word not in quiet)]


def _exit_code(words: list[str]) -> int:
    """The exit code of a command, errors said on stderr."""
    try:
        code = command_line()(args=_quiet_first(words), standalone_mode=False)
        sys.stdout.flush()
        return code or 0
    except BayesInertiaError as error:
        typer.echo(f"error: {safe_message(str(error))}", err=True)
    except typer.TyperException as error:
        error.show()  # type: ignore[attr-defined]
        return error.exit_code
    except Exception as error:
        message = failure_message(error)
        if message is None:
            raise
        typer.echo(f"error: {safe_message(message)}; {how_to_go_on(words)}", err=True)
    return 2


_ALLOCATION_FAILED = ("RESOURCE_EXHAUSTED", "Out of memory", "Unable to allocate", "bad_alloc")


def failure_message(error: Exception) -> str | None:
    """Message on an exception that the machine caused and not the program.

    >>> failure_message(MemoryError())
    'out of memory; close other programs, or use a machine with more'
    >>> failure_message(OSError(28, "No space left on device", "/run/a.nc"))
    '/run/a.nc: No space left on device; check that the disk has space and may be written'
    >>> failure_message(KeyError("x"))
    """
    text = f"{type(error).__name__} {error}"
    if isinstance(error, MemoryError) or any(part in text for part in _ALLOCATION_FAILED):
        return "out of memory; close other programs, or use a machine with more"
    if isinstance(error, BrokenExecutor):
        return (
            "a worker process was ended from outside, perhaps for want of memory; "
            "start again with fewer --jobs"
        )
    if isinstance(error, OSError) and error.errno is not None:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}; check that the disk has space and may be written"
    if isinstance(error, OSError | RuntimeError) and (reason := disk_failure(error)):
        return f"a file cannot be written ({reason}); check that the disk has space"
    return None


def disk_failure(error: Exception) -> str:
    """The reason that the HDF5 library gives in the middle of its words.

    >>> disk_failure(RuntimeError("write failed: errno = 28, error message = 'No space', buf = 0"))
    'No space'
    """
    text = str(error)
    if "errno = " not in text or "error message = '" not in text:
        return ""
    return text.partition("error message = '")[2].partition("'")[0]
