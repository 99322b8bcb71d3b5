"""SIGINT and SIGTERM end a command within seconds, with a message that says how to go on.

The signal raises `KeyboardInterrupt` in the main thread, where sampling saves its chains. Compiled
code and the compiler do not listen. So a second thread, woken by the signal itself, ends the
process when the main thread has not done so a few seconds later. That loses nothing: every file is
written whole or not at all.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread, current_thread, main_thread
from types import FrameType

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.options import DEMO_FOLDER

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_RUNS = ("fit", "update", "diagnose", "resume", "demo")
_SHOW_CURSOR = "\x1b[?25h"


def how_to_go_on(arguments: Sequence[str]) -> str:
    """Advice after a command was interrupted.

    >>> how_to_go_on(["study", "my_campaign", "-o", "no/such/folder"])
    'nothing was written; the same command begins again'
    """
    words = list(arguments)
    command = next((word for word in words if not word.startswith("-")), "")
    folder = _folder(words, command)
    if command in _RUNS and folder is not None:
        run = folder / "fit" if command == "demo" else folder
        if (run / "run.json").exists():
            return f"what was computed is kept; `bayes-inertia resume {run}` goes on"
    if folder is not None and folder.is_dir() and any(folder.iterdir()):
        return f"what was finished is kept in {folder}; the same command goes on there"
    return "nothing was written; the same command begins again"


def _folder(words: Sequence[str], command: str) -> Path | None:
    """The folder in which a command works."""
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word in ("-o", "--out"):
            return Path(following)
        if word.startswith("--out="):
            return Path(word.removeprefix("--out="))
        if word.startswith("-o") and not word.startswith("--"):
            return Path(word.removeprefix("-o"))
    if command == "demo":
        return DEMO_FOLDER
    if command in ("resume", "report"):
        after = words[words.index(command) + 1 :]
        return next((Path(word) for word in after if not word.startswith("-")), None)
    return None


class Interruption:
    """The signal that ends a command, if one came; `advice` says what to do next."""

    def __init__(self, advice: Callable[[], str]):
        self._advice = advice
        self._number = signal.SIGINT
        self._said = Event()
        self.signalled = False

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal: 130 after SIGINT, 143 after SIGTERM."""
        return 128 + self._number

    def say(self) -> None:
        """Write the message on stderr, once."""
        if self._said.is_set():
            return
        self._said.set()
        word = "terminated" if self._number == signal.SIGTERM else "interrupted"
        cursor = _SHOW_CURSOR if sys.stderr.isatty() else ""
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        with suppress(OSError, ValueError):
            print(f"{cursor}{word}: {self._advice()}", file=sys.stderr, flush=True)

    def end_process(self) -> None:
        """Say the message, end the workers, and leave without waiting for other threads."""
        self.say()
        end_workers()
        os._exit(self.exit_code)

    def came(self, number: int, _: FrameType | None) -> None:
        """Raise `KeyboardInterrupt` in the main thread, as the handler of a signal."""
        self._number = signal.Signals(number)
        self.signalled = True
        raise KeyboardInterrupt

    def watch(self, wakeups: socket.socket) -> None:
        """Wait for a signal, and end the process where the main thread does not."""
        with wakeups:
            first = _next_signal(wakeups)
            if first is None:
                return
            self._number = first
            wakeups.settimeout(LAYOUT.grace_s)
            # Until the command has ended, or a second signal comes: its sender does not want to
            # wait.
            with suppress(TimeoutError):
                _next_signal(wakeups)
        self.end_process()


def _next_signal(wakeups: socket.socket) -> signal.Signals | None:
    """The next signal that ends the command; None if no more will come."""
    while byte := wakeups.recv(1):
        if byte[0] in _SIGNALS:
            return signal.Signals(byte[0])
    return None


def end_workers() -> None:
    """End all processes that this one started."""
    import psutil

    with suppress(psutil.Error):
        workers = psutil.Process().children(recursive=True)
        for worker in workers:
            with suppress(psutil.Error):
                worker.terminate()
        for worker in psutil.wait_procs(workers, timeout=LAYOUT.workers_grace_s)[1]:
            with suppress(psutil.Error):
                worker.kill()


@contextmanager
def ending_soon_on_signals(advice: Callable[[], str]) -> Iterator[Interruption]:
    """Let SIGINT and SIGTERM end what runs in the context within seconds.

    A signal that the process was started to ignore stays ignored.
    """
    interruption = Interruption(advice)
    if current_thread() is not main_thread():
        yield interruption
        return
    reading, writing = socket.socketpair()
    writing.setblocking(False)
    handled = [n for n in _SIGNALS if signal.getsignal(n) is not signal.SIG_IGN]
    before = {number: signal.signal(number, interruption.came) for number in handled}
    fd_before = signal.set_wakeup_fd(writing.fileno(), warn_on_full_buffer=False)
    # A signal to a forked process is none to this one.
    os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))
    Thread(target=interruption.watch, args=(reading,), daemon=True).start()
    try:
        yield interruption
    finally:
        signal.set_wakeup_fd(fd_before)
        for number, handler in before.items():
            signal.signal(number, handler)
        writing.close()
