"""Modules that the end of a task needs, imported while compiled code computes."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from threading import Thread


def import_in_background(names: Sequence[str]) -> Thread:
    """Import modules one after the other, in a thread.

    Compiled code and the compiler need no interpreter lock, so this costs hardly any time.

    Examples
    --------
    >>> import_in_background(["json", "no_such_module"]).join()
    """
    thread = Thread(target=_import_all, args=(tuple(names),), daemon=True)
    thread.start()
    return thread


def _import_all(names: tuple[str, ...]) -> None:
    for name in names:
        if find_spec(name.partition(".")[0]) is not None:
            import_module(name)
