"""The command line, called from a test."""

from __future__ import annotations

import pytest

from bayes_inertia.app.cli import main


def run(*arguments: object) -> int:
    """The exit code of a command."""
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code
