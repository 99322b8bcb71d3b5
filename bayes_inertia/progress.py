"""Progress of long work: one callback, passed down to whatever takes seconds, and the bar it moves.

Who calls a function asks for the bar by `progress=True`; a callback of one's own does as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import wraps
from time import monotonic
from typing import TYPE_CHECKING, Any

from bayes_inertia.errors import SettingsError, require

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import ProgressColumn

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, of); `of` is 0 for a stage that is not counted.

A counted stage ends with what is counted: ("sampling, steps", 10, 128).
"""

# Time [s] over which the speed of a stage is averaged: one fit of many may last minutes.
_SPEED_PERIOD_S = 3600.0
# A notebook redraws at most so often [s]: the page would take the time of the fit.
_REDRAW_PERIOD_S = 0.2


def silent(stage: str, done: int, of: int) -> None:
    """Tell nobody: the progress of work that nobody watches."""


def as_callback(progress: Progress | bool | None) -> Progress:
    """The callback that was given, or one that tells nobody; `SettingsError` for anything else."""
    if callable(progress):
        return progress
    told, advice = progress is None or isinstance(progress, bool), "give True, None or a callback"
    what = f"{progress!r} is no callback"
    require(told, "progress", what, advice, error=SettingsError)
    return silent


def with_bar[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """The same function; `progress=True` shows a bar, in a terminal or a notebook.

    Examples
    --------
    >>> @with_bar
    ... def work(n, *, progress=None):
    ...     progress("counting", 1, n)
    ...     return n
    >>> work(3, progress=True), work(3, progress=print)
    counting 1 3
    (3, 3)
    """

    @wraps(function)
    def shown(*args: P.args, **kwargs: P.kwargs) -> R:
        wanted: Any = kwargs.get("progress")
        if not isinstance(wanted, bool):
            return function(*args, **kwargs)
        if not wanted:
            return function(*args, **kwargs | {"progress": None})  # type: ignore[arg-type]
        with progress_bar() as progress:
            return function(*args, **kwargs | {"progress": progress})  # type: ignore[arg-type]

    return shown


@contextmanager
def progress_bar(console: Console | None = None) -> Iterator[Progress]:
    """A callback that shows stage and time left while the context lasts.

    On stderr, where that is a terminal, or below the cell of a notebook; else nowhere.
    """
    from rich.console import Console

    shown = console or Console(stderr=True, markup=False, emoji=False, highlight=False)
    if shown.is_jupyter:
        with _below_the_cell() as update:
            yield update
    elif shown.is_terminal and not shown.quiet:
        with _on_terminal(shown) as update:
            yield update
    else:
        yield silent


@contextmanager
def _on_terminal(console: Console) -> Iterator[Progress]:
    """A line of a terminal that goes away in the end."""
    from rich.progress import Progress as Live
    from rich.progress import SpinnerColumn

    spinner = SpinnerColumn("line" if console.options.ascii_only else "dots")
    live = Live(
        spinner,
        _stage_column(),
        console=console,
        transient=True,
        speed_estimate_period=_SPEED_PERIOD_S,
    )
    with live:
        live.add_task("starting", total=None)

        def update(stage: str, done: int, of: int) -> None:
            if stage != live.tasks[0].description:
                # Anew, so that the time that is left counts from the beginning of this stage.
                live.remove_task(live.tasks[0].id)
                live.add_task(stage, total=of or None)
            live.update(live.tasks[0].id, completed=done)

        yield update


def _stage_column() -> ProgressColumn:
    """The time since the work began, the stage, how far it is, and what is left of it."""
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    began = monotonic()

    class Stage(ProgressColumn):
        def render(self, task: Task) -> Text:
            left = task.time_remaining if task.total else None
            line = _line(began, task.description, int(task.completed), int(task.total or 0), left)
            return Text(line, overflow="ellipsis")

    return Stage()


@contextmanager
def _below_the_cell() -> Iterator[Progress]:
    """A line of a notebook, without widgets, which pages cannot hold."""
    from IPython.display import display

    began, stage_of, since, drawn = monotonic(), "", monotonic(), 0.0
    line = display({"text/plain": "starting"}, raw=True, display_id=True)

    def update(stage: str, done: int, of: int) -> None:
        nonlocal stage_of, since, drawn
        now = monotonic()
        if stage != stage_of:
            stage_of, since = stage, now
        elif now - drawn < _REDRAW_PERIOD_S:
            return
        drawn, left = now, (now - since) * (of - done) / done if of and done else None
        line.update({"text/plain": _line(began, stage, done, of, left)}, raw=True)

    try:
        yield update
    finally:
        line.update({"text/plain": ""}, raw=True)


def _line(began: float, stage: str, done: int, of: int, left: float | None) -> str:
    """`0:01:40  sampling, steps 10/128, 0:00:09 left`."""
    text = f"{_duration(monotonic() - began)}  {stage}"
    text += f" {done}/{of}" if of else ""
    return text if left is None else f"{text}, {_duration(left)} left"


def _duration(seconds: float) -> str:
    """Hours, minutes and seconds."""
    return str(timedelta(seconds=int(seconds)))
